"""What the axis is asked to follow: position, velocity and acceleration at every sample."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.control.controller import Controller
from twin.errors import BadInput

FloatArray = NDArray[np.floating[Any]]
KINDS = ("minimum-jerk", "sine", "step")
TRAVEL = {"rad": 1.0, "m": 0.1}  # unless an amplitude is given
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
    speed, pull = SHARE * min(controller.reachable_speed, 1e6), SHARE * controller.reachable_acceleration
    slow = 1.0 / controller.bandwidth
    if kind == "minimum-jerk":
        length = max(1.875 * size / speed, math.sqrt(5.7735 * size / pull), 3.0 * slow)
    elif kind == "sine":
        length = 2.0 * math.pi * max(0.5 * size / speed, math.sqrt(0.5 * size / pull), slow)
    else:
        length = max(2.0 * size / speed, 4.0 * math.sqrt(size / pull), 4.0 * slow)
    rest = max(6.0 * slow, 1.0)
    # Lead-in, there, rest, back, rest; or a lead-in and four swings.
    whole = rest + (4.0 * length if kind == "sine" else 2.0 * (length + rest))
    stretch = 1.0 if duration is None else duration / whole
    lead, length = 0.5 * rest * stretch, length * stretch
    rest *= stretch
    t = np.arange(max(int(whole * stretch / controller.sample_time), 2)) * controller.sample_time
    zero = np.zeros_like(t)
    if kind == "sine":
        w = 2.0 * math.pi / length
        on = np.clip((t - lead) / length, 0.0, 1.0)
        # The swing grows over its first period, smoothly to the second derivative.
        grow = on**3 * (10 - 15 * on + 6 * on**2)
        grow1 = 30 * on**2 * (1 - on) ** 2 / length
        grow2 = 60 * on * (1 - on) * (1 - 2 * on) / length**2
        s, c = np.sin(w * (t - lead)), np.cos(w * (t - lead))
        half = 0.5 * size
        return Reference(
            kind, t, begin + half * grow * s, half * (grow1 * s + grow * w * c),
            half * (grow2 * s + 2 * grow1 * w * c - grow * w * w * s),
        )  # fmt: skip
    back = lead + length + rest
    if kind == "step":
        return Reference(kind, t, begin + np.where((t >= lead) & (t < back), size, 0.0), zero, zero)
    there, again = _move(t, lead, length, size), _move(t, back, length, -size)
    position, velocity, acceleration = (a + b for a, b in zip(there, again, strict=True))
    return Reference(kind, t, begin + position, velocity, acceleration)


def read_reference(path: Path, sample_time: float) -> Reference:
    """A reference from CSV: columns `time` or `t` (s) and `position` or `reference`, optionally `velocity` and
    `acceleration`; without those they are the derivatives of a smooth curve through the points. Raises BadInput.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(file))
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such reference file: check the name") from None
    except IsADirectoryError:
        raise BadInput(f"{path} is a folder, not a reference file: name a CSV file") from None
    except (UnicodeDecodeError, csv.Error):
        raise BadInput(f"{path} is not CSV text: give a CSV with columns time and position") from None
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): check its permissions") from None
    rows = [r for r in rows if any(cell.strip() for cell in r)]
    if not rows:
        raise BadInput(f"{path} is empty: give a CSV with columns time and position")
    names = [cell.strip().lower() for cell in rows[0]]
    columns = {}
    for wanted, aliases in {
        "time": ("time", "t"), "position": ("position", "reference"),
        "velocity": ("velocity", "reference_velocity"), "acceleration": ("acceleration", "reference_acceleration"),
    }.items():  # fmt: skip
        here = [names.index(a) for a in aliases if a in names]
        if here:
            columns[wanted] = here[0]
    for wanted in ("time", "position"):
        if wanted not in columns:
            raise BadInput(f"{path}, line 1: no column {wanted!r} among {', '.join(names)}: name it so")
    table = {name: np.empty(len(rows) - 1) for name in columns}
    for line, row in enumerate(rows[1:], start=2):
        for name, at in columns.items():
            cell = row[at].strip() if at < len(row) else ""
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise BadInput(f"{path}, line {line}: {name} is {cell!r}, which is not a finite number: give one")
            table[name][line - 2] = value
    time = table["time"]
    if len(time) < 4:
        raise BadInput(f"{path} has {len(time)} rows: give at least 4")
    if np.any(np.diff(time) <= 0.0):
        line = int(np.flatnonzero(np.diff(time) <= 0.0)[0]) + 3
        raise BadInput(f"{path}, line {line}: time does not increase: sort the rows by time")
    if (time[-1] - time[0]) / sample_time > 5e6:
        raise BadInput(f"{path} lasts {time[-1] - time[0]:g} s, too many samples of {sample_time:g} s: time is in s")
    t = np.arange(int((time[-1] - time[0]) / sample_time + 1e-6) + 1) * sample_time
    # A held column is a step reference: its corners are not to be rounded off.
    held = np.mean(np.diff(table["position"]) == 0.0) > 0.5 and "velocity" not in table
    if held:
        before = np.searchsorted(time, t + time[0] + 1e-9, side="right") - 1
        return Reference(path.name, t, table["position"][before], np.zeros_like(t), np.zeros_like(t))
    from scipy.interpolate import CubicSpline, PchipInterpolator  # slow to import, and only a file has need of it

    curve = CubicSpline(time, table["position"])
    made = [curve(t + time[0])]
    for order, name in ((1, "velocity"), (2, "acceleration")):
        given = PchipInterpolator(time, table[name]) if name in table else curve.derivative(order)
        made.append(given(t + time[0]))
    return Reference(path.name, t, *made)


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
            need += side * law.grip(place, speed, side, 0.5 * need, p)
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
