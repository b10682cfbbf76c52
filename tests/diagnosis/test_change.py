"""Changes between two fits: planted ones are found with their size, and an axis that is the same is left alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from example_diagnosis import model_of
from scipy.stats import binomtest

from twin.diagnosis.change import DRIVE, INERTIA, changes_sentence, compare_models
from twin.errors import BadInput
from twin.model.fitted_model import Model


def drawn(model: Model, rng: np.random.Generator, **factors: float) -> Model:
    """What a fit finds of an axis whose parameters are so many times as large: drawn from the fit's own errors."""
    truth = np.array([model.values[n] * factors.get(n, 1.0) for n in model.fitted])
    values = rng.multivariate_normal(truth, model.covariance)
    return replace(model, notes={}, values={**model.values, **dict(zip(model.fitted, values.tolist(), strict=True))})


def correlated(model: Model, rng: np.random.Generator) -> Model:
    """The model with errors that hang together, as those of a fit do."""
    n = len(model.fitted)
    mixed = np.eye(n) + 0.4 * rng.standard_normal((n, n))
    size = np.sqrt(np.diag(model.covariance))
    covariance = np.outer(size, size) * (mixed @ mixed.T) / n
    return replace(model, covariance=covariance, notes={})


def on_a_ridge(model: Model) -> Model:
    """The model with gap and motor share known to 5 % each, and their product to 1 %."""
    i, j = model.fitted.index("backlash_gap"), model.fitted.index("motor_share")
    covariance = np.diag(np.diag(model.covariance))
    gap, share = 0.05 * model.values["backlash_gap"], 0.05 * model.values["motor_share"]
    covariance[np.ix_([i, j], [i, j])] = [[gap**2, -0.98 * gap * share], [-0.98 * gap * share, share**2]]
    return replace(model, covariance=covariance, notes={}, intervals={})


def test_an_axis_that_did_not_change_is_left_alone() -> None:
    rng = np.random.default_rng(1)
    alarms = 0
    for _ in range(200):
        model = correlated(model_of("gravity", "coulomb_friction"), rng)
        alarms += bool(compare_models(drawn(model, rng), drawn(model, rng), 0.05).found)
    assert binomtest(alarms, 200, 0.05, alternative="greater").pvalue > 0.001


@pytest.mark.parametrize("name", ["input_gain", "viscous_friction", "dead_band_forward", "gravity_gain"])
def test_one_parameter_that_changed_is_named_with_its_size(name: str) -> None:
    rng = np.random.default_rng(2)
    named = held = 0
    for _ in range(30):
        model = correlated(model_of("gravity", "coulomb_friction"), rng)
        found = compare_models(drawn(model, rng), drawn(model, rng, **{name: 1.5})).found
        named += [c.parameter for c in found] == [name]
        held += any(c.parameter == name and c.interval[0] / c.before <= 1.5 <= c.interval[1] / c.before for c in found)
    assert named >= 27
    assert held >= 24


def test_an_inertia_that_grew_is_not_five_other_things() -> None:
    rng = np.random.default_rng(3)
    over = ("input_gain", "viscous_friction", "gravity_gain", "coulomb_friction")
    right = 0
    for _ in range(20):
        model = correlated(model_of("gravity", "coulomb_friction"), rng)
        grown = compare_models(drawn(model, rng), drawn(model, rng, **dict.fromkeys(over, 1 / 3.0))).found
        right += [c.parameter for c in grown] == [INERTIA] and abs(math.log(grown[0].after / 3.0)) < 0.2
    assert right >= 18


def test_a_weak_drive_is_offered_where_no_other_torque_tells_it_from_an_inertia() -> None:
    rng = np.random.default_rng(5)
    for effects, same in (((), True), (("gravity", "coulomb_friction"), False)):
        model = correlated(model_of(*effects), rng)
        over = ("input_gain", "viscous_friction", "gravity_gain", "coulomb_friction")
        changes = compare_models(drawn(model, rng), drawn(model, rng, **dict.fromkeys(over, 0.3)))
        assert [c.parameter for c in changes.found] == [INERTIA]
        assert (DRIVE in changes.found[0].rivals) is same
        assert ("known weight" in changes_sentence(changes)) is same


