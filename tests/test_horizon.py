"""Values for a long free run: a complete model keeps its own, an incomplete one is served by others."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from axis_runs import run, steps

from twin import identify, likelihood
from twin.axis import Structure
from twin.errors import BadInput
from twin.model import Model
from twin.recording import Recording

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
    likeliest = identify.identify(recordings, STRUCTURE)
    return likeliest, identify.for_horizon(likeliest, recordings, 24.0)


def free_run(model: Model, recording: Recording) -> float:
    case = likelihood.prepare(recording, model.structure)
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


@pytest.mark.parametrize("horizon", [0.0, -1.0, float("nan")])
def test_a_horizon_lies_ahead(horizon: float) -> None:
    with pytest.raises(BadInput, match="time above 0"):
        identify.for_horizon(models(0.0)[0], [recorded(1, 0.0)], horizon)
