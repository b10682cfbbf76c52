"""What is left in the missing torque, and the shape that is drawn for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from axis_runs import run, steps
from scipy.interpolate import CubicHermiteSpline

from twin.diagnosis import (
    cross_validation,
    data_split,
    diagnose,
    free_curves,
    handed_out,
    holdout,
    model_comparison,
    name_tests,
    nonparametric,
    residual_torque,
    screening,
    selection_round,
    thresholds,
)
from twin.diagnosis.adequacy import Adequacy
from twin.diagnosis.nonparametric import CurveTerm
from twin.diagnosis.plausibility import is_plausible
from twin.diagnosis.search_result import Alternative, SearchResult
from twin.effects.catalogue import CANDIDATES, UNKNOWN
from twin.effects.knots import KNOTS, held, line, names, spots, through
from twin.estimation import (
    contact_masking,
    filter_memory,
    local_optima,
    maximum_likelihood,
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

STRUCTURE = Structure.of(("inertia", "viscous_friction", "dead_band"))
FREE = ("input_gain", "viscous_friction", "dead_band_forward", "dead_band_reverse")
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
COUNT = 6.283185307179586 / 16384
SAMPLES = 15000


def recorded(seed: int, missing: tuple[str, ...] = (), noise: float = 0.3, **values: float) -> PreparedRecording:
    """A counted recording of 30 s with white torque noise, made with the kernel and given to it without `missing`."""
    rng = np.random.default_rng(seed)
    time = 0.002 * np.arange(SAMPLES)
    command = steps(rng, SAMPLES, 300, 40.0)
    shaken = command + noise * rng.standard_normal(SAMPLES)
    truth = STRUCTURE.with_(*missing)
    y, _ = run(truth, VALUES | values, time, shaken)
    recording = Recording(
        name="made", time=time, input=command, output=np.round(y / COUNT) * COUNT, input_unit="%", output_unit="rad",
        resolution=COUNT,
    )  # fmt: skip
    return prepared_recording.prepare_recording(recording, STRUCTURE)


@cache
def fitted(case_key: str) -> tuple[PreparedRecording, Fit]:
    case = CASES[case_key]()
    return case, optimizer.fit_with_process_noise(FitProblem([case]), STRUCTURE, VALUES, FREE)


def with_curve(cases: list[PreparedRecording], base: Fit, term: CurveTerm) -> Fit:
    """The base and a term of no known shape, fitted together."""
    return nonparametric.fit_curve(FitProblem(cases), nonparametric.sketch_curve(FitProblem(cases), base, term))


def with_name(case: PreparedRecording, base: Fit, *names: str) -> Fit:
    """The base and effects, fitted together."""
    structure = STRUCTURE.with_(*names)
    mine, free = FitProblem([case]).stepped(structure), free_parameters(structure)
    return optimizer.levenberg_marquardt(
        FitProblem(mine, process_noise=base.process_noise),
        structure,
        preparation.complete_values(structure, base.values),
        free,
    )


def screened(case: PreparedRecording, base: Fit, effect: str) -> Fit:
    """The base and an effect, from where the screening begins with it."""
    problem = FitProblem([case])
    (found,) = selection_round.screen_candidates(problem, base, screening.trial_grids(problem, base, [effect]))
    return optimizer.levenberg_marquardt_from(problem, found.point, rounds=100, tolerance=0.01)


def hidden(case: PreparedRecording) -> PreparedRecording:
    """The case with its first second not judged."""
    return replace(case, contact_mask=case.drive.time < 1.0)


def bump(at: np.ndarray) -> np.ndarray:
    """A torque over position of a shape that no page has."""
    return 3.0 * np.exp(-(((at - 1.0) / 0.8) ** 2))


#: The planted line: the bump at twelve knots from -2 to 4 rad.
SPOTS = np.linspace(-2.0, 4.0, KNOTS)
PLANTED = through("unknown_position", SPOTS, bump(SPOTS))
#: A bump that lies between two of so many even knots.
NARROW = np.array([-6.0, -4.0, -2.0, -0.9, -0.66, -0.48, -0.3, -0.12, 0.06, 0.3, 2.0, 3.0])
SHARP = through("unknown_position", NARROW, 4.0 * np.exp(-(((NARROW + 0.3) / 0.3) ** 2)))
#: Grease that warms: viscous friction that falls from 3 to 2 per second with a time constant of 8 s.
TIMES = np.linspace(0.0, 30.0, KNOTS)
WARMING = through("unknown_drag", TIMES, np.exp(-TIMES / 8.0))
#: Drag that is felt around one speed only, either way.
SPEEDS = np.linspace(-8.0, 8.0, KNOTS)
HUMP = through("unknown_velocity", SPEEDS, 2.5 * np.sign(SPEEDS) * np.exp(-((np.abs(SPEEDS) - 4.0) ** 2)))
#: Friction that gives by three degrees before it slides.
BENT = {"presliding_friction": 1.0, "presliding_travel": 0.05}
#: A liquid that the walls of its vessel drag along, and a load that hangs from the link and swings twice a second.
LIQUID = {"flexible_load_share": 0.3, "flexible_load_stiffness": 0.0, "flexible_load_damping": 3.0}
HANGING = {"flexible_load_share": 0.3, "flexible_load_stiffness": 160.0, "flexible_load_damping": 1.0}
CASES = {
    "hump": lambda: recorded(10, ("unknown_velocity",), **HUMP),
    "humped": lambda: recorded(11, ("unknown_velocity", "coulomb_friction"), coulomb_friction=3.0, **HUMP),
    "warming": lambda: recorded(9, ("unknown_drag",), **WARMING),
    "bump": lambda: recorded(3, ("unknown_position",), **PLANTED),
    "sharp": lambda: recorded(3, ("unknown_position",), **SHARP),
    "drag": lambda: recorded(4, ("quadratic_drag",), quadratic_drag=0.1),
    "cogging": lambda: recorded(6, ("unknown_angle",), unknown_angle_order=7.0, unknown_angle_sin_1=1.5),
    "gain": lambda: recorded(7, ("unknown_gain",), unknown_gain_sin_1=0.2),
    "push": lambda: recorded(8, ("unknown_push",), unknown_push_order=3.0, unknown_push_forward_cos_1=4.0),
    "crank": lambda: recorded(14, ("unknown_inertia",), unknown_inertia_sin_1=0.2),
    "bend": lambda: recorded(12, ("presliding_friction",), **BENT),
    "liquid": lambda: recorded(15, ("flexible_load",), **LIQUID),
    "hanging": lambda: recorded(15, ("flexible_load",), **HANGING),
    "dry": lambda: recorded(13, ("coulomb_friction",), coulomb_friction=1.0),
    "nothing": lambda: recorded(5),
}


def test_shapes_without_a_name_are_no_candidates():
    assert not set(UNKNOWN) & set(CANDIDATES)
    assert {f"unknown_{v}" for v in nonparametric.TERM_KINDS} == set(UNKNOWN)


def drawn(values: dict[str, float], at: np.ndarray, prefix: str = "unknown_position") -> np.ndarray:
    """The line with these parameters."""
    return np.array([line(x, prefix, SimpleNamespace(**values)) for x in at])


def test_line_goes_through_its_knots_without_a_corner_and_straight_on_beyond():
    rng = np.random.default_rng(1)
    heights, places = rng.normal(size=KNOTS), -2.0 + np.cumsum(rng.uniform(0.1, 1.0, KNOTS))
    values, at = through("x", places, heights), np.linspace(-5.0, 8.0, 200)
    assert np.allclose(spots("x", values), places)
    # At a knot the slope of the parabola through three, which NumPy fits; at an end through the last three.
    three = [np.arange(i - 1, i + 2) for i in (1, *range(1, KNOTS - 1), KNOTS - 2)]
    lean = [np.polyval(np.polyder(np.polyfit(places[k], heights[k], 2)), x) for k, x in zip(three, places, strict=True)]
    inside = np.clip(at, places[0], places[-1])
    smooth = CubicHermiteSpline(places, heights, lean)(inside)
    chords = np.diff(heights) / np.diff(places)
    beyond = np.where(at < places[0], chords[0], chords[-1]) * (at - inside)
    assert np.allclose(drawn(values, at, "x"), smooth + beyond, atol=1e-9)
    level = [held(x, "x", SimpleNamespace(**values)) for x in at]
    assert np.allclose(level, smooth, atol=1e-9)
    assert np.allclose(nonparametric._knot_weights(at, places) @ heights, smooth, atol=1e-9)


def test_line_draws_a_parabola_as_it_is():
    places, at = np.arange(KNOTS) ** 1.3, np.linspace(0.0, (KNOTS - 1.0) ** 1.3, 300)
    assert np.allclose(drawn(through("x", places, places**2 - 3.0 * places), at, "x"), at**2 - 3.0 * at, atol=1e-9)


def test_knots_that_saw_nothing_lie_on_the_line_of_their_neighbours():
    at = np.arange(KNOTS) ** 1.5
    values, free = through("unknown_position", at, at**2), names("unknown_position")[2:-3]
    bridged = nonparametric._interpolate_unseen_knots(values, "unknown_position", free)
    assert [bridged[n] for n in free] == [values[n] for n in free]
    below, above = np.polyfit(at[2:4], at[2:4] ** 2, 1), np.polyfit(at[-5:-3], at[-5:-3] ** 2, 1)
    assert [bridged[n] for n in names("unknown_position")[:2]] == pytest.approx(np.polyval(below, at[:2]))
    assert [bridged[n] for n in names("unknown_position")[-3:]] == pytest.approx(np.polyval(above, at[-3:]))


def test_knots_lie_closer_where_a_curve_bends():
    fine = np.linspace(-3.0, 5.0, nonparametric.FINE_KNOTS)
    for alike in (np.zeros(nonparametric.FINE_KNOTS), 2.0 * fine**2 + fine):
        assert nonparametric._knot_positions(fine, alike) == pytest.approx(np.linspace(-3.0, 5.0, KNOTS), abs=1e-6)
    placed = nonparametric._knot_positions(fine, bump(fine))
    assert placed[0] == fine[0] and placed[-1] == pytest.approx(fine[-1]) and np.all(np.diff(placed) > 0.0)
    even, at = np.linspace(-3.0, 5.0, KNOTS), np.linspace(-3.0, 5.0, 500)
    misses = [np.std(drawn(through("unknown_position", k, bump(k)), at) - bump(at)) for k in (placed, even)]
    assert misses[0] < 0.5 * misses[1]


def test_null_predicts_nothing():
    case, point = fitted("nothing")
    found = nonparametric.remaining_dependence(case, point.structure, point.values)
    assert found.share < 0.05
    assert found.p_value > 1e-3
    assert not nonparametric.is_dependence_left(found)


def test_of_several_recordings_the_one_that_lacks_most_decides():
    clean, point = fitted("nothing")
    lacking, _ = fitted("bump")
    longer = replace(clean, drive=replace(clean.drive, time=1.0001 * clean.drive.time))
    for cases, telling in (((longer, lacking), lacking), ((clean, longer), longer)):
        found = SearchResult(point, point, (), FitProblem(cases))
        assert diagnose._worst_recording(found)[0] is telling


def late(*missing: str) -> Recording:
    """A recording in whose last third alone the axis comes to a stop, or the drive is asked for so much that it would
    saturate.
    """
    rng = np.random.default_rng(9)
    time = 0.002 * np.arange(SAMPLES)
    before = time < 0.7 * time[-1]
    command = np.where(before, 0.5, 1.0) * steps(rng, SAMPLES, 300, 40.0)
    shaken = command + 0.3 * rng.standard_normal(SAMPLES)
    y, _ = run(STRUCTURE, VALUES, time, shaken)
    stop = 0.5 * (y[before].min() + y.min())
    assert stop < y[before].min() - 1.0 and np.ptp(y) < 100.0
    more = {"saturation_limit": 24.0, "stop_upper": 100.0, "stop_lower": stop, "stop_stiffness": 2e4}
    truth = STRUCTURE.with_(*missing)
    y, _ = run(truth, {**VALUES, **{p.name: more[p.name] for p in truth.parameters if p.name in more}}, time, shaken)
    return Recording("made", time, command, np.round(y / COUNT) * COUNT, "%", "rad", COUNT)


@pytest.mark.parametrize("missing", [("drive_saturation",), ("end_stop",), ()])
def test_where_the_end_goes_where_nothing_before_was_the_middle_is_held_out(missing):
    whole = late(*missing)
    searched = diagnose._split_and_search([whole], STRUCTURE, {}, ["drive_saturation", "end_stop"], None)
    (train,), (held_out,), found = searched.train, searched.held_out, searched.found
    assert set(found.last.structure.ids) == {*STRUCTURE.ids, *missing}
    assert (held_out.begin, held_out.end) == pytest.approx((10.5, 19.5), abs=0.01)
    assert np.array_equal(np.isfinite(train.output), ~held_out.inside[: len(train.time)])
    assert len(train.time) + np.count_nonzero(held_out.inside[len(train.time) :]) == SAMPLES
    (says,) = searched.said
    assert says.startswith("The end goes where the rest never was: the command") and "the middle was held out" in says


@pytest.mark.parametrize("added", [1.0, 0.0])
def test_a_moment_that_lies_in_what_is_held_out_is_looked_for_in_blocks(added):
    """The end goes where nothing before was, so the middle is held out; and there the load changes, or nothing does."""
    rng = np.random.default_rng(9)
    time = 0.002 * np.arange(SAMPLES)
    command = np.where(time < 20.0, 0.5, 1.0) * steps(rng, SAMPLES, 300, 40.0)
    truth = STRUCTURE.with_("load_change")
    values = VALUES | {"load_added": added, "load_time": 15.0}
    y, _ = run(truth, values, time, command + 0.3 * rng.standard_normal(SAMPLES))
    recording = Recording("made", time, command, np.round(y / COUNT) * COUNT, "%", "rad", COUNT)
    searched = diagnose._split_and_search([recording], STRUCTURE, {}, ["load_change", "drive_saturation"], None)
    last = searched.found.last
    assert last.structure.named == (("load_change",) if added else ())
    assert len(searched.held_out) == (len(data_split.BLOCKS) if added else 1)
    assert any("so that no fit could see it" in said for said in searched.said) is bool(added)
    assert not added or last.values["load_time"] == pytest.approx(15.0, abs=0.05)


@pytest.mark.parametrize("where", [data_split.END_PART, data_split.MIDDLE_PART])
def test_held_out_part_of_a_true_model_is_met_by_its_free_run(where):
    """Whether it lies at the end or in the middle: the FMU starts there anew, from what was read ahead of it."""
    case, point = fitted("nothing")
    truth = maximum_likelihood.to_model(FitProblem([case]), replace(point, values=VALUES), [case.recording])
    train, held_out = data_split.split([case.recording], where)
    shown = holdout.traces(truth, truth, [("train", data_split.RecordingPart(train[0])), ("holdout", held_out[0])])
    assert [t.role for t in shown] == ["train", "holdout"]
    assert np.array_equal(shown[1].time, case.recording.time[held_out[0].inside])
    moved = np.ptp(case.recording.output)
    assert np.nanmax(np.abs(shown[1].after - shown[1].recorded)) < 0.02 * moved
    # What was fitted is run by the kernel, also where nothing is read of it: through the FMU it is the same.
    (again,) = holdout.traces(truth, truth, [("holdout", data_split.RecordingPart(train[0]))])
    assert len(shown[0].after) == len(train[0].time)
    assert np.abs(shown[0].after - again.after).max() < 1e-6 * moved


def test_p_value_is_uniform_on_noise():
    """Pure noise along a real path, many times over: p below 0.1 in about a tenth."""
    case, point = fitted("nothing")
    missing = residual_torque.missing_torque(case, point.structure, point.values)
    rng = np.random.default_rng(8)
    found = []
    for _ in range(40):
        white = rng.standard_normal(len(missing.time) + 40)
        smooth = np.convolve(white, np.ones(20) / 20.0, "same")[20:-20]
        # Louder at speed, as real noise is: that alone is no dependence.
        found.append(
            nonparametric.examine_dependence(replace(missing, torque=smooth * (1.0 + np.abs(missing.velocity)))).p_value
        )
    below = [float(np.mean(np.array(found) < level)) for level in (0.1, 0.5)]
    assert below[0] < 0.25
    assert 0.25 < below[1] < 0.75


def test_missing_drag_shows_over_velocity():
    case, point = fitted("drag")
    before = nonparametric.remaining_dependence(case, point.structure, point.values)
    assert before.share > 0.2
    assert before.p_value < 1e-2
    assert "velocity" in before.variables
    assert nonparametric.candidate_terms(before)[0] == CurveTerm("velocity")


def test_what_a_filter_learns_after_a_silence_is_no_missing_torque():
    """It begins anew there, and its first corrections are of what it did not know, not of what the model lacks."""
    case, point = fitted("nothing")
    measured = case.drive.measured.copy()
    measured[5000:5600] = np.nan
    silent = replace(case, drive=replace(case.drive, measured=measured))
    values = {**point.values, "input_gain": 1.1 * point.values["input_gain"]}
    usual, seen = (residual_torque.missing_torque(c, point.structure, values).torque for c in (case, silent))
    after = slice(5500, 6000)
    assert np.nanmax(np.abs(seen[after])) < 2.0 * np.nanmax(np.abs(usual))


def test_a_torque_that_noise_of_the_readings_hides_shows_through_a_longer_memory():
    """Noise makes the torque of one reading from the next, so a filter that remembers for longer lets in less of it."""
    rng = np.random.default_rng(2)
    _, base = fitted("bump")
    for size, shows in ((1.0, True), (0.0, False)):
        law = {n: size * v if n in names("unknown_position") else v for n, v in PLANTED.items()}
        quiet = recorded(3, ("unknown_position",), **law).recording
        read = quiet.output + 25.0 * COUNT * rng.standard_normal(len(quiet.output))
        case = prepared_recording.prepare_recording(replace(quiet, output=read), STRUCTURE)
        point = optimizer.fit_with_process_noise(FitProblem([case]), STRUCTURE, base.values, FREE)
        short, both = (
            nonparametric.examine_dependence(residual_torque.missing_torque(case, STRUCTURE, point.values)),
            nonparametric.remaining_dependence(case, STRUCTURE, point.values),
        )
        assert not nonparametric.is_dependence_left(short)
        assert nonparametric.is_dependence_left(both) is shows
        assert not shows or (both.memory == max(nonparametric.MEMORIES) and "position" in both.variables)
        assert set(both.sizes) == set(nonparametric.MEMORIES)


def test_bump_over_position_is_found_and_drawn():
    case, base = fitted("bump")
    before = nonparametric.remaining_dependence(case, base.structure, base.values)
    assert before.share > 0.3
    assert before.p_value < 1e-2
    assert "position" in before.variables
    found = with_curve([case], base, CurveTerm("position"))
    assert found.deviance < base.deviance - 200.0
    at = spots("unknown_position", found.values)
    heights = np.array([found.values[n] for n in names("unknown_position")])
    truth = drawn(PLANTED, np.array(at))
    size = np.sqrt(np.diag(found.covariance) * found.scale)
    band = np.array([size[found.free.index(n)] if n in found.free else np.inf for n in names("unknown_position")])
    # A line through other knots than the planted ones misses by a little beside the band.
    assert np.all(np.abs(heights - truth) < 4.0 * band + 0.35)
    assert np.abs(heights - truth)[np.isfinite(band)].max() < 0.3 * 3.0
    after = nonparametric.remaining_dependence(case, found.structure, found.values)
    assert after.size < 0.4 * before.size


def test_a_bump_between_two_of_twelve_even_knots_is_drawn_better():
    case, base = fitted("sharp")
    at = np.linspace(-0.9, 0.3, 100)
    truth = drawn(SHARP, at)
    placed = with_curve([case], base, CurveTerm("position"))
    own = spots("unknown_position", placed.values)
    spread = np.linspace(own[0], own[-1], KNOTS)
    begun = {**placed.values, **through("unknown_position", spread, drawn(SHARP, spread))}
    even = nonparametric.fit_curve(
        FitProblem([case]), replace(placed, values=begun, free=(*base.free, *names("unknown_position")))
    )
    placed_miss, even_miss = (np.std(drawn(found.values, at) - truth) for found in (placed, even))
    assert placed_miss < 0.8 * even_miss and placed.deviance < even.deviance - 100.0


def test_a_wave_that_only_one_direction_of_push_knows_is_found():
    """Cogging while the duty is positive, eight times a turn, on a travel of less than a turn and a half."""
    case, point = fitted("nothing")
    missing = residual_torque.missing_torque(case, point.structure, point.values)
    rng = np.random.default_rng(5)
    place = 3.5 * 0.5 * (1.0 + np.sin(0.7 * missing.time))
    cogging = np.where(missing.command > 0.0, np.sin(8.0 * place), 0.0)
    noise = np.convolve(rng.standard_normal(len(place) + 40), np.ones(20) / 20.0, "same")[20:-20]
    found = nonparametric.examine_dependence(replace(missing, position=place, torque=cogging + noise))
    assert nonparametric.is_dependence_left(found)
    assert found.table == "wave 8, push"
    assert found.variables == ("position", "input")


def test_what_a_reversal_leaves_behind_is_found_in_any_unit():
    """A torque that dies down within a tenth of a radian after each turn, or of what is a radian on a linear axis."""
    case, point = fitted("nothing")
    missing = residual_torque.missing_torque(case, point.structure, point.values)
    rng = np.random.default_rng(6)
    sign = np.repeat((-1.0) ** np.arange(200), rng.integers(200, 900, 200))[: len(missing.time)]
    place = np.cumsum(sign) * missing.step
    turns = np.flatnonzero(np.diff(sign, prepend=sign[0]))
    last = np.concatenate([[0], turns])[np.searchsorted(turns, np.arange(len(sign)), "right")]
    torque = sign * np.exp(-np.abs(place - place[last]) / 0.1) + 0.3 * rng.standard_normal(len(sign))
    shares = []
    for lever in (1.0, 1.0 / 64.0):
        seen = replace(missing, position=lever * place, velocity=lever * sign, torque=torque)
        shares.append(
            {d.table: d.share for d in nonparametric.examine_dependence(seen, lever).dependences}["since reversal"]
        )
    assert shares[0] > 0.5 and abs(shares[1] - shares[0]) < 1e-9


def test_a_wave_is_drawn_with_its_order():
    case, base = fitted("cogging")
    before = nonparametric.remaining_dependence(case, base.structure, base.values)
    assert nonparametric.candidate_terms(before)[0] == CurveTerm("angle", 7.0)
    found = with_curve([case], base, CurveTerm("angle", 7.0))
    assert found.values["unknown_angle_order"] == 7.0
    assert found.values["unknown_angle_sin_1"] == pytest.approx(1.5, abs=0.15)
    others = [v for n, v in found.values.items() if n.startswith("unknown_angle_") and n[-1] in "23456"]
    assert max(abs(v) for v in others) < 0.2


def test_friction_that_falls_with_time_is_found_and_drawn():
    case, base = fitted("warming")
    before = nonparametric.remaining_dependence(case, base.structure, base.values)
    assert CurveTerm("drag") in nonparametric.candidate_terms(before)
    found = with_curve([case], base, CurveTerm("drag"))
    drawn = np.array([found.values[n] for n in names("unknown_drag")])
    truth = np.array([WARMING[n] for n in names("unknown_drag")])
    # What is constant in it is the viscous friction's.
    assert drawn + found.values["viscous_friction"] == pytest.approx(truth + VALUES["viscous_friction"], abs=0.15)
    other = with_curve([case], base, CurveTerm("time"))
    assert found.deviance < min(base.deviance, other.deviance) - 100.0


@pytest.mark.parametrize(
    ("key", "name", "term", "outdone"),
    [
        ("hump", "quadratic_drag", CurveTerm("velocity"), True),  # a name that bends towards what it is not
        ("humped", "coulomb_friction", CurveTerm("velocity"), False),  # a friction that departs from its name
        ("drag", "quadratic_drag", CurveTerm("velocity"), False),
        ("nothing", "", CurveTerm("velocity"), False),
        ("hump", "", CurveTerm("velocity"), True),
    ],
)
def test_what_has_no_name_wins_where_the_names_do_nothing_beside_it(key, name, term, outdone):
    case, first = fitted(key)
    last = with_name(case, first, name) if name else first
    assert not name or model_comparison.is_significant(first, last)
    nameless = with_curve([case], first, term)
    found = SearchResult(first, last, (), FitProblem((case,)))
    for p_value in (1.0, 0.0):
        assert free_curves.replaces_names(found, nameless, 2 * [left(0.3, p_value, 0.4)]) is outdone


@pytest.mark.parametrize(
    ("names", "earned", "outdone"), [(1, 10.0, True), (1, 30.0, False), (2, 30.0, True), (2, 50.0, False)]
)
def test_beside_a_curve_that_does_more_every_name_has_to_earn_its_place(names, earned, outdone):
    """Names of no size gain nothing beside the curve, so that each fit but theirs is said to lack so much."""
    case, first = fitted("hump")
    curve = with_curve([case], first, CurveTerm("velocity"))
    lack = earned * model_comparison.overdispersion([curve])
    last = replace(
        first, structure=STRUCTURE.with_(*("quadratic_drag", "gravity")[:names]), deviance=first.deviance + lack
    )
    nameless = replace(curve, deviance=curve.deviance + lack)
    found = SearchResult(first, last, (), FitProblem((case,)))
    assert free_curves.replaces_names(found, nameless, 2 * [left(0.3, 0.0, 0.4)]) is outdone


@pytest.mark.parametrize(
    ("name", "size", "outdone"),
    [("coulomb_friction", 0.1, False), ("coulomb_friction", 0.2, True), ("quadratic_drag", 0.1, True)],
)
def test_dry_friction_that_leaves_little_keeps_its_name(name, size, outdone):
    """No machine's follows a law exactly; and a curve over the speed has its step, so that it does nothing beside."""
    case, first = fitted("hump")
    last, nameless = replace(first, structure=STRUCTURE.with_(name)), with_curve([case], first, CurveTerm("velocity"))
    what = [left(0.8, 0.0, 0.4), left(0.7, 0.0, size)]
    assert free_curves.replaces_names(SearchResult(first, last, (), FitProblem((case,))), nameless, what) is outdone


