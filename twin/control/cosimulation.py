"""The loop closed: controller and plant side by side, as two FMUs under a master would run.

Both take a step from the same instant with what they knew at it; the command computed from a reading leaves
one sample later. A plant is anything that can be read and stepped: an FMU in FMPy, or the model in process.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twin.codegen import control_law, python
from twin.control.controller import Controller, LimitCycle
from twin.control.reference import Reference, check, make_reference
from twin.display.numbers import number
from twin.display.table import DisplayTable, Tabular
from twin.effects.catalogue import EFFECTS, pages
from twin.errors import BadInput
from twin.fmi.fmu_archive import Fmu, open_fmu
from twin.fmi.fmu_instance import Running, running
from twin.model.fitted_model import Model
from twin.model.stepper import KNOWN, STATES

FloatArray = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Hunting:
    """A limit cycle across the gap: as predicted, and as co-simulation shows it with the gap-aware mode off and on."""

    predicted: LimitCycle
    unaware: LimitCycle | None
    aware: LimitCycle | None

    @property
    def verdict(self) -> str:
        """On the prediction: confirmed, refuted, or seen otherwise than predicted."""
        if self.unaware is None:
            return "refuted"
        ratios = (
            self.unaware.amplitude / self.predicted.amplitude,
            self.unaware.frequency / self.predicted.frequency,
        )
        return "confirmed" if all(0.5 <= r <= 2.0 for r in ratios) else "seen, but not as predicted"

    def sentence(self, unit: str) -> str:
        def words(cycle: LimitCycle | None) -> str:
            return f"{cycle.amplitude:.3g} {unit} at {cycle.frequency:.3g} Hz" if cycle else "none"

        why = ", since load or friction holds the flank" if self.unaware is None else ""
        return (
            f"Limit cycle across the gap: {words(self.predicted)} by its describing function, {self.verdict}; "
            f"in co-simulation without the gap-aware mode {words(self.unaware)}{why}, with it {words(self.aware)}."
        )


@dataclass(frozen=True, eq=False, repr=False)
class Tracking(Tabular):
    """What the closed loop did. Arrays (N,); errors of the true link position against the reference."""

    time: FloatArray  # s
    reference: FloatArray  # axis unit
    position: FloatArray  # axis unit
    input: FloatArray  # input's unit
    rms: float  # axis unit
    peak: float  # axis unit
    effort: float  # RMS of the command, input's unit
    settled: float | None  # s after the reference's last move until within 2 % of the travel for good
    limit_cycle: LimitCycle | None  # at rest, at the end
    says: tuple[str, ...]  # sentences
    hunting: Hunting | None = None  # where a limit cycle was predicted and the reference rests

    @property
    def error(self) -> FloatArray:
        """Position minus reference (N,), axis unit."""
        return self.position - self.reference

    def table(self) -> DisplayTable:
        """Errors and effort, and the sentences about them."""
        settled = "not settled" if self.settled is None else f"{number(self.settled)} s"
        rows = (
            ("RMS error", number(self.rms)),
            ("largest error", number(self.peak)),
            ("RMS command", number(self.effort)),
            ("settles within", settled),
        )
        return DisplayTable(f"closed loop over {number(float(self.time[-1]))} s", ("", ""), rows, self.says)


class Plant(Protocol):
    def read(self) -> tuple[float, float]:
        """True position of the link and what the sensor reads."""

    def advance(self, time: float, command: float, period: float) -> None:
        """Hold the command over one period."""


class ModelPlant:
    """The model itself, without an FMU around it."""

    def __init__(self, model: Model, position: float) -> None:
        names: dict[str, Any] = {}
        exec(compile(python.write(model.structure), "<plant>", "exec"), names)
        self._step, self._sensor = names["step"], names["sensor"]
        self._x = [float(position), *[0.0] * (len(STATES) - 2), model.time_start]
        self._p = [float(model.values[p.name]) for p in model.structure.parameters]
        self._k, self._longest = [float(model.known.get(n, 0.0)) for n in KNOWN], model.longest_step
        self._delay = float(model.values.get("delay", 0.0))
        self._sent: list[tuple[float, float]] = [(-1e9, 0.0)]

    def read(self) -> tuple[float, float]:
        return self._x[0], self._x[0] + self._sensor(self._x[0], self._x[2], self._p)

    def advance(self, time: float, command: float, period: float) -> None:
        self._sent.append((time + self._delay, command))
        now = time
        while now < time + period - 1e-12:
            while len(self._sent) > 1 and self._sent[1][0] <= now + 1e-12:
                self._sent.pop(0)
            until = min([time + period, *(at for at, _ in self._sent[1:2])])
            pieces = max(1, math.ceil((until - now) / self._longest - 1e-9))
            for _ in range(pieces):
                self._step(self._x, self._p, self._k, self._sent[0][1], (until - now) / pieces)
            now = until


class FmuPlant:
    """A plant FMU in FMPy, whose outputs are position and position_measured in this order."""

    def __init__(self, instance: Running) -> None:
        self._instance = instance

    def read(self) -> tuple[float, float]:
        position, measured = self._instance.read()
        return position, measured

    def advance(self, time: float, command: float, period: float) -> None:
        self._instance.step(time, period, [command])


ROLES = ("input", "position", "position_measured")


def _names(fmu: Fmu, controller: Controller, mapping: Mapping[str, str]) -> dict[str, str]:
    """The FMU's own names by role. Raises BadInput."""
    usual = dict(zip(ROLES, (controller.input_name, "position", "position_measured"), strict=True))
    for name in mapping:
        if name not in (*ROLES, controller.input_name):
            raise BadInput(f"cannot map {name!r}: map {', '.join(usual.values())} to the FMU's names")
    offered: dict[str, list[str]] = {"input": [], "output": []}
    for node in fmu.description.findall("ModelVariables/*"):
        offered.setdefault(node.get("causality", "local"), []).append(node.get("name", ""))
    found = {}
    for role, name in usual.items():
        causality = "input" if role == "input" else "output"
        found[role] = mapping.get(role, mapping.get(name, name))
        if found[role] not in offered[causality]:
            raise BadInput(
                f"{fmu.path} has no {causality} {found[role]!r}, only {', '.join(offered[causality]) or 'none'}: "
                f"map it ({name}=NAME)"
            )
    return found


