"""Readings at the limit of a sensor, told from an axis that stands there.

A reading that stands at the end of its range has two causes. The sensor is clipped, and the axis goes on beyond. Or the
axis stands: at an end stop, or at rest. How the axis answers to its command shows within the range, away from both
ends. This law carries the motion on from where the reading comes to its limit, through the command that was recorded
meanwhile.

A clipped axis is back at the limit when its reading leaves it. How far it still is from there, as a share of how far it
went beyond, is the error of the law: near 0. A stop holds the axis for as long as it is pushed, and lets it go when the
push ends. The law then still has it where it was furthest, and the share is near 1. Half way between the two decides.
The same holds of the speed at which it comes back, which a reading that leaves from rest does not have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.io.faults import BoolArray, Fault, FloatArray, runs

#: The law is seen over windows of these lengths, s, and of so many rows at least.
_WINDOWS, _WINDOW_ROWS = (0.1, 0.03), 5
#: So many windows tell six coefficients, and how much the law leaves unexplained.
_MIN_WINDOWS = 50
#: The law explains more than it leaves of the change of speed within the range, and brings the axis back more than half
#: of the way that it went beyond.
_HALF = 0.5
#: The axis goes beyond by so many counts and so much of the range: by less, a law errs at any turning point.
_MIN_COUNTS, _MIN_SHARE = 10.0, 0.02
#: A stand of so many rows is judged. One that is alone may be chance.
_STAND_ROWS, _MIN_STANDS = 5, 2
#: The law is carried on for so many steps in all; longer stands are no easier to judge.
_MAX_STEPS = 20_000


@dataclass(frozen=True, eq=False)
class _Motion:
    """The readings that are there, and the command. Arrays have shape (N,)."""

    time: FloatArray  # s
    value: FloatArray
    pushed: FloatArray  # the integral of the command, which is held from row to row
    is_speed: bool

    @property
    def row(self) -> float:
        """The usual time from row to row, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def limits(self) -> tuple[float, ...]:
        """The smallest and the largest reading. A speed of zero is rest, and no limit."""
        ends = (float(self.value.min()), float(self.value.max()))
        return tuple(e for e in ends if not (self.is_speed and e == 0.0))

    def stands(self, limit: float, around: float) -> list[tuple[int, int]]:
        """First and last row of each stand at a limit, with `around` s of the recording before and after."""
        found = runs(self.value == limit)
        start, end = self.time[0] + around, self.time[-1] - around
        return [(a, b) for a, b in found if b - a >= _STAND_ROWS and self.time[a] > start and self.time[b] < end]


@dataclass(frozen=True)
class _Law:
    """Acceleration as it is linear in the command, the speed, its sign, 1, and the position from `origin`."""

    weights: tuple[float, ...]
    origin: float
    window: float  # s, over which it was seen
    explained: float  # share of the change of speed within the range

    def after(self, step: float, command: float, speed: float, position: float) -> float:
        """The speed after a step, of which the viscous part is implicit: a fast axis stays stable."""
        by_command, by_speed, by_sign, constant, by_position = self.weights
        sign = (speed > 0.0) - (speed < 0.0)
        pushed = by_command * command + by_sign * sign + constant + by_position * (position - self.origin)
        return (speed + step * (pushed + max(by_speed, 0.0) * speed)) / (1.0 - step * min(by_speed, 0.0))


