"""What an addition foretells of stretches that it was not fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps
from scipy.signal import lfilter

from twin.diagnosis import cross_validation, nonparametric, thresholds
from twin.diagnosis.nonparametric import CurveTerm
from twin.effects.knots import KNOTS, through
from twin.estimation import filter_memory, likelihood, optimizer, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording
from twin.model.stepper import Structure

PLAIN = Structure.of(("inertia", "viscous_friction", "dead_band"))
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
COUNT = 2.0 * np.pi / 16384
SPEEDS = np.linspace(-8.0, 8.0, KNOTS)


def recorded(hump: float, seconds: float = 20.0) -> Recording:
    """A resistance that is larger at one speed by `hump` than a straight line, and torque noise that lasts 0.3 s."""
    rng = np.random.default_rng(4)
    time = 0.002 * np.arange(round(seconds / 0.002))
    command = steps(rng, len(time), 300, 40.0)
    noise = lfilter([1.0], [1.0, -np.exp(-0.002 / 0.3)], rng.standard_normal(len(time)))
    truth = PLAIN.with_("unknown_velocity")
    curve = through("unknown_velocity", SPEEDS, hump * np.exp(-0.5 * (SPEEDS - 3.0) ** 2))
    y, _ = run(truth, VALUES | curve, time, command + noise / noise.std() * (command != 0.0))
    return Recording("made", time, command, np.round(y / COUNT) * COUNT, "%", "rad", COUNT)


def compared(recording: Recording) -> tuple[list[PreparedRecording], Fit, Fit]:
    cases = [prepared_recording.prepare_recording(recording, PLAIN)]
    process_noise = filter_memory.process_noise_of(cases[0], 0.1)
    plain = optimizer.levenberg_marquardt(
        FitProblem(cases, process_noise=process_noise), PLAIN, VALUES, free_parameters(PLAIN)
    )
    return (
        cases,
        plain,
        nonparametric.fit_curve(
            FitProblem(cases), nonparametric.sketch_curve(FitProblem(cases), plain, CurveTerm("velocity"))
        ),
    )


def test_what_is_there_is_foretold():
    cases, plain, curve = compared(recorded(hump=2.0))
    assert cross_validation.gain_p_value(FitProblem(cases), plain, curve) < thresholds.CURVE_MAX_P_VALUE


def test_knots_that_follow_slow_noise_foretell_nothing():
    cases, plain, curve = compared(recorded(hump=0.0))
    assert plain.deviance - curve.deviance > 10.0 * KNOTS  # white noise would give each knot about one
    assert cross_validation.gain_p_value(FitProblem(cases), plain, curve) > 0.05


def test_a_model_does_no_better_than_itself():
    cases, plain, _ = compared(recorded(hump=0.0))
    assert cross_validation.gain_p_value(FitProblem(cases), plain, plain) == 1.0


def test_every_reading_that_is_judged_is_left_out_once():
    """With nothing to fit, what the stretches gain is what the models differ by on all that is judged."""
    cases, plain, _ = compared(recorded(hump=0.5))
    other = likelihood.evaluate(
        FitProblem(cases, process_noise=plain.process_noise), PLAIN, {**plain.values, "viscous_friction": 2.2}
    )
    found = cross_validation.block_gains(FitProblem(cases), plain, other)
    (one,), (two,) = (cross_validation._reading_losses(FitProblem(cases), p, plain.scale) for p in (plain, other))
    assert len(found) == 40 and found.sum() == pytest.approx(one.sum() - two.sum())
    hidden = cases[0].drive.time < 7.0
    (judged,) = FitProblem([replace(cases[0], contact_mask=hidden)]).stepped(PLAIN)
    assert cross_validation.block_gains(FitProblem([judged]), plain, other).sum() == pytest.approx(
        (one - two)[~hidden].sum()
    )


def test_of_a_few_seconds_nothing_is_said():
    cases, plain, curve = compared(recorded(hump=2.0, seconds=4.0))
    assert cross_validation.gain_p_value(FitProblem(cases), plain, curve) == 1.0


def test_what_acts_in_a_few_places_only_is_no_chance() -> None:
    rng = np.random.default_rng(7)
    nothing = rng.standard_normal(40)
    few = np.concatenate([rng.uniform(20.0, 900.0, 9), nothing[9:]])
    assert cross_validation.p_value_of_gains(few) < thresholds.CURVE_MAX_P_VALUE
    assert cross_validation.p_value_of_gains(-few) > 0.5 and cross_validation.p_value_of_gains(nothing) > 0.05
    # One loss among the largest, and it may be chance again.
    assert cross_validation.p_value_of_gains(np.append(few, -400.0)) > thresholds.CURVE_MAX_P_VALUE


@pytest.mark.parametrize("tails", ["light", "heavy"])
def test_changes_of_random_sign_are_seldom_no_chance(tails: str) -> None:
    rng = np.random.default_rng(8)
    sizes = rng.standard_normal((3000, 40)) if tails == "light" else rng.standard_cauchy((3000, 40))
    said = np.array([cross_validation.p_value_of_gains(row) for row in sizes])
    for level in (0.2, 0.05, thresholds.CURVE_MAX_P_VALUE):
        # Above three standard deviations of what is counted it is more than the level.
        assert np.mean(said <= level) < level + 3.0 * np.sqrt(level / len(said))
    assert (
        cross_validation.p_value_of_gains(np.ones(20)) < 1e-4 and cross_validation.p_value_of_gains(-np.ones(20)) == 1.0
    )