def _check_structure(fmu: Fmu, controller: Controller) -> None:
    """Raises BadInput where the FMU is an axis with other physics than the controller was designed for."""
    nodes = fmu.description.findall("ModelVariables/*")
    parameters = {node.get("name") for node in nodes if node.get("causality") == "parameter"}
    if "input_gain" not in parameters:
        return  # somebody else's FMU: only its variables can be checked
    # An effect without parameters of its own leaves no trace in the description.
    for effect in (id for id, page in EFFECTS.items() if page.parameters):
        names = {p.name for page in pages(effect) for p in page.parameters if not p.acts_on}
        here, there = effect in controller.plant, names <= parameters
        if here != there:
            has, lacks = ("the controller", "the FMU") if here else ("the FMU", "the controller")
            raise BadInput(
                f"{fmu.path}: {has} has {effect}, {lacks} has not: the controller was made for another "
                "structure; design it from this FMU's model with twin control, or try it so with `same_structure=False`"
            )


@contextmanager
def open_plant(
    path: Path, controller: Controller, position: float, mapping: Mapping[str, str], same_structure: bool
) -> Iterator[FmuPlant]:
    """The plant FMU, started at a position. Raises BadInput."""
    fmu = open_fmu(path)
    names = _names(fmu, controller, mapping)
    unit = fmu.unit(names["position"])
    if unit and unit != controller.axis_unit:
        raise BadInput(
            f"{path} moves in {unit}, the controller in {controller.axis_unit}: design it from this FMU's model"
        )
    if same_structure:
        _check_structure(fmu, controller)
    start = {"position_start": position} if "position_start" in fmu.references() else {}
    with running(fmu, [names["input"]], [names["position"], names["position_measured"]]) as instance:
        instance.start(start)
        yield FmuPlant(instance)


