"""A sensor that is read more slowly than the log is a finding, unless the user said so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin.diagnosis import held_sensor
from twin.io import recording

HEAD = '[time]\ncolumn = "t"\n[input]\ncolumn = "u"\nunit = "%"\n[output]\ncolumn = "y"\nunit = "rad"\n'


def logged(folder: Path, every: int, more: str = "") -> list[recording.Recording]:
    """What is read of a log at 2 ms whose sensor gives a new reading in every so manieth row."""
    time = 0.002 * np.arange(4000)
    position = np.round(3.0 * np.sin(1.7 * time) / 1e-3) * 1e-3
    held = position[np.arange(len(time)) // every * every]
    log, rig = folder / "log.csv", folder / "rig.toml"
    duty = 40.0 * np.cos(1.7 * time)
    np.savetxt(log, np.column_stack([time, duty, held]), "%.6f", ",", header="t,u,y", comments="")
    rig.write_text(HEAD + more, encoding="utf-8")
    return recording.load([log], rig)[0]


@pytest.mark.parametrize("every", [5, 10])
def test_a_sensor_that_repeats_itself_is_found_with_its_interval(tmp_path: Path, every: int) -> None:
    (found,) = held_sensor.finding(logged(tmp_path, every))
    assert (found.id, found.station) == ("sensor_hold", "sensor")
    assert found.parameters["refresh"].value == pytest.approx(0.002 * every, rel=0.02)
    assert f"{2 * every} ms" in found.says


def test_a_sensor_that_is_read_at_each_row_or_known_to_be_slow_is_no_finding(tmp_path: Path) -> None:
    assert held_sensor.finding(logged(tmp_path, 1)) == ()
    assert held_sensor.finding(logged(tmp_path, 10, "refresh = 0.02\n")) == ()
