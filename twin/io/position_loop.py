"""The rig's own position loop: what it commands, so that a recording can be simulated from the reference it followed.

The loop runs faster than it logs. Between stamps it is given instants of its own, at which the reference is held.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.errors import BadInput
from twin.io.recording import Recording

FloatArray = NDArray[np.float64]

#: Longest time between two commands of the rig's loop, s.
PERIOD = 0.002


@dataclass(frozen=True, eq=False)
class OwnLoop:
    """What the loop knows, in the units of the recording."""

    time: FloatArray  # (M,) s, the stamps and the instants between them
    reference: FloatArray  # (M,) as the rig's own rate limiter passes it on
    stamps: NDArray[np.intp]  # (N,) where the recording's stamps are in `time`
    law: FloatArray  # (5,) gains on reference, reading and velocity; largest and smallest command
    resolution: float  # of the reading, 0 where it is not counted

    def command(self, at: int, position: float, velocity: float) -> float:
        """What the loop commands at an instant."""
        reading = position
        if self.resolution > 0.0:
            reading = self.resolution * math.floor(position / self.resolution + 0.5)
        forward, back, damping, most, least = self.law.tolist()
        wish = forward * float(self.reference[at]) - back * reading - damping * velocity
        if 0.0 < abs(wish) < least:
            wish = math.copysign(least, wish)
        return float(min(max(wish, -most), most))


def _limited(time: FloatArray, reference: FloatArray, rate: float | None) -> FloatArray:
    """The reference as the rig's own rate limiter passes it on."""
    if rate is None:
        return reference
    limited = reference.copy()
    for i in range(1, len(time)):
        most = rate * (time[i] - time[i - 1])
        limited[i] = limited[i - 1] + min(max(reference[i] - limited[i - 1], -most), most)
    return limited


def own_loop(recording: Recording) -> OwnLoop:
    """The loop under which a recording was made. Raises BadInput where the rig file describes none."""
    loop = recording.loop
    if loop is None:
        raise BadInput(
            f"{recording.name}: the rig's own loop is not known: add [loop] to the rig file, or leave `closed_loop` out"
        )
    if recording.is_speed:
        raise BadInput(f"{recording.name}: only a position loop can be closed: give the position as the output")
    if loop.law == "P":
        forward, damping = loop.gain, 0.0
    else:
        assert loop.kp is not None and loop.kv is not None
        forward, damping = loop.kp * loop.kv, loop.kv
    assert forward is not None
    most = math.inf if loop.limit is None else loop.limit
    step = np.diff(recording.time)
    pieces = np.maximum(np.ceil(step / PERIOD - 1e-6).astype(np.intp), 1)
    stamps = np.concatenate([[0], np.cumsum(pieces)])
    time = np.interp(np.arange(stamps[-1] + 1), stamps, recording.time)
    held = np.searchsorted(stamps, np.arange(len(time)), side="right") - 1
    reference = _limited(time, recording.optional["reference"][held], loop.reference_rate_limit)
    law = np.array([forward, forward, damping, most, loop.minimum or 0.0])
    return OwnLoop(time, reference, stamps, law, recording.resolution)
