"""Does the held-out part stay where the fitted part has been? Which part to hold out so that it does.

A drive that clips at 45 % shows that in no recording that commands less. A model fitted there may be right and still
err outside that range. Held-out data from outside say nothing for or against it. So the ranges of command, speed,
position, supply and temperature are compared before anything is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis.data_split import BLOCKS, END_PART, MIDDLE_PART, Intervals, RecordingPart, split
from twin.io.recording import Recording, command_of

FloatArray = NDArray[np.float64]

#: Share of the range in the fitted part by which the held-out part may leave it.
ROOM = 0.1
#: Share of the samples at either end of the held-out range that do not count: an outlier is no range.
_ASIDE = 0.002
#: A speed is the slope of the position over so many s, so that it is not made of counts.
_SLOPE = 0.1
#: An axis that turns so often passes all its angles.
_TURNS = 2.0 * math.pi


@dataclass(frozen=True)
class Beyond:
    """A variable that leaves its fitted range (least, largest) in the held-out part, and the unit of both."""

    variable: str
    train: tuple[float, float]
    holdout: tuple[float, float]
    unit: str = ""

    @property
    def excess(self) -> float:
        """By how much of the fitted range it is left."""
        width = max(self.train[1] - self.train[0], 1e-300)
        return max(self.train[0] - self.holdout[0], self.holdout[1] - self.train[1]) / width


def _speed(recording: Recording) -> FloatArray:
    """The speed (N,), NaN where it is not known: as recorded, or the slope of the position."""
    y, time = recording.output, recording.time
    if recording.is_speed:
        return y
    width = max(round(_SLOPE / float(np.median(np.diff(time)))), 1)
    slope = np.full(len(y), np.nan)
    if len(y) > width:
        slope[width // 2 : width // 2 + len(y) - width] = (y[width:] - y[:-width]) / (time[width:] - time[:-width])
    return slope


def variables(recording: Recording) -> dict[str, FloatArray]:
    """What a model may depend on (each (N,)), NaN where it is not known or the reading is left out.

    The position of an axis that turns all round is none: it comes by every angle.
    """
    read = np.isfinite(recording.output)
    found = {"input": command_of(recording), "velocity": _speed(recording)}
    around = recording.is_angle and np.ptp(recording.output[read]) > _TURNS
    if not recording.is_speed and not around:
        found["position"] = recording.output
    found |= {n: recording.optional[n] for n in ("supply", "temperature") if n in recording.optional}
    return {n: np.where(read, values, np.nan) for n, values in found.items()}


def _unit(variable: str, recording: Recording) -> str:
    """The unit of a variable of this recording."""
    axis = recording.output_unit.removesuffix("/s")
    units = {"input": recording.input_unit, "velocity": f"{axis}/s", "position": axis}
    return {**units, "supply": "V", "temperature": "°C"}[variable]


def _joined(parts: Iterable[FloatArray]) -> FloatArray:
    values = np.concatenate(list(parts))
    return np.asarray(values[np.isfinite(values)])


def beyond(train: Sequence[Recording], held_out: Sequence[RecordingPart]) -> list[Beyond]:
    """The variables that leave in the held-out part, by more than `ROOM`, their range in the fitted part."""
    fitted, tested = [variables(r) for r in train], [(variables(p.recording), p.inside) for p in held_out]
    shared = set.intersection(*map(set, [*fitted, *(v for v, _ in tested)])) if tested else set()
    found = []
    for name in (n for n in ("input", "velocity", "position", "supply", "temperature") if n in shared):
        before, after = _joined(v[name] for v in fitted), _joined(v[name][inside] for v, inside in tested)
        if len(before) == 0 or len(after) == 0:
            continue
        low, high = np.quantile(after, [_ASIDE, 1.0 - _ASIDE])
        fitted_range = float(before.min()), float(before.max())
        one = Beyond(name, fitted_range, (float(low), float(high)), _unit(name, train[0]))
        if one.excess > ROOM:
            found.append(one)
    return found


def later(train: Sequence[Recording], held_out: Sequence[RecordingPart]) -> list[Beyond]:
    """The time since the start where the held-out part goes on for longer than any fitted one, by more than `ROOM`.

    It matters to models whose physics depends on it, such as a motor that warms. To any other model all times are the
    same.
    """
    tested = [p.recording.time[p.inside & np.isfinite(p.recording.output)] for p in held_out]
    ends = [float(t[-1]) for t in tested if len(t)]
    if not ends:
        return []
    begins = min(float(t[0]) for t in tested if len(t))
    fitted = max(float(r.time[np.isfinite(r.output)][-1]) for r in train)
    one = Beyond("time", (0.0, fitted), (begins, max(ends)), "s")
    return [one] if one.excess > ROOM else []


@dataclass(frozen=True, eq=False)
class Choice:
    """The part to hold out, the variables that still leave the fitted range there, and those that would at the end."""

    where: Intervals
    untested: tuple[Beyond, ...]
    at_end: tuple[Beyond, ...]


def choose(recordings: Sequence[Recording]) -> Choice:
    """The part to hold out: the end, the middle, or blocks all over the recording. It is the first that the fitted part
    surrounds, or the one that leaves it least. Recordings that are held out by role stay so. Raises BadInput where
    nothing is to be fitted.
    """
    tried = [(where, tuple(beyond(*split(recordings, where)))) for where in (END_PART, MIDDLE_PART, BLOCKS)]
    at_end = tried[0][1]
    if any(r.role != "train" for r in recordings):
        return Choice(END_PART, at_end, at_end)
    where, untested = min(tried, key=lambda t: max((b.excess for b in t[1]), default=0.0))
    return Choice(where, untested, at_end)


_SPOKEN = {"input": "the command", "velocity": "the speed", "position": "the position", "supply": "the supply voltage"}


def _range(one: Beyond) -> str:
    (low, high), (least, most) = one.train, one.holdout
    name = _SPOKEN.get(one.variable, one.variable)
    unit = f" {one.unit}" if one.unit else ""
    return f"{name} goes from {least:.3g} to {most:.3g}{unit} there, elsewhere from {low:.3g} to {high:.3g}{unit}"


def sentences(choice: Choice) -> list[str]:
    """Sentences on the choice: that another part was held out, and what stays untested."""
    said = []
    if choice.where != END_PART and choice.at_end:
        part = "the middle was" if choice.where == MIDDLE_PART else "blocks all over the recording were"
        said.append(f"The end goes where the rest never was: {_range(choice.at_end[0])}. So {part} held out instead.")
    said += [f"Untested by what was fitted: in the held-out part {_range(b)}." for b in choice.untested]
    return said
