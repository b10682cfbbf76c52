"""Values for a long free run: a complete model keeps its own, an incomplete one is served by others."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from axis_runs import run, steps

from twin.errors import BadInput
from twin.estimation import estimate, horizon, likelihood, maximum_likelihood, prepared_recording
from twin.io.recording import Loop, Recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

STRUCTURE = Structure.of(["inertia", "viscous_friction", "coulomb_friction"])
TRUTH = {"input_gain": 0.4, "viscous_friction": 1.5, "coulomb_friction": 1.0}
COUNT = 2.0 * np.pi / 10000.0
SAMPLES = 12000


def recorded(seed: int, lag: float) -> Recording:
    """24 s counted, with a little torque noise and, if it is not zero, a lag (s) that the structure lacks."""
    rng = np.random.default_rng(seed)
    time = 0.002 * np.arange(SAMPLES)
    command = steps(rng, SAMPLES, 400, 40.0)
    truth = STRUCTURE.with_("motor_lag") if lag else STRUCTURE
    y, _ = run(truth, TRUTH | ({"lag_time": lag} if lag else {}), time, command + 0.3 * rng.standard_normal(SAMPLES))
    return Recording("made", time, command, np.round(y / COUNT) * COUNT, "%", "rad", resolution=COUNT)


@cache
def models(lag: float) -> tuple[Model, Model]:
    recordings = [recorded(1, lag), recorded(2, lag)]
    likeliest = maximum_likelihood.identify(recordings, STRUCTURE)
    return likeliest, horizon.for_horizon(likeliest, recordings, 24.0)


def free_run(model: Model, recording: Recording) -> float:
    case = prepared_recording.prepare_recording(recording, model.structure)
    error = likelihood.innovations(case, model.structure, model.values, 0.0).error
    return float(np.sqrt(np.mean(error**2)))


def test_a_complete_model_keeps_its_values() -> None:
    likeliest, ahead = models(0.0)
    for name, true in TRUTH.items():
        assert ahead.values[name] == pytest.approx(true, rel=0.03)
        assert abs(ahead.values[name] - true) < 4.0 * ahead.std(name)
    assert ahead.provenance["horizon"] == "24 s"
    assert (ahead.reading_std, ahead.torque_density) == (likeliest.reading_std, likeliest.torque_density)


def test_an_incomplete_model_runs_better_where_nothing_was_fitted() -> None:
    likeliest, ahead = models(0.05)
    fresh = [recorded(seed, 0.05) for seed in (3, 4, 5)]
    assert sum(free_run(ahead, r) for r in fresh) < 0.7 * sum(free_run(likeliest, r) for r in fresh)


def test_under_the_own_loop_the_values_are_those_of_the_loop() -> None:
    """The input is logged a third too large: the loop's own motion knows better."""
    loop, time = Loop("P", gain=150.0, limit=80.0), 0.002 * np.arange(8000)
    made = Recording(
        "made", time, np.zeros(8000), np.zeros(8000), "%", "rad", loop=loop,
        optional={"reference": np.sin(2.0 * time) + 0.5 * np.sign(np.sin(1.3 * time))},
    )  # fmt: skip
    case = prepared_recording.prepare_recording(made, STRUCTURE, closed=True)
    position = -likelihood.innovations(case, STRUCTURE, TRUTH, 0.0).error
    wish = np.clip(150.0 * (made.optional["reference"] - position), -80.0, 80.0)
    recording = replace(made, output=np.round(position / COUNT) * COUNT, input=1.33 * wish, resolution=COUNT)
    likeliest = maximum_likelihood.identify([recording], STRUCTURE)
    assert likeliest.values["input_gain"] < 0.8 * TRUTH["input_gain"]
    closed = horizon.for_horizon(likeliest, [recording], 16.0, closed=True)
    for name, true in TRUTH.items():
        assert closed.values[name] == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("span", [0.0, -1.0, float("nan")])
def test_a_horizon_lies_ahead(span: float) -> None:
    with pytest.raises(BadInput, match="time above 0"):
        horizon.for_horizon(models(0.0)[0], [recorded(1, 0.0)], span)


def test_a_model_without_an_estimate_is_no_start() -> None:
    with pytest.raises(BadInput, match="no estimate to start from"):
        horizon.for_horizon(Model(STRUCTURE, TRUTH), [recorded(1, 0.0)], 1.0)


def test_a_gap_does_not_make_up_for_a_lag() -> None:
    """The likeliest gap of a rig without one is as wide as may be where the lag is not modelled."""
    first = Structure.of(["inertia", "viscous_friction", "dead_band", "backlash"])
    recording = recorded(1, 0.05)
    problem, likeliest = maximum_likelihood.likeliest([recording], first)
    assert horizon.lacks_physics(problem, likeliest)
    found = estimate.identify(recording, first)
    assert found.provenance["horizon"] == horizon.WHOLE and horizon.LACKING in found.provenance
    assert found.values["backlash_gap"] < 0.1 and 0.02 < found.values["motor_share"] < 0.98
    ahead = horizon.for_horizon(found, [recording], 0.2)
    assert horizon.LACKING not in ahead.provenance  # its values are not those of the best free run
    model = maximum_likelihood.to_model(problem, likeliest, [recording])
    assert free_run(found, recording) < free_run(model, recording)


def test_a_complete_model_keeps_the_likeliest_values() -> None:
    recording = recorded(1, 0.0)
    found = estimate.identify(recording, STRUCTURE)
    assert "horizon" not in found.provenance
    assert found.values == maximum_likelihood.identify([recording], STRUCTURE).values
