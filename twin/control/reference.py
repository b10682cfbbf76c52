"""What the axis is asked to follow: position, velocity and acceleration at every sample."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.control.controller import Controller
from twin.errors import BadInput
from twin.io.rig_file import split_unit
from twin.io.tables.formats import open_table
from twin.io.tables.table import Table, listing
from twin.io.units import POSITION_UNITS, SPEED_UNITS, TIME_UNITS, Units

FloatArray = NDArray[np.floating[Any]]
KINDS = ("minimum-jerk", "sine", "step")
TRAVEL = {"rad": 1.0, "m": 0.1, "kcount": 0.5}  # unless an amplitude is given
_ACCELERATION_UNITS: Units = {f"{u}/s": (f"{kept}^2", factor) for u, (kept, factor) in SPEED_UNITS.items()} | {
    f"{unit}^2": (f"{kept}^2", factor) for unit, (kept, factor) in SPEED_UNITS.items()
}
#: Names and units of the columns of a reference file, names without signs and in small letters.
_COLUMNS: Mapping[str, tuple[tuple[str, ...], Units]] = {
    "time": (("time", "t"), TIME_UNITS),
    "position": (("position", "reference"), POSITION_UNITS),
    "velocity": (("velocity", "referencevelocity"), SPEED_UNITS),
    "acceleration": (("acceleration", "referenceacceleration"), _ACCELERATION_UNITS),
}
_LARGEST = 1e12  # s, or the axis' unit: no axis gets there
_MOST_SAMPLES = 5e6
#: A file of more points than this, each so many seconds after the one before, has its time in another unit.
_FEW_POINTS, _SLOWEST = 50, 0.5
SHARE = 0.4  # of the reachable speed and acceleration that a made reference uses


@dataclass(frozen=True, eq=False)
class Reference:
    """Arrays (N,) in s and the axis' unit, evenly spaced; `kind` says where it comes from."""

    kind: str
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    @property
    def travel(self) -> float:
        return float(np.ptp(self.position))

    @property
    def rests_from(self) -> float:
        """Time from which the reference stands still until its end, s."""
        moving = np.flatnonzero((self.velocity != 0.0) | (np.diff(self.position, append=self.position[-1]) != 0.0))
        return float(self.time[min(moving[-1] + 1, len(self.time) - 1)]) if len(moving) else float(self.time[0])

    def __repr__(self) -> str:
        return f"{self.kind} reference, {self.time[-1]:.3g} s, over {self.travel:.3g}"