def test_dry_friction_is_no_motor_that_varies_over_its_turn():
    """However little it leaves: a curve over the speed follows friction's step, one of the motor's gain does not."""
    case, first = fitted("gain")
    last, nameless = with_name(case, first, "position_dependent_friction"), with_curve([case], first, CurveTerm("gain"))
    what = [left(0.8, 0.0, 0.4), left(0.7, 0.0, 0.04)]
    assert free_curves.replaces_names(SearchResult(first, last, (), FitProblem((case,))), nameless, what)


@pytest.mark.parametrize(
    ("earned", "p_value", "outdone"), [(5.0, 1e-4, True), (5.0, 0.002, False), (-5.0, 1e-4, False)]
)
def test_a_curve_that_foretells_what_plainly_goes_with_something_has_to_earn_its_price(earned, p_value, outdone):
    case, first = fitted("hump")
    curve = with_curve([case], first, CurveTerm("velocity"))
    # The first model with such a deviance that the same curve gains so much.
    surplus = model_comparison.gain(first, curve) - earned
    first = replace(first, deviance=first.deviance - surplus * model_comparison.overdispersion([first, curve]))
    assert model_comparison.gain(first, curve) == pytest.approx(earned, abs=0.01)
    what = 2 * [left(0.1, p_value, 0.1)]
    assert free_curves.replaces_names(SearchResult(first, first, (), FitProblem((case,))), curve, what) is outdone


