"""What is held out moves: rest before and after the motion tests no model."""

from __future__ import annotations

import numpy as np
import pytest

from twin.diagnosis import data_split
from twin.io.recording import Recording

STEP = 0.01


def recorded(head: float, moving: float, tail: float, unit: str = "rad") -> Recording:
    """An axis that rests, is driven there and back, and rests, each for so many s."""
    before, inside, after = (np.zeros(round(s / STEP)) for s in (head, moving, tail))
    drive = 20.0 * np.sign(np.sin(np.arange(len(inside)) * STEP * 3.0) + 1e-9)
    duty = np.concatenate([before, drive, after])
    speed = duty / 10.0
    output = speed if unit.endswith("/s") else STEP * np.cumsum(speed)
    return Recording("made", STEP * np.arange(len(duty)), duty, output, "%", unit)


@pytest.mark.parametrize("unit", ["rad", "rad/s"])
@pytest.mark.parametrize(("head", "tail"), [(0.0, 40.0), (30.0, 0.0), (15.0, 25.0)])
def test_rest_before_and_after_the_motion_is_not_held_out(head: float, tail: float, unit: str) -> None:
    recording = recorded(head, 20.0, tail, unit)
    (fitted,), (part,) = data_split.split([recording])
    assert (part.begin, part.end) == pytest.approx((head + 14.0, head + 20.0), abs=0.2)
    assert np.ptp(recording.output[part.inside]) > 0.3 * np.ptp(recording.output)
    assert fitted.time[-1] == pytest.approx(head + 14.0, abs=0.2)


@pytest.mark.parametrize("where", [data_split.END_PART, data_split.MIDDLE_PART, data_split.BLOCKS])
def test_without_long_rest_the_parts_are_shares_of_the_recording(where: data_split.Intervals) -> None:
    recording = recorded(0.5, 20.0, 1.0)
    _, parts = data_split.split([recording], where)
    whole = float(recording.time[-1])
    assert [(p.begin, p.end) for p in parts] == [(a * whole, b * whole) for a, b in where]
