"""What is held out stays where the fitted part has been, or the answer says where it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.diagnosis import coverage, data_split
from twin.io.recording import Recording

TIME = 0.002 * np.arange(15000)


def made(height: np.ndarray, role: str = "train") -> Recording:
    duty = height * np.sign(np.sin(2.0 * np.pi * 0.4 * TIME))
    return Recording("made", TIME, duty, 0.02 * np.cumsum(duty) * 0.002, "%", "rad", 1e-4, role=role)


def test_an_end_like_the_rest_is_held_out() -> None:
    choice = coverage.choose([made(np.full(len(TIME), 40.0))])
    assert (choice.where, choice.untested, coverage.sentences(choice)) == (data_split.END_PART, (), [])


def test_an_end_that_commands_more_is_not() -> None:
    choice = coverage.choose([made(np.where(TIME > 21.0, 70.0, 34.0))])
    assert choice.where == data_split.MIDDLE_PART and not choice.untested
    (says,) = coverage.sentences(choice)
    assert "the command goes from -70 to 70 % there, elsewhere from -34 to 34 %" in says and "the middle" in says


def test_where_end_and_middle_leave_the_range_blocks_are_held_out() -> None:
    wave = np.sin(2.0 * np.pi * 0.4 * TIME) > 0.0
    ahead, behind = np.where(TIME > 21.5, 70.0, 34.0), np.where((TIME > 11.0) & (TIME < 19.0), 70.0, 34.0)
    recording = replace(made(ahead), input=np.where(wave, ahead, -behind), output=np.sin(TIME))
    choice = coverage.choose([recording])
    train, parts = data_split.split([recording], choice.where)
    assert choice.where == data_split.BLOCKS and len(parts) == 4
    assert not coverage.beyond(train, parts)
    hidden = np.any([p.inside for p in parts], axis=0)
    assert np.isnan(train[0].output[hidden[: len(train[0].output)]]).all()


def test_recordings_with_a_role_stay_held_out_and_the_range_is_named() -> None:
    choice = coverage.choose([made(np.full(len(TIME), 34.0)), made(np.full(len(TIME), 70.0), "holdout")])
    assert {b.variable for b in choice.untested} >= {"input"}
    assert coverage.sentences(choice)[0].startswith("Untested")


@pytest.mark.parametrize(("reach", "counted"), [(2.0, True), (30.0, False)])
def test_the_position_of_an_axis_that_turns_all_round_is_no_range(reach: float, counted: bool) -> None:
    duty = np.sin(TIME)
    recording = Recording("made", TIME, duty, reach * TIME / TIME[-1], "%", "rad", 1e-4)
    assert ("position" in coverage.variables(recording)) == counted