def test_a_name_that_two_stretches_speak_for_is_dropped(monkeypatch):
    case, first = fitted("drag")
    last = with_name(case, first, "quadratic_drag")
    found = SearchResult(first, last, (), FitProblem((case,)), (first,))
    assert name_tests.name_p_values(found, first.structure)["quadratic_drag"] < thresholds.NAME_CLEAR_P_VALUE
    assert name_tests.name_p_values(replace(found, smaller_models=()), first.structure) == {}
    rng = np.random.default_rng(2)
    lucky = np.concatenate([[300.0, 90.0], 10.0 * rng.standard_normal(40) - 2.0])
    for gains, dropped in ((lucky, True), (lucky[:9], False), (np.abs(lucky), False)):
        monkeypatch.setattr(cross_validation, "block_gains", lambda *a, gains=gains: gains)
        lasting, _, failed = name_tests.drop_unearned_names(found, first.structure)
        assert (lasting.last.structure == first.structure) is dropped
        assert [n.id for n in failed] == ["quadratic_drag"] * dropped
        assert all(n.figure > thresholds.NAME_MAX_P_VALUE for n in failed)


@pytest.mark.parametrize(("key", "kept"), [("nothing", False), ("drag", True)])
def test_a_name_that_a_longer_memory_makes_nothing_of_is_not_given(key, kept):
    case, first = fitted(key)
    last = with_name(case, first, "quadratic_drag")
    if not kept:
        last = replace(last, values={**last.values, "quadratic_drag": 0.0})
    swap = Alternative("quadratic_drag", "gravity", last)
    found = SearchResult(first, last, (), FitProblem((case,)), (first,), (swap,))
    lasting, (cases, point), _ = name_tests.drop_unearned_names(found, first.structure)
    assert point.structure == lasting.last.structure and len(cases.recordings) == 1
    if kept:
        assert lasting is found
    else:
        assert lasting.last.structure == first.structure
        assert (lasting.smaller_models, lasting.alternatives) == ((), ())
        assert lasting.last.deviance <= first.deviance + 1.0
    assert name_tests.drop_unearned_names(replace(found, last=last), last.structure)[0].last is last


