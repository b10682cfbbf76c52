"""Which part of the recordings no fit and no choice may see, and where a free run through it begins."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.io.recording import Recording, command_of, to_fit
from twin.model.equations import timed
from twin.model.stepper import Structure

#: Where in a lone recording the held-out parts begin and end, as shares of it.
Intervals = tuple[tuple[float, float], ...]
END_PART: Intervals = ((0.7, 1.0),)
MIDDLE_PART: Intervals = ((0.35, 0.65),)
BLOCKS: Intervals = ((0.1, 0.175), (0.35, 0.425), (0.6, 0.675), (0.85, 0.925))
#: Three time constants, but no less and no more than this, a free run starts ahead of what is judged, s.
_LEAD_TIME = (1.0, 5.0)
#: Of long recordings about so many parts of so many s each are held out.
_SHORT_PARTS, _SHORT_PART = 5, 12.0
#: A command or a way of less than these shares of the largest is none. Rest at both ends of a recording that makes up
#: less than this share of it is part of what was tried.
_IDLE_COMMAND, _IDLE_WAY, _IDLE_TIME = 0.01, 0.02, 0.1


@dataclass(frozen=True, eq=False)
class RecordingPart:
    """The readings from `begin` to `end` (s) of a recording. The rest only leads there."""

    recording: Recording
    begin: float = 0.0
    end: float = math.inf

    @property
    def inside(self) -> NDArray[np.bool_]:
        """The stamps (N,) of the recording that belong to the part."""
        return np.asarray((self.recording.time >= self.begin) & (self.recording.time <= self.end))

    @property
    def is_read(self) -> bool:
        """Whether the part holds a reading."""
        return bool(np.isfinite(self.recording.output[self.inside]).any())

    @property
    def whole(self) -> bool:
        """Whether the part is the recording."""
        return bool(self.inside.all())


def _in_motion(recording: Recording) -> tuple[float, float]:
    """From when until when (s) the axis is driven or moves: a model is not tested by how an axis stands still."""
    time, whole = recording.time, (0.0, float(recording.time[-1]))
    command = np.abs(command_of(recording))
    read = np.flatnonzero(np.isfinite(recording.output))
    y = np.interp(time, time[read], recording.output[read])
    ends = (0.0, 0.0) if recording.is_speed else (y[0], y[-1])
    far = _IDLE_WAY * (float(np.max(np.abs(y))) if recording.is_speed else float(np.ptp(y)))
    driven = command > _IDLE_COMMAND * float(np.max(command))
    begins, stops = (np.flatnonzero(driven | (np.abs(y - at) > far)) for at in ends)
    if not begins.size or not stops.size:
        return whole
    moving = float(time[begins[0]]), float(time[stops[-1]])
    return moving if moving[0] + whole[1] - moving[1] > _IDLE_TIME * whole[1] else whole


def split(recordings: Sequence[Recording], where: Intervals = END_PART) -> tuple[list[Recording], list[RecordingPart]]:
    """What may be fitted, and what is held out: the recordings of that role, or a part of each if there are none.

    Raises BadInput where nothing is to be fitted.
    """
    train = to_fit(recordings)
    held_out = [RecordingPart(r) for r in recordings if r.role != "train"]
    if held_out:
        return train, held_out
    parts, kept = [], []
    for recording in train:
        begin, end = _in_motion(recording)
        mine = [RecordingPart(recording, *(begin + share * (end - begin) for share in shares)) for shares in where]
        parts += mine
        rest = recording
        # From the last on: what is left out at the end makes the recording shorter, as does the rest after it.
        for part in reversed(mine):
            rest = rest.without(part.begin, part.end if part.end < end else float(recording.time[-1]))
        several = f"{recording.name} (without {len(mine)} blocks)"
        kept.append(replace(rest, name=several) if len(mine) > 1 else rest)
    return kept, parts


def short_parts(parts: Sequence[RecordingPart]) -> list[RecordingPart]:
    """At most so many short parts in the place of long ones, evenly spread. Each is cut out with what leads to it."""
    most = max(round(_SHORT_PARTS / len(parts)), 1)
    out = []
    for part in parts:
        end = min(part.end, float(part.recording.time[-1]))
        if end - part.begin <= most * _SHORT_PART:
            out.append(part)
            continue
        for begin in np.linspace(part.begin, end - _SHORT_PART, most).tolist():
            ahead = max(begin - _LEAD_TIME[1], 0.0)
            cut = part.recording.part(ahead, begin + _SHORT_PART)
            if np.isfinite(cut.output).any():
                out.append(RecordingPart(cut, begin - ahead))
    return out


def lead_of(values: Mapping[str, float]) -> float:
    """How long (s) a free run goes before it is judged."""
    return float(np.clip(3.0 / max(values.get("viscous_friction", 0.0), 1e-9), *_LEAD_TIME))


def led(
    parts: Sequence[RecordingPart], structure: Structure, lead: float
) -> tuple[list[Recording], list[RecordingPart]]:
    """What a free run through each part goes through, from `lead` seconds ahead or from the start, and the part in it.

    It begins with a reading, off which its start is read. Physics that depends on the time since the start must run
    from the start.
    """
    runs, inside = [], []
    for part in parts:
        begin = 0.0
        if not (part.whole or timed(structure)):
            time = part.recording.time
            read = time[np.isfinite(part.recording.output) & (time >= part.begin - lead)]
            begin = float(read[0]) if len(read) and read[0] < part.end else max(part.begin - lead, 0.0)
        run = part.recording if part.whole else part.recording.part(begin, part.end)
        shift = float(part.recording.time[part.recording.time >= begin][0])
        runs.append(run)
        inside.append(RecordingPart(run, part.begin - shift, part.end - shift))
    return runs, inside
