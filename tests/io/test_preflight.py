"""What is found before any fit: each fault that is planted, with its cure, and nothing on sound recordings."""

import math
from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, axis_speed, duty_levels, rig_text, write_log
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.errors import BadInput
from twin.io.preflight.checks import examine
from twin.io.preflight.finding import Severity
from twin.io.preflight.response import Signals
from twin.io.recording import Recording, load, preflight_of, to_fit

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"
STEP, N = 0.004, 5000
TIME = np.arange(N) * STEP
COUNT = 2 * math.pi / 4096
COUNTS = 'unit = "count"\ncounts_per_revolution = 4096'
SPEED = 'unit = "rad/s"'


def loaded(folder: Path, duty: np.ndarray, reading: np.ndarray, output: str = COUNTS, drive: str = 'unit = "%"'):
    return load([write_log(folder, {"t": TIME, "duty": duty, "y": reading}, rig_text(output, drive))])[0][0]


def kinds(recording: Recording) -> list[str]:
    return [f.kind for f in recording.preflight]


def counts(duty: np.ndarray, **axis: float) -> np.ndarray:
    return np.round(axis_position(duty, STEP, **axis) / COUNT)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_reversed_sensor_is_found_and_the_cure_works(tmp_path: Path, seed: int) -> None:
    duty = duty_levels(seed, N, STEP)
    recording = loaded(tmp_path, duty, -counts(duty))
    assert kinds(recording) == ["sign"]
    with pytest.raises(BadInput, match=r"log\.csv: the output moves against the input: .*scale = -1 in \[output\]"):
        to_fit([recording])
    cured = loaded(tmp_path, duty, -counts(duty), COUNTS + "\nscale = -1")
    assert kinds(cured) == []
    assert to_fit([cured]) == [cured]