@pytest.mark.parametrize(("key", "emptied"), [("nothing", True), ("drag", False)])
def test_a_name_of_which_the_best_free_run_leaves_nothing_is_dropped(key, emptied):
    """Its likeliest values passed every test, but ran too far off; those that are handed out have to pass, too."""
    case, first = fitted(key)
    problem = FitProblem((case,))
    last = with_name(case, first, "quadratic_drag")
    found = SearchResult(first, last, (), problem, (first,))
    judged = [
        handed_out.Judged(f, maximum_likelihood.to_model(problem, f, [case.recording]))
        for f in (first, replace(last, values=dict(last.values)))
    ]
    chosen = diagnose._Chosen(found, (problem, last), (), case, (left(0.3, 1e-9, 0.3),) * 2, False, ())
    names = diagnose._emptied_names(chosen, handed_out.Pair(*judged, Adequacy()), first.structure)
    assert [n.id for n in names] == ["quadratic_drag"] * emptied
    assert all("may be nothing" in n.reason and n.figure < thresholds.MIN_SIZE_IN_ERRORS for n in names)
    likeliest = replace(chosen, foreseen=(problem, judged[1].fit))
    assert diagnose._emptied_names(likeliest, handed_out.Pair(*judged, Adequacy()), first.structure) == []


