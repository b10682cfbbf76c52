"""What noise makes of a free run, held against closed forms and draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.diagnosis import adequacy, drift
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


def two_runs() -> tuple[list[drift.Run], np.ndarray, np.ndarray, np.ndarray]:
    """Two free runs with the same two parameters. And their sources, parameters and readings' variance as one."""
    runs = []
    for times in (1.0, 1.5):
        factor = times * drift.factor(free(2.0), EDGES, Noise(1.0, 0.0, 0.0), False)
        columns = 0.5 * np.stack([np.ones(len(factor)), np.linspace(0.0, times, len(factor))], axis=1)
        count = len(factor)
        runs.append(drift.Run(factor, columns, np.full(count, 0.5 / count), np.full(count, 1e-3)))
    one, other = (r.factor for r in runs)
    nothing = np.zeros((len(one), other.shape[1]))
    return (
        runs,
        np.block([[one, nothing], [nothing, other]]),
        np.vstack([r.parameters for r in runs]),
        np.full(160, 1e-3),
    )


def test_what_parameters_can_follow_is_no_error_any_more() -> None:
    """Residuals of a generalised least-squares fit to draws of the error have the mean squares that are foretold."""
    rng = np.random.default_rng(2)
    runs, factor, columns, reading = two_runs()
    draws = factor @ rng.standard_normal((factor.shape[1], 2000)) + np.sqrt(1e-3) * rng.standard_normal((160, 2000))
    weighed = np.linalg.solve(factor @ factor.T + np.diag(reading), columns)
    rest = draws - columns @ np.linalg.solve(columns.T @ weighed, weighed.T @ draws)
    null, free_null = (drift.mean_square(runs, 1e-3, 160, fitted) for fitted in (True, False))
    assert np.mean(rest**2) == pytest.approx(null.mean, rel=0.05)
    assert null.mean < 0.5 * free_null.mean
    assert np.quantile(np.mean(rest**2, axis=0), 0.95) == pytest.approx(null.exceeded(0.05), rel=0.1)


def test_runs_share_the_errors_of_their_parameters() -> None:
    rng = np.random.default_rng(3)
    runs, factor, columns, _ = two_runs()
    draws = factor @ rng.standard_normal((factor.shape[1], 4000)) + columns @ rng.standard_normal((2, 4000))
    squares = np.mean(draws**2, axis=0)
    null = drift.mean_square(runs, 0.0, 160, False)
    assert null.mean == pytest.approx(np.mean(squares), rel=0.05)
    assert null.exceeded(0.05) == pytest.approx(np.quantile(squares, 0.95), rel=0.1)
    apart = [replace(r, parameters=0.0 * r.parameters) for r in runs]
    assert drift.mean_square(apart, 0.0, 160, False).mean < 0.9 * null.mean


def test_nothing_random_leaves_no_doubt() -> None:
    null = MeanSquare(np.zeros(3), np.ones(3))
    assert (null.chance(0.0), null.chance(1.0), null.exceeded(0.05)) == (1.0, 0.0, 0.0)


def test_nothing_is_expected_of_a_model_whose_error_no_number_holds() -> None:
    """A law that pushes makes any small error grow without bound: the error found is told, and no chance for it."""
    time = 0.01 * np.arange(4000)
    pushed = Dynamics(time, np.zeros(4000), np.full(4000, -50.0), np.ones(4000, dtype=bool))
    factor = drift.factor(pushed, np.arange(0, 4000, 100), Noise(1.0, 1.0, 1.0), speed=False)
    assert not np.isfinite(factor).all()
    share = np.full(len(factor), 1.0 / len(factor))
    run = adequacy.together([adequacy.Error(40.0, 10, share, factor, np.zeros((len(factor), 1)), 1e-6)], False)
    assert run.rmse == 2.0 and np.isnan([run.expected, run.p_value, run.largest]).all()
