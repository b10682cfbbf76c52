"""What an effect is: one page of physics.

A page says what the effect is and gives its parameters, its station in the machine and its law. It also says what the
law promises and what the effect is easily mistaken for. Every other text about the effect (kernel, FMU, report
equation, Modelica) is generated from the law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from twin.display.table import DisplayTable, Tabular
from twin.effects.parameter import Parameter

Law = Callable[[Any, Any], Any]

#: Where a law is called by the stepper, what it may read and what it returns.
SLOTS: Mapping[str, tuple[tuple[str, ...], str]] = {
    # The position is the motor's.
    "drive": (("command", "emf", "heat", "position"), "command that acts, in the input's unit; laws apply in turn"),
    "load": (("position", "velocity", "time", "moment"), "torque on the link; laws add up"),
    # On motor and link by `shaft_share`, at the place of each.
    "shaft": (("position",), "torque on motor and link; laws add up"),
    "drag": (("position", "velocity"), "smooth resistance, against the speed; laws add up"),
    "bristle": (("bend",), "friction on the motor by how far its bristles are bent; laws add up"),
    "rider": (("tug",), "torque on the link by what rides on it, drawn back with the acceleration `tug`; laws add up"),
    "grip": (("position", "velocity", "direction", "transmitted", "time"), "size of the dry friction; laws add up"),
    "mass": (("position", "time", "payload"), "inertia added to the link; laws add up"),
    # The gap is motor position minus link position.
    "sensor": (("position", "gap"), "what the sensor adds to the true position; laws add up"),
    "structure": ((), "acts through the stepper itself"),
}


@dataclass(frozen=True)
class Recorded:
    """What a page may know of a recording to say where a search for its effect begins."""

    end: float  # s, the length of the recording
    lowest: float  # least position, in the axis' unit
    travel: float  # greatest position minus least
    turns: bool  # the axis turns; else it is a linear one
    step: float  # s, between two readings
    lever: float  # what an angle of 1 rad is in the axis' unit


@dataclass(frozen=True)
class Seen(Recorded):
    """What a page may know to say where a search for its effect begins: the recording, and a model of it that lacks the
    effect.
    """

    fast: float  # speed that is exceeded for a twentieth of the time, in the axis' unit per s
    span: float  # largest command either way, in the input's unit
    heating: float  # command that heats a held motor as the recording does in the mean, in the input's unit
    push: float  # acceleration that the largest command makes, in the axis' unit per s^2
    dry_friction: float | None  # size of the model's dry friction, over inertia; None where it has none


@dataclass(frozen=True)
class Screen:
    """How to look for an effect before it is fitted.

    `gain` is the parameter whose neutral value switches the effect off. Where the law also has a phase or rest
    position, `phase` names it. `combine` then makes (gain, phase) of two amounts: that of the law at phase zero, and
    that of its derivative by the phase. `grid` holds trial values of other parameters; where they depend on what is
    seen, `trials` gives them row by row. A law that acts at one place or time is `local`. It has many rows, and those
    whose law best follows the missing torque are tried. `rate` names a parameter that says how often the law repeats
    over the position or the time: its values are the strongest lines of the missing torque. `moment` names the
    parameter that says when in a recording the effect begins.
    """

    gain: str
    phase: str | None = None
    combine: Callable[[float, float], tuple[float, float]] | None = None
    grid: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    trials: Callable[[Seen], list[dict[str, float]]] | None = None
    local: bool = False
    rate: str | None = None
    moment: str | None = None


@dataclass(frozen=True)
class Effect(Tabular):
    """One page. `promises` are among dissipative, odd, memoryless, state: the contract test holds it to them."""

    id: str
    title: str
    station: str  # drive, motor, transmission, friction, load, inertia, sensor, disturbance
    slot: str
    parameters: tuple[Parameter, ...]
    law: Law | None
    depends_on: tuple[str, ...]
    promises: frozenset[str]
    sentence: str  # what was left out, with {parameter} values to be filled in
    reference: str
    confused_with: Mapping[str, str]  # other effect's id -> the experiment that tells them apart
    equation: str | None = None  # LaTeX, only where there is no law to generate it from
    screen: Screen | None = None
    includes: tuple[str, ...] = ()  # effects that this one cannot be without
    substeps: int = 1  # internal steps per 2 ms that the effect needs
    plausible: Callable[[Mapping[str, float], Recorded], bool] | None = None  # whether fitted values still mean it

    def __repr__(self) -> str:
        return f"{self.id}: {self.title} ({', '.join(p.name for p in self.parameters)}), acts at the {self.station}"

    def __str__(self) -> str:
        return str(self.table())

    def table(self) -> DisplayTable:
        """Its parameters, and how to tell it from what it is confused with."""
        rows = [(p.name, p.unit_for("rad", "%"), p.meaning) for p in self.parameters]
        notes = [f"not {other}: {experiment}" for other, experiment in self.confused_with.items()]
        title = f"{self.id}: {self.title}, acts at the {self.station}"
        return DisplayTable(title, ("parameter", "unit", "meaning"), rows, notes)
