"""What to record next: planted rivals told apart, limits kept, and predictions held against what then happens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.diagnosis import experiment_design
from twin.diagnosis.experiment_design import Limits, design_for_discrimination, design_for_precision, library
from twin.effects import knots
from twin.errors import BadInput
from twin.estimation import filter_memory, likelihood, optimizer, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording
from twin.model.stepper import BASE, Structure
from twin.simulation import kernel

COUNT = 2.0 * np.pi / 10000
NOISE = 0.05  # torque, rad/s^2/sqrt(Hz)
VALUES = {
    "input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 6.0,
    "backlash_gap": 0.02, "motor_share": 0.25, "friction_share": 0.6,
}  # fmt: skip
PLANTED = {
    "coulomb_friction": {"coulomb_friction": 0.8, "dry_share": 0.6},
    "quadratic_drag": {"quadratic_drag": 0.08},
    "motor_lag": {"lag_time": 0.008},
    "input_delay": {"delay": 0.008},
}


def structure_of(*effects: str) -> Structure:
    return Structure.of([*BASE, *effects])


def values_of(*effects: str) -> dict[str, float]:
    return {**VALUES, **{k: v for e in effects for k, v in PLANTED[e].items()}}


def played(
    effects: tuple[str, ...], time: np.ndarray, command: np.ndarray, seed: int = 0, noise: float = NOISE
) -> Recording:
    """What the rig with these effects answers: noise enters as torque, readings are counts."""
    structure, values = structure_of(*effects), values_of(*effects)
    blank = Recording("played", time, command, np.zeros(len(time)), "%", "rad", resolution=COUNT)
    step = float(time[1] - time[0])
    shaking = np.random.default_rng(seed).standard_normal(len(time)) * noise / np.sqrt(step) / VALUES["input_gain"]
    drive = replace(
        prepared_recording.prepare_recording(blank, structure).drive,
        command=command + np.where(command != 0.0, shaking, 0.0),
    )
    output = kernel.predict(drive, kernel.vector(structure, values), kernel.start_state(0.0, 0.0, 0.0)).reading
    return replace(blank, output=np.round(output / COUNT) * COUNT)


def steps(
    duration: float = 8.0, levels: tuple[float, ...] = (30.0, -30.0, 15.0, -15.0)
) -> tuple[np.ndarray, np.ndarray]:
    time = np.round(np.arange(round(duration / 0.002)) * 0.002, 9)
    index = np.minimum((time / duration * len(levels)).astype(int), len(levels) - 1)
    return time, np.array(levels)[index]


STARTS = ((0.02, 0.25), (0.025, 0.2), (0.014, 0.35))
DENSITY = NOISE**2 / (COUNT**2 / 12.0)


def fitted(recordings: list[Recording], *effects: str) -> tuple[Fit, list[PreparedRecording]]:
    """Maximum likelihood at the noise density that was planted, the best of a few starts: gap crossings are kinks."""
    structure = structure_of(*effects)
    cases = [prepared_recording.prepare_recording(r, structure) for r in recordings]
    free = free_parameters(structure)
    starts = [{**values_of(*effects), "backlash_gap": gap, "motor_share": m} for gap, m in STARTS]
    points = [
        optimizer.levenberg_marquardt(FitProblem(cases, process_noise=DENSITY), structure, v, free) for v in starts
    ]
    return min(points, key=lambda p: p.deviance), cases


PAIRS = [("coulomb_friction", "quadratic_drag"), ("motor_lag", "input_delay")]


def gains(pair: tuple[str, str], truth: int, seed: int) -> tuple[float, float]:
    """Log-likelihood that the truth gains with the designed input, and per as many seconds of the first one again."""
    first = played((pair[truth],), *steps(), seed=seed)
    rivals = [fitted([first], effect)[0] for effect in pair]
    designed = design_for_discrimination(rivals, [prepared_recording.prepare_recording(first, rivals[0].structure)])
    assert len(designed.time)

    def gained(second: Recording) -> float:
        both = [fitted([first, second], effect)[0] for effect in pair]
        return 0.5 * (both[1 - truth].deviance - both[truth].deviance - before)

    before = rivals[1 - truth].deviance - rivals[truth].deviance
    once = gained(played((pair[truth],), designed.time, designed.input, seed=seed + 100))
    again = gained(played((pair[truth],), *steps(), seed=seed + 100))
    return once, again * float(designed.time[-1]) / 8.0


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_the_designed_input_tells_rivals_apart_whichever_is_true(pair):
    """It is made for the truth under which the two are harder to tell apart; over four noises, since each has luck."""
    once, again = np.mean([np.min([gains(pair, t, seed) for t in (0, 1)], axis=0) for seed in range(4)], axis=0)
    assert once > experiment_design.NEEDED_LOG_LIKELIHOOD
    assert once > 1.5 * again


def test_what_a_rival_has_but_does_not_use_does_not_make_it_another_truth():
    """Where drag is true the other's dry friction ends at zero: that rig drag explains, too, and no input can tell."""
    point, _ = fitted([played(("quadratic_drag",), *steps())], "quadratic_drag")
    other, _ = fitted([played((), *steps())], "coulomb_friction")
    idle = replace(other, values={**other.values, "coulomb_friction": 0.0})
    busy = replace(other, values={**other.values, "coulomb_friction": 0.8})
    assert [p.truth for p in experiment_design._rival_pairs([point, idle])] == [point]
    assert [p.truth for p in experiment_design._rival_pairs([point, busy])] == [point, busy]


