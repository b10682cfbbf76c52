"""How far a fitted model's free run ends from the recordings that it was fitted to, and whether it lacks physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.diagnosis import holdout, model_comparison, nonparametric
from twin.estimation import prepared_recording
from twin.io.recording import Recording
from twin.model.fitted_model import Model


@dataclass(frozen=True)
class FreeRunError:
    """The error of one free run, and what the missing torque depends on, if on anything.

    Parameters
    ----------
    recording
        Name of the recording.
    rmse
        Root mean square error, in the unit of the output.
    nrmse_percent
        The same in percent of the recorded range.
    depends_on
        The variables that predict the missing torque on blocks that were left out; empty where nothing is left.
    """

    recording: str
    rmse: float
    nrmse_percent: float
    depends_on: tuple[str, ...]


def free_run_errors(model: Model, recordings: Sequence[Recording], closed: bool = False) -> list[FreeRunError]:
    """The error of each free run from the recorded start.

    Parameters
    ----------
    model
        A fitted model.
    recordings
        What to compare it with.
    closed
        Whether to simulate under the rig's own position loop, from its reference.

    Returns
    -------
    list of FreeRunError
        One for each recording.

    Raises
    ------
    BadInput
        Where `closed` is asked for and the loop is not known.
    """
    out = []
    for recording in recordings:
        seen = holdout.simulate_recording(model, recording, closed)
        rmse, percent = model_comparison.rmse(recording.output, seen)
        case = prepared_recording.prepare_recording(recording, model.structure)
        left = nonparametric.remaining_dependence(case, model.structure, model.values)
        depends = left.variables if nonparametric.is_dependence_left(left) else ()
        out.append(FreeRunError(recording.name, rmse, percent, depends))
    return out


def sentences(errors: Sequence[FreeRunError], unit: str) -> list[str]:
    """What the errors say: one line for each recording, and a warning where physics is missing."""
    said = [
        f"free run of {e.recording}: error {e.rmse:.3g} {unit}, {e.nrmse_percent:.3g} % of the range" for e in errors
    ]
    lacking = [e for e in errors if e.depends_on]
    if lacking:
        worst = max(lacking, key=lambda e: e.nrmse_percent)
        said.append(
            f"warning: the model lacks physics: in {worst.recording} the missing torque depends on "
            f"{' and '.join(worst.depends_on)}. Its parameters make up for that. "
            "Run twin diagnose; until then a fit over a horizon serves long runs better."
        )
    return said
