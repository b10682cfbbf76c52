"""What is left out of a recording, and what is undone in it, signal by signal."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.errors import BadInput
from twin.io.faults import (
    BoolArray,
    Fault,
    FloatArray,
    find_contradicted,
    find_held,
    find_missing,
    find_outliers,
    find_resolution,
)
from twin.io.jumps import bridge_restarts, undo_wraps
from twin.io.limits import find_clipped
from twin.io.refresh import find_count, find_refresh, new_readings
from twin.io.rig_file import Column

#: Sizes, in counts, at which counters and absolute encoders wrap.
_COUNTERS = tuple(float(2**bits) for bits in (8, 10, 12, 14, 16, 24, 32))
#: Sizes at which whole numbers overflow in a program.
_INTEGERS = tuple(float(2**bits) for bits in (8, 16, 32))


@dataclass(frozen=True, eq=False)
class Raw:
    """One column as it was logged. Arrays have shape (N,), NaN where a cell holds no number."""

    logged: FloatArray  # as the file holds it
    values: FloatArray  # the same in the column's unit
    column: Column
    where: str  # file and column, for messages

    @property
    def turns(self) -> tuple[float, ...]:
        """Sizes at which the column may wrap, in its unit: the likeliest first."""
        column = self.column
        size = abs(column.factor * column.scale)
        found: list[float] = []
        if column.turn is not None:
            found += [column.turn * size, column.turn * size * abs(column.scale)]
        finite = self.logged[np.isfinite(self.logged)]
        if column.counts:
            found += [n * size for n in _COUNTERS]
        elif np.array_equal(finite, np.round(finite)):
            found += [n * size for n in _INTEGERS]
        return tuple(dict.fromkeys(found))


@dataclass(frozen=True, eq=False)
class Cleaned:
    """A signal (N,) with NaN where it is not to be believed, and why."""

    values: FloatArray
    resolution: float  # size of one count, 0.0 where it is not counted
    refresh: float | None  # s, how often the sensor is read anew; None: at each row
    faults: tuple[Fault, ...]


def hold(time: FloatArray, values: FloatArray, what: str, name: str) -> tuple[FloatArray, list[Fault]]:
    """The last value held where one is missing. Raises BadInput where there is none at all."""
    good = np.isfinite(values)
    if not good.any():
        raise BadInput(f"{name}: the {what} holds no number")
    index = np.maximum.accumulate(np.where(good, np.arange(values.size), -1))
    index[index < 0] = np.flatnonzero(good)[0]
    return values[index], find_missing(time, values, what)


def clean_optional(
    time: FloatArray, key: str, raw: Raw, name: str, command: FloatArray
) -> tuple[FloatArray, list[Fault]]:
    """An optional column (N,) cleaned, and what was wrong in it."""
    words = key.replace("_", " ")
    if key == "motor_position":
        cleaned = clean_output(time, raw, command, None)
        return cleaned.values, [
            replace(f, says=f"Motor position: {f.says}", signal="motor position") for f in cleaned.faults
        ]
    values, faults = raw.values, find_missing(time, raw.values, words)
    spikes = np.zeros(values.size, dtype=bool)
    if key != "speed":  # a reported speed is too coarse and too noisy to be judged
        spikes = find_outliers(values, find_resolution(values))
    faults += _outliers(time, values, spikes, words)
    held, _ = hold(time, np.where(spikes, np.nan, values), words, name)
    return held, faults


def _outliers(time: FloatArray, values: FloatArray, spikes: BoolArray, what: str) -> list[Fault]:
    return [
        Fault("outlier", t, t, f"The {what} jumps to {value:.4g} at {t:.3f} s and comes back.", what)
        for t, value in zip(time[spikes], values[spikes], strict=True)
    ]


def clean_output(
    time: FloatArray, raw: Raw, command: FloatArray, speed: FloatArray | None, refresh: float | None = None
) -> Cleaned:
    """The output without what no motion makes.

    Parameters
    ----------
    time, command
        Shape (N,): s, and the input.
    raw
        The column of the output.
    speed
        Shape (N,): a speed that was logged beside a position, or None.
    refresh
        How often the sensor is read anew, s; None where that is to be found.

    Raises
    ------
    BadInput
        The reading wraps, and the axis moves too far between readings to tell how often.
    """
    column, output = raw.column, raw.values
    faults = find_missing(time, output, "output")
    resolution = column.resolution if column.resolution is not None else find_resolution(output)
    refresh = refresh or find_refresh(time, output, column.resolution or 0.0)
    if refresh is not None:
        output = np.where(new_readings(time, output, refresh), output, np.nan)
        resolution = column.resolution if column.resolution is not None else find_count(output)
    output, spikes, wraps = undo_wraps(time, output, raw.turns, resolution, raw.where)
    faults += wraps
    spikes |= find_outliers(output, resolution)
    output = np.where(spikes, np.nan, output)
    is_speed = column.unit.endswith("/s")
    if not is_speed:
        output, jumps = bridge_restarts(time, output, command, resolution, raw.turns, column.unit)
        frozen, out = find_held(time, output, resolution)
        if speed is not None:
            contradicted, more = find_contradicted(time, output, speed, resolution)
            seen = [(f.start, f.end) for f in frozen]
            frozen += [f for f in contradicted if not any(f.start < b and a < f.end for a, b in seen)]
            out |= more
        faults += jumps + frozen
        output = np.where(out, np.nan, output)
        inside = np.array([any(f.start < t < f.end for f in frozen) for t in time[spikes]], dtype=bool)
        spikes[np.flatnonzero(spikes)[inside]] = False  # a freeze that holds an outlier is one freeze
    clipped, out = find_clipped(time, output, command, resolution, is_speed)
    faults += [*clipped, *_outliers(time, raw.values, spikes, "output")]
    output = np.where(out, np.nan, output)
    return Cleaned(output, resolution, refresh, tuple(faults))
