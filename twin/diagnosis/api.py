"""What `import twin` offers for finding what a model leaves out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from twin.diagnosis import diagnose as search
from twin.diagnosis.result import Diagnosis
from twin.estimation import estimate
from twin.io.api import as_list
from twin.io.recording import Recording, as_told, check_units
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

Progress = Callable[[str, float], None]


def diagnose(
    recordings: Recording | Sequence[Recording], first: Structure | Model | None = None, closed_loop: bool = False,
    progress: Progress | None = None,
) -> Diagnosis:  # fmt: skip
    """Find what a first model leaves out: locate it, name it, model it, and check it on data that no fit has seen.

    Parameters
    ----------
    recordings
        One recording of the axis, or several. A part of each, or the recordings with the role "holdout", is kept for
        the check.
    first
        The first model: a structure, whose parameters are fitted; or a model, whose known parameters are kept. By
        default `first_structure` of the recordings.
    closed_loop
        Simulate the rig's own position loop from the recorded reference in the check.
    progress
        Is called with what is being done and the share of the work that is done, 0 to 1.

    Returns
    -------
    Diagnosis
        ``.verdict``, ``.findings``, ``.ranking``, ``.fit`` and ``.model``, the model with what was found.

    Raises
    ------
    BadInput
        The recordings do not allow a diagnosis, or `first` is in other units than they are.
    """
    recordings, tell = as_list(recordings), progress or (lambda sentence, share: None)
    held: dict[str, float] = {}
    if isinstance(first, Model):
        for r in recordings:
            check_units(r, "the first model", first.input_unit, first.axis_unit)
        recordings = [as_told(r, first.known) for r in recordings]
        held, first = estimate.held_parameters(first), first.structure
    structure = estimate.first_structure(recordings) if first is None else first
    estimate.compile_kernel(tell)
    found = search.diagnose(
        recordings, structure, held, progress=lambda s, x: tell(s, 0.05 + 0.95 * x), closed=closed_loop
    )
    before, after = (estimate.with_largest_command(m, recordings) for m in (found.before, found.after))
    return replace(found, before=before, after=after)