def _move(t: FloatArray, begin: float, length: float, distance: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One minimum-jerk move (Flash and Hogan, J. Neuroscience 5, 1985)."""
    s = np.clip((t - begin) / length, 0.0, 1.0)
    return (
        distance * s**3 * (10 - 15 * s + 6 * s**2),
        distance / length * 30 * s**2 * (1 - s) ** 2,
        distance / length**2 * 60 * s * (1 - s) * (1 - 2 * s),
    )


def make_reference(
    kind: str, controller: Controller, amplitude: float | None = None, duration: float | None = None
) -> Reference:
    """A reference within the axis' reach: "minimum-jerk" and "step" go there and back and rest, "sine" swings.

    It begins at 0, or midway between the stops where 0 is not between them. `amplitude` in the axis' unit (by
    default what fits before the upper stop), `duration` in s of the whole. Raises BadInput for an unknown kind or
    numbers that are not usable.
    """
    if kind not in KINDS:
        raise BadInput(f"reference kind is {kind!r}: use one of {', '.join(KINDS)}, or a CSV file")
    lower, upper = controller.ends
    begin = 0.0 if lower < 0.0 < upper else 0.5 * (lower + upper)
    room = (upper - begin) * (1.6 if kind == "sine" else 0.8)
    size = min(TRAVEL[controller.axis_unit], room) if amplitude is None else amplitude
    for name, value in (("amplitude", size), ("duration", 1.0 if duration is None else duration)):
        if not (math.isfinite(value) and value > 0.0):
            raise BadInput(f"reference {name} is {value:g}: give a number above 0")
    length = _motion_length(kind, controller, size)
    rest = max(6.0 / controller.bandwidth, 1.0)
    # Lead-in, there, rest, back, rest; or a lead-in and four swings.
    whole = rest + (4.0 * length if kind == "sine" else 2.0 * (length + rest))
    stretch = 1.0 if duration is None else duration / whole
    lead, length = 0.5 * rest * stretch, length * stretch
    rest *= stretch
    if not whole * stretch / controller.sample_time <= _MOST_SAMPLES:
        raise BadInput(
            f"{kind} reference would last {whole * stretch:.3g} s, over {_MOST_SAMPLES:.0f} samples of "
            f"{controller.sample_time:g} s, at a bandwidth of {controller.bandwidth:.3g} Hz: give a shorter duration, "
            "a smaller amplitude or a faster controller"
        )
    t = np.arange(max(int(whole * stretch / controller.sample_time), 2)) * controller.sample_time
    if kind == "sine":
        position, velocity, acceleration = _swing(t, lead, length, 0.5 * size)
        return Reference(kind, t, begin + position, velocity, acceleration)
    back = lead + length + rest
    if kind == "step":
        zero = np.zeros_like(t)
        return Reference(kind, t, begin + np.where((t >= lead) & (t < back), size, 0.0), zero, zero)
    there, again = _move(t, lead, length, size), _move(t, back, length, -size)
    position, velocity, acceleration = (a + b for a, b in zip(there, again, strict=True))
    return Reference(kind, t, begin + position, velocity, acceleration)


def _motion_length(kind: str, controller: Controller, size: float) -> float:
    """The time of one move, or the period of a sine, s: within the axis' reach and slower than the loop. Raises
    BadInput for a controller that reaches nothing.
    """
    speed, pull = SHARE * min(controller.reachable_speed, 1e6), SHARE * controller.reachable_acceleration
    if not (speed > 0.0 and pull > 0.0):
        raise BadInput(
            f"the controller reaches {controller.reachable_speed:g} {controller.axis_unit}/s and "
            f"{controller.reachable_acceleration:g} {controller.axis_unit}/s^2: both must be above 0; design it anew"
        )
    slow = 1.0 / controller.bandwidth
    if kind == "minimum-jerk":
        return max(1.875 * size / speed, math.sqrt(5.7735 * size / pull), 3.0 * slow)
    if kind == "sine":
        return 2.0 * math.pi * max(0.5 * size / speed, math.sqrt(0.5 * size / pull), slow)
    return max(2.0 * size / speed, 4.0 * math.sqrt(size / pull), 4.0 * slow)


def _swing(t: FloatArray, begin: float, period: float, half: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A sine of amplitude `half`, which grows over its first period, smoothly to the second derivative."""
    w = 2.0 * math.pi / period
    on = np.clip((t - begin) / period, 0.0, 1.0)
    grow = on**3 * (10 - 15 * on + 6 * on**2)
    grow1 = 30 * on**2 * (1 - on) ** 2 / period
    grow2 = 60 * on * (1 - on) * (1 - 2 * on) / period**2
    s, c = np.sin(w * (t - begin)), np.cos(w * (t - begin))
    return (
        half * grow * s,
        half * (grow1 * s + grow * w * c),
        half * (grow2 * s + 2 * grow1 * w * c - grow * w * w * s),
    )


def read_reference(path: Path, controller: Controller) -> Reference:
    """A reference from a table in any format that a recording may have.

    Columns `time` or `t` and `position` or `reference`, optionally `velocity` and `acceleration`; without those they
    are the derivatives of a smooth curve through the points. Units stand behind the names, as in `time [ms]` or
    `position_deg`, or in a row of their own; without one they are s and the axis' unit.

    Parameters
    ----------
    path
        The file.
    controller
        Gives the sample time and the axis' unit.

    Raises
    ------
    BadInput
        Where the file cannot be read, a column or a value is missing, a unit is not that of the axis, or time makes no
        sense.
    """
    table = open_table(path)
    columns, factors = _find_columns(table, controller.axis_unit)
    values = dict(zip(columns, table.columns(list(columns.values())), strict=True))
    for name, column in values.items():
        bad = np.flatnonzero(~(np.abs(column * factors[name]) < _LARGEST))
        if len(bad):
            found = column[bad[0]]
            said = "missing" if np.isnan(found) else f"{found:g}, beyond any axis"
            raise BadInput(f"{path}, {table.where(int(bad[0]))}: {name} is {said}: give a finite number")
        values[name] = column * factors[name]
    time = values["time"]
    if len(time) < 4:
        raise BadInput(f"{path} has {len(time)} rows: give at least 4")
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if len(back):
        raise BadInput(f"{path}, {table.where(int(back[0]) + 1)}: time does not increase: sort the rows by time")
    step, whole = float(np.median(np.diff(time))), float(time[-1] - time[0])
    if whole / controller.sample_time > _MOST_SAMPLES:
        raise BadInput(
            f"{path} lasts {whole:g} s, too many samples of {controller.sample_time:g} s: shorten it, or give the unit "
            "of time, as in 'time [ms]'"
        )
    if step > _SLOWEST and len(time) > _FEW_POINTS and split_unit(columns["time"])[1] is None:
        raise BadInput(
            f"{path}: column '{columns['time']}' makes {step:g} s from row to row, {whole:g} s in all: call it "
            "'time [ms]' if it is in ms, or 'time [s]' if it is in s"
        )
    return _resample(path.name, values, controller.sample_time)


