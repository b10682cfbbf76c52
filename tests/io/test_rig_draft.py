"""A rig file written from a log loads that log, names the drive and not the reference, and says what is unsure."""

from pathlib import Path

import numpy as np
import pytest
from driven_axis import axis_position, axis_speed, duty_levels

from twin.cli.main import main
from twin.errors import BadInput
from twin.io.recording import load, to_fit
from twin.io.rig_draft import draft

STEP, N = 0.002, 5000
TIME = np.arange(N) * STEP
DUTY = duty_levels(11, N, STEP)
ANGLE = axis_position(DUTY, STEP)
COUNTS = np.round(ANGLE * 4096 / (2 * np.pi))


def write(folder: Path, columns: dict[str, np.ndarray]) -> Path:
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{x:.10g}" for x in row) for row in rows)]
    (folder / "log.csv").write_text("\n".join(lines))
    return folder / "log.csv"


@pytest.mark.parametrize(
    ("columns", "holds"),
    [
        ({"t": TIME, "duty": DUTY, "counts": COUNTS}, ['column = "duty"', 'unit = "%"', 'unit = "count"']),
        ({"millis": TIME * 1e3, "u": DUTY / 100, "pos_deg": np.rad2deg(ANGLE)}, ['"ms"', 'unit = "1"', 'unit = "deg"']),
        ({"t_us": TIME * 1e6, "goal": ANGLE, "command": ANGLE, "pwm": np.round(DUTY * 2.55), "enc": -COUNTS},
         ['"us"', 'column = "pwm"', "full_scale = 255", "scale = -1", "'goal' looks like a reference"]),
        ({"t": TIME, "pwm": np.abs(np.round(DUTY * 2.55)), "dir": np.where(DUTY < 0, 0.0, 1.0), "counts": COUNTS},
         ["[input.direction]", 'column = "dir"']),
        ({"Zeit [ms]": TIME * 1e3, "PWM": np.abs(np.round(DUTY * 2.55)), "Richtung": np.where(DUTY < 0, 0.0, 1.0),
          "Winkel [°]": np.rad2deg(ANGLE)}, ["[input.direction]", 'column = "Richtung"', 'unit = "deg"']),
        ({"t": TIME, "duty": np.round(DUTY) % 256, "counts": axis_position(np.round(DUTY), STEP) * 1000 // 1},
         ["signed_bits = 8"]),
        ({"t": TIME, "motor_voltage": DUTY / 8, "rpm": np.round(axis_speed(DUTY, STEP) * 9.55)},
         ['unit = "V"', 'unit = "rpm"']),
        ({"Zeit [s]": TIME, "Tastgrad [%]": DUTY, "Zähler": COUNTS}, ['column = "Tastgrad [%]"', 'column = "Zähler"']),
        ({"t": TIME, "sollwert [%]": DUTY, "ausgabe [%]": DUTY, "geber [rad]": ANGLE},
         ['column = "ausgabe [%]"', "'geber [rad]' is taken for a position by its unit"]),
        ({"t": TIME, "duty": DUTY, "counts": np.repeat(COUNTS[::20], 20)}, ["refresh = 0.04"]),
    ],
)  # fmt: skip
def test_what_is_written_loads_the_log_and_may_be_fitted(
    tmp_path: Path, columns: dict[str, np.ndarray], holds: list[str]
) -> None:
    log = write(tmp_path, columns)
    assert main(["init", str(log), "--quiet"]) == 0
    text = (tmp_path / "rig.toml").read_text(encoding="utf-8")
    for part in holds:
        assert part in text
    (recording,), _ = load([log])
    assert to_fit([recording]) == [recording]
    assert np.median(np.diff(recording.time)) == pytest.approx(STEP)


@pytest.mark.parametrize("step", [0.002, 0.01])
def test_a_counter_of_microseconds_that_wraps_is_known_without_a_name(tmp_path: Path, step: float) -> None:
    duty = np.round(duty_levels(3, N, step) * 2.55)
    stamps = (2**32 - 2_000_000 + np.round(np.arange(N) * step * 1e6)) % 2**32
    counts = np.round(axis_position(duty / 2.55, step) * 4096 / (2 * np.pi))
    rows = "".join(f"{t:.0f},{u:.0f},{y:.0f}\r\n" for t, u, y in zip(stamps, duty, counts, strict=True))
    (tmp_path / "log.txt").write_text("Motor test v1.3\r\nready\r\n" + rows)
    assert main(["init", str(tmp_path / "log.txt"), "--quiet"]) == 0
    assert 'unit = "us"' in (tmp_path / "rig.toml").read_text()
    (recording,), _ = load([tmp_path / "log.txt"])
    assert np.ptp(recording.time) == pytest.approx((N - 1) * step)


def test_a_log_without_time_is_not_fitted_with_a_guessed_one(tmp_path: Path) -> None:
    log = write(tmp_path, {"duty": DUTY, "counts": COUNTS})
    assert main(["init", str(log), "--quiet"]) == 0
    rig = tmp_path / "rig.toml"
    with pytest.raises(BadInput, match=r"no time column is named; give \[time\] column or sample_time"):
        load([log])
    text = rig.read_text()
    assert "\n# sample_time = " in text and "sample_time is not known" in text
    rig.write_text(text.replace("\n# sample_time = 0.001", "\nsample_time = 0.002"))
    (recording,), _ = load([log])
    assert np.median(np.diff(recording.time)) == pytest.approx(STEP)


def test_a_rig_file_that_is_there_stays(tmp_path: Path) -> None:
    log = write(tmp_path, {"t": TIME, "duty": DUTY, "counts": COUNTS})
    (tmp_path / "rig.toml").write_text("# mine")
    assert main(["init", str(log)]) == 2
    assert (tmp_path / "rig.toml").read_text() == "# mine"


def test_a_log_without_a_drive_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no column looks like the input"):
        draft([write(tmp_path, {"t": TIME, "goal": ANGLE, "counts": COUNTS})])
