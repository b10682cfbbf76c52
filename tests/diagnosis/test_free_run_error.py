"""What identification says of its own free run."""

from __future__ import annotations

import numpy as np
import pytest
from axis_runs import run, steps

from twin.diagnosis import nonparametric
from twin.diagnosis.free_run_error import compare_horizon, free_run_errors, sentences
from twin.estimation import horizon, maximum_likelihood, prepared_recording
from twin.io.recording import Recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

FIRST = Structure.of(["inertia", "viscous_friction"])
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0}


def made(structure: Structure, **values: float) -> Recording:
    rng = np.random.default_rng(3)
    time, duty = 0.004 * np.arange(4000), steps(rng, 4000, 100, 40.0)
    read, _ = run(structure, VALUES | values, time, duty + 0.2 * rng.standard_normal(4000))
    return Recording("made", time, duty, np.round(read / 1e-3) * 1e-3, "%", "rad", 1e-3)


def test_the_true_model_is_told_its_error_and_nothing_else() -> None:
    recording = made(FIRST)
    (error,) = free_run_errors(Model(FIRST, VALUES), [recording])
    assert error.recording == "made" and error.depends_on == ()
    assert error.nrmse_percent == pytest.approx(100.0 * error.rmse / np.ptp(recording.output))
    assert len(sentences([error], Model(FIRST, VALUES), "rad")) == 1


def test_a_model_that_lacks_friction_is_warned_of() -> None:
    recording = made(FIRST.with_("coulomb_friction"), coulomb_friction=4.0)
    model = Model(FIRST, VALUES)
    errors = free_run_errors(model, [recording])
    assert errors[0].depends_on
    assert any("lacks physics" in s and "twin diagnose" in s for s in sentences(errors, model, "rad"))


@pytest.mark.parametrize(("spring", "matters"), [(1e-3, False), (0.5, True)])
def test_what_is_certain_but_moves_nothing_is_not_warned_of(spring: float, matters: bool) -> None:
    """Readings without noise show a torque that is a ten-thousandth of what moves the axis."""
    time, duty = 0.004 * np.arange(4000), steps(np.random.default_rng(3), 4000, 100, 40.0)
    pulled = VALUES | {"spring_stiffness": spring, "spring_rest": 0.0}
    read, _ = run(FIRST.with_("spring"), pulled, time, duty)
    recording = Recording("made", time, duty, read, "%", "rad", 1e-9)
    found = nonparametric.remaining_dependence(prepared_recording.prepare_recording(recording, FIRST), FIRST, VALUES)
    assert found.p_value < 1e-3 and found.share > 0.2
    assert bool(free_run_errors(Model(FIRST, VALUES), [recording])[0].depends_on) == matters


def test_a_model_whose_likeliest_values_make_up_for_physics_is_warned_of() -> None:
    """Also where its missing torque depends on nothing, as that of a lag."""
    marked = Model(FIRST, VALUES, provenance={horizon.LACKING: "so it is"})
    said = sentences(free_run_errors(marked, [made(FIRST)]), marked, "rad")
    assert len(said) == 2 and "lacks physics" in said[1] and "twin diagnose" in said[1]


def test_a_horizon_is_not_advised_where_it_was_taken() -> None:
    recording = made(FIRST.with_("gravity"), gravity_gain=8.0)
    likeliest, ahead = Model(FIRST, VALUES), Model(FIRST, VALUES, provenance={"horizon": "0.2 s"})
    said = [sentences(free_run_errors(m, [recording]), m, "rad")[-1] for m in (likeliest, ahead)]
    assert "lacks physics" in said[0] and "fit over a horizon" in said[0]
    assert "lacks physics" in said[1] and "horizon" not in said[1]


def test_both_kinds_of_values_are_held_against_each_other_on_held_out_data() -> None:
    recording = made(FIRST.with_("motor_lag"), lag_time=0.05)
    model = maximum_likelihood.identify([recording], FIRST)
    compared = compare_horizon(model, [recording], 10.0, False)
    assert 0.0 < compared.for_horizon < compared.likeliest
    said = compared.sentence(10.0, "rad")
    assert "those for the horizon are better" in said
    assert f"{compared.likeliest:.3g} rad" in said and f"{compared.for_horizon:.3g} rad" in said