def _find_columns(table: Table, axis_unit: str) -> tuple[dict[str, str], dict[str, float]]:
    """The columns that there are, and the factors of each to s and the axis' unit."""
    columns: dict[str, str] = {}
    factors: dict[str, float] = {}
    for wanted, (aliases, units) in _COLUMNS.items():
        kept = axis_unit + {"velocity": "/s", "acceleration": "/s^2"}.get(wanted, "") if wanted != "time" else "s"
        for column in table.names:
            base, unit = split_unit(column)
            if base not in aliases or wanted in columns:
                continue
            unit = unit or table.units.get(column) or kept
            converted, factor = units.get(unit, ("", 1.0))
            if unit == kept:
                factor = 1.0
            elif converted != kept or unit.startswith("count"):
                raise BadInput(
                    f"{table.name}: column '{column}' is in {unit}, the controller's {wanted} in {kept}: convert it, "
                    "or correct the unit behind its name"
                )
            columns[wanted], factors[wanted] = column, factor
    for wanted in ("time", "position"):
        if wanted not in columns:
            unit = axis_unit if wanted == "position" else "s"
            raise BadInput(
                f"{table.name}: no column '{wanted}' among {listing(table.names)}: call it '{wanted} [{unit}]' and "
                "give it in that unit"
            )
    return columns, factors


def _resample(name: str, values: Mapping[str, FloatArray], sample_time: float) -> Reference:
    """The reference at every sample."""
    time = values["time"]
    t = np.arange(int((time[-1] - time[0]) / sample_time + 1e-6) + 1) * sample_time
    # A held column is a step reference: its corners are not to be rounded off.
    held = np.mean(np.diff(values["position"]) == 0.0) > 0.5 and "velocity" not in values
    if held:
        before = np.searchsorted(time, t + time[0] + 1e-9, side="right") - 1
        return Reference(name, t, values["position"][before], np.zeros_like(t), np.zeros_like(t))
    from scipy.interpolate import CubicSpline, PchipInterpolator  # slow to import, and only a file has need of it

    curve = CubicSpline(time, values["position"])
    made = [curve(t + time[0])]
    for order, key in ((1, "velocity"), (2, "acceleration")):
        given = PchipInterpolator(time, values[key]) if key in values else curve.derivative(order)
        made.append(given(t + time[0]))
    return Reference(name, t, *made)


def check(reference: Reference, controller: Controller) -> None:
    """Raises BadInput where the reference asks for more than full command can give, by the model's laws."""
    law, p, k = controller.laws, controller.parameter_list, controller.known_list
    g, v = controller.settings, controller.values
    period = np.diff(reference.time)
    if len(period) and not np.allclose(period, controller.sample_time, rtol=1e-6, atol=1e-12):
        raise BadInput(
            f"{reference.kind} reference is spaced by {period[0]:g} s, the controller runs every "
            f"{controller.sample_time:g} s: make it with that spacing"
        )
    for name in ("position", "velocity", "acceleration"):
        if not np.all(np.isfinite(getattr(reference, name))):
            raise BadInput(f"{reference.kind} reference has a {name} that is not finite: mend it")
    lower, upper = controller.ends
    outside = np.flatnonzero((reference.position < lower) | (reference.position > upper))
    if len(outside):
        when, where = reference.time[outside[0]], reference.position[outside[0]]
        raise BadInput(
            f"{reference.kind} reference asks at t = {when:.4g} s for position {where:.4g} {controller.axis_unit}, "
            f"beyond a stop: stay between {lower:.4g} and {upper:.4g}"
        )
    damping = v.get("viscous_friction", 0.0)
    stride = max(1, len(reference.time) // 5000)
    worst, at = 1.0, -1
    for i in range(0, len(reference.time), stride):
        place, speed = float(reference.position[i]), float(reference.velocity[i])
        side = 1.0 if speed > 0.0 else -1.0
        total = 1.0 + law.mass(place, 0.0, k[0], p)
        need = total * float(reference.acceleration[i]) - law.drag(place, speed, p)
        need -= law.load(place, speed, 0.0, k[1], p) + law.shaft(place, p)
        if speed != 0.0:
            need += side * law.grip(place, speed, side, 0.5 * need, 0.0, p)
        way = 1.0 if need > 0.0 else -1.0
        most = way * v["input_gain"] * law.drive(way * g["limit"], damping * speed / v["input_gain"], 0.0, place, p)
        share = abs(need) / most if most > 0.0 else math.inf
        if share > worst:
            worst, at = share, i
    if at >= 0:
        raise BadInput(
            f"{reference.kind} reference asks for {worst:.3g} times what full command can do at t = "
            f"{reference.time[at]:.4g} s (position {reference.position[at]:.4g} {controller.axis_unit}, speed "
            f"{reference.velocity[at]:.4g} {controller.axis_unit}/s, acceleration {reference.acceleration[at]:.4g} "
            f"{controller.axis_unit}/s^2); the axis reaches {controller.reachable_speed:.3g} {controller.axis_unit}/s "
            f"and {controller.reachable_acceleration:.3g} {controller.axis_unit}/s^2: slow it down"
        )
