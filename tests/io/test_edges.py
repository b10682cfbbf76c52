"""A coarse counter read at its edges: where the axis truly was, and only where counts are coarse."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, axis_speed, duty_levels, rig_text, write_log
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from twin.io.edges import counted
from twin.io.preflight.finding import Severity
from twin.io.recording import Recording, load

STEP, N = 0.002, 15_000
TIME = STEP * np.arange(N)


def loaded(folder: Path, duty: np.ndarray, angle: np.ndarray, per_turn: int, name: str = "log.csv") -> Recording:
    counts = np.round(angle * per_turn / (2 * math.pi))
    rig = rig_text(f'unit = "count"\ncounts_per_revolution = {per_turn}')
    log = write_log(folder, {"t": STEP * np.arange(len(duty)), "duty": duty, "y": counts}, rig, name)
    (recording,), _ = load([log])
    return recording


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 999), st.sampled_from([20, 35, 100, 400]), st.floats(-0.5, 0.5))
def test_the_axis_is_where_the_edge_is(seed: int, per_turn: int, offset: float) -> None:
    """However coarse, an edge errs by what the axis moves within a row."""
    duty = 0.1 * duty_levels(seed, N, STEP)
    count = 2 * math.pi / per_turn
    angle = axis_position(duty, STEP) + offset * count
    seen = counted(TIME, np.round(angle / count) * count, count)
    assert seen is not None
    known, share = seen.edges()
    error = np.abs(known - angle)[1:]
    assert np.nanmax(error) < np.max(np.abs(np.diff(angle))) + 1e-9
    if share.size > 20:
        assert np.sqrt(np.nanmean(error**2)) < 2.0 * count * np.sqrt(np.mean(share**2) / 12.0)


def test_one_count_a_row_is_read_as_it_is() -> None:
    """The edges go over into plain readings where the axis moves by a count or more from row to row."""
    value = np.concatenate((np.arange(500.0), 500.0 + 3.0 * np.arange(500.0)))
    seen = counted(STEP * np.arange(1000), value, 1.0)
    assert seen is not None and seen.repeats[0] == 0
    known, share = seen.edges()
    np.testing.assert_allclose(known, value, atol=1e-9)
    np.testing.assert_allclose(share, 1.0)


@pytest.mark.parametrize("per_turn", [35, 150])
def test_a_coarse_counter_gives_the_parameters_within_their_errors(tmp_path: Path, per_turn: int) -> None:
    """Read at each row, a filter that repeats the last reading would be the likeliest."""
    duty = 0.1 * duty_levels(4, N, STEP)
    recording = loaded(tmp_path, duty, axis_position(duty, STEP) + 0.01, per_turn)
    (finding,) = recording.preflight
    assert finding.kind == "coarse" and finding.severity is Severity.WARNS
    assert "read where its count changes" in finding.says
    assert np.mean(np.isfinite(recording.output)) < 0.5
    model = twin.identify(recording, twin.first_structure(recording, exclude=["dead_band", "backlash"]))
    for name, truth in (("input_gain", 6.0), ("viscous_friction", 5.0)):
        assert abs(model.values[name] - truth) < 4.0 * model.std(name)
        assert model.std(name) < 0.02 * truth


def test_a_fine_counter_and_a_speed_are_read_at_each_row(tmp_path: Path) -> None:
    duty = duty_levels(5, N, STEP)
    recording = loaded(tmp_path, duty, axis_position(duty, STEP), 2000)
    assert recording.preflight == () and recording.edge_rounding is None and np.isfinite(recording.output).all()
    speed = np.round(axis_speed(0.02 * duty, STEP))
    log = write_log(tmp_path, {"t": TIME, "duty": duty, "y": speed}, rig_text('unit = "rad/s"'), "speed.csv")
    (recording,), _ = load([log])
    assert recording.edge_rounding is None and np.isfinite(recording.output).all()


def test_recordings_of_one_rig_are_read_alike(tmp_path: Path) -> None:
    """A slow one among fast ones keeps its rows, and a fast one among slow ones does not."""
    for slow, at_edges in ((1, False), (3, True)):
        logs = []
        for k in range(4):
            duty = duty_levels(20 + k, N, STEP) * (0.02 if k < slow else 1.0)
            angle = axis_position(duty, STEP)
            logs.append(tmp_path / f"{k}.csv")
            loaded(tmp_path, duty, angle, 600, logs[-1].name)
        recordings, _ = load(logs)
        assert [r.edge_rounding is not None for r in recordings] == [at_edges] * 4
        assert sum(f.kind == "coarse" for r in recordings for f in r.preflight) == at_edges
