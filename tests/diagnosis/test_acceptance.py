"""The figures of a name must confirm it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps

from twin.diagnosis import acceptance, cross_validation
from twin.estimation import likelihood, optimizer, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording
from twin.model.stepper import Structure

FIRST = Structure.of(["inertia", "viscous_friction"])
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0}
COUNT = 2.0 * np.pi / 8192.0


def made(structure: Structure, values: dict[str, float], seed: int, largest: float = 40.0) -> Recording:
    """Steps of duty on the model, shaken a little and read in counts."""
    rng = np.random.default_rng(seed)
    time, duty = 0.002 * np.arange(3000), steps(rng, 3000, 150, largest)
    read, _ = run(structure, values, time, duty + 0.5 * rng.standard_normal(3000))
    return Recording(f"made {seed}", time, duty, COUNT * np.round(read / COUNT), "%", "rad", COUNT)


def fitted(problem: FitProblem, structure: Structure, values: dict[str, float]) -> Fit:
    begun = preparation.complete_values(structure, values)
    return optimizer.fit_with_process_noise(problem, structure, begun, free_parameters(structure))


@pytest.mark.parametrize("size", [0.0, 2.0])
def test_a_size_within_three_of_its_errors_is_not_borne_out(size: float) -> None:
    structure = FIRST.with_("constant_offset")
    values = {**VALUES, "offset": size}
    problem = preparation.prepare_recordings([made(structure, values, 3)], structure)
    failed = acceptance.not_borne_out(problem, fitted(problem, structure, values), FIRST, {})
    if size:
        assert failed is None
    else:
        assert failed is not None and failed.id == "constant_offset" and failed.figure < 3.0
        assert "offset" in failed.reason and "±" in failed.reason
    assert acceptance.not_borne_out(problem, fitted(problem, structure, values), structure, {}) is None


@pytest.mark.parametrize(("variation", "possible"), [(1.0, True), (5.0, False)])
def test_dry_friction_that_would_push_is_not_borne_out(variation: float, possible: bool) -> None:
    structure = FIRST.with_("position_dependent_friction")
    values = {**VALUES, "coulomb_friction": 3.0, "friction_variation": 1.0, "friction_angle": 0.4}
    problem = preparation.prepare_recordings([made(structure, values, 5)], structure)
    point = fitted(problem, structure, values)
    point = replace(point, values={**point.values, "friction_variation": variation})
    failed = acceptance.not_borne_out(problem, point, FIRST, {})
    assert (failed is None) is possible
    if failed is not None:
        assert failed.id == "position_dependent_friction" and -2.1 < failed.figure < -1.0


def test_a_time_constant_at_its_bound_is_not_borne_out() -> None:
    structure = FIRST.with_("thermal_fade")
    values = preparation.complete_values(structure, {**VALUES, "fade": 0.2, "fade_time": 5.0})
    problem = preparation.prepare_recordings([made(structure, values, 7)], structure)
    point = fitted(problem, structure, values)
    failed = acceptance.not_borne_out(problem, replace(point, values={**point.values, "fade_time": 1.0}), FIRST, {})
    assert failed is not None and "bound of 1 s" in failed.reason and failed.figure == 1.0


def test_what_one_of_three_recordings_shows_is_not_borne_out() -> None:
    """A constant torque that acts in one recording alone makes the others worse."""
    structure = FIRST.with_("constant_offset")
    recordings = [made(structure, {**VALUES, "offset": size}, seed) for seed, size in ((1, 0.0), (2, 0.0), (3, 3.0))]
    problem = preparation.prepare_recordings(recordings, structure)
    larger, without = (fitted(problem, s, {**VALUES, "offset": 1.0}) for s in (structure, FIRST))
    gains = cross_validation.recording_gains(problem, without, larger)
    assert (gains > 0.0).tolist() == [False, False, True]
    failed = acceptance.not_borne_out(problem, larger, FIRST, {"constant_offset": without})
    assert failed is not None and failed.figure < 0.0 and "without made 3" in failed.reason


def test_what_two_of_five_recordings_show_stands() -> None:
    """A drive that clips does so only where much is asked of it."""
    structure = FIRST.with_("drive_saturation")
    values = {**VALUES, "saturation_limit": 25.0}
    recordings = [made(structure, values, i, most) for i, most in enumerate((40.0, 12.0, 40.0, 12.0, 12.0))]
    problem = preparation.prepare_recordings(recordings, structure)
    larger, without = (fitted(problem, s, values) for s in (structure, FIRST))
    gains = cross_validation.recording_gains(problem, without, larger)
    assert np.all(gains[[0, 2]] > 0.0)
    assert acceptance.not_borne_out(problem, larger, FIRST, {"drive_saturation": without}) is None


def test_a_size_at_its_bound_is_not_borne_out() -> None:
    structure = FIRST.with_("load_dependent_friction")
    values = preparation.complete_values(structure, {**VALUES, "load_friction": 0.3})
    problem = preparation.prepare_recordings([made(structure, values, 9)], structure)
    point = fitted(problem, structure, values)
    assert acceptance.not_borne_out(problem, point, FIRST, {}) is None
    failed = acceptance.not_borne_out(
        problem, replace(point, values={**point.values, "load_friction": 0.95}), FIRST, {}
    )
    assert failed is not None and "bound of 0.95" in failed.reason and failed.figure == 0.95


@pytest.mark.parametrize("true", [True, False])
def test_a_name_has_to_predict_blocks_that_it_was_not_fitted_to(true: bool) -> None:
    """A spring that is there helps in the free run; one of the wrong sign, held there, does harm."""
    structure = FIRST.with_("spring")
    values = {**VALUES, "spring_stiffness": 3.0, "spring_rest": 0.2}
    problem = preparation.prepare_recordings([made(structure, values, 11)], structure)
    larger, without = fitted(problem, structure, values), fitted(problem, FIRST, VALUES)
    if not true:
        held = {**larger.values, "spring_stiffness": -1.0}
        larger = likelihood.evaluate(problem.at(larger.process_noise), structure, held, without.free)
    failed = acceptance.not_borne_out(problem, larger, FIRST, {"spring": without})
    assert (failed is None) is true
    if failed is not None:
        assert failed.id == "spring" and failed.figure > 1.05 and "left out" in failed.reason


def test_what_predicts_clearly_is_borne_out_whatever_its_standard_error() -> None:
    """Slopes at a rough place of the likelihood may promise any error."""
    structure = FIRST.with_("spring")
    values = {**VALUES, "spring_stiffness": 3.0, "spring_rest": 0.2}
    problem = preparation.prepare_recordings([made(structure, values, 11)], structure)
    larger, without = fitted(problem, structure, values), fitted(problem, FIRST, VALUES)
    larger = replace(larger, information=1e-8 * larger.information)
    assert acceptance.not_borne_out(problem, larger, FIRST, {"spring": without}) is None
    failed = acceptance.not_borne_out(problem, larger, FIRST, {})
    assert failed is not None and "less than three errors" in failed.reason
