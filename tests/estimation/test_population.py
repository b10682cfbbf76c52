"""Axes of one kind: the planted spread comes back, an axis that stands apart is named, and none where none does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.estimation.population import apart, centre_and_spread, population_of


def test_the_planted_spread_comes_back_without_the_errors_of_the_estimates():
    rng = np.random.default_rng(1)
    found = []
    for _ in range(200):
        stds = rng.uniform(0.1, 1.0, 20)
        found.append(centre_and_spread(5.0 + rng.normal(0.0, 0.5, 20) + rng.normal(0.0, stds), stds**2))
    mean, between = np.mean(found, axis=0)
    assert mean == pytest.approx(5.0, abs=0.05)
    assert between == pytest.approx(0.25, rel=0.15)


def test_exact_estimates_have_the_sample_variance():
    values = np.random.default_rng(2).normal(3.0, 2.0, 12)
    mean, between = centre_and_spread(values, np.zeros(12))
    assert mean == pytest.approx(values.mean())
    assert between == pytest.approx(values.var(ddof=1))


@pytest.mark.parametrize("count", [6, 20])
def test_a_sound_fleet_has_no_outlier_but_by_chance(count):
    rng = np.random.default_rng(3)
    alarms = 0
    for _ in range(200):
        stds = rng.uniform(0.01, 0.5, count)
        alarms += bool(apart(rng.normal(0.0, 1.0, count) + rng.normal(0.0, stds), stds**2, 0.05))
    assert alarms <= 20  # 0.05 of 200 is 10, with three standard deviations


def test_two_axes_that_stand_apart_alike_do_not_hide_one_another():
    rng = np.random.default_rng(4)
    values = rng.normal(1.0, 0.02, 14)
    values[[3, 9]] = 1.6
    assert sorted(apart(values, np.full(14, 1e-6), 0.01)) == [3, 9]


def test_an_outlier_that_is_only_badly_known_is_none():
    values, variances = np.r_[np.linspace(0.98, 1.02, 9), 2.0], np.r_[np.full(9, 1e-6), 1.0]
    assert apart(values, variances, 0.05) == []


def test_spread_and_centre_are_those_of_the_others():
    rng = np.random.default_rng(5)
    values = {f"axis{i}": float(v) for i, v in enumerate(2.0 * np.exp(rng.normal(0.0, 0.03, 12)))} | {"bad": 4.0}
    found = population_of(values, dict.fromkeys(values, 1e-3), 0.05)
    assert found.by_ratio and found.outliers == ("bad",)
    assert found.centre == pytest.approx(2.0, rel=0.03)
    assert found.spread == pytest.approx(0.03, rel=0.6)
    assert found.quantile(1.0) == pytest.approx(found.centre * np.exp(found.spread))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=12),
    st.floats(-100.0, 100.0),
    st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_the_unit_does_not_matter(values, shift, scale):
    x, variances = np.array(values), np.full(len(values), 0.01)
    mean, between = centre_and_spread(x, variances)
    moved, wider = centre_and_spread(scale * (x + shift), scale**2 * variances)
    assert moved == pytest.approx(scale * (mean + shift), rel=1e-6, abs=1e-6 * scale)
    assert wider == pytest.approx(scale**2 * between, rel=1e-4, abs=1e-6 * scale**2)
