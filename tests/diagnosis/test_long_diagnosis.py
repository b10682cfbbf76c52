"""Of a long recording stretches are diagnosed: the answer is the same, and it says what was not looked at."""

from __future__ import annotations

import math

import numpy as np

from twin.diagnosis import data_split, thresholds
from twin.diagnosis.data_split import RecordingPart
from twin.diagnosis.diagnose import diagnose
from twin.io.recording import Recording
from twin.model.stepper import Structure

STEP, GAIN, FRICTION, DRY, COUNT = 0.01, 6.0, 5.0, 60.0, 2.0 * math.pi / 4096
FIRST = Structure.of(["inertia", "viscous_friction"])


def driven(seconds: float) -> Recording:
    """A rigid axis with dry friction that never stops, under steps that keep their sign; torque noise; rounded."""
    rng = np.random.default_rng(3)
    size = int(seconds / STEP)
    duty = np.repeat(rng.uniform(30.0, 70.0, size // 50 + 1), 50)[:size]
    push = GAIN * duty - DRY + rng.normal(0.0, 3.0, size)
    decay = math.exp(-FRICTION * STEP)
    speed, position = np.zeros(size), np.zeros(size)
    for i in range(size - 1):
        speed[i + 1] = decay * speed[i] + (1.0 - decay) / FRICTION * push[i]
        position[i + 1] = position[i] + (push[i] * STEP - speed[i + 1] + speed[i]) / FRICTION
    return Recording("long", STEP * np.arange(size), duty, np.round(position / COUNT) * COUNT, "%", "rad", COUNT)


def test_diagnosis_of_a_long_recording_is_that_of_stretches(monkeypatch) -> None:
    monkeypatch.setattr(thresholds, "MANY_STAMPS", 10_000)
    recording = driven(300.0)
    found = diagnose([recording], FIRST, candidates=["constant_offset", "spring"])
    assert [f.id for f in found.findings] == ["constant_offset"]
    size = found.findings[0].parameters["offset"]
    assert abs(size.value + DRY) < 4.0 * size.std
    assert any("stretches were searched" in says for says in found.remarks)
    seen = sum(len(t.recorded) for t in found.traces)
    assert seen < 0.8 * len(recording.time)
    assert found.recordings == (recording,)


def test_short_parts_lie_in_what_was_held_out() -> None:
    recording = driven(300.0)
    part = RecordingPart(recording, 200.0, 290.0)
    held_out = set(recording.output[part.inside].tolist())
    short = data_split.short_parts([part])
    assert len(short) == 5 and all(set(p.recording.output[p.inside].tolist()) <= held_out for p in short)
    assert all(p.begin > 0.0 for p in short)  # a free run is led there
    assert data_split.short_parts([RecordingPart(recording, 200.0, 210.0)])[0].recording is recording
