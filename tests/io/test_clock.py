"""Clocks that wrap, jump, come in bursts or are in another unit."""

from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, duty_levels, rig_text, write_log

from twin.errors import BadInput
from twin.io.clock import count_from_first
from twin.io.recording import Recording, load

N = 5000
COUNTS = 'unit = "count"\ncounts_per_revolution = 4096'


def loaded(folder: Path, stamps: np.ndarray, step: float, unit: str = "s", duty: np.ndarray | None = None) -> Recording:
    duty = duty_levels(1, N, step) if duty is None else duty
    counts = np.round(axis_position(duty, step) * 4096 / (2 * np.pi))
    rig = rig_text(COUNTS, time=f'unit = "{unit}"')
    return load([write_log(folder, {"t": stamps, "duty": duty, "y": counts}, rig)])[0][0]


@pytest.mark.parametrize(
    ("unit", "top", "step"),
    [("us", 2**32, 2000), ("ms", 2**32, 2), ("ms", 2**32 / 1e3, 2), ("s", 2**32 / 1e6, 0.002), ("ms", 2**16, 2)],
)
def test_a_counter_that_passes_its_largest_number(tmp_path: Path, unit: str, top: float, step: float) -> None:
    stamps = (top - 1000.5 * step + np.arange(N) * step) % top
    assert stamps[-1] < stamps[0]
    recording = loaded(tmp_path, stamps, 0.002, unit)
    np.testing.assert_allclose(recording.time, np.arange(N) * 0.002, atol=1e-4)
    assert [f.kind for f in recording.faults] == ["clock"]


@pytest.mark.parametrize("jump", [-50.0, 3600.0])
def test_a_clock_that_was_set_while_the_axis_moved_on(tmp_path: Path, jump: float) -> None:
    stamps = np.arange(N) * 0.002 + 100.0
    stamps[2500:] += jump
    recording = loaded(tmp_path, stamps, 0.002, duty=np.full(N, 40.0) * np.sign(np.sin(np.arange(N) / 400.0)))
    np.testing.assert_allclose(recording.time, np.arange(N) * 0.002, atol=1e-3)
    assert [f.kind for f in recording.faults] == ["clock"]


def test_a_pause_of_the_log_is_a_gap(tmp_path: Path) -> None:
    stamps = np.arange(N) * 0.002
    stamps[2500:] += 2.0
    duty = duty_levels(1, N + 1000, 0.002)
    counts = np.round(axis_position(duty, 0.002) * 4096 / (2 * np.pi))
    keep = np.r_[0:2500, 3500:6000]
    log = write_log(tmp_path, {"t": keep * 0.002, "duty": duty[keep], "y": counts[keep]}, rig_text(COUNTS))
    (recording,), _ = load([log])
    assert [f.kind for f in recording.faults] == ["gap"]
    assert recording.time[-1] == pytest.approx(0.002 * 5999)


def test_two_runs_in_one_file_are_refused(tmp_path: Path) -> None:
    stamps = np.concatenate([np.arange(N // 2), np.arange(N // 2)]) * 0.002
    duty = np.concatenate([duty_levels(1, N // 2 - 300, 0.002), np.zeros(300), duty_levels(1, N // 2, 0.002)])
    with pytest.raises(BadInput, match=r"line 2502: time goes backwards.*split the recording"):
        loaded(tmp_path, stamps, 0.002, duty=duty)


@pytest.mark.parametrize(("many", "jitter"), [(10, 0.0), (4, 0.001), (25, 0.004)])
def test_bursts_are_spread_evenly(tmp_path: Path, many: int, jitter: float) -> None:
    rng = np.random.default_rng(2)
    true = np.arange(N) * 0.002
    burst = np.arange(N) // many
    stamps = (burst + 1) * many * 0.002 + rng.uniform(0, jitter, burst[-1] + 1)[burst] + np.arange(N) % many * 1e-5
    recording = loaded(tmp_path, stamps, 0.002)
    (fault,) = recording.faults
    assert f"bursts of {many} every" in fault.says
    assert "sample_time = 0.002" in fault.says
    np.testing.assert_allclose(recording.time, true, atol=2 * jitter + 0.001)


def test_uneven_stamps_are_no_bursts(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    stamps = np.cumsum(rng.exponential(0.002, N) + 1e-5)
    recording = loaded(tmp_path, stamps, 0.002)
    np.testing.assert_allclose(recording.time, stamps - stamps[0], atol=1e-7)


@pytest.mark.parametrize(
    ("stamp", "said", "cure", "makes"),
    [
        (2.0, "us", "ms", "2 ms"), (2000.0, "s", "us", "2 ms"), (2000.0, "ms", "us", "2 ms"), (2.0, "s", "ms", "2 ms"),
        (0.002, "us", "s", "2 ms"), (2e6, "ms", "ns", "2 ms"), (5e6, "us", "ns", "5 ms"),
    ],
)  # fmt: skip
def test_a_wrong_unit_is_refused_with_the_one_that_works(
    tmp_path: Path, stamp: float, said: str, cure: str, makes: str
) -> None:
    step = float(makes.split()[0]) * 1e-3
    with pytest.raises(BadInput, match=rf'column \'t\' makes .*say unit = "{cure}" in \[time\].*makes it {makes}'):
        loaded(tmp_path, np.arange(N) * stamp, step, said)
    assert loaded(tmp_path, np.arange(N) * stamp, step, cure).time[1] == pytest.approx(step)


def test_stamps_that_are_no_time_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"makes 0\.002 ns from sample to sample.*give \[time\] sample_time instead"):
        loaded(tmp_path, np.arange(N) * 2e-12, 0.002)


@pytest.mark.parametrize("begin", [0.001, 100.0, 43200.0, 1.77e9])
def test_a_recording_has_the_same_times_whenever_it_was_made(tmp_path: Path, begin: float) -> None:
    """To the last bit: a fit that has two ends of equal likelihood would else take the one or the other."""
    early, late = (np.array([float(f"{at + 0.002 * k:.3f}") for k in range(N)]) for at in (0.0, begin))
    assert np.array_equal(count_from_first(late), early)
    if begin < 1e6:  # write_log writes ten digits
        assert np.array_equal(loaded(tmp_path, late, 0.002).time, loaded(tmp_path, early, 0.002).time)


@pytest.mark.parametrize("scale", [1e-300, 1e-9, 1e18, 1e300])
def test_stamps_of_any_size_are_counted_from_the_first(scale: float) -> None:
    stamps = scale * np.array([1.0, 1.5, 2.0])
    np.testing.assert_allclose(count_from_first(stamps), scale * np.array([0.0, 0.5, 1.0]), rtol=1e-9)