def test_what_lasts_is_asked_of_a_filter_that_forgets_no_faster_than_the_one_that_chose(monkeypatch):
    """Meetings that nobody foresees, passed over, must not make it forget the slow torques that a name stands for."""
    case, first = fitted("hump")
    long = replace(first, process_noise=filter_memory.process_noise_of(case, 0.4))
    assert (
        optimizer.most_likely_process_noise(FitProblem([case]), long.structure, long.values, around=long.process_noise)
        > 2.0 * long.process_noise
    )
    monkeypatch.setattr(local_optima, "with_longer_memory", lambda cases, point: point)
    monkeypatch.setattr(
        contact_masking, "with_contact_mask", lambda cases, point: cases.on(list(map(hidden, cases.recordings)))
    )
    masked, point = name_tests.fit_with_longest_memory(SearchResult(first, long, (), FitProblem((case,))))
    (judged,) = masked.recordings
    assert judged.contact_mask is not None and point.process_noise == pytest.approx(long.process_noise)


@pytest.mark.parametrize(("took", "drawn"), [(0.9, True), (1.1, False)])
def test_names_that_leave_little_are_doubted_where_they_took_less_than_depends_on_the_state(took, drawn):
    """What a table foretells on blocks that it was not drawn from a right name takes away, too."""
    case, first = fitted("hump")
    found = SearchResult(first, with_name(case, first, "quadratic_drag"), (), FitProblem((case,)))
    before = nonparametric.remaining_dependence(case, first.structure, first.values)
    size = before.size * np.sqrt(1.0 - took * before.share)
    little = replace(before, share=0.5 * thresholds.FAINT_SHARE, size=float(size), sizes={})
    nameless = free_curves.best_curve(found, before, little, {})
    assert ("unknown_velocity" in nameless.structure) is drawn
    assert drawn or nameless is first


