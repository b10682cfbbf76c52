"""The clock of a recording: stamps that wrap, jump or come in bursts are mended, and a wrong unit is named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.errors import BadInput
from twin.io.faults import Fault, FloatArray
from twin.io.units import TIME_UNITS

#: Sizes at which the counters of micros(), millis() and 16-bit timers wrap, as they are and divided into s or ms.
_COUNTERS = tuple(2.0**bits / divisor for bits in (16, 32) for divisor in (1.0, 1e3, 1e6))
#: A step of the clock this many times the usual one, and over so many s, is a pause or a jump.
_PAUSE_STEPS, _PAUSE = 50.0, 1.0
#: Steps from sample to sample, s, between which an axis can be seen to move, and the shortest recording, s.
SHORTEST_STEP, LONGEST_STEP, _SHORTEST = 20e-6, 0.5, 0.5
#: The step of a fast converter, s: below, stamps are no time at all.
CONVERTER_STEP = 1e-6
#: More decimals no log writes.
_DECIMALS = 20
#: Stamps of a burst: the median step is below this share of the mean one, and a burst holds so many.
_CROWDED, _MIN_BURST, _MIN_BURSTS, _ALIKE = 0.2, 3, 5, 0.8


@dataclass(frozen=True, eq=False)
class Stamps:
    """Stamps (N,) in s from the first, and what was mended in them."""

    time: FloatArray
    faults: tuple[Fault, ...] = ()


def count_from_first(stamps: FloatArray) -> FloatArray:
    """Stamps since the first, in the unit of the file, as a log that begins at 0 writes them.

    A double holds a late stamp more coarsely than an early one, and the difference shows that. Rounded to the decimals
    that the largest stamp can hold, one recording has the same times whenever it was made.
    """
    since: FloatArray = stamps - stamps[0]
    if stamps[0] == 0.0:
        return since
    decimals = np.floor(-np.log10(4.0 * np.spacing(np.max(np.abs(stamps)))))
    if 0 <= decimals <= _DECIMALS:
        since = np.round(since, int(decimals))
    return since


def undo_counter_wraps(stamps: FloatArray) -> tuple[FloatArray, list[int]]:
    """Stamps, in the unit of the file, of a counter that passed its largest number, and where it did.

    Every step backwards, without one size of the counter, has to be a step as the clock makes them elsewhere.
    """
    step = np.diff(stamps)
    back = np.flatnonzero(step < 0)
    if not back.size or back.size == step.size:
        return stamps, []
    usual = float(np.median(step[step >= 0]))
    for size in _COUNTERS:
        mended = step[back] + size
        if np.all((mended >= 0.0) & (mended <= _PAUSE_STEPS * usual) & (mended < 0.1 * size)):
            passed = np.zeros(stamps.size)
            passed[back + 1] = size
            return stamps + np.cumsum(passed), [int(k) for k in back]
    return stamps, []


def bridge_jumps(time: FloatArray, reading: FloatArray) -> tuple[FloatArray, list[int]]:
    """Stamps of a clock that was set while the axis moved on, and where.

    At a pause of the log, an axis in motion would have moved on by far more than from row to row. At a new recording it
    would be elsewhere. Where the reading goes on as if one step had passed, one step did pass.
    """
    step = np.diff(time)
    usual = float(np.median(step[step > 0])) if np.any(step > 0) else 0.0
    jumps = np.flatnonzero((step < 0) | (step > max(_PAUSE, _PAUSE_STEPS * usual)))
    with np.errstate(over="ignore"):
        moved = np.abs(np.diff(reading))
    for k in jumps:
        around = np.concatenate([moved[max(0, k - 5) : k], moved[k + 1 : k + 6]])
        lone = k + 1 < step.size and step[k + 1] > 1.5 * usual  # one bad stamp, after which the clock is as it was
        if lone or around.size < 6 or not np.all(around > 0) or not 0 < moved[k] <= 2.0 * np.max(around):
            return time, []
    mended = step.copy()
    mended[jumps] = usual
    return np.concatenate(([time[0]], time[0] + np.cumsum(mended))), [int(k) for k in jumps]


def spread_bursts(time: FloatArray) -> Stamps:
    """Stamps of reception in bursts, such as over USB, spread evenly over the time that each burst took to fill."""
    step = np.diff(time)
    if step.size < _MIN_BURST * _MIN_BURSTS or np.median(step) > _CROWDED * np.mean(step):
        return Stamps(time)
    last = np.append(np.flatnonzero(step > np.mean(step)), time.size - 1)
    period = np.diff(time[last])
    size = np.diff(last)
    usual, many = (float(np.median(x)) if x.size else 0.0 for x in (period, size))
    regular = np.abs(period - usual) < 0.3 * usual
    if last.size < _MIN_BURSTS or many < _MIN_BURST or np.mean(regular & (np.abs(size - many) <= 1)) < _ALIKE:
        return Stamps(time)
    end = time[last]
    begin = np.concatenate(([end[0] - usual], end[:-1]))
    begin = np.maximum(begin, end - 3.0 * usual)  # a pause of the log took no samples
    first = np.concatenate(([0], last[:-1] + 1))
    burst = np.repeat(np.arange(last.size), last - first + 1)
    share = (np.arange(time.size) - first[burst] + 1) / (last - first + 1)[burst]
    spread = begin[burst] + share * (end - begin)[burst]
    each = float(end[-1] - end[0]) / float(last[-1] - last[0])
    says = (
        f"The stamps come in bursts of {many:.0f} every {1e3 * usual:.3g} ms, as they were received; the samples are "
        f"spread evenly, one each {1e3 * each:.3g} ms. If the rig samples evenly, give [time] sample_time = {each:.3g}."
    )
    return Stamps(spread - spread[0], (Fault("clock", 0.0, float(time[-1]), says, "clock"),))


def check_unit(time: FloatArray, factor: float, where: str, rig_file: str) -> None:
    """Raises BadInput where the step or the length of a recording shows that its clock is in another unit.

    An axis is not seen to move at steps over 0.5 s, nor between steps below 20 us or within less than half a second.
    The units that make sense of the stamps are named; where none does, the step is.

    Parameters
    ----------
    time
        Shape (N,), s.
    factor
        Seconds per unit of the stamps, as the rig file says.
    where, rig_file
        File and column, and the rig file, for the message.
    """
    step, length = float(np.median(np.diff(time))) if time.size > 1 else 0.0, float(time[-1] - time[0])
    short = step < SHORTEST_STEP or length < _SHORTEST
    if not short and step <= LONGEST_STEP:
        return
    raw_step, raw_length = step / factor, length / factor
    fitting = {
        unit: raw_step * f
        for unit, (_, f) in TIME_UNITS.items()
        if SHORTEST_STEP <= raw_step * f <= LONGEST_STEP and (raw_length * f >= _SHORTEST or not short) and f != factor
    }
    if short and not fitting and step >= CONVERTER_STEP:
        return  # a quick burst of a fast converter: no other unit makes more of it
    # the geometric middle of what people log: 3 ms
    best = sorted(fitting, key=lambda unit: abs(np.log(fitting[unit] / 3e-3)))
    cure = " or ".join(
        f'say unit = "{unit}" in [time] of {rig_file}, which makes it {_time(fitting[unit])}' for unit in best
    )
    if not best:
        cure = "correct the stamps, or give [time] sample_time instead of a column"
    what = "too slow to see an axis move" if not short else "too short to see an axis move"
    raise BadInput(f"{where} makes {_time(step)} from sample to sample, {_time(length)} in all, {what}; {cure}")


def _time(seconds: float) -> str:
    """A time in the unit that people say it in."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"
