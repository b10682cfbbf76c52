"""Steps of the search within bounds, and standard errors where the model errs."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, lsq_linear
from scipy.special import huber

from twin.effects.catalogue import BASE
from twin.effects.end_stop import NOWHERE
from twin.estimation import (
    filter_memory,
    likelihood,
    likelihood_profile,
    maximum_likelihood,
    numerics,
    optimizer,
    parameter_bounds,
    preparation,
    prepared_recording,
)
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording
from twin.model.stepper import Structure
from twin.simulation import kernel

STRUCTURE = Structure.of(BASE)
VALUES = {
    "input_gain": 0.3, "viscous_friction": 2.0, "dead_band_forward": 4.0, "dead_band_reverse": 5.0,
    "backlash_gap": 0.03, "motor_share": 0.25, "friction_share": 0.7,
}  # fmt: skip
FREE = tuple(VALUES)
COUNT = 2e-4


def bounds(point: Fit) -> np.ndarray:
    found = {p.name: (p.lower, p.upper) for p in STRUCTURE.parameters}
    return np.array([found[n] for n in point.free])


@pytest.mark.parametrize("seed", range(20))
def test_a_step_is_the_best_one_within_the_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = np.array([0.05, 0.5, 1.0, 1.0, 0.02, 0.2, 0.4])
    root = rng.standard_normal((12, 7)) / size
    wanted = size * rng.standard_normal(7) * 3.0
    normal = root.T @ root
    point = Fit(STRUCTURE, VALUES, 1.0, FREE, 0.0, 1.0, normal, normal @ wanted, normal)
    here, limits = np.array(list(VALUES.values())), bounds(point)
    moved = optimizer._damped_step(point, 0.0)
    step = np.array([moved[n] for n in FREE]) - here
    assert parameter_bounds.within_bounds(moved)
    best = lsq_linear(root, root @ wanted, (limits[:, 0] - here, limits[:, 1] - here), tol=1e-12).x

    def gain(change: np.ndarray) -> float:
        return float(2.0 * point.gradient @ change - change @ normal @ change)

    assert gain(step) > 0.95 * gain(best) > 0.0


def made(correlated: float = 0.0, duration: float = 30.0, seed: int = 1) -> PreparedRecording:
    """A square wave of several heights on the base model, read in counts; `correlated` counts of slow error."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration / 0.002)) * 0.002
    duty = np.repeat(rng.uniform(15.0, 60.0, len(time) // 250) * (-1.0) ** np.arange(len(time) // 250), 250)
    blank = Recording("made", time, duty, np.zeros(len(time)), "%", "rad", COUNT)
    case = prepared_recording.prepare_recording(blank, STRUCTURE)
    x = kernel.start_state(0.0, 0.0, 0.0)
    position = kernel.predict(case.drive, kernel.vector(STRUCTURE, VALUES), x).reading
    slow = np.convolve(rng.standard_normal(len(time) + 99), np.full(100, 0.1), "valid")
    read = position + COUNT * (rng.uniform(-0.5, 0.5, len(time)) + correlated * slow)
    return prepared_recording.prepare_recording(replace(blank, output=read), STRUCTURE)


@pytest.mark.parametrize(("correlated", "least", "most"), [(0.0, 1.0, 1.6), (1.0, 2.0, 30.0)])
def test_errors_that_hang_together_widen_the_standard_errors(correlated: float, least: float, most: float) -> None:
    case = made(correlated)
    process_noise = filter_memory.process_noise_of(case, 0.2)
    point = optimizer.levenberg_marquardt(FitProblem([case], process_noise=process_noise), STRUCTURE, VALUES, FREE)
    wider = np.sqrt(np.diag(likelihood.jackknife_covariance(FitProblem([case]), point)) / np.diag(point.covariance))
    assert least <= float(np.median(wider)) < most


@pytest.mark.parametrize("angle", [0.4, 2.2, -2.9])
def test_gravity_is_found_whichever_way_the_link_hangs(angle: float) -> None:
    """It begins as none, at the angle 0. From half of all angles the slope leads below none."""
    structure = STRUCTURE.with_("gravity").without("backlash")
    case, truth = made(duration=10.0), {**VALUES, "gravity_gain": 5.0, "gravity_angle": angle}
    truth = preparation.complete_values(structure, truth)
    position = kernel.predict(case.drive, kernel.vector(structure, truth), kernel.start_state(0.0, 0.0, 0.0)).reading
    rng = np.random.default_rng(3)
    read = position + COUNT * rng.uniform(-0.5, 0.5, len(position))
    case = prepared_recording.prepare_recording(replace(case.recording, output=read), structure)
    problem = FitProblem([case], process_noise=filter_memory.process_noise_of(case, 0.2))
    none = {**truth, "gravity_gain": 0.0, "gravity_angle": 0.0}
    found = optimizer.levenberg_marquardt(problem, structure, none, problem.free(structure)).values
    assert found["gravity_gain"] == pytest.approx(5.0, rel=0.02)
    assert math.remainder(found["gravity_angle"] - angle, 2.0 * math.pi) == pytest.approx(0.0, abs=0.02)


def test_a_place_is_remembered_by_all_that_its_likelihood_comes_from() -> None:
    case = made(duration=6.0)
    half = np.arange(len(case.drive.time)) % 2 == 0
    louder = replace(case.drive, command=1.01 * case.drive.command)
    others = [
        case,
        replace(case, contact=1.0),
        replace(case, start=(0.1, 0.0)),
        replace(case, reading_variance=2.0 * case.reading_variance),
        replace(case, contact_mask=half),
        replace(case, free_run=half),
        replace(case, free_run=~half),
        replace(case, drive=louder),
        replace(case, drive=replace(case.drive, longest=0.001)),
        replace(case, drive=replace(case.drive, measured=np.where(half, np.nan, case.drive.measured))),
    ]
    assert len({c.digest for c in others}) == len(others)
    assert replace(case, drive=replace(case.drive)).digest == case.digest
    first = likelihood.evaluate(FitProblem([case], process_noise=1e6), STRUCTURE, VALUES, FREE)
    for cases, values, process_noise, free in (
        ([others[4]], VALUES, 1e6, FREE),
        ([case, case], VALUES, 1e6, FREE),
        ([case], {**VALUES, "backlash_gap": 0.02}, 1e6, FREE),
        ([case], VALUES, 2e6, FREE),
        ([case], VALUES, 1e6, FREE[:3]),
    ):
        found = likelihood.evaluate(FitProblem(cases, process_noise=process_noise), STRUCTURE, values, free)
        results = [likelihood.innovations(c, STRUCTURE, values, process_noise, free) for c in cases]
        fresh = likelihood.fit_from_innovations(FitProblem(cases, {}, process_noise), STRUCTURE, values, free, results)
        assert found.deviance == fresh.deviance != first.deviance or free != FREE
        assert np.array_equal(found.information, fresh.information) and np.array_equal(found.gradient, fresh.gradient)
    again = likelihood.evaluate(
        FitProblem([replace(case)], process_noise=1e6), STRUCTURE, dict(reversed(VALUES.items())), FREE
    )
    assert again is first


def test_what_stretches_say_is_the_sum_of_what_their_readings_say() -> None:
    case = made(duration=5.0)
    case.drive.measured[[300, 2200]] += 30.0 * COUNT
    blank, weight = np.zeros(len(case.drive.time), dtype=bool), np.zeros(len(case.drive.time))
    blank[600:1100] = True  # more than a stretch
    case = replace(case, contact_mask=blank)
    point = likelihood.evaluate(FitProblem([case], process_noise=1.0), STRUCTURE, VALUES, FREE)
    run = likelihood.innovations(case, STRUCTURE, VALUES, 1.0, FREE)
    z = run.error / np.sqrt(run.variance * point.scale)
    assert np.count_nonzero(np.abs(z) > likelihood.HUBER_LIMIT) > 0 and np.isnan(z[800])
    weight[~blank] = np.minimum(1.0, likelihood.HUBER_LIMIT / np.maximum(np.abs(z[~blank]), 1e-9))
    per = weight / (run.variance * point.scale)
    pulls = run.slopes * (per * np.where(blank, 0.0, run.error))[:, None]
    each = [pulls[i : i + 250].sum(axis=0) for i in range(0, 2500, 250) if not blank[i : i + 250].all()]
    assert len(each) == 9
    np.testing.assert_allclose(point.gradient, pulls.sum(axis=0), rtol=1e-9, atol=1e-12 * np.abs(pulls).sum())
    np.testing.assert_allclose(point.information, run.slopes.T @ (per[:, None] * run.slopes), rtol=1e-9, atol=1e-9)
    by_stretch, _ = likelihood._scores_by_block(FitProblem([case]), point, None, 0.5)
    np.testing.assert_allclose(by_stretch, each, rtol=1e-7, atol=1e-9 * np.abs(pulls).sum())


def test_slow_errors_are_seen_where_little_is_judged_too() -> None:
    """Stretches of the usual length would be too few for the parameters to tell how much the slopes scatter."""
    whole = made(1.0, duration=12.0)
    late = np.arange(len(whole.drive.time)) >= 2000
    units = []
    for case in (whole, replace(whole, rattle_mask=late)):
        point = optimizer.levenberg_marquardt(
            FitProblem([case], process_noise=filter_memory.process_noise_of(case, 0.2)), STRUCTURE, VALUES, FREE
        )
        units.append(point.overdispersion)
    assert units[0] > 2.0 and units[1] > 0.3 * units[0]


def test_slow_errors_are_seen_in_a_short_recording_too() -> None:
    """Were it taken for one whose errors have nothing to do with each other, the larger of two models would win."""
    case = made(1.0, duration=4.0)
    point = optimizer.levenberg_marquardt(
        FitProblem([case], process_noise=filter_memory.process_noise_of(case, 0.2)), STRUCTURE, VALUES, FREE
    )
    assert point.overdispersion > 2.0


def rattling() -> tuple[PreparedRecording, dict[str, float], float]:
    """A light motor that bounces in a wide gap under a fast chirp, its true values, and a noise density."""
    structure = STRUCTURE.with_("tooth_compliance")
    values = {
        "input_gain": 0.0335, "viscous_friction": 0.7, "dead_band_forward": 5.6, "dead_band_reverse": 9.0,
        "backlash_gap": 0.082, "motor_share": 0.12, "friction_share": 0.62, "tooth_frequency": 58.0,
        "tooth_damping": 0.25,
    }  # fmt: skip
    time = np.arange(5000) * 0.002
    duty = 60.0 * np.sin(2.0 * np.pi * (0.1 + 0.395 * time) * time)
    blank = Recording("rattles", time, duty, np.zeros(len(time)), "%", "rad", COUNT)
    case = prepared_recording.prepare_recording(blank, structure)
    read = kernel.predict(case.drive, kernel.vector(structure, values), kernel.start_state(0.0, 0.0, 0.0)).reading
    noise = COUNT * np.random.default_rng(3).uniform(-0.5, 0.5, len(time))
    case = prepared_recording.prepare_recording(replace(blank, output=read + noise), structure)
    return case, values, filter_memory.process_noise_of(case, 0.1)


def test_slopes_that_have_run_away_do_not_hold_a_climb() -> None:
    """They promise so much of a step that none is tried which is long enough for what all others say."""
    case, values, process_noise = rattling()
    structure, off = STRUCTURE.with_("tooth_compliance"), ("input_gain", "dead_band_forward", "backlash_gap")
    begun = {n: 1.02 * v if n in off else v for n, v in values.items()}
    reached = optimizer.levenberg_marquardt(
        FitProblem([case], process_noise=process_noise), structure, begun, tuple(values)
    )
    assert abs(reached.values["input_gain"] / values["input_gain"] - 1.0) < 0.01


def test_only_slopes_of_rattle_count_as_run_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where teeth stay in mesh for longer than a bounce, all of them say something, with any memory of the filter."""
    calm, (rough, values, process_noise) = made(), rattling()
    known = [filter_memory.process_noise_of(calm, memory) for memory in (0.01, 0.03, 0.1, 0.5)]
    kept = [likelihood.innovations(calm, STRUCTURE, VALUES, d, FREE).slopes for d in known]
    bounded = likelihood.innovations(
        rough, STRUCTURE.with_("tooth_compliance"), values, process_noise, tuple(values)
    ).slopes
    limit = likelihood.MAX_SLOPE_RATIO * 60.0 * 0.102**2
    monkeypatch.setattr(likelihood, "MAX_SLOPE_RATIO", math.inf)
    for d, slopes in zip(known, kept, strict=True):
        np.testing.assert_array_equal(slopes, likelihood.innovations(calm, STRUCTURE, VALUES, d, FREE).slopes)
    grown = likelihood.innovations(
        rough, STRUCTURE.with_("tooth_compliance"), values, process_noise, tuple(values)
    ).slopes
    away = np.abs(grown[:, 0]) > limit
    assert 0.05 < away.mean() < 0.5 and float(np.abs(grown[:, 0]).max()) > 100.0 * limit
    assert not bounded[away].any()
    np.testing.assert_array_equal(bounded[~away], grown[~away])


@pytest.mark.parametrize("away", [0.4, 3.0])
def test_what_rounding_takes_from_a_resting_axis_is_no_error(away: float) -> None:
    """A stiff spring holds the model so many counts away from a reading that says the same again and again."""
    structure = Structure.of(["inertia", "viscous_friction", "spring"])
    values = {"input_gain": 0.3, "viscous_friction": 2.0, "spring_stiffness": 1e4, "spring_rest": away * COUNT}
    time = 0.002 * np.arange(1000)
    rests = Recording("rests", time, np.zeros(1000), np.zeros(1000), "%", "rad", COUNT)
    moves = replace(rests, output=COUNT * np.round(time / 0.4))
    late = time > 1.0  # once it swings no more
    case = prepared_recording.prepare_recording(rests, structure)
    run = likelihood.innovations(case, structure, values, filter_memory.process_noise_of(case, 0.1), tuple(values))
    assert case.resting.all() and not prepared_recording.prepare_recording(moves, structure).resting.any()
    beyond = max(away - 0.5, 0.0) * COUNT
    assert np.allclose(run.error[late], -beyond, atol=0.05 * COUNT)
    assert np.any(run.slopes[late] != 0.0) == (beyond > 0.0)


def test_what_happened_in_a_silence_bends_no_estimate() -> None:
    """Ten seconds are not read, in which the axis was driven otherwise than was recorded."""
    whole = made()
    time, duty = whole.drive.time, whole.drive.command
    silent = (time > 10.0) & (time < 20.0)
    otherwise = np.where(silent, 1.05 * duty, duty)
    x = kernel.start_state(0.0, 0.0, 0.0)
    moved = kernel.predict(replace(whole.drive, command=otherwise), kernel.vector(STRUCTURE, VALUES), x).reading
    read = np.where(silent, np.nan, moved + COUNT * np.random.default_rng(2).uniform(-0.5, 0.5, len(time)))
    recording = replace(whole.recording, output=read)
    case = prepared_recording.prepare_recording(recording, STRUCTURE)
    start = {**VALUES, "input_gain": 0.31, "viscous_friction": 2.1}
    point = optimizer.levenberg_marquardt(
        FitProblem([case], process_noise=filter_memory.process_noise_of(case, 0.2)), STRUCTURE, start, FREE
    )
    away = [point.values[n] - VALUES[n] for n in FREE] / np.sqrt(
        np.diag(likelihood.jackknife_covariance(FitProblem([case]), point))
    )
    assert np.all(np.abs(away) < 4.0) and point.overdispersion < 2.0
    apart = kernel.predict(case.drive, kernel.vector(STRUCTURE, VALUES), x).reading - moved
    assert np.abs(apart[time > 20.0]).min() > 100.0 * COUNT


def test_values_so_wild_that_the_model_overflows_are_refused_without_a_word() -> None:
    case = made(duration=5.0)
    wild = [VALUES | {"input_gain": gain} for gain in (1e160, 1e300)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # in every thread: an array's overflow would be raised
        assert likelihood.deviances(FitProblem([case], process_noise=1.0), STRUCTURE, wild) == [math.inf, math.inf]
        assert likelihood.evaluate(FitProblem([case], process_noise=1.0), STRUCTURE, wild[0], FREE).deviance == math.inf
        assert (
            "cannot run"
            in optimizer.levenberg_marquardt(FitProblem([case], process_noise=1.0), STRUCTURE, wild[0], FREE).message
        )
        untraced = Fit(STRUCTURE, VALUES, 1.0, FREE[:2], 0.0, 1.0, np.diag([4.0, 0.0]), np.zeros(2), np.eye(2))
        assert np.array_equal(untraced.covariance, [[0.25, 0.0], [0.0, math.inf]]) and untraced.overdispersion == 1.0


def test_a_model_that_no_command_moves_is_refused() -> None:
    """Far from the truth it would be the likeliest: a slow axis is followed best by a filter that expects nothing."""
    case = made(duration=5.0)
    wide = {**VALUES, "dead_band_forward": 90.0, "dead_band_reverse": 90.0}
    assert likelihood.evaluate(FitProblem([case], process_noise=1.0), STRUCTURE, wide).deviance == np.inf
    assert np.isfinite(
        likelihood.evaluate(
            FitProblem([case], process_noise=1.0), STRUCTURE, {**wide, "dead_band_reverse": 50.0}
        ).deviance
    )


@pytest.mark.parametrize("stop", ["stop_lower", "stop_upper"])
def test_a_stop_far_on_the_wrong_side_of_all_readings_is_refused(stop: str) -> None:
    """The link would be pressed as deep as no stop gives way, in steps as short as that stiffness asks for."""
    case, structure = made(duration=5.0), STRUCTURE.with_("end_stop")
    stiff = {**VALUES, **NOWHERE, "stop_stiffness": 5e4, "stop_damping": 0.0, "stop_hysteresis": 0.0}
    least, most = case.reading_range
    met, wrong = {
        "stop_lower": (least + 0.1 * case.reading_span, most + 1.1 * case.reading_span),
        "stop_upper": (most - 0.1 * case.reading_span, least - 1.1 * case.reading_span),
    }[stop]
    for place in (NOWHERE[stop], met):
        assert np.isfinite(
            likelihood.evaluate(FitProblem([case], process_noise=1.0), structure, {**stiff, stop: place}).deviance
        )
    assert (
        likelihood.evaluate(FitProblem([case], process_noise=1.0), structure, {**stiff, stop: wrong}).deviance == np.inf
    )


SOUND = {
    "input_gain": 0.3, "viscous_friction": 3.0, "dead_band_forward": 5.0, "dead_band_reverse": 6.0,
    "backlash_gap": 0.03, "motor_share": 0.3, "friction_share": 0.6, "tooth_frequency": 90.0, "tooth_damping": 0.4,
}  # fmt: skip
LOOSE = {
    "viscous_friction": 0.6, "backlash_gap": 0.06, "motor_share": 0.12, "friction_share": 0.4,
    "tooth_frequency": 150.0, "tooth_damping": 0.08,
}  # fmt: skip
#: Teeth at the bounds: damped so hard that a step of the usual length would overshoot.
HARD = {"tooth_frequency": 300.0, "tooth_damping": 2.0, "motor_share": 0.05}


@pytest.mark.parametrize(
    ("values", "hold", "rough"), [(SOUND, 250, False), (SOUND | HARD, 250, False), (SOUND | LOOSE, 50, True)]
)
def test_a_motor_that_rattles_makes_the_likelihood_rough_and_the_errors_wide(
    values: dict[str, float], hold: int, rough: bool
) -> None:
    structure, count = preparation.base_structure(), 6e-4
    time, duty = 0.002 * np.arange(6000), steps(np.random.default_rng(1), 6000, hold, 40.0)
    read = count * np.round(run(structure, values, time, duty)[0] / count)
    recording = Recording("made", time, duty, read, "%", "rad", count)
    cases = [prepared_recording.prepare_recording(recording, structure)]
    process_noise = filter_memory.process_noise_of(cases[0], 0.1)
    point = optimizer.levenberg_marquardt(
        FitProblem(cases, process_noise=process_noise), structure, values, free_parameters(structure)
    )
    found = maximum_likelihood.roughness(FitProblem(cases), point)
    assert found > 100.0 if rough else found < 1.0
    model = maximum_likelihood.to_model(FitProblem(cases), point, [recording])
    least = point.covariance if rough else likelihood.jackknife_covariance(FitProblem(cases), point)
    wider = np.sqrt(np.diag(model.covariance) / np.diag(least))
    assert np.all(wider > 10.0) if rough else np.all(wider < 1.2)
    # What bounces have made of the slopes must not pass for knowledge.
    size = np.array([values[n] for n in model.fitted])
    assert np.all(np.sqrt(np.diag(model.covariance)) > 1e-5 * size)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.9), st.floats(1.0, 6.0))
def test_the_scale_is_where_hubers_losses_balance(seed: int, wild: float, limit: float) -> None:
    """Held against a bracketing root finder on the equation, and the loss against scipy's."""
    rng = np.random.default_rng(seed)
    squares = rng.standard_normal(400) ** 2 * np.where(rng.uniform(size=400) < wild, 10.0 ** rng.uniform(0, 8), 1.0)
    scale, loss = kernel.compiled().scaling(squares, limit)

    def short(s: float) -> float:
        return float(np.mean(np.minimum(squares, limit * np.sqrt(s * squares)))) / s - 1.0

    assert scale == pytest.approx(brentq(short, 1e-12, 2.0 * squares.mean(), xtol=1e-300, rtol=1e-13), rel=1e-9)
    assert loss == pytest.approx(2.0 * float(huber(limit, np.sqrt(squares / scale)).sum()), rel=1e-9)


def test_what_is_not_finite_has_no_scale_and_what_is_nothing_a_small_one() -> None:
    scaling = kernel.compiled().scaling
    assert scaling(np.array([1.0, np.nan, 2.0]), 4.0) == (np.inf, np.inf)
    assert scaling(np.array([1.0, np.inf]), 4.0) == (np.inf, np.inf)
    assert scaling(np.zeros(3), 4.0) == (1e-30, 0.0)


def test_errors_are_judged_where_something_was_read_and_beyond_what_rounding_takes() -> None:
    measured = np.array([1.0, 1.0, np.nan, 1.0, 1.0, 1.0])
    left_out, rounding = np.array([False, False, False, True, False, False]), np.array([0.0, 0.3, 0.3, 0.3, 0.3, 0.1])
    error, variance = np.array([0.5, 0.5, 0.5, 0.5, 0.8, 1.4]), np.arange(1.0, 7.0)
    kernel.compiled().judging(measured, left_out, rounding, 2.0, error, variance)
    np.testing.assert_allclose(error, [0.5, 0.2, np.nan, np.nan, 0.0, -0.3])
    np.testing.assert_array_equal(variance, 2.0 * np.arange(1.0, 7.0))
    squares = np.empty(6)
    count, logs = kernel.compiled().normalising(error, variance, squares)
    np.testing.assert_allclose(squares[:count], [0.25 / 2, 0.04 / 4, 0.0, 0.09 / 12])
    assert logs == pytest.approx(math.log(2 * 4 * 10 * 12))


@settings(max_examples=20, deadline=None)
@given(dry=st.floats(0.0, 2.0), beyond=st.floats(0.0, 2.0), side=st.sampled_from([-1.0, 1.0]))
def test_friction_that_would_push_is_none(dry: float, beyond: float, side: float) -> None:
    """Beyond friction in one direction alone nothing changes but the numbers, and they go no further."""
    structure = Structure.of(["inertia", "viscous_friction", "dead_band", "friction_asymmetry"])
    values = {n: VALUES[n] for n in ("input_gain", "viscous_friction", "dead_band_forward", "dead_band_reverse")}
    values |= {"coulomb_friction": dry, "friction_asymmetry": side * (dry + beyond)}
    time = 0.002 * np.arange(2000)
    command = steps(np.random.default_rng(8), len(time), 150, 40.0)
    there, _ = run(structure, values, time, command)
    within = optimizer._with_resisting_friction(values, tuple(values))
    here, _ = run(structure, within, time, command)
    assert here == pytest.approx(there, abs=1e-9)
    assert abs(within["friction_asymmetry"]) <= within["coulomb_friction"] + 1e-12
    known = optimizer._with_resisting_friction(values, ("friction_asymmetry",))
    assert known["coulomb_friction"] == dry == pytest.approx(abs(known["friction_asymmetry"]))


def test_friction_in_one_direction_alone_has_a_size_that_is_known() -> None:
    structure = Structure.of(["inertia", "viscous_friction", "dead_band", "friction_asymmetry"])
    values = {n: VALUES[n] for n in ("input_gain", "viscous_friction", "dead_band_forward", "dead_band_reverse")}
    values |= {"coulomb_friction": 1.0, "friction_asymmetry": -1.0}
    rng = np.random.default_rng(9)
    time = 0.002 * np.arange(10000)
    command = np.where(np.arange(len(time)) % 400 < 100, 0.0, steps(rng, len(time), 200, 40.0))
    y, _ = run(structure, values, time, command + 0.3 * rng.standard_normal(len(time)))
    recording = Recording("made", time, command, np.round(y / COUNT) * COUNT, "%", "rad", COUNT)
    case = prepared_recording.prepare_recording(recording, structure)
    begun = {**values, "coulomb_friction": 0.4, "friction_asymmetry": -1.5}
    found = optimizer.levenberg_marquardt(
        FitProblem([case], process_noise=filter_memory.process_noise_of(case, 0.1)), structure, begun, tuple(values)
    )
    lean = found.free.index("friction_asymmetry")
    assert found.values["friction_asymmetry"] == pytest.approx(-1.0, abs=0.1)
    assert found.robust_covariance[lean, lean] ** 0.5 < 0.1


def test_a_gap_of_nothing_has_an_interval_too() -> None:
    """Its ridge goes with powers of the gap, which has none at zero."""
    case = made(duration=6.0)
    problem = FitProblem([case], process_noise=filter_memory.process_noise_of(case, 0.2))
    point = likelihood.evaluate(problem, STRUCTURE, {**VALUES, "backlash_gap": 0.0}, FREE)
    low, high = likelihood_profile.profile_interval(problem, point, "backlash_gap", 0.01, {"motor_share": -1.0})
    assert low == 0.0 < high < math.inf


def test_what_is_not_finite_is_not_known() -> None:
    a, b = np.array([[1.0, np.nan], [np.nan, 2.0]]), np.array([1.0, 2.0])
    assert np.all(np.isinf(numerics.least_squares_solution(a, b)))
    found = numerics.without_what_is_lost(np.array([[1.0, np.nan], [np.nan, np.inf]]))
    assert found.tolist() == [[1.0, 0.0], [0.0, math.inf]]


def test_an_estimate_without_a_stretch_keeps_to_the_bounds() -> None:
    """A share that one stretch alone determines moves within its bounds, and takes no other parameter further."""
    a = np.array([[1.0, 0.999999], [0.999999, 1.0]])  # all but the sum of the two is lost
    b = np.array([0.0, 1e-3])
    wide = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
    np.testing.assert_allclose(numerics.bounded_solution(a, b, wide), np.linalg.solve(a, b), rtol=1e-6)
    narrow = np.array([[-np.inf, -0.2], [np.inf, 0.8]])
    free, share = numerics.bounded_solution(a, b, narrow)
    assert share == 0.8
    assert free == pytest.approx(b[0] - 0.999999 * 0.8)
