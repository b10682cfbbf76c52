"""The studies of changes: a truth that is planted is in the label, the answer is judged by it, a small run prints."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from example_diagnosis import model_of

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import change_study
import track_study

from twin.diagnosis.change import Changes, compare_models
from twin.diagnosis.tracking import track


def test_a_trial_changes_what_its_label_says_and_nothing_else():
    label, (before, after), effects = change_study.make(60, 5, 2.0)
    assert (label.parameter, effects) == ("coulomb_friction", ("coulomb_friction",))
    assert 0.5 <= label.factor <= 2.0 and label.factor != 1.0
    assert before.time[-1] == after.time[-1] and not np.array_equal(before.input, after.input)
    again, _, _ = change_study.make(60, 5, 2.0)
    assert again.sealed() == label.sealed()
    assert change_study.make(60, 9, 2.0)[0].parameter == ""


def test_an_inertia_that_grows_divides_all_that_stands_over_it():
    rig = change_study.circuit_rig.draw_rig(np.random.default_rng(1))
    heavier = change_study._changed(rig, "inertia", 2.0)
    one, two = rig.model_values(), heavier.model_values()
    assert two["input_gain"] == pytest.approx(0.5 * one["input_gain"])
    assert two["viscous_friction"] == pytest.approx(0.5 * one["viscous_friction"])
    assert two["backlash_gap"] == one["backlash_gap"] and heavier.half_speed == pytest.approx(rig.half_speed)


def test_an_answer_is_judged_by_the_label():
    model = replace(model_of(), notes={}, intervals={})
    worn = model.with_values({"viscous_friction": 1.5 * model.values["viscous_friction"]})
    said = compare_models(model, worn)
    label = change_study.Label(1, 1, "viscous friction", 1.5)
    outcome = change_study.judge(label, said)
    assert outcome.right and outcome.holds and outcome.visible
    assert not change_study.judge(replace(label, factor=3.0), said).holds
    assert not change_study.judge(replace(label, kind="gap"), said).right
    nothing = change_study.judge(replace(label, factor=1.0), Changes((), (), {}, 1.0, 0.0))
    assert nothing.right
    assert "nothing else: 1 of 1" in change_study.summary([outcome, nothing])


def test_histories_are_judged_by_when_a_change_can_be_seen():
    rng = np.random.default_rng(5)
    model = replace(model_of(), notes={}, intervals={})
    step = track_study.Label(0, "step", "viscous_friction", 8, 1.1)
    assert step.factors(12) == [1.0] * 8 + [1.1] * 4
    wear = replace(step, kind="wear").factors(12)
    assert wear[:8] == [1.0] * 8 and wear[-1] == pytest.approx(1.1) and wear == sorted(wear)
    fits = [track_study._drawn(model, step.parameter, f, rng) for f in step.factors(12)]
    outcome = track_study.Outcome(step, track_study.visible_from(step, model, 12), track(model, fits))
    assert outcome.visible == 8 and outcome.in_time and outcome.right and outcome.false_alarms == 0
    assert track_study.visible_from(replace(step, factor=1.0001), model, 12) is None
    sound = track_study.Outcome(replace(step, kind="sound"), None, outcome.history)
    assert sound.false_alarms == 1 and sound.sound_recordings == 12
    assert "false alarms: 0 in 8" in track_study.summary([outcome])
