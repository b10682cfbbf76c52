"""The history of an axis: a step is seen soon and where it was, a sound axis raises no alarm, wear is forecast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from example_diagnosis import model_of

from twin.diagnosis.tracking import forecast, pool, track, with_scatter
from twin.errors import BadInput
from twin.model.fitted_model import Model


def fit_of(model: Model, rng: np.random.Generator, scatter: float = 0.0, **factors: float) -> Model:
    """A fit of an axis whose parameters are so many times as large, and scatter by a share from day to day."""
    truth = np.array([model.values[n] * factors.get(n, 1.0) for n in model.fitted])
    truth = truth * (1.0 + scatter * rng.standard_normal(len(truth)))
    values = rng.multivariate_normal(truth, model.covariance)
    return replace(model, notes={}, values={**model.values, **dict(zip(model.fitted, values.tolist(), strict=True))})


def known() -> Model:
    return replace(model_of("gravity"), notes={})


def test_the_pool_is_the_weighted_mean() -> None:
    """Against the textbook's formula for one parameter with errors of its own."""
    model = known()
    one = replace(model.with_values({"input_gain": 1.0}), covariance=np.eye(len(model.fitted)))
    two = replace(model.with_values({"input_gain": 4.0}), covariance=np.eye(len(model.fitted)) / 4.0)
    found = pool([one, two])
    assert found.values["input_gain"] == pytest.approx((1.0 * 1.0 + 4.0 * 4.0) / 5.0)
    assert found.std("input_gain") == pytest.approx(np.sqrt(1.0 / 5.0))


def test_a_sound_axis_raises_no_alarm() -> None:
    rng = np.random.default_rng(11)
    model = known()
    for scatter in (0.0, 0.03):
        fits = [fit_of(model, rng, scatter) for _ in range(12)]
        first = with_scatter([fit_of(model, rng, scatter) for _ in range(12)])[0] if scatter else model
        assert track(first, fits).alarms == ()


def test_a_step_is_seen_within_two_recordings_and_where_it_was() -> None:
    rng = np.random.default_rng(12)
    model = known()
    for at in (0, 5):
        fits = [fit_of(model, rng, viscous_friction=1.3 if i >= at else 1.0) for i in range(9)]
        alarm = track(model, fits).alarms[0]
        assert alarm.since == at and alarm.seen <= at + 2
        (change,) = alarm.changes
        assert change.parameter == "viscous_friction"
        assert change.interval[0] < 1.3 * model.values["viscous_friction"] < change.interval[1]


def test_a_change_is_judged_by_all_that_was_recorded_since() -> None:
    rng = np.random.default_rng(15)
    model = known()
    fits = [fit_of(model, rng, viscous_friction=1.05 if i >= 5 else 1.0) for i in range(25)]
    late = track(model, fits).alarms[0]
    early = track(model, fits[: late.seen + 1]).alarms[0]
    widths = [a.changes[0].interval[1] - a.changes[0].interval[0] for a in (early, late)]
    assert late.seen <= 7 and late.since == 5 and widths[1] < 0.7 * widths[0]
    assert late.changes[0].interval[0] < 1.05 * model.values["viscous_friction"] < late.changes[0].interval[1]


def test_what_the_axis_has_become_is_the_new_normal() -> None:
    rng = np.random.default_rng(13)
    model = known()
    fits = [fit_of(model, rng, input_gain=0.8 if i >= 3 else 1.0) for i in range(10)]
    found = track(model, fits)
    assert len(found.alarms) == 1
    assert found.latest.values["input_gain"] == pytest.approx(0.8 * model.values["input_gain"], rel=0.01)


def test_wear_is_forecast() -> None:
    rng = np.random.default_rng(14)
    model = known()
    fits = [fit_of(model, rng, viscous_friction=1.0 + 0.02 * i) for i in range(16)]
    limit = 1.5 * model.values["viscous_friction"]
    found = forecast(track(model, fits), "viscous_friction", limit)
    assert found.interval[0] < 10.0 < found.interval[1]
    assert found.recordings == pytest.approx(10.0, abs=2.0)
    with pytest.raises(BadInput, match="three recordings"):
        forecast(track(model, fits[:2]), "viscous_friction", limit)


def test_parameters_of_very_different_sizes_are_pooled_each_with_its_own_error() -> None:
    """A dead band known to 2 % beside an input gain known to 1e-7: neither hides the other."""
    model = replace(model_of(), notes={}, intervals={})
    errors = dict.fromkeys(model.fitted, 0.01) | {"input_gain": 1e-7, "dead_band_forward": 2.0}
    names = model.fitted
    model = replace(model, covariance=np.diag([errors[n] ** 2 for n in names]))
    pooled = pool([model] * 4)
    for n in names:
        assert pooled.std(n) == pytest.approx(0.5 * errors[n])
        assert pooled.values[n] == pytest.approx(model.values[n])
