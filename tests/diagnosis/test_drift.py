"""What noise makes of a free run, held against closed forms and draws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.diagnosis import drift
from twin.diagnosis.drift import Dynamics, MeanSquare, Noise

TIME = 0.002 * np.arange(2001)
EDGES = np.linspace(0, 2000, 81).astype(np.intp)


def free(damping: float = 0.0, stiffness: float = 0.0) -> Dynamics:
    count = len(TIME)
    return Dynamics(TIME, np.full(count, stiffness), np.full(count, damping), np.ones(count, dtype=bool))


def spread(dynamics: Dynamics, noise: Noise, speed: bool = False) -> np.ndarray:
    """Variance of the error at the end of each step."""
    return np.asarray(np.sum(drift.factor(dynamics, EDGES, noise, speed) ** 2, axis=1))


def test_the_integral_of_a_damped_random_velocity_spreads_as_in_closed_form() -> None:
    b, t = 2.0, TIME[EDGES[1:]]
    exact = (2.0 * b * t - 3.0 + 4.0 * np.exp(-b * t) - np.exp(-2.0 * b * t)) / (2.0 * b**3)
    assert spread(free(b), Noise(1.0, 0.0, 0.0))[10:] == pytest.approx(exact[10:], rel=0.02)
    exact = (1.0 - np.exp(-2.0 * b * t)) / (2.0 * b)
    assert spread(free(b), Noise(1.0, 0.0, 0.0), speed=True) == pytest.approx(exact, rel=0.01)


def test_a_spring_keeps_the_error_within_bounds() -> None:
    b, k = 4.0, 100.0
    assert spread(free(b, k), Noise(1.0, 0.0, 0.0))[-1] == pytest.approx(1.0 / (2.0 * b * k), rel=0.02)


def test_noise_does_not_move_what_dry_friction_holds() -> None:
    dynamics = free(1.0)
    held = Dynamics(TIME, dynamics.stiffness, dynamics.damping, TIME < 1.0)
    found = spread(held, Noise(1.0, 0.0, 0.0))
    after = TIME[EDGES[1:]] > 1.1
    assert np.ptp(found[after]) < 1e-12 and found[after][0] > 0.1 * spread(dynamics, Noise(1.0, 0.0, 0.0))[19]


def test_a_wrong_first_speed_costs_its_time_constant_ever_after() -> None:
    assert spread(free(2.0), Noise(0.0, 0.0, 0.09))[-1] == pytest.approx((0.3 / 2.0) ** 2, rel=0.01)


@settings(max_examples=30)
@given(st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=6), st.integers(0, 100))
def test_the_tail_is_that_of_draws(weights: list[float], seed: int) -> None:
    null = MeanSquare(np.array(weights), np.ones(len(weights)))
    draws = np.random.default_rng(seed).standard_normal((20000, len(weights))) ** 2 @ np.array(weights)
    for quantile in (0.1, 0.5, 0.9, 0.99):
        assert null.chance(float(np.quantile(draws, quantile))) == pytest.approx(1.0 - quantile, abs=0.03)
    assert np.mean(draws > null.exceeded(0.05)) == pytest.approx(0.05, abs=0.02)
    values = np.linspace(0.0, 8.0 * null.mean, 50)
    assert np.all(np.diff([null.chance(float(v)) for v in values]) <= 1e-6)


def test_what_parameters_can_follow_is_no_error_any_more() -> None:
    """Residuals of a generalised least-squares fit to draws of the error have the mean square that is foretold."""
    rng = np.random.default_rng(2)
    factor = drift.factor(free(2.0), EDGES, Noise(1.0, 0.0, 0.0), False)
    columns = np.stack([np.ones(len(factor)), np.linspace(0.0, 1.0, len(factor))], axis=1)
    covariance, reading = factor @ factor.T, np.full(len(factor), 1e-3)
    whole = covariance + np.diag(reading)
    draws = factor @ rng.standard_normal((factor.shape[1], 2000)) + np.sqrt(1e-3) * rng.standard_normal((80, 2000))
    weighed = np.linalg.solve(whole, columns)
    rest = draws - columns @ np.linalg.solve(columns.T @ weighed, weighed.T @ draws)
    foretold = np.mean(np.diag(drift.fitted(covariance, columns, reading))) + 1e-3
    assert np.mean(rest**2) == pytest.approx(foretold, rel=0.05)
    assert foretold < 0.5 * np.mean(np.diag(whole))


def test_nothing_random_leaves_no_doubt() -> None:
    null = MeanSquare(np.zeros(3), np.ones(3))
    assert (null.chance(0.0), null.chance(1.0), null.exceeded(0.05)) == (1.0, 0.0, 0.0)