def test_a_loop_that_holds_a_load_is_not_reversed(tmp_path: Path) -> None:
    """Position loop, gravity, slow reference: the command goes with the load, not with the speed."""
    angle = speed = 0.0
    read, commands = np.zeros(N), np.zeros(N)
    goal = np.repeat(np.random.default_rng(4).uniform(-1.2, 1.2, N // 250), 250)
    for k in range(N):
        read[k] = angle
        command = commands[k] = np.clip(60.0 * (goal[k] - angle), -60.0, 60.0)
        for _ in range(4):
            speed += STEP / 4 * (3.0 * command - 8.0 * speed - 60.0 * math.sin(angle))
            angle += STEP / 4 * speed
    assert kinds(loaded(tmp_path, commands, np.round(read / COUNT))) == []


@pytest.mark.parametrize("seed", [3, 4, 5])
@pytest.mark.parametrize("friction", [0.2, 1.5, 5.0, 20.0])
def test_a_magnitude_with_its_direction_elsewhere(tmp_path: Path, seed: int, friction: float) -> None:
    duty = duty_levels(seed, N, STEP)
    recording = loaded(tmp_path, np.abs(duty), counts(duty, friction=friction))
    assert kinds(recording) == ["direction"]
    assert "[input.direction]" in recording.preflight[0].says


@pytest.mark.parametrize(
    ("seed", "friction", "spring", "gravity"), [(1, 0.7, 0.0, 50.0), (5, 0.7, 40.0, 0.0), (5, 2.0, 40.0, 0.0)]
)
def test_a_magnitude_on_a_slow_axis_under_load(
    tmp_path: Path, seed: int, friction: float, spring: float, gravity: float
) -> None:
    """The speed follows late, so that the command explains little of its size: it explains the size of its change."""

    def reading(duty: np.ndarray) -> np.ndarray:
        angle = speed = 0.0
        read = np.zeros(N)
        for k in range(N):
            read[k] = angle
            for _ in range(2):
                speed += STEP / 2 * (3.0 * duty[k] - friction * speed - spring * angle - gravity * math.sin(angle))
                angle += STEP / 2 * speed
        return np.round(read / COUNT)

    duty = duty_levels(seed, N, STEP)
    assert kinds(loaded(tmp_path, np.abs(duty), reading(duty))) == ["direction"]
    assert kinds(loaded(tmp_path, duty, reading(duty))) == []
    assert kinds(loaded(tmp_path, np.abs(duty), reading(np.abs(duty)))) == []  # the load brings it back


def test_a_load_that_falls_back_has_not_lost_a_direction(tmp_path: Path) -> None:
    """A command of one sign against a spring: the axis moves both ways, and the command brakes it on its way back."""
    duty = np.abs(duty_levels(3, N, STEP))
    angle = speed = 0.0
    read = np.zeros(N)
    for k in range(N):
        read[k] = angle
        for _ in range(4):
            speed += STEP / 4 * (3.0 * duty[k] - 6.0 * speed - 40.0 * angle)
            angle += STEP / 4 * speed
    assert kinds(loaded(tmp_path, duty, np.round(read / COUNT))) == []


def test_a_speed_without_its_direction(tmp_path: Path) -> None:
    duty = duty_levels(5, N, STEP)
    speed = np.round(axis_speed(duty, STEP), 1)
    assert kinds(loaded(tmp_path, duty, np.abs(speed), SPEED)) == ["unsigned_output"]
    assert kinds(loaded(tmp_path, duty, speed, SPEED)) == []


@pytest.mark.parametrize("friction", [1.0, 3.0, 20.0])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_counter_of_pulses_gives_a_speed_without_its_direction(tmp_path: Path, friction: float, noise: float) -> None:
    """A command of one size, to and fro, tells nothing by its size; noise around standstill is below zero."""
    rng = np.random.default_rng(3)
    duty = 40.0 * np.repeat(rng.choice([-1.0, 1.0], N // 60 + 1), 60)[:N]
    speed = axis_speed(duty, STEP, friction=friction)
    read = np.abs(speed) + noise * np.ptp(speed) * rng.standard_normal(N)
    assert kinds(loaded(tmp_path, duty, np.round(read, 2), SPEED)) == ["unsigned_output"]
    signed = speed + noise * np.ptp(speed) * rng.standard_normal(N)
    assert kinds(loaded(tmp_path, duty, np.round(signed, 2), SPEED)) == []
    # One way only, with a brake: the speed is positive because it is.
    braked = np.where(duty > 0.0, duty, -1.0)
    assert kinds(loaded(tmp_path, braked, np.round(axis_speed(braked, STEP, friction=friction), 2), SPEED)) == []


@pytest.mark.parametrize(("bits", "most", "drive"), [(8, 100.0, 'unit = "%"'), (16, 3000.0, "full_scale = 3000")])
def test_signed_numbers_that_were_read_as_unsigned(tmp_path: Path, bits: int, most: float, drive: str) -> None:
    duty = np.round(duty_levels(6, N, STEP, most))
    reading = counts(duty / most * 60.0)
    recording = loaded(tmp_path, duty % 2**bits, reading, drive=drive)
    assert "unsigned_input" in kinds(recording)
    assert f"signed_bits = {bits}" in recording.preflight[0].says
    cured = loaded(tmp_path, duty % 2**bits, reading, drive=f"{drive}\nsigned_bits = {bits}")
    assert kinds(cured) == []
    np.testing.assert_allclose(cured.input, duty / most * 100.0 if bits == 16 else duty)


def test_a_signed_word_in_percent_names_its_cure(tmp_path: Path) -> None:
    duty = np.round(duty_levels(6, N, STEP))
    with pytest.raises(BadInput, match=r"signed_bits = 16 in \[input\]"):
        loaded(tmp_path, duty % 2**16, counts(duty))


@pytest.mark.parametrize(
    ("scale", "drive", "cure"),
    [
        (0.01, 'unit = "%"', 'unit = "1"'), (2.55, 'unit = "%"', "full_scale = 255"),
        (10.0, 'unit = "%"', "full_scale = 1000"), (1.0, 'unit = "1"', 'unit = "%"'),
    ],
)  # fmt: skip
def test_a_duty_of_another_scale(tmp_path: Path, scale: float, drive: str, cure: str) -> None:
    duty = duty_levels(7, N, STEP, 95.0)
    recording = loaded(tmp_path, np.round(duty * scale, 4), counts(duty), drive=drive)
    assert kinds(recording) == ["duty_scale"]
    assert cure in recording.preflight[0].says
    assert recording.preflight[0].severity is Severity.WARNS
    assert to_fit([recording]) == [recording]


def test_columns_that_have_nothing_to_do_with_each_other() -> None:
    """By chance the true command explains more than 40 moved ones in one case of twenty."""
    found = []
    for seed in range(20):
        duty, other = duty_levels(2 * seed, N, STEP), duty_levels(2 * seed + 1, N, STEP)
        output = counts(other) * COUNT
        found += [f.kind for f in examine([Signals("a", TIME, duty, output, False, COUNT, duty, "%")])]
    assert set(found) == {"unrelated"}
    assert len(found) >= 17


@given(
    seed=st.integers(0, 10**6), gain=st.floats(0.2, 30.0), friction=st.floats(0.3, 60.0),
    kind=st.sampled_from(["levels", "square", "sine", "ramp"]),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_nothing_is_found_on_a_sound_axis(seed: int, gain: float, friction: float, kind: str) -> None:
    duty = {
        "levels": duty_levels(seed, N, STEP), "square": 40.0 * np.sign(np.sin(2 * np.pi * 0.7 * TIME + seed)),
        "sine": 50.0 * np.sin(2 * np.pi * 0.5 * TIME + seed), "ramp": np.linspace(0.0, 80.0, N),
    }[kind]  # fmt: skip
    output = np.round(axis_position(duty, STEP, gain, friction) / COUNT) * COUNT
    assert examine([Signals("a", TIME, duty, output, False, COUNT, duty, "%")]) == []


def test_an_axis_that_stays_in_its_dead_band(tmp_path: Path) -> None:
    duty = duty_levels(8, N, STEP, 6.0)
    shaken = np.random.default_rng(0).integers(0, 2, N).astype(float)
    recording = loaded(tmp_path, duty, shaken)
    assert kinds(recording) == ["dead_band"]
    assert "drive it harder" in recording.preflight[0].says


def test_the_same_readings_twice(tmp_path: Path) -> None:
    duty = duty_levels(9, N, STEP)
    columns = {"t": TIME, "duty": duty, "y": counts(duty)}
    logs = [write_log(tmp_path, columns, rig_text(COUNTS), name) for name in ("a.csv", "b.csv")]
    recordings, _ = load(logs)
    assert [f.says for r in recordings for f in r.preflight] == [
        "b.csv holds the same readings as a.csv: take one of them out of the list"
    ]
    with pytest.raises(BadInput, match=r"the same readings as a\.csv"):
        to_fit(recordings)


def test_one_recording_of_several_that_is_reversed(tmp_path: Path) -> None:
    logs = []
    for k in range(4):
        duty = duty_levels(20 + k, N, STEP)
        columns = {"t": TIME, "duty": duty, "y": counts(duty) * (-1 if k == 2 else 1)}
        logs.append(write_log(tmp_path, columns, rig_text(COUNTS), f"{k}.csv"))
    recordings, _ = load(logs)
    assert [(r.name, kinds(r)) for r in recordings if r.preflight] == [("2.csv", ["sign"])]


@pytest.mark.parametrize("speed_goes_on", [True, False])
def test_an_output_that_stands_while_another_column_moves(tmp_path: Path, speed_goes_on: bool) -> None:
    """As in a counter whose cable fell off: left out. An axis that truly stands in its dead-band stays."""
    logs = []
    for k in range(3):
        duty = duty_levels(30 + k, N, STEP) * (0.05 if k == 1 and not speed_goes_on else 1.0)
        speed = axis_speed(duty, STEP) * (0.0 if k == 1 and not speed_goes_on else 1.0)
        reading = np.zeros(N) if k == 1 else counts(duty)
        columns = {"t": TIME, "duty": duty, "y": reading, "speed": np.round(speed)}
        logs.append(write_log(tmp_path, columns, rig_text(COUNTS), f"{k}.csv"))
    recordings, _ = load(logs)
    if speed_goes_on:
        assert [r.name for r in recordings] == ["0.csv", "2.csv"]
        assert kinds(recordings[0]) == ["standing"]
        assert preflight_of(recordings)[0]["recording"] == "1.csv"
        assert (
            "1.csv is left out: its output stands still throughout while column 'speed'"
            in recordings[0].preflight[0].says
        )
    else:
        assert [r.name for r in recordings] == ["0.csv", "1.csv", "2.csv"]
        assert [k for r in recordings for k in kinds(r)] == []


def test_nothing_is_found_on_the_shipped_recording() -> None:
    (recording,), _ = load([ROOT / "models" / "shipped" / "recording.csv"])
    assert recording.preflight == ()


@pytest.mark.skipif(not SHARED.exists(), reason="the real recordings are not here")
def test_nothing_is_found_on_real_recordings(tmp_path: Path) -> None:
    data, rigs = SHARED / "data", ROOT / "models" / "rigs"
    sets = {
        "jga25": sorted((data / "jga25_pwm_steps/runs").glob("*.csv"))[::8],
        "emps": sorted((data / "emps").glob("*.mat")),
        "ak80": sorted((data / "ak80_pendulum").glob("*_measured.csv")),
    }  # fmt: skip
    for name, files in sets.items():
        recordings, _ = load(files, rigs / f"{name}.toml")
        assert [(r.name, f) for r in recordings for f in r.preflight] == []
    rig = (rigs / "sts3215.toml").read_text()
    (tmp_path / "rig.toml").write_text(rig[: rig.index("[loop]")])
    servo, _ = load(sorted((data / "sts3215_pendulum/runs").glob("*.csv"))[::60], tmp_path / "rig.toml")
    assert [(r.name, f) for r in servo for f in r.preflight] == []


def test_an_output_at_its_ends_that_does_not_answer_is_named(tmp_path: Path) -> None:
    """A switch, not a sensor: nothing lies between its ends, from which a law could be seen."""
    duty = duty_levels(7, N, STEP)
    ends = np.where(axis_position(duty, STEP) > 3.0, 21.0, -14.0)
    ends[::50] += 1e-3 * np.arange(N // 50)
    recording = loaded(tmp_path, duty, ends, 'unit = "rad"')
    (finding,) = recording.preflight
    assert finding.kind == "clipped" and finding.severity is Severity.BLOCKS
    assert "smallest or its largest reading" in finding.says
