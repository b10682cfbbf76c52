"""What a gain in deviance is worth, and what makes innovations white."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from twin.diagnosis import model_comparison, thresholds
from twin.effects.catalogue import BASE
from twin.estimation.fit import Fit
from twin.model.stepper import Structure


def point(normal: np.ndarray, scatter: np.ndarray) -> Fit:
    free = ("input_gain", "viscous_friction", "backlash_gap")
    return Fit(Structure.of(BASE), {}, 1.0, free, 0.0, 1.0, normal, np.zeros(3), scatter)


@pytest.mark.parametrize("repeated", [1.0, 3.0, 12.0])
def test_readings_that_repeat_each_other_count_once(repeated):
    """Every reading given n times over: n times the information, n squared times the scatter of the slopes."""
    once = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.3], [0.0, 0.3, 5.0]])
    found = model_comparison.overdispersion([point(repeated * once, repeated**2 * once)])
    assert found == pytest.approx(repeated)


def test_what_a_model_lacks_does_not_speak_against_itself():
    """The slopes of a model that errs scatter for what it lacks; the one that lacks less knows what noise does."""
    once = np.eye(3)
    lacking, complete = point(once, 90.0 * once), replace(point(once, 4.0 * once), deviance=-10.0)
    assert model_comparison.overdispersion([lacking, complete]) == pytest.approx(4.0)


def test_slopes_that_ran_away_say_nothing():
    """An information far beyond what the gradient's scatter bears out is that of chaos."""
    once = np.eye(3)
    wild = replace(point(once, 1e-3 * once), deviance=-10.0)
    assert wild.is_chaotic and not point(once, once).is_chaotic
    assert model_comparison.overdispersion([wild, point(once, 4.0 * once)]) == pytest.approx(4.0)


def test_knots_that_each_see_little_do_not_outvote_the_rest():
    """A curve beside three parameters whose slopes repeat: what it adds is judged by what both models have."""
    plain = point(np.eye(3), 6.0 * np.eye(3))
    knots, scatter = tuple(f"unknown_velocity_{i:02}" for i in range(1, 13)), np.diag([5.0] * 3 + [1.0] * 12)
    drawn = replace(
        plain,
        free=(*plain.free, *knots),
        deviance=-100.0,
        information=np.eye(15),
        gradient=np.zeros(15),
        scatter=scatter,
    )
    assert drawn.overdispersion == pytest.approx(1.0)
    assert model_comparison.overdispersion([plain, drawn]) == pytest.approx(5.0)


def test_an_addition_is_judged_by_its_own_size():
    """Slow errors lead the slope of a slow effect more than those of what all models have."""
    before = point(np.eye(3), 2.0 * np.eye(3))
    free = (*before.free, "ripple_torque", "ripple_order")
    for scatter, unit in ((20.0, 20.0), (1.0, 2.0)):
        after = replace(
            before, structure=before.structure.with_("torque_ripple"), free=free, deviance=-1000.0,
            information=np.eye(5), gradient=np.zeros(5), scatter=np.diag([2.0, 2.0, 2.0, scatter, 90.0]),
        )  # fmt: skip
        gain = 1000.0 / unit - 2.0 * thresholds.PENALTY_PER_PARAMETER
        assert model_comparison.gain(before, after) == pytest.approx(gain)
        assert model_comparison.gain(before, after, 500.0) == pytest.approx(gain - 500.0 / unit)
        assert model_comparison.is_significant(before, after, 500.0) is (gain - 500.0 / unit > thresholds.MIN_GAIN)
        assert model_comparison.criterion_difference(after, before) == pytest.approx(
            1000.0 / 2.0 - 2.0 * thresholds.PENALTY_PER_PARAMETER
        )


def test_what_cannot_be_told_apart_has_the_say_of_what_is_known_of_it():
    """Gain and dead-band under a command of one size: only their sum is known, and its slope repeats like the rest."""
    twins = np.array([[1.0, 1.0 - 1e-15, 0.0], [1.0 - 1e-15, 1.0, 0.0], [0.0, 0.0, 1.0]])
    known = point(twins, 50.0 * np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.02]]))
    assert model_comparison.overdispersion([known]) == pytest.approx(50.0)
    errors = np.sqrt(np.diag(known.robust_covariance))
    assert np.all(errors[:2] > 1e5) and errors[2] == pytest.approx(1.0)


def test_what_leaves_no_trace_has_no_say():
    seen = np.diag([4.0, 2.0, 0.0])
    assert model_comparison.overdispersion([point(seen, 3.0 * seen)]) == pytest.approx(3.0)


def test_a_model_that_says_nothing_for_certain_has_no_say() -> None:
    nothing, once = np.full((3, 3), math.inf), np.eye(3)
    with np.errstate(invalid="ignore"):
        assert model_comparison.overdispersion([point(once, nothing), point(once, 2.0 * once)]) == pytest.approx(2.0)


def test_a_parameter_too_many_earns_less_than_its_price() -> None:
    """A structure with one useless parameter: twice the log-likelihood it gains has mean one."""
    gains = np.random.default_rng(1).standard_normal(10000) ** 2
    assert np.mean(gains > thresholds.PENALTY_PER_PARAMETER) < 0.1
    one, two = (
        point(np.eye(3), np.eye(3)),
        replace(point(np.eye(3), np.eye(3)), deviance=-10.0 * thresholds.PENALTY_PER_PARAMETER),
    )
    assert model_comparison.criterion(two, 10.0) == pytest.approx(
        model_comparison.criterion(one, 10.0) - thresholds.PENALTY_PER_PARAMETER
    )


def test_white_noise_is_white_and_coloured_noise_is_not():
    rng = np.random.default_rng(3)
    said = [model_comparison.whiteness_p_value(rng.standard_normal(2000)) for _ in range(200)]
    assert 0.005 < np.mean(np.array(said) < 0.05) < 0.11
    assert model_comparison.whiteness_p_value(lfilter([1.0], [1.0, -0.3], rng.standard_normal(2000))) < 1e-3
