"""The study of where an effect acts: its scores, its truths, and one rig from end to end."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import locate_study
from concealed import Concealed
from locate_study import Score, Study

from twin.diagnosis.residual_torque import MissingTorque


def test_f1_is_one_for_the_truth_and_falls_with_what_is_missed_or_made_up() -> None:
    true = np.arange(100) < 20
    assert locate_study.f1(true, true) == 1.0 and locate_study.f1(~true, true) == 0.0
    # Half of it found and nothing else: precision 1, recall 0.5. All, and as much again: the other way round.
    assert locate_study.f1(np.arange(100) < 10, true) == pytest.approx(2.0 / 3.0)
    assert locate_study.f1(np.arange(100) < 40, true) == pytest.approx(2.0 / 3.0)


@pytest.mark.parametrize(
    ("effect", "parameters", "variable"),
    [
        ("disturbance_pulse", {"pulse_start": 4.0, "pulse_length": 3.0}, "time"),
        ("sticky_sector", {"sector_angle": 0.5, "sector_half": 0.4}, "position"),
        ("other_friction_hump", {"hump_speed": 3.0, "hump_width": 0.5}, "velocity"),
        ("friction_asymmetry", {"dry_reverse": 1.0}, "direction"),
    ],
)
def test_a_torque_that_acts_only_there_is_reported_there(
    effect: str, parameters: dict[str, float], variable: str
) -> None:
    time = 0.002 * np.arange(10000)
    velocity = 5.0 * np.cos(2.1 * time) * np.cos(0.37 * time)
    position = np.cumsum(velocity) * 0.002
    run = SimpleNamespace(time=time, position=position, velocity=velocity)
    true = locate_study.acts(Concealed(effect, parameters), run)
    assert 0.05 < true.mean() < 0.7
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(time))
    missing = MissingTorque(time, true + noise, position, velocity, np.gradient(velocity, time), 0.0 * time, 0.002)
    assert locate_study.f1(locate_study.reported(missing, variable), true) > 0.9


def test_places_and_gaps_take_turns_and_the_table_counts_false_alarms() -> None:
    alarm, calm = Score("nowhere", True, math.nan, False, 0.0, 0.0), Score("nowhere", True, math.nan, True, 0.0, 0.0)
    printed = locate_study.table([alarm, calm, Score("angle", False, 0.8, True, 0.01, 0.0)])
    assert "false alarms on sound rigs: 1 of 2" in printed
    assert [row.split()[:4] for row in printed.splitlines()[1:2]] == [["angle", "no", "1", "0.80"]]


def test_a_push_is_found_in_time_on_a_rig_without_a_gap() -> None:
    score = locate_study.judge(5, Study([("time", False)], duration=16.0))
    assert (score.place, score.gap, score.right) == ("time", False, True)
    assert score.f1 > 0.6 and abs(score.corrected) < 0.03


def test_where_the_command_changes_between_stamps_a_sound_rig_is_left_alone() -> None:
    study = Study([("nowhere", False)], duration=16.0, step=locate_study.STEP / locate_study.FINE)
    assert locate_study.judge(0, study).right