class Runner:
    """The controller's text with its memory."""

    def __init__(self, controller: Controller) -> None:
        self._sample = controller.laws.sample
        self._x = [0.0] * len(STATES)
        self._y = [0.0] * len(STATES)
        self._m = [0.0] * len(control_law.MEMORY)
        self._q = [0.0] * (int(controller.settings["whole"]) + 2)
        self._p, self._g = controller.parameter_list, controller.settings_list
        self._k = controller.known_list

    def sample(self, reference: float, velocity: float, acceleration: float, measured: float) -> float:
        """The command to be given from the next sample on."""
        return float(
            self._sample(
                self._x, self._y, self._m, self._q, self._p, self._g, self._k,
                reference, velocity, acceleration, measured,
            )
        )  # fmt: skip


class Sampler(Protocol):
    def sample(self, reference: float, velocity: float, acceleration: float, measured: float) -> float:
        """The command to be given from the next sample on."""


def close(plant: Plant, controller: Controller, reference: Reference, sampler: Sampler | None = None) -> Tracking:
    """Run the loop over the reference; another sampler may take the controller's place."""
    runner, period = sampler or Runner(controller), controller.sample_time
    columns = (c.tolist() for c in (reference.time, reference.position, reference.velocity, reference.acceleration))
    position, given, command = [], [], 0.0
    for time, goal, speed, acceleration in zip(*columns, strict=True):
        place, measured = plant.read()
        if not math.isfinite(place):
            raise BadInput(f"the closed loop ran away at t = {time:.4g} s: lower the bandwidth")
        position.append(place)
        given.append(command)
        following = runner.sample(goal, speed, acceleration, measured)
        plant.advance(time, command, period)
        command = following
    return judge(controller, reference, np.array(position), np.array(given))


def find_limit_cycle(time: FloatArray, position: FloatArray, floor: float) -> LimitCycle | None:
    """A sustained oscillation in a stretch at rest: amplitude and frequency, or None below `floor`.

    Sustained: the second half swings at least half as far as the first, over three periods or more.
    """
    if len(time) < 16:
        return None
    swing = position - 0.5 * (np.max(position) + np.min(position))
    early, late = (float(np.ptp(half)) for half in np.array_split(position, 2))
    if late < max(0.5 * early, 2.0 * floor):
        return None
    half = 0.25 * np.ptp(swing)
    # Crossings with a hysteresis of half the swing, so that noise does not count.
    side = np.where(swing > half, 1, np.where(swing < -half, -1, 0))
    kept = np.flatnonzero(side)
    ups = [kept[i] for i in range(1, len(kept)) if side[kept[i]] > side[kept[i - 1]]]
    if len(ups) < 3:
        return None
    return LimitCycle(0.5 * late, (len(ups) - 1) / float(time[ups[-1]] - time[ups[0]]))