def test_a_knot_that_saw_nothing_that_is_judged_is_on_the_line_between_its_neighbours():
    case, first = fitted("drag")
    time = case.drive.time
    begin, end = 0.3 * time[-1], 0.8 * time[-1]
    rattles = replace(case, rattle_mask=(time > begin) & (time < end))
    sketched = nonparametric.sketch_curve(FitProblem([rattles]), first, CurveTerm("time"))
    at = np.array(spots("unknown_time", sketched.values))
    heights = np.array([sketched.values[n] for n in names("unknown_time")])
    free = np.array([n in sketched.free for n in names("unknown_time")])
    inside = (np.append(begin, at[:-1]) > begin) & (np.append(at[1:], end) < end)  # with both of its neighbours
    assert inside.sum() > 1 and not free[inside].any() and free[~inside].sum() > 3
    assert heights[inside] == pytest.approx(np.interp(at[inside], at[free], heights[free]))
    blind = replace(case, rattle_mask=np.ones(len(time), dtype=bool))
    missing = residual_torque.missing_torque(case, first.structure, first.values)
    assert nonparametric._masked_torque(blind, missing) is missing


def test_a_name_that_a_curve_has_swallowed_grows_again_beside_it():
    case, first = fitted("humped")
    last, nameless = with_name(case, first, "coulomb_friction"), with_curve([case], first, CurveTerm("velocity"))
    both = free_curves._fit_names_beside_curve(SearchResult(first, last, (), FitProblem((case,))), nameless)
    # The curve alone is what it grows from: larger by a parameter, it cannot fit less well.
    assert both.deviance < nameless.deviance
    assert both.values["coulomb_friction"] == pytest.approx(3.0, rel=0.2)


