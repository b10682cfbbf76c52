"""What identification says of its own free run."""

from __future__ import annotations

import numpy as np
import pytest
from axis_runs import run, steps

from twin.diagnosis.free_run_error import free_run_errors, sentences
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
    assert len(sentences([error], "rad")) == 1


def test_a_model_that_lacks_friction_is_warned_of() -> None:
    recording = made(FIRST.with_("coulomb_friction"), coulomb_friction=4.0)
    errors = free_run_errors(Model(FIRST, VALUES), [recording])
    assert errors[0].depends_on
    assert any("lacks physics" in s and "twin diagnose" in s for s in sentences(errors, "rad"))