def test_rivals_that_add_only_what_does_nothing_leave_the_question_what_is_known_worst():
    point, cases = fitted([played((), *steps())])
    other, _ = fitted([played((), *steps())], "coulomb_friction")
    idle = replace(other, values={**point.values, **other.values, "coulomb_friction": 0.0})
    assert experiment_design._rival_pairs([point, idle]) == []
    assert design_for_discrimination([point, idle], cases).why == design_for_precision(point, cases).why != ""


def test_a_smaller_model_within_a_larger_one_is_asked_one_way_only():
    first = played(("coulomb_friction",), *steps())
    small, cases = fitted([first])
    large, _ = fitted([first], "coulomb_friction")
    (pair,) = experiment_design._rival_pairs([small, large])
    assert pair.truth is large and pair.rival is small
    designed = design_for_discrimination([small, large], cases)
    assert "whether there is dry (Coulomb) friction" in designed.why
    assert len(designed.time)


def test_equal_models_are_not_told_apart():
    point, cases = fitted([played((), *steps())])
    designed = design_for_discrimination([point, point], cases)
    assert len(designed.time) == 0 and designed.why.startswith("No input")


@pytest.fixture(scope="module")
def lag_or_delay() -> tuple[list[Fit], list[PreparedRecording]]:
    first = played(("motor_lag",), *steps())
    rivals = [fitted([first], effect)[0] for effect in ("motor_lag", "input_delay")]
    return rivals, [prepared_recording.prepare_recording(first, rivals[0].structure)]


def test_the_input_keeps_to_what_was_recorded(lag_or_delay):
    rivals, cases = lag_or_delay
    designed = design_for_discrimination(rivals, cases)
    assert np.abs(designed.input).max() <= 30.0
    assert designed.input[-1] == 0.0
    assert np.allclose(np.diff(designed.time), 0.002) and designed.time[0] == 0.0


def test_given_limits_are_kept(lag_or_delay):
    rivals, cases = lag_or_delay
    limits = Limits(input=20.0, duration=3.0, travel=0.5, sample_time=0.005)
    designed = design_for_discrimination(rivals, cases, limits)
    assert len(designed.time) and designed.time[-1] <= 3.0
    assert np.abs(designed.input).max() <= 20.0
    assert np.allclose(np.diff(designed.time), 0.005)
    # Played on the rig without its noise and left alone for two seconds, it stays within the travel.
    rest = np.round(designed.time[-1] + 0.005 * np.arange(1, 400), 9)
    time = np.concatenate([designed.time, rest])
    command = np.concatenate([designed.input, np.zeros(len(rest))])
    travelled = played(("motor_lag",), time, command, noise=0.0).output
    assert 0.05 < np.abs(travelled).max() <= 0.5


def test_a_verdict_out_of_reach_is_said_to_be(lag_or_delay):
    rivals, cases = lag_or_delay
    noisy = [replace(r, scale=r.scale * 3e3) for r in rivals]
    designed = design_for_discrimination(noisy, cases, Limits(duration=1.0))
    assert "No input" in designed.why or "only" in designed.why


