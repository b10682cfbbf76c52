"""Jumps that no motion makes: planted ones are undone, and motion is left alone."""

import math
from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, axis_speed, duty_levels, rig_text, write_log
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.errors import BadInput
from twin.io.faults import find_outliers
from twin.io.jumps import bridge_restarts, undo_wraps
from twin.io.recording import Recording, load

STEP = 0.002
PER_TURN = 4096
COUNT = 2 * math.pi / PER_TURN
COUNTS = f'unit = "count"\ncounts_per_revolution = {PER_TURN}'


def loaded(folder: Path, duty: np.ndarray, reading: np.ndarray, output: str, step: float = STEP) -> Recording:
    log = write_log(folder, {"t": np.arange(duty.size) * step, "duty": duty, "y": reading}, rig_text(output))
    return load([log])[0][0]


def moved(recording: Recording) -> np.ndarray:
    return recording.output - recording.output[0]


@given(
    seed=st.integers(0, 10**6), turn=st.sampled_from([256, 1000, 4096, 65536]), step=st.sampled_from([0.001, 0.005]),
    first=st.integers(0, 10**6),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_a_wrap_of_known_size_is_undone(seed: int, turn: int, step: float, first: int) -> None:
    duty = duty_levels(seed, 4000, step)
    counts = np.round(axis_position(duty, step) / (2 * math.pi) * 4 * turn / (4 * 2 * math.pi) * 2)
    largest = np.max(np.abs(np.diff(counts)))
    assert largest < 0.4 * turn
    wrapped = (counts + first) % turn
    found, out, faults = undo_wraps(np.arange(4000) * step, wrapped, (float(turn),), 1.0, "y")
    assert not out.any()
    assert {f.kind for f in faults} <= {"wrap"}
    np.testing.assert_array_equal(found - found[0], counts - counts[0])


@pytest.mark.parametrize(("first", "second"), [(1500, None), (1500, 3100)])
def test_a_counter_that_restarts_goes_on_with_an_offset(tmp_path: Path, first: int, second: int | None) -> None:
    duty = duty_levels(1, 5000, STEP)
    counts = np.round(axis_position(duty, STEP) / COUNT)
    read = counts.copy()
    for at in (first, second):
        if at is not None:
            assert abs(read[at]) > 2000
            read[at:] -= read[at]
    recording = loaded(tmp_path, duty, read, COUNTS)
    at = [k for k in (first, second) if k is not None]
    assert [(f.kind, f.end) for f in recording.faults] == [("restart", pytest.approx(STEP * k)) for k in at]
    assert all(" rad in " in f.says for f in recording.faults)
    # the motion in the one step is not seen: a count or two for each restart
    np.testing.assert_allclose(moved(recording), (counts - counts[0]) * COUNT, atol=2.5 * COUNT * len(at))


def test_homing_at_rest_is_no_freeze(tmp_path: Path) -> None:
    duty = duty_levels(3, 5000, STEP)
    duty[1500:3000] = 0.0
    counts = np.round(axis_position(duty, STEP) / COUNT)
    read = counts.copy()
    read[2800:] -= read[2800]
    recording = loaded(tmp_path, duty, read, COUNTS)
    assert [f.kind for f in recording.faults] == ["restart"]
    np.testing.assert_allclose(moved(recording), (counts - counts[0]) * COUNT, atol=1e-9)


@pytest.mark.parametrize("wrap", [1024, 3000])
def test_a_wrap_behind_a_gear_of_unknown_ratio_is_found(tmp_path: Path, wrap: int) -> None:
    duty = duty_levels(5, 6000, STEP)
    counts = np.round(axis_position(duty, STEP) / COUNT)
    recording = loaded(tmp_path, duty, counts % wrap, COUNTS.replace("4096", "40960"))
    assert {f.kind for f in recording.faults} == {"wrap"}
    np.testing.assert_allclose(moved(recording), (counts - counts[0]) * COUNT / 10, atol=1e-9)


def test_an_angle_of_the_motor_wraps_at_its_own_turn(tmp_path: Path) -> None:
    duty = duty_levels(6, 6000, STEP)
    angle = np.rad2deg(axis_position(duty, STEP))
    recording = loaded(tmp_path, duty, np.round(angle % 360.0, 2), 'unit = "deg"\nscale = 0.1')
    assert {f.kind for f in recording.faults} == {"wrap"}
    np.testing.assert_allclose(moved(recording), np.deg2rad(angle - angle[0]) / 10, atol=2e-5)


@pytest.mark.parametrize(("bits", "scale"), [(16, 10.0), (8, 1.0)])
def test_a_speed_that_overflows_is_mended(tmp_path: Path, bits: int, scale: float) -> None:
    duty = duty_levels(7, 4000, STEP)
    speed = np.round(axis_speed(duty, STEP) * scale)
    top = 2**bits
    centre = 0.75 * top / 2  # the speed passes the largest whole number
    read = (speed + centre + top // 2) % top - top // 2
    if np.ptp(speed) >= top or not np.any(np.abs(np.diff(read)) > top / 2):
        read = (speed + top // 2 - 20) % top - top // 2 + 20
    recording = loaded(tmp_path, duty, read, f'unit = "rad/s"\nscale = {1 / scale}')
    assert {f.kind for f in recording.faults} <= {"wrap"}
    np.testing.assert_allclose(moved(recording), (speed - speed[0]) / scale, atol=1e-9)


def test_a_slow_log_is_unwrapped_by_the_nearest_turn_and_refused_where_that_is_unknown(tmp_path: Path) -> None:
    duty = duty_levels(8, 1200, 0.04)
    angle = axis_position(duty, 0.04)
    counts = np.round(angle / COUNT)
    fastest = np.max(np.abs(np.diff(counts))) / PER_TURN
    assert 0.3 < fastest < 0.5
    recording = loaded(tmp_path, duty, counts % PER_TURN, COUNTS, 0.04)
    np.testing.assert_allclose(moved(recording), (counts - counts[0]) * COUNT, atol=1e-9)
    with pytest.raises(BadInput, match=r"column 'y' wraps, and moves up to 0\.\d+ of a turn between readings 40 ms"):
        loaded(tmp_path, duty, np.round(1.7 * angle / COUNT) % PER_TURN, COUNTS, 0.04)


def test_outliers_in_a_wrapped_reading_are_left_out(tmp_path: Path) -> None:
    duty = duty_levels(9, 6000, STEP, 20.0)
    counts = np.round(axis_position(duty, STEP) / COUNT)
    read = counts % PER_TURN
    for at in (700, 2000, 4100):
        read[at] = (read[at] + 1500) % PER_TURN
    recording = loaded(tmp_path, duty, read, COUNTS)
    assert np.flatnonzero(np.isnan(recording.output)).tolist() == [700, 2000, 4100]
    np.testing.assert_allclose(
        moved(recording)[recording.time < 100], np.where(np.isnan(recording.output), np.nan, counts * COUNT), atol=1e-9
    )


def test_a_freeze_that_holds_an_outlier_is_one_freeze(tmp_path: Path) -> None:
    duty = np.full(3000, 40.0)
    duty[2000:] = -40.0
    counts = np.round(axis_position(duty, STEP) / COUNT)
    counts[1000:1200] = counts[1000]
    counts[1100] += 30_000
    recording = loaded(tmp_path, duty, counts, COUNTS)
    (freeze,) = recording.faults
    assert (freeze.kind, freeze.start, freeze.end) == ("freeze", pytest.approx(2.0), pytest.approx(2.398))


@given(seed=st.integers(0, 10**6), step=st.sampled_from([0.001, 0.01, 0.05]), gap=st.booleans())
@settings(max_examples=40, deadline=None)
def test_motion_is_no_jump(seed: int, step: float, gap: bool) -> None:
    duty = duty_levels(seed, 3000, step)
    angle = axis_position(duty, step)
    time = np.arange(3000) * step
    if gap:
        keep = np.r_[0:1000, 1200:3000]
        time, angle, duty = time[keep], angle[keep], duty[keep]
    counts = np.round(angle / COUNT)
    turns = (float(PER_TURN), 65536.0)
    for wrapped in (undo_wraps(time, counts, turns, 1.0, "y")[0], bridge_restarts(time, counts, duty, 1.0, turns)[0]):
        np.testing.assert_array_equal(wrapped, counts)
    assert not find_outliers(counts, 1.0).any()


def test_a_positioner_that_steps_in_one_sample_does_not_jump() -> None:
    """Between two samples a slow log sees nothing of the motion: two rest positions a turn apart are no wrap."""
    rest = np.repeat([0.0, 4096.0, 0.0, 2048.0, 4096.0, 0.0] * 5, 25)
    time = np.arange(rest.size) * 0.1
    assert undo_wraps(time, rest, (4096.0,), 1.0, "y")[2] == []
    assert bridge_restarts(time, rest, np.ones(rest.size), 1.0, (4096.0,))[1] == []