def _integral(time: FloatArray, values: FloatArray) -> FloatArray:
    """From the first row to each (N,), of values that go on evenly from row to row."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))))


def _windows(motion: _Motion, window: float) -> FloatArray:
    """Centres (M,) of the windows, `window` s to either side, that no reading at a limit touches."""
    t, y = motion.time, motion.value
    at_limit = np.concatenate(([0], np.cumsum((y == y.min()) | (y == y.max()))))
    at = np.arange(t[0] + window, t[-1] - window, max(motion.row, window / 4.0))
    first, last = np.searchsorted(t, at - window), np.searchsorted(t, at + window)
    clear = at_limit[np.minimum(last + 1, t.size)] == at_limit[np.maximum(first - 1, 0)]
    return np.asarray(at[clear])


def _law(motion: _Motion, window: float, with_position: bool) -> _Law | None:
    """Least squares within the range; None where too little of the recording lies there.

    The law is integrated over each window, once for a speed and twice for a position: no reading is differentiated.
    """
    t, y = motion.time, motion.value
    at = _windows(motion, window)
    if at.size < _MIN_WINDOWS:
        return None

    def change(values: FloatArray) -> FloatArray:
        before, here, after = (np.interp(at + s * window, t, values) for s in (-1.0, 0.0, 1.0))
        return np.asarray(after - before if motion.is_speed else after - 2.0 * here + before)

    def over(rate: FloatArray) -> FloatArray:
        return change(rate if motion.is_speed else _integral(t, rate))

    origin = float(np.mean(y))
    half = 0.5 * window
    speed = y if motion.is_speed else np.interp(t + half, t, y) - np.interp(t - half, t, y)
    moved = _integral(t, y) if motion.is_speed else y - origin
    terms = [over(motion.pushed), over(moved), over(_integral(t, np.sign(speed))), over(t)]
    if with_position:
        terms.append(over(_integral(t, moved)))
    columns = np.column_stack(terms)
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    seen = change(y)
    weights = np.linalg.lstsq(columns / size, seen, rcond=1e-9)[0] / size
    left = seen - columns @ weights
    explained = 1.0 - float(np.var(left)) / max(float(np.var(seen)), 1e-300)
    given = tuple(float(w) for w in weights)
    return _Law(given if with_position else (*given, 0.0), origin, window, explained)


@dataclass(frozen=True)
class _Return:
    """What the law says of one stand at a limit, in the unit of the readings and that over s."""

    beyond: float  # how far the axis goes beyond the limit
    left: float  # how far from the limit it is as the reading leaves it
    speed: float  # at which it comes back, as a size
    speed_off: float  # by how much that is not the speed at which the reading leaves; 0 where a speed is read


def _slope(motion: _Motion, at: float, step: float) -> float:
    """At one end of three readings, of the parabola through them; a negative step goes back in time."""
    here, near, far = np.interp((at, at + step, at + 2.0 * step), motion.time, motion.value)
    return float(4.0 * near - 3.0 * here - far) / (2.0 * step)


def _carried(motion: _Motion, law: _Law, stand: tuple[int, int], side: float) -> _Return:
    """The motion from where the reading comes to its limit, which is one of speed where a speed is read."""
    t, y = motion.time, motion.value
    a, b = stand
    limit, is_speed = float(y[a]), motion.is_speed
    steps = max(1, round((t[b] - t[a]) / max(motion.row, law.window / 20.0)))
    at = np.append(np.linspace(t[a], t[b], steps + 1), t[b + 1])
    step = np.diff(at)
    command = np.diff(np.interp(at, t, motion.pushed)) / step
    speed = limit if is_speed else _slope(motion, float(t[a]), -law.window)
    position = law.origin if is_speed else limit
    away = [0.0]
    for h, u in zip(step.tolist(), command.tolist(), strict=True):
        before = speed
        speed = law.after(h, u, speed, position)
        if not is_speed:
            position += 0.5 * h * (before + speed)
        away.append(side * ((speed if is_speed else position) - limit))
    # the reading leaves the limit somewhere in the last step
    last, after = away[-2:]
    left = 0.0 if last * after <= 0.0 else min(abs(last), abs(after))
    off = 0.0 if is_speed else abs(speed - _slope(motion, float(t[b + 1]), law.window))
    return _Return(max(away), left, abs(speed), off)


def _law_of(motion: _Motion, window: float) -> _Law | None:
    """The law within the range, with a force that goes with the position where that explains half of what is left."""
    plain = _law(motion, window, with_position=False)
    if plain is None or motion.is_speed:
        return plain
    other = _law(motion, window, with_position=True)
    return other if other is not None and 1.0 - other.explained < _HALF * (1.0 - plain.explained) else plain


def _is_clipped(motion: _Motion, limit: float, resolution: float) -> bool:
    """Whether the law within the range brings the axis back to its limit when the reading leaves it."""
    side = 1.0 if limit == motion.value.max() else -1.0
    least = max(_MIN_COUNTS * resolution, _MIN_SHARE * float(np.ptp(motion.value)))
    for window in dict.fromkeys(max(w, _WINDOW_ROWS * motion.row) for w in _WINDOWS):
        stands = motion.stands(limit, 2.0 * window)
        law = _law_of(motion, window) if stands else None
        if law is None or law.explained < _HALF:
            continue
        found = [_carried(motion, law, s, side) for s in _judged(motion, stands)]
        if found and max(f.beyond for f in found) > least:
            back = sum(f.left for f in found) < _HALF * sum(f.beyond for f in found)
            return back and sum(f.speed_off for f in found) <= _HALF * sum(f.speed for f in found)
    return False


def _judged(motion: _Motion, stands: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """As many of the stands, from the first on, as can be carried on in reasonable time."""
    rows = np.array([b - a for a, b in stands])
    short = [s for s, n in zip(stands, rows, strict=True) if n <= _MAX_STEPS]
    total = np.cumsum(rows[rows <= _MAX_STEPS])
    return [s for s, n in zip(short, total, strict=True) if n <= _MAX_STEPS]


def find_clipped(
    time: FloatArray, values: FloatArray, command: FloatArray, resolution: float, is_speed: bool
) -> tuple[list[Fault], BoolArray]:
    """Stretches at a limit of the sensor, beyond which the axis went on.

    Parameters
    ----------
    time, values, command
        Shape (N,): s, the reading (NaN where there is none), and the input, held from row to row.
    resolution
        Size of one count in the unit of `values`; 0.0 where nothing is counted.
    is_speed
        Whether a speed is read, not a position.

    Returns
    -------
    list of Fault, ndarray of bool
        The stretches, and the readings (N,) to leave out.
    """
    out = np.zeros(values.size, dtype=bool)
    good = np.flatnonzero(np.isfinite(values))
    if good.size < _MIN_WINDOWS:
        return [], out
    pushed = np.concatenate(([0.0], np.cumsum(command[:-1] * np.diff(time))))
    motion = _Motion(time[good], values[good], pushed[good], is_speed)
    faults = []
    limits = [limit for limit in motion.limits if _is_clipped(motion, limit, resolution)]
    if sum(len(motion.stands(limit, -motion.row)) for limit in limits) < _MIN_STANDS:
        return [], out
    for limit in limits:
        out |= values == limit
        for a, b in runs(motion.value == limit):
            start, end = float(motion.time[a]), float(motion.time[b])
            says = f"The sensor was at its limit of {limit:.4g} from {start:.3f} s for {end - start:.3f} s."
            faults.append(Fault("saturation", start, end, says))
    return sorted(faults, key=lambda f: f.start), out
