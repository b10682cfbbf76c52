"""A slow sensor is hidden in the rigs of every simulator, and found before any fit."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="one of the simulators needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import hold_study
from hold_study import Held
from simulators import SIMULATORS


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_a_slow_sensor_is_found_with_its_interval_and_no_other_is_called_slow(simulator: str) -> None:
    usual, slow = (hold_study.judge(simulator, number, duration=10.0) for number in (0, 1))
    assert (usual.true, usual.found) == (0.0, 0.0)
    assert slow.found == pytest.approx(slow.true, rel=0.03)


def test_the_table_counts_what_was_missed_and_made_up() -> None:
    seen = [Held("a", 0.02, 0.021), Held("a", 0.02, 0.0), Held("a", 0.0, 0.01), Held("a", 0.0, 0.0)]
    assert hold_study.table(seen).splitlines()[1].split() == ["a", "2", "1", "5.00", "2", "1"]