def test_the_input_scales_with_its_unit(lag_or_delay):
    """Volts instead of percent: the same experiment, in volts."""
    rivals, cases = lag_or_delay
    factor = 0.1

    def in_volts(point: Fit) -> Fit:
        scale = {n: factor if n.startswith("dead_band") else 1.0 / factor if n == "input_gain" else 1.0
                 for n in point.values}  # fmt: skip
        size = np.array([scale[n] for n in point.free])
        values = {n: v * scale[n] for n, v in point.values.items()}
        both = np.outer(size, size)
        return replace(point, values=values, information=point.information / both, scatter=point.scatter / both)

    recording = replace(cases[0].recording, input=cases[0].recording.input * factor, input_unit="V")
    volts = design_for_discrimination(
        [in_volts(r) for r in rivals], [prepared_recording.prepare_recording(recording, rivals[0].structure)]
    )
    duty = design_for_discrimination(rivals, cases)
    assert volts.why == duty.why
    assert np.allclose(volts.input, duty.input * factor, atol=1e-3)


def test_a_missing_reversal_is_asked_for_and_does_what_was_promised():
    """Driven one way only, a rig does not show its gap; the designed input fixes it as well as it said."""
    first = played((), *steps(6.0, (20.0, 30.0, 0.0, 25.0)))
    structure = structure_of()
    case = prepared_recording.prepare_recording(first, structure)
    free = free_parameters(structure)
    point = likelihood.evaluate(FitProblem([case], process_noise=DENSITY), structure, VALUES, free)
    designed = design_for_precision(point, [case], Limits(input=40.0, travel=np.inf))
    assert len(designed.time) and designed.input.min() < -10.0
    second = prepared_recording.prepare_recording(played((), designed.time, designed.input, seed=2), structure)
    after = likelihood.evaluate(FitProblem([case, second], process_noise=DENSITY), structure, VALUES, free)
    sizes = np.array([VALUES[n] for n in free])
    relative = np.sqrt(np.diag(after.covariance)) / sizes
    before = np.sqrt(np.diag(point.covariance)) / sizes
    assert before.max() > 1.0
    assert relative.max() < 3.0 * experiment_design._KNOWN_ERROR


def test_a_knot_that_is_known_worst_says_where_it_lies():
    """Its number alone leaves the reader to add up twelve widths."""
    at = np.array([-30.0, -20.0, -12.0, -6.0, -3.0, -1.0, 1.0, 3.0, 6.0, 12.0, 20.0, 30.0])
    structure, name = structure_of("unknown_velocity"), "unknown_velocity_10"
    values = {**VALUES, **knots.through("unknown_velocity", at, 0.01 * np.abs(at) * at)}
    # At this duty the axis comes to some 4 rad/s: not near the tenth knot.
    case = prepared_recording.prepare_recording(played((), *steps()), structure)
    point = likelihood.evaluate(
        FitProblem([case], process_noise=DENSITY), structure, values, (*free_parameters(structure_of()), name)
    )
    assert (
        "unknown_velocity_10 (value at knot 10 of 12, at 12 rad/s)" in design_for_precision(point, [case], Limits()).why
    )


def rested(point: Fit, case: PreparedRecording, signal: experiment_design.Signal) -> np.ndarray:
    bench = experiment_design._rig_limits([point], [case], Limits(input=40.0, travel=np.inf))
    (pair,) = (experiment_design._Pair(point, point, point.values),)
    trial = experiment_design._simulate_signal(bench, signal, [pair])
    assert trial is not None
    return trial.seen[0].error_inflation


def test_readings_count_for_less_where_the_motor_rattles_in_its_gap():
    """Noise and an unknown start grow from bounce to bounce; driven one way, the gears stay in mesh."""
    structure = structure_of().with_("tooth_compliance")
    case = prepared_recording.prepare_recording(played((), *steps()), structure)
    values = {**VALUES, "tooth_frequency": 100.0, "tooth_damping": 0.15}
    point = likelihood.evaluate(
        FitProblem([case], process_noise=DENSITY), structure, values, free_parameters(structure)
    )
    steady = rested(point, case, ((4.0, 30.0, 30.0),))
    rattle = rested(point, case, tuple((0.06, level, level) for level in (30.0, -30.0) * 33))
    assert np.mean(steady[500:]) < 1.5
    assert np.mean(rattle) > 3.0 * np.mean(steady)


def test_stiff_teeth_do_not_ring_up_in_the_design():
    """Twice the internal step of a fit had made teeth of 300 Hz unstable, and every block promised 1e50."""
    structure = structure_of().with_("tooth_compliance")
    case = prepared_recording.prepare_recording(played((), *steps()), structure)
    values = {**VALUES, "tooth_frequency": 299.0, "tooth_damping": 0.46}
    point = likelihood.evaluate(
        FitProblem([case], process_noise=DENSITY), structure, values, free_parameters(structure)
    )
    designed = design_for_precision(point, [case])
    assert len(designed.time) and len(designed.about) == 1
    bench = experiment_design._rig_limits([point], [case], Limits())
    pair = experiment_design._Pair(point, point, point.values)
    found = [np.diag(t.whole[0].information) for t in experiment_design._feasible_blocks(bench, [pair])]
    assert np.max(found) < 1e6 * np.max(np.diag(point.information))


