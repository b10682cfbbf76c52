"""What an FMU of a model shows to the outside: one list, which every kind of FMU is written from.

Communication steps are run as `twin.codegen.kalman_loops.predict` runs the steps of a recording. A piece between two
edges of the command, of length d, takes max(1, int(d / model.longest_step + ROUND)) equal internal steps. The command
is held over a communication step and acts `delay` later. With a delay, the commands on their way stand in a line,
oldest first, as pairs (time since the start at which it was given, value); `acting_command` is the one that acts (0
until the first arrives). At the start of a communication step its command joins the line. Then this repeats until the
step is done. The head leaves the line and acts once its time + delay <= now. The next piece ends where the new head
will arrive or the step ends, whichever is first. Moments within (1 - ROUND) * model.longest_step are the same moment. A
full line makes room by joining the two neighbours that together lasted shortest (the first such pair), to their mean
over that time.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from twin.errors import BadInput
from twin.model.equations import trace
from twin.model.fitted_model import Model
from twin.model.stepper import KNOWN, STATES

#: What is added before the number of internal steps is cut to an integer, as in twin.codegen.kalman_loops.
ROUND = 0.999999

#: Names of the stepper's states, in its order; `time` is what importers call their own clock.
STATE_NAMES: tuple[str, ...] = tuple("time_since_start" if s == "time" else s for s in STATES)

OUTPUTS: tuple[str, ...] = ("position", "velocity", "position_measured")

#: Sizes that are usual, by which solvers scale their tolerances: a gap and a ride are small against the travel. The lag
#: is of the size of the command.
_USUAL = {"gap": 0.01, "motor_velocity": 1.0, "heat": 1.0, "bend": 1.0, "ride": 0.01, "ride_velocity": 0.1}

_BASE = {
    "1": (1.0, {}),
    "%": (0.01, {}),
    "s": (1.0, {"s": 1}),
    "Hz": (1.0, {"s": -1}),
    "m": (1.0, {"m": 1}),
    "kg": (1.0, {"kg": 1}),
    "A": (1.0, {"A": 1}),
    "K": (1.0, {"K": 1}),
    "rad": (1.0, {"rad": 1}),
    "kcount": (1000.0, {}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
}  # fmt: skip


@dataclass(frozen=True)
class Variable:
    """One variable of the FMU, with the attributes that FMI gives it; None where it has none.

    `reference` is the value reference; references count from 0 in the order of the list.
    `initially_from` names what its value at the start is calculated from.
    """

    name: str
    causality: str  # input, output, parameter, local
    variability: str  # continuous, discrete, tunable, fixed
    initial: str | None  # exact, calculated
    unit: str
    description: str
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    start: float | None = None
    initially_from: tuple[str, ...] = ()
    reference: int = -1


def base_unit(unit: str) -> tuple[float, dict[str, int]]:
    """Factor and exponents of SI base units (kg, m, s, A, K, rad) of a unit such as "rad/s^2/%".

    Raises BadInput for a unit that it cannot read.
    """
    factor, exponents = 1.0, dict.fromkeys(("kg", "m", "s", "A", "K", "rad"), 0)
    for sign, name, power in re.findall(r"([*/]?)([^*/^]+)(?:\^(-?\d+))?", unit):
        if name not in _BASE:
            raise BadInput(f"unit {unit!r}: {name!r} is not a unit the FMU knows: use {', '.join(_BASE)}")
        times = int(power or 1) * (-1 if sign == "/" else 1)
        scale, bases = _BASE[name]
        factor *= scale**times
        for base, exponent in bases.items():
            exponents[base] += exponent * times
    return factor, {base: exponent for base, exponent in exponents.items() if exponent}


def known_read(model: Model) -> tuple[str, ...]:
    """The known quantities that the laws of the structure read, in the stepper's order."""
    laws = [trace(e.id).expression for e in model.structure.effects if e.law is not None]
    read = {symbol.name for law in laws for symbol in law.free_symbols}
    return tuple(name for name in KNOWN if name in read)


def delay_capacity(model: Model) -> int:
    """Number of commands that the delay line holds; 0 without a delay.

    It suffices for the longest delay at communication steps of 1 ms, and for shorter delays at shorter steps.
    """
    if "input_delay" not in model.structure:
        return 0
    return math.ceil(model.parameter("delay").upper / 0.001) + 2


