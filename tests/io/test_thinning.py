"""Of more recordings than memory holds, what moves most is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, duty_levels, rig_text, write_log
from hypothesis import given
from hypothesis import strategies as st

import twin
from twin.io import thinning

STEP, N = 0.002, 24_000
RIG = rig_text('unit = "rad"\nresolution = 0.0006')


def logs(folder: Path, count: int, idle: int = 0) -> list[Path]:
    """Recordings of an axis that stands still for so many rows before it moves."""
    made = []
    for k in range(count):
        duty = np.concatenate((np.zeros(idle), duty_levels(k, N - idle, STEP)))
        columns = {"t": STEP * np.arange(N), "duty": duty, "y": np.round(axis_position(duty, STEP) / 6e-4) * 6e-4}
        made.append(write_log(folder, columns, RIG, f"{k}.csv"))
    return made


@given(st.integers(0, 999), st.floats(0.0, 0.4))
def test_the_half_that_moves_most(seed: int, missing: float) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.001, 0.003, 12_001))
    speed = np.repeat(rng.uniform(0.0, 1.0, 13), 1000)[: time.size]
    output = np.where(rng.random(time.size) < missing, np.nan, np.cumsum(speed))
    ends = thinning.busiest_half(time, output)
    assert ends is not None
    inside = (time >= ends[0]) & (time <= ends[1])
    assert np.count_nonzero(inside) == 6000

    def way(begin: int) -> float:
        read = output[begin : begin + 6000]
        return float(np.sum(np.abs(np.diff(read[np.isfinite(read)]))))

    assert way(int(np.flatnonzero(inside)[0])) >= max(way(k) for k in range(0, 6001, 250)) - 5.0


def test_of_an_axis_that_stands_the_half_that_is_read() -> None:
    output = np.full(12_000, np.nan)
    output[7000:] = 1.0
    ends = thinning.busiest_half(np.arange(12_000.0), output)
    assert ends is not None and ends[1] >= 11_000


def test_what_fits_is_held_whole(tmp_path: Path) -> None:
    recordings = twin.load(logs(tmp_path, 2))
    assert [r.time.size for r in recordings] == [N, N] and [r.name for r in recordings] == ["0.csv", "1.csv"]
    assert not [f for r in recordings for f in r.preflight]


@pytest.mark.parametrize("count", [3, 6])
def test_what_does_not_fit_is_cut_to_what_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Alike, however many follow; once said; and the parameters are those of the axis."""
    monkeypatch.setattr(thinning, "MOST", 40_000)
    recordings = twin.load(logs(tmp_path, count, idle=N // 2))
    sizes = {r.time.size for r in recordings}
    assert len(recordings) == count and len(sizes) == 1 and 20_000 < sum(r.time.size for r in recordings) <= 40_000
    for r in recordings:
        assert np.mean(r.input != 0.0) > 0.7 and r.time[0] == 0.0
        begin = float(r.name.split("(")[1].split(" to ")[0])
        assert begin >= 0.99 * STEP * N // 2
    (finding,) = [f for r in recordings for f in r.preflight]
    kept, lasted = sum(r.time[-1] for r in recordings), count * STEP * (N - 1)
    assert finding.kind == "thinned" and f"{kept:.0f} s of {lasted:.0f} s are used" in finding.says
    model = twin.identify(recordings, twin.first_structure(recordings, exclude=["dead_band", "backlash"]))
    for name, truth in (("input_gain", 6.0), ("viscous_friction", 5.0)):
        assert model.values[name] == pytest.approx(truth, rel=1e-4) and model.std(name) < 1e-4 * truth


def test_a_short_recording_is_not_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thinning, "MOST", 1_000)
    columns = {"t": STEP * np.arange(4000), "duty": duty_levels(1, 4000, STEP)}
    columns["y"] = np.round(axis_position(columns["duty"], STEP) / 6e-4) * 6e-4
    (recording,) = twin.load(write_log(tmp_path, columns, RIG))
    assert recording.time.size == 4000 and recording.name == "log.csv" and not recording.preflight
