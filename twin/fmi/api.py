"""What `import twin` offers for FMUs."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from twin.errors import BadInput
from twin.fmi import native_fmu, python_fmu
from twin.fmi.evidence import Trial, attach
from twin.io.api import as_list
from twin.io.files import check_free, put
from twin.io.recording import Recording
from twin.model.fitted_model import Model

TARGETS = ("python", "native")


def check_target(target: str, fmi: int) -> None:
    """Raises BadInput for a kind of FMU that is not written."""
    if target not in TARGETS:
        raise BadInput(f"`target` is {target!r}: use one of {', '.join(TARGETS)}")
    if fmi not in (2, 3):
        raise BadInput(f"`fmi` is {fmi}: use 2 or 3")
    if target == "python" and fmi == 3:
        raise BadInput('`target="python"` writes FMI 2 only, through pythonfmu: use `target="native"` for FMI 3')


def export_fmu(
    model: Model, out: str | Path, target: str = "python", fmi: int = 2, force: bool = False,
    evidence: Recording | Sequence[Recording] = (),
) -> Path:  # fmt: skip
    """Write a model as an FMU.

    Parameters
    ----------
    model
        The model of the axis.
    out
        The file, whose name ends in ``.fmu``.
    target
        "python": through pythonfmu; the host needs Python. "native": compiled; the host needs no Python.
    fmi
        The version of the standard, 2 or 3; 3 with ``target="native"`` only.
    force
        Overwrite what is there.
    evidence
        Recordings for the FMU to carry, with how well it fits them (`twin.fmi.evidence`).

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    BadInput
        The file cannot be written, there is no such kind of FMU, or the evidence is of another rig.
    """
    check_target(target, fmi)
    out = Path(out)
    check_free(out, force)
    with tempfile.TemporaryDirectory(prefix="twin-") as folder:
        draft = Path(folder) / "made.fmu"
        if target == "native":
            native_fmu.export_native(model, draft, fmi)
        else:
            python_fmu.export(model, draft)
        if trials := [Trial(recording) for recording in as_list(evidence)]:
            attach(draft, trials)
        put(out, draft.read_bytes())
    return out
