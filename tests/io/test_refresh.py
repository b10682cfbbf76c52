"""Sensors that are read anew more slowly than the log: found, with their true count; fresh and slow ones are not."""

import math
from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, axis_speed, duty_levels, rig_text, write_log
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.io.recording import load
from twin.io.refresh import find_count, find_refresh, new_readings

STEP = 0.005


def held(values: np.ndarray, time: np.ndarray, refresh: float, late: float = 0.0) -> np.ndarray:
    """What a log shows of a sensor that is read anew only so often."""
    read = np.floor((time - late) / refresh + 1e-9) * refresh
    return values[np.clip(np.searchsorted(time, read + 1e-9) - 1, 0, None)]


@given(
    seed=st.integers(0, 10**6), rows=st.sampled_from([3, 4, 10]), jitter=st.sampled_from([0.0, 0.2]),
    per_turn=st.sampled_from([2048, 20480]),
)  # fmt: skip
@settings(max_examples=30, deadline=None)
def test_the_interval_is_found(seed: int, rows: int, jitter: float, per_turn: int) -> None:
    duty = duty_levels(seed, 4000, STEP, 30.0)
    count = 2 * math.pi / per_turn
    rng = np.random.default_rng(seed)
    time = (np.arange(4000) + rng.uniform(0, jitter, 4000)) * STEP
    fresh = np.round(axis_position(duty, STEP) / count) * count
    read = held(fresh, time, rows * STEP)
    assert find_refresh(time, fresh, 0.0) is None
    found = find_refresh(time, read, 0.0)
    assert found == pytest.approx(rows * STEP, rel=0.1)
    new = new_readings(time, read, found)
    assert np.mean(new) == pytest.approx(1 / rows, rel=0.15)
    assert find_count(read[new]) == pytest.approx(count, rel=1e-4)


@pytest.mark.parametrize("per_turn", [16, 200, 4096])
def test_a_slow_axis_repeats_counts_and_is_not_held(per_turn: int) -> None:
    duty = duty_levels(4, 6000, 0.001, 8.0)
    counts = np.round(axis_position(duty, 0.001) * per_turn / (2 * math.pi))
    assert np.mean(np.diff(counts) == 0) > 0.3
    for resolution in (0.0, 1.0):
        assert find_refresh(np.arange(6000) * 0.001, counts, resolution) is None


def test_a_speed_held_at_20_hz_is_found() -> None:
    duty = duty_levels(2, 8000, 0.002)
    time = np.arange(8000) * 0.002
    assert find_refresh(time, held(np.round(axis_speed(duty, 0.002), 2), time, 0.05), 0.0) == pytest.approx(0.05)


@pytest.mark.parametrize("given_refresh", ["", "refresh = 0.05"])
def test_rows_that_repeat_are_left_out_and_it_is_no_row_of_freezes(tmp_path: Path, given_refresh: str) -> None:
    duty = duty_levels(2, 8000, 0.002)
    time = np.arange(8000) * 0.002
    counts = held(np.round(axis_position(duty, 0.002) / 1e-3), time, 0.05)
    output = f'unit = "count"\ncounts_per_revolution = 6283\n{given_refresh}'
    (recording,), _ = load([write_log(tmp_path, {"t": time, "duty": duty, "y": counts}, rig_text(output))])
    assert recording.faults == ()
    assert recording.refresh == pytest.approx(0.05)
    assert np.isfinite(recording.output).sum() == pytest.approx(16 / 0.05, rel=0.05)