def test_a_payload_changes_inertia_and_not_the_weight_of_the_rest() -> None:
    """A payload twice as heavy: the inertia doubles, gravity over inertia stays, and both are said."""
    rng = np.random.default_rng(4)
    model = correlated(model_of("gravity", "coulomb_friction"), rng)
    over = dict.fromkeys(("input_gain", "viscous_friction", "coulomb_friction"), 0.5)
    found = compare_models(drawn(model, rng), drawn(model, rng, **over)).found
    assert {c.parameter for c in found} == {INERTIA, "gravity_gain"}
    for c in found:  # gravity's torque doubles, though its share of the inertia, which the models hold, does not
        assert (c.before, c.unit) == (1.0, "1") and c.interval[0] < 2.0 < c.interval[1]
        assert "times what it was" in c.says


def test_what_a_fit_cannot_fix_is_said_to_be_that() -> None:
    model = model_of()
    wide = model.covariance.copy()
    i = model.fitted.index("dead_band_reverse")
    wide[i, i] = math.inf
    found = compare_models(model, replace(model, covariance=wide))
    assert found.undetermined == ("dead_band_reverse",) and found.found == ()
    assert "The dead band reverse cannot be fixed by this recording" in changes_sentence(found)


def test_a_gap_whose_profile_is_wide_has_not_changed() -> None:
    """The curvature at the maximum promises 1 %, the profile of the likelihood says a factor of two."""
    model = replace(model_of(), notes={}, intervals={})
    moved = model.with_values({"backlash_gap": 1.5 * model.values["backlash_gap"]})
    assert [c.parameter for c in compare_models(model, moved).found] == ["backlash_gap"]
    wide = {"backlash_gap": (0.5 * moved.values["backlash_gap"], 2.0 * moved.values["backlash_gap"])}
    assert compare_models(model, replace(moved, intervals=wide)).found == ()


def test_a_wider_gap_with_a_lighter_motor_has_not_changed() -> None:
    """The motor crosses it in the same time, so the likelihood has a ridge there; a gap that alone is wider has."""
    model = on_a_ridge(model_of("gravity"))
    gap, share = model.values["backlash_gap"], model.values["motor_share"]
    slid = model.with_values({"backlash_gap": 1.4 * gap, "motor_share": share / 1.4})
    assert compare_models(model, slid).found == ()
    worn = compare_models(model, slid.with_values({"backlash_gap": 1.4 * 1.5 * gap})).found
    assert [c.parameter for c in worn] == ["backlash_gap"] and worn[0].after == pytest.approx(1.5 * gap)


def test_a_load_that_is_heavier_lets_the_gap_alone() -> None:
    """The motor's share falls as the inertia grows, and the gap stays what it was."""
    rng = np.random.default_rng(6)
    model = on_a_ridge(model_of())
    over = dict.fromkeys(("input_gain", "viscous_friction", "motor_share"), 0.5)
    found = compare_models(drawn(model, rng), drawn(model, rng, **over)).found
    assert [c.parameter for c in found] == [INERTIA] and found[0].interval[0] < 2.0 < found[0].interval[1]


def test_an_interval_is_wider_where_the_rest_scatters_more_than_it_should() -> None:
    model = replace(model_of(), notes={}, intervals={})
    grown = model.with_values({"viscous_friction": 1.5 * model.values["viscous_friction"]})
    others = ("dead_band_forward", "dead_band_reverse", "input_gain")
    off = {
        n: model.values[n] + s * 2.5 * math.sqrt(2.0) * model.std(n) for n, s in zip(others, (1, -1, 1), strict=True)
    }
    (calm,), (rough,) = (compare_models(model, m).found for m in (grown, grown.with_values(off)))
    width = [math.log(c.interval[1] / c.interval[0]) for c in (calm, rough)]
    # Three of the four that did not change are 2.5 standard errors off: 3 * 2.5^2 / 4.
    assert rough.parameter == calm.parameter == "viscous_friction"
    assert width[1] / width[0] == pytest.approx(math.sqrt(0.75) * 2.5, rel=0.02)


def test_an_angle_is_compared_around_the_circle() -> None:
    model = replace(model_of("gravity"), notes={})
    turned = model.with_values({"gravity_angle": model.values["gravity_angle"] + 2 * math.pi})
    assert compare_models(model, turned).found == ()


def test_models_that_cannot_be_compared_are_refused() -> None:
    model = model_of()
    with pytest.raises(BadInput, match="structure"):
        compare_models(model, model_of("gravity"))
    with pytest.raises(BadInput, match="standard errors"):
        compare_models(model, replace(model, fitted=(), covariance=np.zeros((0, 0))))