def test_rigs_that_log_speed_get_an_experiment_too():
    structure = structure_of("coulomb_friction")
    time, command = steps()
    truth = played(("coulomb_friction",), time, command)
    speed = replace(truth, output=np.gradient(truth.output, time), output_unit="rad/s", resolution=0.0)
    case = prepared_recording.prepare_recording(speed, structure)
    free = free_parameters(structure)
    process_noise = filter_memory.process_noise_of(case, 0.1)
    point = likelihood.evaluate(
        FitProblem([case], process_noise=process_noise), structure, values_of("coulomb_friction"), free
    )
    designed = design_for_discrimination([point], [case])
    assert len(designed.time) and "standard error" in designed.why


def test_what_leaves_no_room_is_refused(lag_or_delay):
    rivals, cases = lag_or_delay
    with pytest.raises(BadInput, match="duration"):
        design_for_discrimination(rivals, cases, Limits(duration=-1.0))
    idle = replace(cases[0].recording, input=np.zeros(len(cases[0].recording.time)))
    with pytest.raises(BadInput, match="zero throughout"):
        design_for_discrimination(rivals, [prepared_recording.prepare_recording(idle, rivals[0].structure)])
    with pytest.raises(BadInput, match="at least one"):
        design_for_discrimination([], cases)


# ---- laws ----


@given(st.integers(0, 10_000), st.integers(1, 6))
@settings(max_examples=50, deadline=None)
def test_divergence_is_what_least_squares_leaves(seed, n):
    """Against the stacked problem solved by an orthogonal factorisation."""
    rng = np.random.default_rng(seed)
    slopes, z = rng.standard_normal((40, n)), rng.standard_normal(40)
    root = rng.standard_normal((n, n))
    new = experiment_design._Evidence(float(z @ z), slopes.T @ z, slopes.T @ slopes)
    known = experiment_design._Evidence(0.0, np.zeros(n), root.T @ root)
    stacked, target = np.vstack([slopes, root]), np.concatenate([z, np.zeros(n)])
    rest = target - stacked @ np.linalg.lstsq(stacked, target, rcond=None)[0]
    assert (known + new).divergence == pytest.approx(0.5 * rest @ rest, rel=1e-5)


@given(st.floats(0.0, 10.0), st.floats(11.0, 100.0), st.floats(0.1, 2.0), st.floats(0.01, 5.0))
@settings(max_examples=50, deadline=None)
def test_blocks_keep_to_the_range_and_end_at_rest(lost, most, pace, turn):
    for name, signal in library(lost, most, pace, turn).items():
        assert all(length > 0.0 and max(abs(a), abs(b)) <= most * (1 + 1e-9) for length, a, b in signal), name
        assert signal[-1][2] == 0.0, name


@given(st.floats(0.05, 5.0))
@settings(max_examples=50, deadline=None)
def test_a_cut_signal_is_the_beginning_of_the_whole(end):
    signal = experiment_design._on_grid(library(5.0, 60.0, 0.5, 1.0)["slow triangle"], 0.004)
    end = round(end / 0.004) * 0.004
    cut = experiment_design._cut_signal(signal, end)
    _, whole = experiment_design._sampled(signal, 0.004, -100.0, 100.0)
    _, part = experiment_design._sampled(cut, 0.004, -100.0, 100.0)
    assert experiment_design._length(cut) == pytest.approx(min(end, experiment_design._length(signal)))
    assert np.allclose(part[:-1], whole[: len(part) - 1], atol=0.011)


def test_errors_are_the_inverse_and_stay_numbers_where_nothing_tells_two_parameters_apart():
    rng = np.random.default_rng(2)
    seen = rng.standard_normal((40, 4))
    known = np.sqrt(np.diag(np.linalg.inv(seen.T @ seen + np.eye(4) / experiment_design._UNKNOWN_ERROR**2)))
    assert experiment_design._relative_errors(seen.T @ seen) == pytest.approx(known)
    for _ in range(50):
        seen = 1e8 * rng.standard_normal((40, 4))
        seen[:, 3] = seen[:, 2]
        found = experiment_design._relative_errors(seen.T @ seen)
        assert found[2:] == pytest.approx(experiment_design._UNKNOWN_ERROR / np.sqrt(2.0), rel=1e-6)
        assert np.all(found[:2] < 1e-6)
