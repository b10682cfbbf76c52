"""Faults of a recording: planted ones are found, and nothing is found where nothing is wrong."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from driven_axis import dry_axis, square_wave

from twin.io.faults import find_held
from twin.io.recording import Recording, load

SHARED = Path(__file__).resolve().parents[3] / "shared"
MODELS = Path(__file__).resolve().parents[2] / "models"
COUNT = 2 * math.pi / 10_000
RIG = (MODELS / "shipped" / "rig.toml").read_text()


def recorded(folder: Path, duty: np.ndarray, angle: np.ndarray, time: np.ndarray | None = None) -> Recording:
    """Through the whole of `load`: counts in a CSV."""
    time = np.arange(duty.size) * 0.002 if time is None else time
    counts = np.round(angle / COUNT)
    rows = [f"{t:.6f},{u:g},{n:.0f}" for t, u, n in zip(time, duty, counts, strict=True)]
    (folder / "log.csv").write_text("\n".join(["t,duty,counts", *rows]))
    (folder / "rig.toml").write_text(RIG)
    (recording,), _ = load([folder / "log.csv"])
    return recording


@pytest.fixture(scope="module")
def clean() -> tuple[np.ndarray, np.ndarray]:
    duty = square_wave(np.random.default_rng(3), 8000)
    return duty, dry_axis(duty)


# 3 degrees of gap is far more than a gear has
@pytest.mark.parametrize("gap", [0.0, 0.005, 0.05])
@pytest.mark.parametrize("stop", [math.inf, 2.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_nothing_is_invented(tmp_path: Path, gap: float, stop: float, seed: int) -> None:
    duty = square_wave(np.random.default_rng(seed), 6000)
    angle = dry_axis(duty, gap=gap, stop=stop)
    still = np.diff(np.flatnonzero(np.diff(np.round(angle / COUNT)) != 0)).max() * 0.002
    assert still > 0.5, "the null case must stick for long, or it tests nothing"
    recording = recorded(tmp_path, duty, angle)
    assert recording.faults == ()
    assert np.isfinite(recording.output).all()


@pytest.mark.parametrize("period", [0.02, 0.1])
def test_nothing_is_invented_at_a_low_sample_rate(tmp_path: Path, period: float) -> None:
    duty = square_wave(np.random.default_rng(5), 12_000)
    step = round(period / 0.002)
    angle = dry_axis(duty, gap=0.02)[::step]
    recording = recorded(tmp_path, duty[::step], angle, np.arange(angle.size) * period)
    assert recording.faults == ()


def test_ringing_is_no_row_of_outliers(tmp_path: Path) -> None:
    time = np.arange(4000) * 0.002
    angle = 0.3 * np.exp(-5 * (time % 1)) * np.sin(2 * np.pi * 120 * time)
    assert recorded(tmp_path, np.sign(np.sin(time)), angle).faults == ()


@pytest.mark.parametrize("size", [0.05, -0.3, math.pi])
def test_planted_outliers_are_left_out(tmp_path: Path, clean: tuple[np.ndarray, np.ndarray], size: float) -> None:
    duty, angle = clean
    read = angle.copy()
    speed = np.abs(np.gradient(angle))
    slow = np.flatnonzero(speed < abs(size) / 20)
    planted = sorted(int(k) for k in slow[:: slow.size // 7][1:7])
    read[planted] += size
    recording = recorded(tmp_path, duty, read)
    assert np.flatnonzero(np.isnan(recording.output)).tolist() == planted
    assert [f.kind for f in recording.faults] == ["outlier"] * len(planted)
    assert [f.start for f in recording.faults] == pytest.approx([0.002 * k for k in planted])


def test_two_read_errors_in_a_row_are_left_out(tmp_path: Path, clean: tuple[np.ndarray, np.ndarray]) -> None:
    duty, angle = clean
    read = angle.copy()
    read[3000:3002] = angle.max() + 5
    recording = recorded(tmp_path, duty, read)
    assert np.flatnonzero(np.isnan(recording.output)).tolist() == [3000, 3001]


@pytest.mark.parametrize("length", [0.1, 0.4, 1.2])
def test_planted_freezes_are_found(tmp_path: Path, clean: tuple[np.ndarray, np.ndarray], length: float) -> None:
    duty, angle = clean
    samples = round(length / 0.002)
    moving = np.abs(np.gradient(angle)) > 20 * COUNT
    starts = [k for k in range(300, angle.size - samples - 300, 37) if moving[k] and moving[k + samples]]
    found = 0
    for start in starts[:: max(1, len(starts) // 12)]:
        read = angle.copy()
        read[start : start + samples] = angle[start]
        recording = recorded(tmp_path, duty, read)
        freezes = [f for f in recording.faults if f.kind == "freeze"]
        assert len(recording.faults) == len(freezes) <= 1
        if freezes:
            found += 1
            assert freezes[0].start == pytest.approx(0.002 * start, abs=0.0021)
            assert freezes[0].end == pytest.approx(0.002 * (start + samples - 1), abs=0.0021)
            assert np.isnan(recording.output[start + 1 : start + samples]).all()
            assert np.isfinite(recording.output[start + samples :]).all()
    tried = len(starts[:: max(1, len(starts) // 12)])
    assert tried >= 8
    assert found >= 0.9 * tried


def stretches(*parts: tuple[float, int]) -> np.ndarray:
    """Counts of an axis that moves at given counts per sample for given numbers of samples."""
    return np.concatenate(([0.0], np.cumsum(np.concatenate([np.full(n, float(v)) for v, n in parts]))))


FAST = (
    (400, 30),
    (-400, 30),
)  # how fast this axis can be, so that 300 counts in a sample are nothing impossible
SLOW_STOP = ((60, 50), (45, 1), (30, 1), (15, 1), (4, 1))


@pytest.mark.parametrize(
    ("what", "parts", "found"),
    [
        ("moved on slowly", (*FAST, (10, 200), (0, 20), (200, 1), (10, 200), (0, 50)), 1),
        ("in mid-range, no braking, no starting", (*FAST, (30, 100), (0, 50), (30, 100), (0, 50)), 1),
        ("stopped by friction, hit by the gear", (*FAST, *SLOW_STOP, (0, 50), (60, 50), (0, 50)), 0),
        ("hit by the gear after an end stop", ((60, 100), (0, 50), (-60, 100), (0, 50)), 0),
        (
            "steps of a positioner, slowly sampled",
            tuple((v, 1) for n in (70, 90, 80) for v in [n, *[0] * 20]),
            0,
        ),
        ("accelerates from rest", ((0, 40), *((v, 1) for v in range(5, 400, 30)), (0, 40)), 0),
    ],
)
def test_what_is_and_is_not_a_freeze(what: str, parts: tuple[tuple[float, int], ...], found: int) -> None:
    counts = stretches(*parts)
    faults, out = find_held(np.arange(counts.size) * 0.002, counts * COUNT, COUNT)
    assert [f.kind for f in faults] == ["freeze"] * found
    assert out.any() == bool(found)


def test_a_freeze_shows_in_the_reported_speed(tmp_path: Path) -> None:
    """The axis comes back to where it was when the reading froze: only the speed gives it away."""
    time = np.arange(2000) * 0.002
    angle = np.sin(2 * np.pi * time)
    speed = np.round(2 * np.pi * np.cos(2 * np.pi * time) / 0.05) * 0.05
    angle[600:1100], speed[600:1100] = angle[600], speed[600]
    rows = zip(time, np.sign(angle), angle, speed, strict=True)
    lines = ["t,duty,pos,speed", *(f"{t:.4f},{u:g},{y:.5f},{w:.3f}" for t, u, y, w in rows)]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    rig = RIG.replace("counts", "pos", 1).replace('"count"', '"rad"').replace("10000", "100000")
    (tmp_path / "rig.toml").write_text(rig + '[optional.speed]\ncolumn = "speed"\nunit = "rad/s"\n')
    (recording,), _ = load([tmp_path / "log.csv"])
    (freeze,) = recording.faults
    assert freeze.kind == "freeze"
    assert (freeze.start, freeze.end) == pytest.approx((1.2, 2.198), abs=0.003)


def test_gap_is_reported_and_its_data_stay(tmp_path: Path, clean: tuple[np.ndarray, np.ndarray]) -> None:
    duty, angle = clean
    keep = np.r_[0:2500, 2700:8000]
    recording = recorded(tmp_path, duty[keep], angle[keep], keep * 0.002)
    (gap,) = recording.faults
    assert (gap.kind, gap.start, gap.end) == ("gap", pytest.approx(4.998), pytest.approx(5.4))
    assert np.isfinite(recording.output).all()


def test_a_stamp_that_comes_twice_is_dropped(tmp_path: Path, clean: tuple[np.ndarray, np.ndarray]) -> None:
    duty, angle = clean
    time = np.arange(8000) * 0.002
    time[[100, 4000]] = time[[99, 3999]]
    recording = recorded(tmp_path, duty, angle, time)
    assert [f.kind for f in recording.faults] == ["clock", "clock"]
    assert recording.time.size == 7998
    assert (np.diff(recording.time) > 0).all()


@pytest.mark.parametrize("turn", [10_000, 2**16, 2**12])
def test_wraps_are_undone(tmp_path: Path, turn: int) -> None:
    time = np.arange(6000) * 0.002
    angle = 14 * np.sin(0.9 * time) + np.cos(9 * time)
    counts = np.round(angle / COUNT)
    wrapped = (counts + turn // 2) % turn - turn // 2
    jumps = np.count_nonzero(np.abs(np.diff(wrapped)) > turn / 2)
    recording = recorded(tmp_path, np.sign(np.sin(time)), wrapped * COUNT)
    if turn != 2**16:
        assert jumps > 5
    assert sum(f.kind == "wrap" for f in recording.faults) == jumps == len(recording.faults)
    np.testing.assert_allclose(recording.output - recording.output[0], (counts - counts[0]) * COUNT, atol=1e-9)


def test_missing_cells_are_left_out_and_merged(tmp_path: Path) -> None:
    lines = [f"{0.01 * k:.2f},{k % 7},{math.sin(0.1 * k):.6f}" for k in range(200)]
    lines[50] = f"0.50,,{math.sin(5):.6f}"
    for k in (80, 81, 82):
        lines[k] = f"{0.01 * k:.2f},3,nan"
    lines[120] = "1.20,3,inf"
    (tmp_path / "log.csv").write_text("\n".join(["t,duty,pos_rad", *lines]))
    (recording,), _ = load([tmp_path / "log.csv"])
    spans = [(f.kind, round(f.start, 3), round(f.end, 3)) for f in recording.faults]
    assert spans == [("missing", 0.5, 0.5), ("missing", 0.8, 0.82), ("missing", 1.2, 1.2)]
    assert recording.input[50] == recording.input[49]
    assert np.flatnonzero(np.isnan(recording.output)).tolist() == [80, 81, 82, 120]
    assert "4 readings left out" in repr(recording)


@pytest.mark.skipif(not SHARED.exists(), reason="the real recordings are not here")
class TestRealRecordings:
    def test_no_fault_in_the_gear_motor_steps(self) -> None:
        folder = SHARED / "data/jga25_pwm_steps/runs"
        recordings, _ = load(sorted(folder.glob("*.csv")), MODELS / "rigs/jga25.toml")
        assert len(recordings) == 104
        assert [r.name for r in recordings if r.faults] == []
        # the README: 38.8 rpm per step
        assert recordings[0].resolution == pytest.approx(38.8 * 2 * math.pi / 60, rel=0.005)

    def test_the_servo_runs_show_the_faults_of_their_list(self, tmp_path: Path) -> None:
        folder = SHARED / "data/sts3215_pendulum"
        with (folder / "manifest.csv").open() as stream:
            listed = list(csv.DictReader(stream))
        rare = [r for r in listed if int(r["n_volt_dropouts"]) or float(r["frozen_s"])]
        rows = [*rare, *(r for r in listed[::5] if r not in rare)]
        manifest = [(r, folder / "runs" / r["file"]) for r in rows]
        rig = (MODELS / "rigs/sts3215.toml").read_text()
        (tmp_path / "rig.toml").write_text(rig[: rig.index("[loop]")])  # its gain is in another manifest
        recordings, _ = load([path for _, path in manifest], tmp_path / "rig.toml")
        for recording, (row, _) in zip(recordings, manifest, strict=True):
            says = [f.says for f in recording.faults]
            frozen = sum(f.end - f.start for f in recording.faults if f.kind == "freeze")
            for what, count in (("output", "n_pos_outliers"), ("supply", "n_volt_dropouts")):
                assert sum(s.startswith(f"The {what} jumps") for s in says) == int(row[count]), row["file"]
            assert frozen == pytest.approx(float(row["frozen_s"]), abs=0.01), row["file"]
            assert {f.kind for f in recording.faults} <= {"outlier", "freeze"}

    def test_nothing_is_invented_on_the_other_rigs(self) -> None:
        folder = SHARED / "data/ak80_pendulum"
        recordings, _ = load(sorted(folder.glob("*_measured.csv")), MODELS / "rigs/ak80.toml")
        recordings += load(sorted((SHARED / "data/emps").glob("*.mat")), MODELS / "rigs/emps.toml")[0]
        assert [(r.name, f) for r in recordings for f in r.faults] == []
