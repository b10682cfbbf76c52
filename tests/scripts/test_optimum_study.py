"""The optimum that a user gets, against the one from the truth: where the motor seldom crosses its wide gap, too."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import optimum_study


@pytest.mark.parametrize(("seed", "trial"), [(170921, 4), (210911, 6)])
def test_a_wide_gap_is_found_where_many_short_parts_led_astray(seed: int, trial: int) -> None:
    """Both ended hundreds of units of deviance above it, one of them with twice the gap and a sixth of the share."""
    outcome = optimum_study.ask("circuit", seed, trial)
    assert outcome.lost < optimum_study.LESSER
    assert outcome.found.values["backlash_gap"] == pytest.approx(outcome.from_truth.values["backlash_gap"], rel=0.15)
    assert optimum_study.summary([outcome]).startswith("0 of 1")
