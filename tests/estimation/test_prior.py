"""A new unit with its siblings' word: the posterior is the textbook's, and a unit that is unlike them stays itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from example_diagnosis import model_of

from twin.errors import BadInput
from twin.estimation.prior import prior_of, read_prior, with_prior
from twin.model.fitted_model import Model

SPREAD = 0.05


def unit(rng: np.random.Generator, error: float, **factors: float) -> tuple[Model, Model]:
    """A unit of the fleet as it is, and a fit of it whose errors are so large a share of the values."""
    base = replace(model_of(), notes={}, intervals={})
    names = base.fitted
    truth = np.array([base.values[n] * np.exp(SPREAD * rng.normal()) * factors.get(n, 1.0) for n in names])
    mixed = np.eye(len(names)) + 0.4 * rng.standard_normal((len(names), len(names)))
    size = error * np.abs([base.values[n] for n in names])
    covariance = np.outer(size, size) * (mixed @ mixed.T) / len(names)
    values = rng.multivariate_normal(truth, covariance)
    found = [dict(zip(names, v.tolist(), strict=True)) for v in (truth, values)]
    return base.with_values(found[0]), replace(base.with_values(found[1]), covariance=covariance)


def siblings(rng: np.random.Generator, count: int = 20) -> dict[str, Model]:
    return {f"axis{i}": unit(rng, 0.005)[1] for i in range(count)}


def test_a_short_recording_with_siblings_errs_less_and_its_errors_are_honest():
    rng = np.random.default_rng(11)
    prior = prior_of(siblings(rng))
    alone, together, standardised = [], [], []
    for _ in range(60):
        truth, fit = unit(rng, 0.2)
        posterior = with_prior(fit, prior)
        for n in ("input_gain", "viscous_friction", "dead_band_forward", "dead_band_reverse"):
            alone.append(fit.values[n] / truth.values[n] - 1.0)
            together.append(posterior.values[n] / truth.values[n] - 1.0)
            standardised.append((posterior.values[n] - truth.values[n]) / posterior.std(n))
    assert 2.0 * np.std(together) < np.std(alone)
    assert np.mean(np.abs(standardised) < 1.96) == pytest.approx(0.95, abs=0.06)


def test_with_one_parameter_it_is_the_precision_weighted_mean():
    rng = np.random.default_rng(12)
    prior = prior_of(siblings(rng))
    _, fit = unit(rng, 0.05)
    fit = replace(fit, covariance=np.diag(np.diag(fit.covariance)))
    posterior = with_prior(fit, prior)
    n = "viscous_friction"
    weights = np.array([1.0 / fit.std(n) ** 2, 1.0 / prior.variance(n)])
    assert posterior.values[n] == pytest.approx(np.average([fit.values[n], prior.centre(n)], weights=weights))
    assert posterior.std(n) == pytest.approx(weights.sum() ** -0.5)


def test_an_outlier_is_not_pulled_in():
    rng = np.random.default_rng(13)
    prior = prior_of(siblings(rng))
    truth, fit = unit(rng, 0.05, viscous_friction=2.0)
    posterior = with_prior(fit, prior)
    assert posterior.provenance["unlike_siblings"] == "viscous_friction"
    assert abs(posterior.values["viscous_friction"] - truth.values["viscous_friction"]) < 3.0 * fit.std(
        "viscous_friction"
    )
    assert posterior.std("input_gain") < fit.std("input_gain")


def test_what_the_recording_does_not_show_is_the_fleets():
    rng = np.random.default_rng(14)
    prior = prior_of(siblings(rng))
    _, fit = unit(rng, 0.01)
    i = fit.fitted.index("dead_band_reverse")
    wide = fit.covariance.copy()
    wide[i, :] = wide[:, i] = 0.0
    wide[i, i] = np.inf
    posterior = with_prior(replace(fit, covariance=wide), prior)
    assert posterior.values["dead_band_reverse"] == pytest.approx(prior.centre("dead_band_reverse"))
    assert posterior.std("dead_band_reverse") == pytest.approx(prior.variance("dead_band_reverse") ** 0.5)


def test_a_fleets_folder_is_read_by_structure(tmp_path):
    rng = np.random.default_rng(15)
    for name, model in siblings(rng, 6).items():
        (tmp_path / name).mkdir()
        model.write(tmp_path / name / "improved.toml")
    assert read_prior(tmp_path, model_of().structure).siblings == 6
    with pytest.raises(BadInput, match="holds 0 models of the structure"):
        read_prior(tmp_path, model_of("gravity").structure)
    with pytest.raises(BadInput, match="is not a folder"):
        read_prior(tmp_path / "none", model_of().structure)
    with pytest.raises(BadInput, match="needs 5 siblings"):
        prior_of(siblings(rng, 3))