def judge(controller: Controller, reference: Reference, position: FloatArray, command: FloatArray) -> Tracking:
    """Figures and sentences for a run."""
    error = position - reference.position
    unit = controller.axis_unit
    count = controller.settings["resolution"]
    rests = reference.rests_from
    band = max(0.02 * reference.travel, 2.0 * count)
    outside = np.flatnonzero(np.abs(error) > band)
    end = float(reference.time[outside[-1]]) if len(outside) else rests
    settled = max(end - rests, 0.0) if rests < reference.time[-1] and end < reference.time[-1] else None
    rest = float(reference.time[-1]) - rests
    quiet = reference.time >= rests + 0.4 * rest
    floor = max(1.5 * count, 1e-4 * reference.travel, 1e-9)
    cycle = find_limit_cycle(reference.time[quiet], position[quiet], floor) if rest > 0.0 else None
    rms, peak = float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))
    effort = float(np.sqrt(np.mean(command**2)))
    says = [
        f"On the {reference.kind} reference over {reference.travel:.3g} {unit} the link errs by {rms:.3g} {unit} RMS "
        f"and {peak:.3g} {unit} at most, with {effort:.3g} {controller.input_unit} RMS of command."
    ]
    if cycle:
        says.append(f"At rest it hunts: a limit cycle of {cycle.amplitude:.3g} {unit} at {cycle.frequency:.3g} Hz.")
    elif rest > 0.0:
        says.append("At rest it stands still: no limit cycle.")
    clipped = float(np.mean(np.abs(command) >= 0.999 * controller.settings["limit"]))
    if clipped > 0.01:
        says.append(f"The command is at its limit for {100 * clipped:.0f} % of the time.")
    return Tracking(
        reference.time, reference.position, position, command, rms, peak, effort, settled, cycle, tuple(says)
    )  # fmt: skip


def unaware(controller: Controller) -> Controller:
    """The controller as it would be if it knew nothing of the gap, with the same gains."""
    if "backlash_gap" not in controller.values:
        return controller
    return replace(
        controller,
        values={**controller.values, "backlash_gap": 0.0},
        settings={**controller.settings, "tolerance": 0.0},
    )


def _with_hunting(
    tracking: Tracking, controller: Controller, reference: Reference, again: Callable[[Controller], Tracking]
) -> Tracking:
    """Where a limit cycle is predicted: the prediction against a run without the gap-aware mode."""
    if controller.limit_cycle is None or reference.rests_from >= reference.time[-1]:
        return tracking
    found = Hunting(controller.limit_cycle, again(unaware(controller)).limit_cycle, tracking.limit_cycle)
    return replace(tracking, hunting=found, says=(*tracking.says, found.sentence(controller.axis_unit)))


def simulate(model: Model, controller: Controller, reference: Reference) -> Tracking:
    """The loop with the model in process as the plant, which may be another one than the controller's."""

    def once(made: Controller) -> Tracking:
        return close(ModelPlant(model, float(reference.position[0])), made, reference)

    return _with_hunting(once(controller), controller, reference, once)


def run(
    fmu: Path, controller: Controller, reference: Reference | None = None, names: Mapping[str, str] | None = None,
    same_structure: bool = True,
) -> Tracking:  # fmt: skip
    """The loop with the plant FMU in FMPy. `names` maps the usual variable names to the FMU's.

    Raises BadInput: not an FMU, other variables, another structure, a reference beyond reach.
    """
    wanted = make_reference("minimum-jerk", controller) if reference is None else reference
    check(wanted, controller)

    def once(made: Controller) -> Tracking:
        with open_plant(fmu, controller, float(wanted.position[0]), names or {}, same_structure) as plant:
            return close(plant, made, wanted)

    return _with_hunting(once(controller), controller, wanted, once)


def to_json(tracking: Tracking) -> dict[str, Any]:
    """The figures, for other programs."""

    def cycle(found: LimitCycle | None) -> dict[str, float] | None:
        return None if found is None else {"amplitude": found.amplitude, "frequency": found.frequency}

    hunting = tracking.hunting
    return {
        "format": "twin-tracking/1",
        "rms": tracking.rms,
        "peak": tracking.peak,
        "effort": tracking.effort,
        "settled": tracking.settled,
        "limit_cycle": cycle(tracking.limit_cycle),
        "hunting": None
        if hunting is None
        else {
            "predicted": cycle(hunting.predicted),
            "verdict": hunting.verdict,
            "unaware": cycle(hunting.unaware),
            "aware": cycle(hunting.aware),
        },
        "duration": float(tracking.time[-1]),
        "says": list(tracking.says),
    }