def _bound(value: float) -> float | None:
    return value if math.isfinite(value) else None


def variables(model: Model) -> tuple[Variable, ...]:
    """Every variable of the model's FMU: input, outputs, parameters, hidden states, in this order."""
    parameter, fixed = ("parameter", "tunable", "exact"), ("parameter", "fixed", "exact")
    output, local = ("output", "continuous", "calculated"), ("local", "continuous", "calculated")
    full = 100.0 if model.input_unit == "%" else None
    sensor = tuple(p.name for e in model.structure.effects if e.slot == "sensor" for p in e.parameters)
    least = None if full is None else -full
    found = [
        Variable(
            model.input_name, "input", "continuous", None, "{u}", "command, held over a communication step",
            least, full, full or 1.0, 0.0,
        ),
        Variable(
            "position", *output, "{x}", "position of the link", nominal=1.0, initially_from=("position_start",)
        ),
        Variable(
            "velocity", *output, "{x}/s", "velocity of the link", nominal=1.0, initially_from=("velocity_start",)
        ),
        Variable(
            "position_measured", *output, "{x}", "what the position sensor reads, not quantised", nominal=1.0,
            initially_from=("position_start", *sensor),
        ),
    ]  # fmt: skip
    found += [
        Variable(
            p.name, *parameter, p.unit, p.meaning, _bound(p.lower), _bound(p.upper), abs(p.start) or 1.0,
            float(model.values[p.name]),
        )
        for p in model.structure.parameters
    ]  # fmt: skip
    for name in known_read(model):
        unit, meaning = KNOWN[name]
        found.append(Variable(name, *parameter, unit, meaning, nominal=1.0, start=float(model.known.get(name, 0.0))))
    found += [
        Variable("position_start", *fixed, "{x}", "position of the link at the start", nominal=1.0, start=0.0),
        Variable("velocity_start", *fixed, "{x}/s", "velocity of motor and link at the start", nominal=1.0, start=0.0),
    ]
    if model.holds_moments:
        meaning = "time of the recording at the start: at its end what happened in it is over, at 0 it happens again"
        found.append(Variable("time_start", *fixed, "s", meaning, nominal=1.0, start=model.time_start))
    for name, (unit, meaning) in zip(STATE_NAMES, STATES.values(), strict=True):
        if name not in OUTPUTS:
            origin = ("velocity_start",) if name == "motor_velocity" else ()
            if name == "time_since_start" and model.holds_moments:
                origin = ("time_start",)
            usual = (full or 1.0) if name == "lag" else _USUAL.get(name)
            found.append(Variable(name, *local, unit, meaning, nominal=usual, initially_from=origin))
    found += _delay_line(delay_capacity(model))
    return numbered(found, model.axis_unit, model.input_unit)


def numbered(found: Sequence[Variable], axis_unit: str, input_unit: str) -> tuple[Variable, ...]:
    """The variables with their references, and with the units of axis and input put into theirs."""
    return tuple(replace(v, reference=i, unit=v.unit.format(x=axis_unit, u=input_unit)) for i, v in enumerate(found))


def _delay_line(capacity: int) -> list[Variable]:
    """The commands that are on their way behind a delay, as many as the line holds."""
    held = ("local", "discrete", "calculated")
    if not capacity:
        return []
    line = [
        Variable("acting_command", *held, "{u}", "command that acts, after the dead time"),
        Variable("delay_count", *held, "1", "number of commands that are on their way"),
    ]
    numbers = range(1, capacity + 1)
    meaning = "time since the start at which command {} on its way was given"
    line += [Variable(f"delay_time[{i}]", *held, "s", meaning.format(i)) for i in numbers]
    return line + [Variable(f"delay_value[{i}]", *held, "{u}", f"command {i} on its way") for i in numbers]


def parameters_text(model: Model) -> str:
    """resources/parameters.txt, which an FMU reads when it is instantiated: name, blank, start value."""
    lines = ["# start values; twin update rewrites them"]
    lines += [f"{v.name} {v.start!r}" for v in variables(model) if v.causality == "parameter"]
    return "\n".join(lines) + "\n"