@pytest.mark.parametrize(
    ("key", "name", "term", "drawn"),
    [
        ("hump", "", CurveTerm("velocity"), True),
        ("nothing", "", CurveTerm("time"), False),  # a curve that follows chance
        ("hump", "quadratic_drag", CurveTerm("velocity"), True),
        ("drag", "quadratic_drag", CurveTerm("time"), False),  # a curve that does less than the name
    ],
)
def test_a_curve_stays_in_the_model_where_it_earns_its_place_and_the_names_do_less(key, name, term, drawn):
    case, first = fitted(key)
    last = with_name(case, first, name) if name else first
    nameless = with_curve([case], first, term)
    found = free_curves.keep_or_replace(SearchResult(first, last, (), FitProblem((case,))), nameless)
    assert found.last is (nameless if drawn else last)


@pytest.mark.parametrize(
    ("term", "travel", "order"),
    [
        (CurveTerm("push", 8.0), 3.5, 8.0),  # a wave that was seen to repeat on less than a turn
        (CurveTerm("gain"), 9.0, 1.0),
        (CurveTerm("gain"), 0.5, 2.0 * np.pi / 0.75),  # what changes along a short travel need not repeat on it
    ],
)
def test_a_wave_keeps_its_order_on_a_short_travel(term, travel, order):
    rng = np.random.default_rng(6)
    means = {"position": np.linspace(0.0, travel, 400), "input": rng.uniform(-50.0, 50.0, 400)}
    start, free = nonparametric._initial_waves(means | {"torque": rng.standard_normal(400)}, term, VALUES)
    assert start[f"unknown_{term.kind}_order"] == pytest.approx(order, rel=1e-3)
    assert set(start) - set(free) == {f"unknown_{term.kind}_order"}


def left(share: float, p_value: float, size: float) -> nonparametric.RemainingDependence:
    return nonparametric.RemainingDependence(share, p_value, ("position",), "position", size, 0.1, ())


def test_nothing_is_drawn_of_what_chance_makes():
    seen = nonparametric.Dependence("angle", ("position",), 0.3, 9.0, 0.4)
    for p_value, terms in ((1e-9, [CurveTerm("angle")]), (0.2, [])):
        assert nonparametric.candidate_terms(replace(left(0.3, p_value, 0.4), dependences=(seen,))) == terms


def test_what_two_variables_predict_may_be_a_curve_over_either():
    """Friction that is larger one way is a curve over speed; on a few commands a change over time follows it, too."""
    seen = (
        nonparametric.Dependence("time", ("time",), 0.57, 9.0, 0.4),
        nonparametric.Dependence("input, velocity", ("input", "velocity"), 0.47, 9.0, 0.4),
        nonparametric.Dependence("velocity, time", ("velocity", "time"), 0.45, 9.0, 0.4),
    )
    terms = nonparametric.candidate_terms(replace(left(0.57, 1e-9, 0.4), dependences=seen))
    assert terms == [CurveTerm(kind) for kind in ("time", "drag", "input", "velocity")]


def test_verdicts():
    much, little, chance = left(0.6, 1e-9, 1.0), left(0.03, 1e-5, 0.1), left(0.3, 0.2, 0.4)
    assert nonparametric.is_described(False, little, little)
    assert nonparametric.is_described(False, chance, chance)
    assert nonparametric.is_described(True, much, little)
    assert nonparametric.is_described(True, much, left(0.3, 1e-9, 0.3))
    assert not nonparametric.is_described(True, much, left(0.5, 1e-9, 0.9))
    assert not nonparametric.is_described(False, much, much)


def test_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="no term over"):
        CurveTerm("moonlight")


