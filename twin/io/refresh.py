"""A sensor that is read anew more slowly than it is logged: how often, which rows are new, how large its count is."""

from __future__ import annotations

import numpy as np

from twin.io.faults import BoolArray, FloatArray

#: So many pairs of changes have to show the interval, and this share of them the same one.
_MIN_PAIRS, _MIN_ALIKE = 10, 0.9
#: A change of so many counts is motion of more than a count a row.
_MOVING_COUNTS = 4.0


def find_refresh(time: FloatArray, values: FloatArray, resolution: float) -> float | None:
    """How often the sensor is read anew, s; None where each row may be a new reading.

    Two changes of several counts in the same direction tell that the axis moves by more than a count a row. Then a
    sensor that is read at each row changes at each row. Where nearly all such pairs stand two rows or more apart, and
    always as far, the sensor is held for that time.

    Parameters
    ----------
    time, values
        Shape (N,): s, and the reading; NaN where there is none.
    resolution
        Size of one count in the unit of `values`; 0.0 where it is not known.
    """
    good = np.flatnonzero(np.isfinite(values))
    y, t = values[good], time[good]
    at = np.flatnonzero(np.diff(y) != 0) + 1
    if at.size < _MIN_PAIRS + 1:
        return None
    count = resolution or _least_spacing(y)
    change = y[at] - y[at - 1]
    moving = np.abs(change) >= _MOVING_COUNTS * count
    pairs = moving[1:] & moving[:-1] & (np.sign(change[1:]) == np.sign(change[:-1]))
    if np.count_nonzero(pairs) < _MIN_PAIRS:
        return None
    rows, interval = np.diff(at)[pairs], np.diff(t[at])[pairs]
    usual = float(np.median(interval))
    row = float(np.median(np.diff(t)))
    alike = np.abs(interval - usual) <= max(0.2 * usual, 1.2 * row)
    held = np.mean(rows >= 2) >= _MIN_ALIKE and np.mean(alike) >= _MIN_ALIKE and usual >= 1.8 * row
    # Rows round each interval; their mean is that of the sensor.
    return float(np.mean(interval[alike])) if held else None


def _least_spacing(values: FloatArray) -> float:
    levels = np.unique(values)
    spacing = np.diff(levels)
    return float(np.min(spacing[spacing > 1e-9 * np.ptp(levels)], initial=np.inf))


def new_readings(time: FloatArray, values: FloatArray, refresh: float) -> BoolArray:
    """The rows (N,) that hold a new reading: where it changes, and once every `refresh` s while it stands still."""
    good = np.flatnonzero(np.isfinite(values))
    new = np.zeros(values.size, dtype=bool)
    if not good.size:
        return new
    y, t = values[good], time[good]
    changed = np.concatenate(([True], np.diff(y) != 0))
    since = t - t[np.maximum.accumulate(np.where(changed, np.arange(y.size), 0))]
    # half a row early, as stamps are uneven
    turn = np.floor((since + 0.5 * float(np.median(np.diff(t)))) / refresh) if t.size > 1 else since
    new[good] = changed | (np.diff(turn, prepend=0.0) > 0)
    return new


def find_count(values: FloatArray) -> float:
    """Size of one count, from readings that seldom stand one count apart; 0.0 where they show none.

    All readings differ by whole counts. The least spacing between two of them is some whole number of counts: the
    largest part of it that divides the other small spacings is taken. By chance, a spacing lies within a tenth of a
    whole number of counts one time in five. Twelve of them in a row are no chance (4e-9). The range of all readings
    then fixes the count to many digits.
    """
    levels = np.unique(values[np.isfinite(values)])
    spacing = np.sort(np.diff(levels))
    spacing = spacing[spacing > 1e-9 * np.ptp(levels)] if levels.size > 1 else spacing
    if spacing.size < 12:
        return 0.0
    small = spacing[: max(12, spacing.size // 4)]
    for parts in range(1, 13):
        count = float(small[0]) / parts
        for limit in (5.0, 20.0, 80.0):  # the better the count is known, the longer a spacing may be
            near = small[small < limit * count]
            if near.size >= 2:
                count = float(np.sum(near) / np.sum(np.round(near / count)))
        near = small[small < 80.0 * count]
        off = np.abs(near / count - np.round(near / count))
        if near.size >= 12 and np.mean(off < 0.1) > 0.97:
            return _refined(levels, count)
    return 0.0


def _refined(levels: FloatArray, count: float) -> float:
    """The count from ever longer differences, each of which is known to well within half a count."""
    from_first = levels - levels[0]
    reach = 100.0 * count
    while True:
        near = from_first[(from_first > 0) & (from_first <= reach)]
        if near.size:
            whole = np.round(near / count)
            count = float(np.dot(whole, near) / np.dot(whole, whole))
        if reach >= from_first[-1]:
            return count
        reach *= 2.0
