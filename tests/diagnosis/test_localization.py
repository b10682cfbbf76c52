"""Where a missing torque acts, and what the base model makes of it elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.diagnosis import localization
from twin.diagnosis.residual_torque import MissingTorque

TURN = 2.0 * math.pi
TIME = 0.002 * np.arange(15000)
VELOCITY = 6.0 * np.cos(1.9 * TIME) * np.cos(0.31 * TIME) + 1.0
POSITION = np.cumsum(VELOCITY) * 0.002
COMMAND = 20.0 * np.sign(np.sin(2.3 * TIME)) * (1.0 + 0.5 * np.sin(0.9 * TIME))
DIRECTION = np.sign(VELOCITY)


def missing(torque: NDArray[np.float64]) -> MissingTorque:
    """A torque (N,) with a little noise, along a motion through several turns."""
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(TIME))
    return MissingTorque(TIME, torque + noise, POSITION, VELOCITY, np.gradient(VELOCITY, TIME), COMMAND, 0.002)


def test_a_tight_sector_across_the_end_of_a_turn_is_one_regime() -> None:
    (found,) = localization.regimes(missing(-DIRECTION * (np.cos(POSITION) > math.cos(0.4))), "position", TURN)
    assert (found.low, found.high) == pytest.approx((TURN - 0.4, 0.4), abs=0.15) and found.period == TURN


@pytest.mark.parametrize(("low", "high"), [(2.0, 3.0), (-3.5, -2.5)])
def test_friction_around_a_speed_is_found_there(low: float, high: float) -> None:
    torque = -DIRECTION * ((low < VELOCITY) & (high > VELOCITY))
    (found,) = localization.regimes_of(missing(torque), ("velocity", "direction"))
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.25)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_friction_of_one_direction_is_found_there(side: float) -> None:
    (found,) = localization.regimes_of(missing(-DIRECTION * (side == DIRECTION)), ("direction",))
    assert (found.low, found.high) == ((0.0, 1.0) if side > 0.0 else (-1.0, 0.0))


def test_what_acts_everywhere_or_goes_with_two_states_or_with_time_has_no_regime() -> None:
    assert localization.regimes(missing(-2.0 * DIRECTION), "position") == []
    bump = missing(-DIRECTION * (np.abs(VELOCITY - 2.5) < 0.5))
    assert localization.regimes_of(bump, ("velocity", "input")) == [] == localization.regimes_of(bump, ("time",))
    assert localization.regimes(missing(np.full(len(TIME), np.nan)), "velocity") == []


def test_a_base_model_that_bent_towards_a_push_is_straightened() -> None:
    """What the fit took from the push it gives back everywhere else: by a wrong gain and wrong friction."""
    pushed = (TIME > 12.0) & (TIME < 15.0)
    bent = missing(3.0 * pushed + 0.02 * COMMAND - 0.2 * VELOCITY)
    local = localization.without_base(bent)
    assert np.sqrt(np.mean(local.torque[~pushed] ** 2)) < 0.1 < 0.5 < np.sqrt(np.mean(bent.torque[~pushed] ** 2))
    assert localization.gain_error(bent) == pytest.approx(0.02, abs=0.002)
    (found,) = localization.segments(local)
    assert (found.start, found.end) == pytest.approx((12.0, 15.0)) and found.share > 0.95


def test_noise_alone_bends_no_base() -> None:
    quiet = missing(np.zeros(len(TIME)))
    assert abs(localization.gain_error(quiet)) < 1e-3
    assert localization.without_base(quiet).rms == pytest.approx(quiet.rms, rel=0.01)