@pytest.mark.parametrize(
    ("key", "term", "over", "name", "size"),
    [
        ("gain", CurveTerm("gain"), "input", "unknown_gain_sin_1", 0.2),
        ("push", CurveTerm("push", 3.0), "input", "unknown_push_forward_cos_1", 4.0),
        ("crank", CurveTerm("inertia"), "acceleration", "unknown_inertia_sin_1", 0.2),
    ],
)
def test_what_multiplies_the_command_or_the_acceleration_is_found_and_drawn(key, term, over, name, size):
    case, base = fitted(key)
    before = nonparametric.remaining_dependence(case, base.structure, base.values)
    assert nonparametric.is_dependence_left(before)
    assert before.variables == ("position", over)
    assert term in nonparametric.candidate_terms(before)
    found = with_curve([case], base, term)
    assert found.values[name] == pytest.approx(size, rel=0.1)
    nothing = set(found.free) - {name, *base.free}
    others = [found.values[n] for n in nothing]
    assert max(abs(v) for v in others) < 0.2 * size
    assert found.deviance < min(
        with_curve([case], base, other).deviance for other in (CurveTerm("angle", term.order), CurveTerm("position"))
    )
    after = nonparametric.remaining_dependence(case, found.structure, found.values)
    assert after.size < 0.4 * before.size


def test_a_first_model_that_the_command_does_not_move_still_gets_a_term():
    """A fit without the right physics may end at a gain of zero, where a torque is no command."""
    rng = np.random.default_rng(5)
    means = {"input": rng.uniform(-50.0, 50.0, 400), "torque": rng.standard_normal(400)}
    start, free = nonparametric._initial_curve(means, CurveTerm("input"), {"input_gain": 0.0})
    assert free
    assert all(np.isfinite(value) for value in start.values())


def test_friction_that_gives_is_told_from_friction_that_holds():
    """What gives beats dry friction where it is planted, and the way by which it gives is recovered; where dry friction
    is, what gives becomes dry: it earns nothing and is not believed.
    """
    case, point = fitted("bend")
    gives, holds = screened(case, point, "presliding_friction"), with_name(case, point, "coulomb_friction")
    assert model_comparison.is_significant(holds, gives) and is_plausible(FitProblem([case]), gives)
    assert gives.values == pytest.approx({**gives.values, **BENT}, rel=0.1)
    case, point = fitted("dry")
    gives, holds = screened(case, point, "presliding_friction"), with_name(case, point, "coulomb_friction")
    assert model_comparison.criterion_difference(gives, holds) < 0.0 and not is_plausible(FitProblem([case]), gives)


def test_friction_that_gives_takes_the_place_of_dry_friction() -> None:
    """Beside dry friction that is named already there is nothing left of it to give."""
    case, point = fitted("bend")
    dry = with_name(case, point, "coulomb_friction")
    gives = screened(case, dry, "presliding_friction")
    assert gives.structure == STRUCTURE.with_("presliding_friction") and model_comparison.is_significant(dry, gives)
    assert gives.values == pytest.approx({**gives.values, **BENT}, rel=0.1)


@pytest.mark.parametrize("which", ["liquid", "hanging"])
def test_what_rides_on_the_link_is_told_from_a_joint_that_rings(which: str) -> None:
    case, point = fitted(which)
    rides = screened(case, point, "flexible_load")
    for name, true in {"liquid": LIQUID, "hanging": HANGING}[which].items():
        # A spring of 10 would swing once in two seconds.
        assert abs(rides.values[name] - true) < 0.1 * (true or 10.0)
    assert is_plausible(FitProblem([case]), rides)
    for name in ("motor_lag", "load_change", "joint_elasticity", "coulomb_friction"):
        assert model_comparison.is_significant(with_name(case, point, name), rides)


def test_what_is_held_as_if_it_were_part_of_the_link_rides_on_nothing() -> None:
    case, point = fitted("nothing")
    rides = screened(case, point, "flexible_load")
    assert not model_comparison.is_significant(point, rides)
    for hold in ("flexible_load_stiffness", "flexible_load_damping"):
        firmly = {**rides.values, "flexible_load_stiffness": 10.0, "flexible_load_damping": 1.0}
        assert is_plausible(FitProblem([case]), replace(rides, values=firmly))
        firmly[hold] = parameter_bounds.bounds_of(hold)[1]
        assert not is_plausible(FitProblem([case]), replace(rides, values=firmly))


def test_friction_that_gives_by_a_count_is_none():
    case, point = fitted("nothing")
    structure = STRUCTURE.with_("presliding_friction")
    for give, right in ((2.0 * COUNT, False), (4.0 * COUNT, True), (0.5 * float(np.ptp(case.positions)), False)):
        values = {**point.values, "presliding_friction": 1.0, "presliding_travel": give}
        assert is_plausible(FitProblem([case]), replace(point, structure=structure, values=values)) is right
    # A finer encoder sees what every dry contact gives by.
    fine = replace(case, recording=replace(case.recording, resolution=0.01 * COUNT))
    for give, right in ((5e-4, False), (2e-3, True)):
        values = {**point.values, "presliding_friction": 1.0, "presliding_travel": give}
        assert is_plausible(FitProblem([fine]), replace(point, structure=structure, values=values)) is right


@pytest.mark.parametrize(("levels", "enough"), [(4, False), (40, True)])
def test_a_drive_curve_has_no_more_knots_than_the_command_has_levels(levels: int, enough: bool) -> None:
    time = 0.002 * np.arange(4000)
    duty = np.repeat(np.linspace(-40.0, 40.0, levels), 4000 // levels)
    recording = Recording("made", time, duty, 0.01 * time, "%", "rad")
    assert nonparametric.fixes_drive_curve(preparation.prepare_recordings([recording], STRUCTURE).recordings) == enough
