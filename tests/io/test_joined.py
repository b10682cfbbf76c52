"""Input and output in two files with clocks of their own: joined by time, and refused where no time is common."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from twin.errors import BadInput
from twin.io.recording import Recording, load

TIME = np.arange(300) * 0.01
RIG = """[time]
column = "t"
[input]
column = "u"
unit = "%"
file = "*_drive.csv"
{keys}
[output]
column = "pos"
unit = "rad"
"""


def command(t: np.ndarray) -> np.ndarray:
    return np.where(t % 1 < 0.5, 40.0, -20.0)


def write(path: Path, **columns: np.ndarray) -> None:
    rows = "".join(",".join(f"{v:.9f}" for v in row) + "\n" for row in zip(*columns.values(), strict=True))
    path.write_text(",".join(columns) + "\n" + rows)


def load_joined(folder: Path, drive_time: np.ndarray, per_second: float = 1.0, keys: str = "") -> Recording:
    """A command that is logged with its own stamps, with an origin that both files share."""
    write(folder / "run.csv", t=TIME + 100, pos=np.sin(TIME))
    write(
        folder / "run_drive.csv", t=(drive_time + 100) * per_second, u=command(drive_time), dir=np.ones(len(drive_time))
    )
    (folder / "rig.toml").write_text(RIG.format(keys=keys))
    (recording,), _ = load([folder / "run.csv"])
    return recording


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.floats(0.001, 0.05), st.floats(-0.5, 0.0))
def test_the_command_is_held_between_its_own_stamps(tmp_path: Path, step: float, start: float) -> None:
    drive_time = np.round(np.arange(start, TIME[-1] + step, step), 6)
    recording = load_joined(tmp_path, drive_time)
    last = drive_time[np.searchsorted(drive_time, TIME + 1e-9, side="right") - 1]
    off = np.abs(TIME[:, None] - drive_time).min(axis=1) < 1e-6  # which of two equal stamps is first is rounding
    np.testing.assert_allclose(recording.input[~off], command(last)[~off])
    np.testing.assert_allclose(recording.output, np.sin(TIME), atol=1e-8)


def test_the_other_file_may_have_another_unit_of_time(tmp_path: Path) -> None:
    recording = load_joined(tmp_path, TIME, 1000.0, 'time_column = "t"\ntime_unit = "ms"')
    np.testing.assert_allclose(recording.input, command(TIME))


def test_where_the_other_file_says_nothing_the_input_is_missing(tmp_path: Path) -> None:
    recording = load_joined(tmp_path, TIME[100:200])
    assert [(f.kind, round(f.start, 2), round(f.end, 2)) for f in recording.faults] == [
        ("missing", 0.0, 0.99), ("missing", 2.01, 2.99),
    ]  # fmt: skip


def test_clocks_without_a_common_time_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"runs from 5100 to .* nothing in common"):
        load_joined(tmp_path, TIME + 5000)
    (tmp_path / "run_drive.csv").unlink()
    with pytest.raises(BadInput, match=r"run_drive\.csv: no such file"):
        load([tmp_path / "run.csv"])


def test_keys_that_go_with_a_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="go with file"):
        (tmp_path / "rig.toml").write_text(RIG.format(keys='time_column = "t"').replace('file = "*_drive.csv"\n', ""))
        write(tmp_path / "run.csv", t=TIME, pos=np.sin(TIME), u=TIME)
        load([tmp_path / "run.csv"])
