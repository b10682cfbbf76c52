"""A log without a rig file is read for what it is, whatever columns it holds, and what was assumed is said."""

from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, axis_speed, duty_levels

from twin.errors import BadInput
from twin.io.recording import Recording, load
from twin.io.rig_draft import draft

STEP, N = 0.002, 5000
TIME = np.arange(N) * STEP
DUTY = np.round(duty_levels(11, N, STEP))
ANGLE, SPEED = axis_position(DUTY, STEP), axis_speed(DUTY, STEP)
COUNTS = np.round(ANGLE * 4096 / (2 * np.pi))
MICROS = np.round(TIME * 1e6 + 2.0**32 - 3e6) % 2**32


def write(path: Path, columns: dict[str, np.ndarray], separator: str = ",", decimal: str = ".") -> Path:
    """A text table; columns without names where these begin with an underscore."""
    rows = [
        separator.join(f"{x:.12g}" for x in row).replace(".", decimal) for row in zip(*columns.values(), strict=True)
    ]
    header = [] if next(iter(columns)).startswith("_") else [separator.join(columns)]
    path.write_text("\n".join([*header, *rows]) + "\n", encoding="utf-8")
    return path


def loaded(path: Path) -> tuple[Recording, str]:
    (recording,), rig = load([path])
    return recording, "; ".join(rig.assumed)


@pytest.mark.parametrize(
    ("columns", "unit", "output", "says"),
    [
        ({"time": TIME, "duty": DUTY, "motor_rpm": SPEED * 30 / np.pi}, "rad/s", SPEED, "in rpm"),
        ({"Zeit": TIME, "Spannung": DUTY / 5, "Winkel [°]": np.rad2deg(ANGLE)}, "rad", ANGLE, "in deg"),
        ({"t_ms": TIME * 1e3, "pwm": np.abs(DUTY) * 2.55 // 1, "dir": 1.0 * (DUTY >= 0), "enc": COUNTS}, "kcount",
         COUNTS / 1000, "column 'dir' gives it"),
        ({"t": TIME, "u": DUTY / 100, "theta": -ANGLE}, "rad", ANGLE, "fractions of full drive; the output"),
        ({"micros": MICROS, "duty": DUTY, "ticks": (4 * COUNTS + 32768) % 65536 - 32768}, "kcount",
         COUNTS / 250, "in us"),
        ({"t": TIME, "u": DUTY / 5, "y": SPEED}, "rad/s", SPEED, "taken for V"),
        ({"t": TIME, "u": DUTY / 5, "y": ANGLE}, "rad", ANGLE, "taken for V"),
        ({"_": TIME, "__": DUTY, "___": ANGLE}, "rad", ANGLE, "no name tells which is which"),
        ({"_": TIME, "__": np.round(SPEED, 2), "___": DUTY}, "rad/s", np.round(SPEED, 2), "'3', a speed column '2'"),
        ({"t": TIME, "ue": DUTY, "ye": SPEED}, "rad/s", SPEED, "column 'ue', a speed column 'ye'"),
        ({"t": TIME, "u": DUTY / 5, "z": SPEED}, "rad/s", SPEED, "taken to be 'u' and a speed 'z'"),
        ({"t": TIME, "a": DUTY, "theta": ANGLE}, "rad", ANGLE, "taken to be 'a' and a position 'theta'"),
        ({"time": TIME, "goal": ANGLE, "cmd": DUTY, "battery_voltage": 12 + 0 * TIME + (TIME > 5), "pos": ANGLE}, "rad",
         ANGLE, "the input is column 'cmd'"),
    ],
)  # fmt: skip
def test_columns_are_what_their_names_and_values_say(
    tmp_path: Path, columns: dict[str, np.ndarray], unit: str, output: np.ndarray, says: str
) -> None:
    recording, assumed = loaded(write(tmp_path / "log.csv", columns))
    assert says in assumed
    assert recording.output_unit == unit
    np.testing.assert_allclose(recording.time, TIME, atol=1e-9)
    moved = recording.output - recording.output[0]
    np.testing.assert_allclose(moved, output - output[0], atol=1e-6 * np.ptp(output))
    assert recording.preflight == ()


@pytest.mark.parametrize(("separator", "decimal"), [(";", ","), ("\t", "."), ("|", ",")])
def test_the_dialect_does_not_matter(tmp_path: Path, separator: str, decimal: str) -> None:
    columns = {"time": TIME, "voltage": DUTY / 5, "angle": ANGLE}
    recording, _ = loaded(write(tmp_path / "log.txt", columns, separator, decimal))
    np.testing.assert_allclose(recording.output, np.deg2rad(ANGLE), rtol=1e-9)


def test_steps_of_one_level_a_file_are_guessed_from_all_of_them(tmp_path: Path) -> None:
    """Without a header, a column that is constant in each file but not in all of them is the command."""
    paths = []
    for level in (-60.0, -30.0, 30.0, 60.0):
        time = 0.005 * np.arange(200)
        duty = np.full(200, level)
        columns = {"_": duty, "__": time, "___": np.round(np.rad2deg(axis_position(duty, 0.005)))}
        paths.append(write(tmp_path / f"steps{level:.0f}.csv", columns))
    recordings, rig = load(paths)
    assert (rig.input.name, rig.output.name, rig.time.column) == ("1", "3", "2")
    assert [r.input[0] for r in recordings] == [-60.0, -30.0, 30.0, 60.0]
    text = draft(paths).text
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    again, _ = load(paths)
    for one, other in zip(recordings, again, strict=True):
        np.testing.assert_array_equal(one.output, other.output)


@pytest.mark.parametrize("beside", ["goal", "battery", "temp"])
def test_what_is_known_to_be_no_input_is_not_taken_for_one_because_nothing_else_is_there(
    tmp_path: Path, beside: str
) -> None:
    path = write(tmp_path / "log.csv", {"t": TIME, beside: DUTY, "position": ANGLE})
    with pytest.raises(BadInput, match="no column looks like the input"):
        load([path])
