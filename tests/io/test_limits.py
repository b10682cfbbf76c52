"""A sensor at its limit: its readings there are left out, those of an axis that stands at an end are not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, axis_speed, dry_axis, rig_text, square_wave, write_log
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from twin.io.limits import find_clipped
from twin.io.preflight.finding import Severity
from twin.io.recording import Recording, load

STEP, N = 0.002, 10_000
TIME = STEP * np.arange(N)
COUNT = 2 * math.pi / 10_000
RIG = rig_text('unit = "count"\ncounts_per_revolution = 10000')


def counted(angle: np.ndarray, count: float = COUNT) -> np.ndarray:
    return np.round(angle / count) * count


def clipped(values: np.ndarray, share: float) -> np.ndarray:
    """Cut off so that a share of the readings lies at the two ends."""
    return np.clip(values, *np.quantile(values, [0.5 * share, 1.0 - 0.5 * share]))


def loaded(folder: Path, duty: np.ndarray, angle: np.ndarray) -> Recording:
    log = write_log(folder, {"t": STEP * np.arange(len(duty)), "duty": duty, "y": np.round(angle / COUNT)}, RIG)
    (recording,), _ = load([log])
    return recording


def to_and_fro(seed: int) -> np.ndarray:
    """Duty (N,) of alternating sign, so that the axis comes to both ends of its range again and again."""
    rng = np.random.default_rng(seed)
    duty = np.zeros(N)
    start, sign = 200, 1.0
    while start < N - 500:
        held = int(rng.integers(200, 500))
        duty[start : start + held] = sign * rng.uniform(30.0, 60.0)
        start, sign = start + held, -sign
    return np.round(duty, 2)


def wave() -> np.ndarray:
    return np.round(50.0 * np.cos(2 * np.pi * 0.4 * TIME) * np.sin(2 * np.pi * 0.03 * TIME + 1.0), 2)


def at_ends(read: np.ndarray) -> np.ndarray:
    return (read == read.min()) | (read == read.max())


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("count", [COUNT, 20 * COUNT])
@pytest.mark.parametrize("friction", [2.0, 5.0])
def test_what_a_sensor_cuts_off_is_left_out(share: float, count: float, friction: float) -> None:
    for duty in (to_and_fro(12), wave()):
        read = counted(clipped(axis_position(duty, STEP, friction=friction), share), count)
        faults, out = find_clipped(TIME, read, duty, count, False)
        assert {f.kind for f in faults} == {"saturation"}
        np.testing.assert_array_equal(out, at_ends(read))


def test_a_spring_beyond_the_limit_is_no_stop() -> None:
    """It slows the axis down and brings it back as a stop does not: the law has to know of it."""
    duty = to_and_fro(3)
    angle = speed = 0.0
    read = np.zeros(N)
    for k in range(N):
        read[k] = angle
        for _ in range(4):
            speed += STEP / 4 * (3.0 * duty[k] - 6.0 * speed - 40.0 * angle)
            angle += STEP / 4 * speed
    read = counted(clipped(read, 0.3))
    _, out = find_clipped(TIME, read, duty, COUNT, False)
    np.testing.assert_array_equal(out, at_ends(read))


def test_the_parameters_of_a_clipped_recording_are_those_of_the_whole(tmp_path: Path) -> None:
    """Were the readings at the limit taken for the axis', it would stop with the drive on, many times."""
    duty = to_and_fro(7)
    recording = loaded(tmp_path, duty, clipped(axis_position(duty, STEP), 0.6))
    (finding,) = recording.preflight
    assert finding.kind == "clipped" and finding.severity is Severity.WARNS
    assert "at the limit of its sensor for 60 % of the time" in finding.says
    structure = twin.first_structure(recording, exclude=["dead_band", "backlash"])
    model = twin.identify(recording, structure)
    for name, truth in (("input_gain", 6.0), ("viscous_friction", 5.0)):
        assert abs(model.values[name] - truth) < max(4.0 * model.std(name), 1e-3 * truth)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 999), st.sampled_from([1.0, 2.0, 6.0]), st.sampled_from([0.0, 0.005, 0.05]),
    st.sampled_from([COUNT, 20 * COUNT]),
)  # fmt: skip
def test_an_axis_that_stands_at_an_end_stop_is_not_clipped(seed: int, stop: float, gap: float, count: float) -> None:
    duty = square_wave(np.random.default_rng(seed), 6000)
    angle = counted(dry_axis(duty, gap=gap, stop=stop), count)
    faults, out = find_clipped(TIME[:6000], angle, duty, count, False)
    assert not faults and not out.any()


def test_an_axis_that_rests_again_and_again_at_one_end_is_not_clipped() -> None:
    """It is driven to and fro by the same amounts, and dry friction holds it at each end."""
    duty = np.tile(np.repeat([30.0, 0.0, -30.0, 0.0], 250), N // 1000)
    angle = counted(dry_axis(duty), 50 * COUNT)
    assert np.mean(at_ends(angle)) > 0.3
    faults, out = find_clipped(TIME, angle, duty, 50 * COUNT, False)
    assert not faults and not out.any()


def speed_of(duty: np.ndarray, decay_rate: float, dry: float, dt: float) -> np.ndarray:
    """Speed (rad/s) of an axis with viscous and dry friction under a duty (%)."""
    speed, v = np.zeros(len(duty)), 0.0
    for i, u in enumerate(duty):
        speed[i] = v
        free = v + (1.0 - math.exp(-decay_rate * dt)) * (u - v)
        slow = dry * dt
        v = math.copysign(max(abs(free) - slow, 0.0), free)
    return speed


@settings(max_examples=25, deadline=None)
@given(
    st.floats(1.0, 2000.0), st.sampled_from([0.0, 60.0]), st.sampled_from([1e-3, 0.05, 1.0, 5.0]), st.booleans(),
    st.integers(0, 99),
)  # fmt: skip
def test_a_speed_that_settles_or_rests_is_not_cut_off(
    decay_rate: float, dry: float, count: float, one_way: bool, seed: int
) -> None:
    duty = square_wave(np.random.default_rng(seed), 8000)
    duty = np.abs(duty) if one_way else duty
    speed = speed_of(duty, decay_rate, dry, STEP)
    faults, out = find_clipped(TIME[:8000], np.round(speed / count) * count, duty, count, True)
    assert not faults and not out.any()


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_a_speed_that_its_sensor_cuts_off_is_left_out(noise: float, share: float) -> None:
    rng = np.random.default_rng(5)
    duty = to_and_fro(5)
    speed = counted(clipped(axis_speed(duty, STEP) + noise * rng.standard_normal(N), share), 0.01)
    faults, out = find_clipped(TIME, speed, duty, 0.01, True)
    assert faults and all(f.kind == "saturation" for f in faults)
    np.testing.assert_array_equal(out, at_ends(speed))
