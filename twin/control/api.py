"""What `import twin` offers for control."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from twin.control import controller_fmu, cosimulation, design, reference
from twin.control.controller import Controller
from twin.control.cosimulation import Tracking
from twin.control.reference import Reference
from twin.errors import BadInput
from twin.fmi.api import check_target
from twin.model.fitted_model import Model


def design_controller(model: Model, bandwidth: float | None = None, limit: float | None = None) -> Controller:
    """Design a feedback-linearising controller for an axis.

    Parameters
    ----------
    model
        The model of the axis.
    bandwidth
        Hz, of the closed loop; by default as high as delay, noise and elasticity allow.
    limit
        Largest command, in the input's unit; by default the drive's, or the largest that was recorded.

    Returns
    -------
    Controller
        ``.margins`` and ``.remarks`` say what it promises; ``.write("controller.toml")`` keeps it.

    Raises
    ------
    BadInput
        No controller has this bandwidth on this axis, or no command moves it.
    """
    return design.design(model, bandwidth, limit)


def make_reference(
    kind: str | Path, controller: Controller, amplitude: float | None = None, duration: float | None = None
) -> Reference:
    """A reference for the closed loop, within the reach of the axis.

    Parameters
    ----------
    kind
        "minimum-jerk", "sine" or "step"; or a CSV file with the columns ``time`` (s) and ``position`` (axis unit).
    controller
        The controller that will follow it.
    amplitude
        Travel of a made reference, in the axis' unit.
    duration
        s, of the whole of a made reference.

    Returns
    -------
    Reference
        Position, velocity and acceleration at every sample; arrays of shape (N,).

    Raises
    ------
    BadInput
        The file cannot be used, or a number is not above 0.
    """
    if str(kind) in reference.KINDS:
        return reference.make_reference(str(kind), controller, amplitude, duration)
    if amplitude is not None or duration is not None:
        kinds = ", ".join(reference.KINDS)
        raise BadInput(f"`amplitude` and `duration` shape {kinds}, not a file like {kind}: leave them out")
    return reference.read_reference(Path(kind), controller)


def cosimulate(
    plant: str | Path | Model, controller: Controller, reference: str | Path | Reference = "minimum-jerk",
    names: Mapping[str, str] | None = None, same_structure: bool = True,
) -> Tracking:  # fmt: skip
    """Run the closed loop of a plant and a controller.

    Parameters
    ----------
    plant
        The file of an FMU, which FMPy runs; or a model, which runs in this process.
    controller
        The controller, from `design_controller` or ``Controller.read``.
    reference
        "minimum-jerk", "sine", "step", a CSV file, or what `make_reference` made.
    names
        The FMU's own names of the variables, where they differ: ``{"duty": "motor_command"}``.
    same_structure
        Refuse an FMU with other effects than the controller was designed for.

    Returns
    -------
    Tracking
        ``.rms`` and ``.peak`` error of the link in the axis' unit, ``.effort``, and arrays of shape (N,).

    Raises
    ------
    BadInput
        The FMU cannot be run, has other variables or effects, or the reference is beyond reach.
    """
    wanted = reference if isinstance(reference, Reference) else make_reference(reference, controller)
    if isinstance(plant, Model):
        return cosimulation.simulate(plant, controller, wanted)
    return cosimulation.run(Path(plant), controller, wanted, names, same_structure)


def export_controller(
    controller: Controller, out: str | Path, target: str = "python", fmi: int = 2, force: bool = False
) -> Path:
    """Write a controller as an FMU; parameters, result and errors are those of `export_fmu`."""
    check_target(target, fmi)
    if target == "native":
        return controller_fmu.export_native(controller, Path(out), fmi, force)
    return controller_fmu.export_controller(controller, Path(out), force)
