"""What `import twin` offers for FMUs."""

from __future__ import annotations

from pathlib import Path

from twin.errors import BadInput
from twin.fmi import native_fmu, python_fmu
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


def export_fmu(model: Model, out: str | Path, target: str = "python", fmi: int = 2, force: bool = False) -> Path:
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

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    BadInput
        The file cannot be written, or there is no such kind of FMU.
    """
    check_target(target, fmi)
    if target == "native":
        return native_fmu.export_native(model, Path(out), fmi, force)
    return python_fmu.export(model, Path(out), force)
