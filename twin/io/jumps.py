"""Jumps of a reading that no motion makes: wraps of an angle or a counter, and counters that restart.

A jump counts as impossible where neither the neighbouring speed nor the fastest change of speed elsewhere in the
recording explains it. A wrap is undone by the nearest turn. A restart is bridged by an offset, so that the reading
goes on at the speed that it had.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin.errors import BadInput
from twin.io.faults import BoolArray, Fault, FloatArray

#: A jump exceeds every other change of speed this many times.
_CONTRAST = 5.0
#: And it exceeds this many times the way that the fastest motion goes in the same time.
_BEYOND_FASTEST = 1.5
#: Restarts are rare: at most this share of the steps, or this number. Jumps of one size (wraps) may be many.
_MAX_SHARE, _MAX_NUMBER, _MAX_WRAP_SHARE = 0.01, 3, 0.4
#: Share of the other steps that have to show motion, before anything is known of how fast the axis can be.
_MIN_MOVING = 0.1


@dataclass(frozen=True, eq=False)
class Readings:
    """The readings of one signal that are there. Arrays have shape (N,)."""

    time: FloatArray  # s
    value: FloatArray
    resolution: float  # unit of value, 0 where it is not counted
    unit: str = ""

    @property
    def changes(self) -> Readings:
        """Those that differ from the reading before them."""
        new = np.concatenate(([True], self.step != 0))
        return Readings(self.time[new], self.value[new], self.resolution, self.unit)

    @property
    def step(self) -> FloatArray:
        """The change (N - 1,) from each reading to the next."""
        return np.diff(self.value)

    @property
    def interval(self) -> FloatArray:
        """The time (N - 1,) from each reading to the next, s."""
        return np.diff(self.time)


def fold(step: FloatArray, turn: float) -> FloatArray:
    """The step that is nearest to 0 among all that differ from it by whole turns."""
    return np.asarray(step - np.round(step / turn) * turn)


def _local_median(values: FloatArray) -> FloatArray:
    from scipy.ndimage import median_filter  # slow to import: a file that cannot be read need not wait for it

    return np.asarray(median_filter(values, size=5, mode="nearest"))


def change_of_speed(step: FloatArray, interval: FloatArray) -> FloatArray:
    """By how much each step departs from the speed around it, in the unit of the step.

    The speed around it is the median of five. A constant acceleration and a sudden start or stop leave nothing; a
    jump leaves its whole size.
    """
    return np.asarray(step - _local_median(step / interval) * interval)


def circular_outliers(readings: Readings, turn: float) -> BoolArray:
    """Readings that jump away and come back within two, on a circle of one turn.

    The centre of five neighbours is the one with the least sum of distances to the others on the circle. A reading is
    an outlier where it lies off the centre by over five times the fifth largest step around it, as on a line.
    """
    y, size = readings.value, readings.value.size
    found = np.zeros(size, dtype=bool)
    if size < 11:
        return found
    index = np.clip(np.arange(size)[:, None] + np.arange(-2, 3), 0, size - 1)
    window = y[index]
    far = np.abs(fold(window[:, :, None] - window[:, None, :], turn)).sum(axis=2)
    centre = window[np.arange(size), np.argmin(far, axis=1)]
    off = np.abs(fold(y - centre, turn))
    step = np.abs(fold(readings.step, turn))
    for k in np.flatnonzero(off > max(10 * readings.resolution, 1e-3 * turn)):
        around = np.sort(step[max(0, k - 12) : k + 12])
        found[k] = 0 < k < size - 1 and off[k] > 5 * around[-5]
    return found


def _is_wrapped(readings: Readings, turn: float) -> bool:
    """Whether the reading wraps at this turn.

    All readings lie within one turn. Once folded, the steps at the jumps agree with those around them as well as other
    steps do. A whole turn is far more than any change of speed elsewhere. The axis runs through at least one jump: two
    rest positions a turn apart are no wrap.
    """
    y = readings.value
    step = readings.step
    if np.ptp(y) > turn * (1.0 + 1e-6) + 0.5 * readings.resolution:
        return False
    jumps = np.flatnonzero(np.round(step / turn) != 0)
    if not jumps.size:
        return False
    folded = fold(step, turn)
    change = np.abs(change_of_speed(folded, readings.interval))
    usual = float(np.quantile(np.delete(change, jumps), 0.995)) if jumps.size < change.size else turn
    floor = 3 * readings.resolution + 0.005 * turn
    explained = change[jumps] <= 1.5 * usual + floor
    ahead = folded[np.clip(jumps - 1, 0, folded.size - 1)]
    behind = folded[np.clip(jumps + 1, 0, folded.size - 1)]
    through = (np.sign(ahead) == -np.sign(step[jumps])) & (np.sign(behind) == -np.sign(step[jumps]))
    return bool(np.mean(explained) >= 0.8 and through.any() and 3 * usual < turn)


def _check_not_too_fast(readings: Readings, turn: float, what: str) -> None:
    """Raises BadInput where the axis may have moved half a turn or more between two readings.

    Steps grow by a bounded amount from one to the next. Had one exceeded half a turn, a step within half of the
    largest growth of it would have been read on the way up.
    """
    usual = float(np.median(readings.interval))
    size = np.abs(fold(readings.step, turn))
    even = readings.interval < 1.5 * usual
    moving = even[1:] & even[:-1] & (size[:-1] > 0)
    growth = float(np.max(np.diff(size)[moving], initial=0.0))
    largest = float(np.max(size[1:][moving], initial=0.0))
    if largest + 0.5 * growth >= 0.5 * turn and largest > 0.25 * turn:
        raise BadInput(
            f"{what} wraps, and moves up to {largest / turn:.2g} of a turn between readings {1e3 * usual:.3g} ms "
            "apart: from half a turn on, the direction cannot be told; sample twice as fast, drive more slowly, or "
            "log a counter that does not wrap"
        )


def _wraps_too_fast(readings: Readings, turn: float) -> bool:
    """Whether readings that fill a turn jump across it, in the middle of motion, so often that no speed can be told."""
    y = readings.value
    if not 0.9 * turn < np.ptp(y) <= turn * (1.0 + 1e-6) + 0.5 * readings.resolution:
        return False
    step = readings.step
    jumps = np.flatnonzero(np.abs(step[1:-1]) > 0.5 * turn) + 1
    in_motion = (step[jumps - 1] != 0) & (step[jumps + 1] != 0)
    return bool(np.count_nonzero(in_motion) > max(3, 0.02 * step.size))


def undo_wraps(
    time: FloatArray, values: FloatArray, turns: Sequence[float], resolution: float, what: str
) -> tuple[FloatArray, BoolArray, list[Fault]]:
    """Undo jumps by a full turn, or by a full counter, whose size is known.

    Parameters
    ----------
    time, values
        Shape (N,): s, and the reading in any unit; NaN where there is none.
    turns
        The sizes of a full turn or counter to try, in the unit of `values`.
    resolution
        Size of one count in the unit of `values`; 0.0 where it is not counted.
    what
        Names the column in a message, such as ``log.csv: column 'angle'``.

    Returns
    -------
    values, outliers, faults
        The unwrapped reading. The readings (N,) that jump away and come back, which a wrapped reading shows on the
        circle only. A fault of kind wrap at each jump.

    Raises
    ------
    BadInput
        The axis moves half a turn or more between readings.
    """
    good = np.flatnonzero(np.isfinite(values))
    outliers = np.zeros(values.size, dtype=bool)
    if good.size < 11:
        return values, outliers, []
    everything = Readings(time[good], values[good], resolution)
    for turn in sorted({t for t in turns if t > 20 * resolution}):
        if not np.any(np.abs(everything.step) > 0.5 * turn):
            continue
        off = circular_outliers(everything, turn)
        readings = Readings(everything.time[~off], everything.value[~off], resolution)
        changes = readings.changes
        if not _is_wrapped(changes, turn):
            if turn == turns[0] and _wraps_too_fast(readings, turn):
                _check_not_too_fast(changes, turn, what)
            continue
        _check_not_too_fast(changes, turn, what)
        whole = np.round(_ahead_of_prediction(readings, turn) / turn)
        kept = good[~off]
        unwrapped = values.copy()
        unwrapped[kept] = readings.value - turn * np.concatenate(([0.0], np.cumsum(whole)))
        outliers[good[off]] = True
        faults = [
            Fault(
                "wrap", time[kept[k]], time[kept[k + 1]], f"The reading wraps at {time[kept[k + 1]]:.3f} s; unwrapped."
            )
            for k in np.flatnonzero(whole)
        ]
        return unwrapped, outliers, faults
    return values, outliers, []


def _ahead_of_prediction(readings: Readings, turn: float) -> FloatArray:
    """The steps (N - 1,), without what the speed before a gap in time makes of it, to be rounded to whole turns."""
    step, interval = readings.step, readings.interval
    speed = _local_median(fold(step, turn) / interval)
    before = np.concatenate(([0.0], speed[:-1]))
    gap = interval > 1.5 * float(np.median(interval))
    return np.asarray(np.where(gap, step - before * interval, step))


def bridge_restarts(
    time: FloatArray,
    values: FloatArray,
    command: FloatArray,
    resolution: float,
    turns: Sequence[float] = (),
    unit: str = "",
) -> tuple[FloatArray, list[Fault]]:
    """Undo jumps of an unknown size: wraps behind a gear, and counters that restart or are homed midway.

    Jumps of one size, through which the axis runs on, are wraps at that size. A jump of a known size is a wrap, too.
    Every other one is bridged by an offset.

    Parameters
    ----------
    time, values
        Shape (N,): s, and the position in any unit; NaN where there is none.
    command
        Shape (N,): the input. A standstill without any command is no freeze of the sensor.
    resolution
        Size of one count in the unit of `values`; 0.0 where it is not counted.
    turns
        Known sizes of a full turn or counter.
    unit
        That of `values`, for what is said.

    Returns
    -------
    values, faults
        The position without jumps, and a fault of kind wrap or restart at each.
    """
    good = np.flatnonzero(np.isfinite(values))
    if good.size < 20:
        return values, []
    readings = Readings(time[good], values[good], resolution, unit)
    grain = resolution or 1e-4 * float(np.ptp(readings.value))
    jumps, excess = _impossible_steps(readings, np.abs(command[good]), grain)
    if not jumps.size:
        return values, []
    usual = np.delete(np.abs(change_of_speed(readings.step, readings.interval)), jumps)
    tolerance = 2 * grain + 2 * float(np.max(usual, initial=0.0))
    size, kinds = _sizes(readings, jumps, excess, tolerance, turns)
    if np.count_nonzero(kinds == "restart") > max(_MAX_NUMBER, _MAX_SHARE * readings.step.size):
        return values, []
    shift = np.zeros(readings.value.size)
    shift[jumps + 1] = -size
    joined = values.copy()
    joined[good] = readings.value + np.cumsum(shift)
    return joined, [
        _fault(readings, int(k), float(s), str(kind)) for k, s, kind in zip(jumps, size, kinds, strict=True)
    ]


def _fault(readings: Readings, k: int, size: float, kind: str) -> Fault:
    start, end = float(readings.time[k]), float(readings.time[k + 1])
    unit = f" {readings.unit}" if readings.unit else ""
    if kind == "wrap":
        return Fault("wrap", start, end, f"The reading wraps at {end:.3f} s, by {abs(size):.4g}{unit}; unwrapped.")
    return Fault(
        "restart", start, end,
        f"The reading restarts at {end:.3f} s: it jumps by {size:.4g}{unit} in {1e3 * (end - start):.3g} ms, which no "
        "motion makes; it is continued with an offset.",
    )  # fmt: skip


def _impossible_steps(readings: Readings, command: FloatArray, grain: float) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """The steps that no motion makes, and by how much each departs from the speed around it."""
    step, interval = readings.step, readings.interval
    change = change_of_speed(step, interval)
    order = np.argsort(-np.abs(change))
    size = np.abs(change)[order]
    most = int(_MAX_WRAP_SHARE * size.size)
    gap = np.flatnonzero(size[:most] > _CONTRAST * size[1 : most + 1] + 10 * grain)
    none = np.zeros(0, dtype=np.intp), np.zeros(0)
    if not gap.size:
        return none
    jumps = np.sort(order[: gap[-1] + 1])
    others = np.delete(step, jumps)
    if np.mean(np.abs(others) > 0.5 * grain) < _MIN_MOVING:
        return none
    fastest = float(np.max(np.abs(others) / np.delete(interval, jumps)))
    since = _time_since_change(readings, command, grain)[jumps]
    beyond = np.abs(change[jumps]) > _BEYOND_FASTEST * fastest * since + 10 * grain
    return (jumps[beyond], change[jumps][beyond]) if beyond.all() or np.mean(beyond) > 0.5 else none


def _time_since_change(readings: Readings, command: FloatArray, grain: float) -> FloatArray:
    """For each step (N - 1,), the time in which it may have come about, s.

    Where the sensor may have frozen, the step holds all motion since the reading last changed. An axis that had come
    slowly to rest, and was given no command since, was at rest.
    """
    step, at = readings.step, np.arange(readings.value.size - 1)
    moved = np.maximum.accumulate(np.where(step != 0, at, -1))  # the last step that is none of a standstill
    before = np.concatenate(([-1], moved[:-1]))
    driven = np.concatenate(([0], np.cumsum(command > 0.01 * float(np.max(command, initial=0.0)))))
    slow = (before < 0) | (np.abs(step[before]) <= 3 * grain)
    at_rest = slow & (driven[at + 1] == driven[before + 1])
    return np.asarray(readings.time[1:] - readings.time[np.where(at_rest, at, before + 1)])


def _sizes(
    readings: Readings, jumps: npt.NDArray[np.intp], excess: FloatArray, tolerance: float, turns: Sequence[float]
) -> tuple[FloatArray, npt.NDArray[np.str_]]:
    """The size of each jump and its kind: wraps have one size, or a known one; the others keep their own."""
    kinds = np.full(jumps.size, "restart")
    size = excess.copy()
    if readings.resolution > 0:
        size = np.round(size / readings.resolution) * readings.resolution
    common = float(np.median(np.abs(excess)))
    alike = np.abs(np.abs(excess) - common) < tolerance + 0.002 * common
    if jumps.size >= 2 and alike.all() and np.ptp(readings.value) < common + tolerance:
        if readings.resolution > 0:
            common = round(common / readings.resolution) * readings.resolution
        known = [t for t in turns if abs(t - common) < tolerance]
        return np.sign(excess) * (known[0] if known else common), np.full(jumps.size, "wrap")
    for turn in turns:
        same = np.abs(np.abs(excess) - turn) < tolerance
        size, kinds = np.where(same, np.sign(excess) * turn, size), np.where(same, "wrap", kinds)
    return size, kinds
