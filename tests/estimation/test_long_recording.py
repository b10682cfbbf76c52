"""Of a long recording stretches are searched, and all of it counts in the end."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from twin.estimation import long_recording, maximum_likelihood
from twin.io.recording import Recording
from twin.model.stepper import Structure

STEP, GAIN, FRICTION, DEAD_BAND, COUNT = 0.002, 6.0, 5.0, 8.0, 2 * math.pi / 4096


def driven(minutes: float, idle: float = 0.0, seed: int = 1) -> Recording:
    """An axis under steps, with a torque noise, that rests for a share of the time in its middle."""
    rng = np.random.default_rng(seed)
    size = int(60 * minutes / STEP)
    duty = np.repeat(rng.choice([-60.0, -30.0, -15.0, 15.0, 30.0, 60.0], size // 250 + 1), 250)[:size]
    rest = slice(int(size * (0.5 - 0.5 * idle)), int(size * (0.5 + 0.5 * idle)))
    duty[rest] = 0.0
    push = GAIN * np.sign(duty) * np.maximum(np.abs(duty) - DEAD_BAND, 0.0)
    push += np.where(duty == 0.0, 0.0, rng.normal(0.0, 3.0, size))
    decay = math.exp(-FRICTION * STEP)
    speed = lfilter([0.0, (1.0 - decay) / FRICTION], [1.0, -decay], push)
    moved = push / FRICTION * STEP - np.diff(speed, append=speed[-1]) / FRICTION
    position = np.concatenate(([0.0], np.cumsum(moved)[:-1]))
    return Recording("long", STEP * np.arange(size), duty, np.round(position / COUNT) * COUNT, "%", "rad", COUNT)


def test_stretches_are_of_what_moves() -> None:
    recording = driven(30.0, idle=0.6)
    seen = long_recording.stretches([recording])
    assert sum(len(s.time) for s in seen) < 0.15 * len(recording.time)
    assert min(float(np.ptp(s.output)) for s in seen) > 0.0
    assert max(float(s.time[-1]) for s in seen) <= 12.0
    whole = set(recording.output.tolist())
    assert all(set(s.output.tolist()) <= whole for s in seen)


@pytest.mark.parametrize("sizes", [[1.0], [0.2] * 30, [6.0]])
def test_what_is_not_long_stays_whole(sizes: list[float]) -> None:
    recordings = [driven(s, seed=k) for k, s in enumerate(sizes)]
    found = long_recording.stretches(recordings)
    assert len(found) == len(recordings) and all(a is b for a, b in zip(found, recordings, strict=True))


def test_the_fit_of_a_long_recording_is_that_of_all_its_readings() -> None:
    """At the end a step over all readings promises nothing more, and the errors are those of all of them."""
    recording = driven(14.0)
    assert len(long_recording.stretches([recording])) > 1
    structure = Structure.of(["inertia", "viscous_friction", "dead_band"])
    problem, point = maximum_likelihood.likeliest([recording], structure)
    assert sum(len(c.drive.time) for c in problem.recordings) == len(recording.time)
    promised = point.gradient @ np.linalg.solve(point.information, point.gradient)
    assert promised < 0.1
    model = maximum_likelihood.with_intervals(problem, point, [recording])
    truths = {"input_gain": GAIN, "viscous_friction": FRICTION, "dead_band_forward": DEAD_BAND}
    for name, truth in truths.items():
        assert abs(model.values[name] - truth) < 4.0 * model.std(name) < 0.01 * truth
    low, high = model.intervals["dead_band_forward"]
    assert high - low == pytest.approx(2 * 1.96 * model.std("dead_band_forward"))
