"""Recordings that cannot separate two effects: both are shown, with what each is given and what would decide."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from twin.diagnosis import alternatives, dead_band_rivals, growth, round_margin, thresholds

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from concealed import Concealed
from example_diagnosis import RIG, example
from mujoco_rig import TURN, draw_rig, simulate

from twin.diagnosis import diagnose, model_comparison, probabilities, result
from twin.diagnosis.result import Diagnosis, Fitness
from twin.diagnosis.search_result import Alternative, SearchResult
from twin.diagnosis.selection_round import Hypothesis, Round
from twin.diagnosis.thresholds import UNDECIDED_MARGIN
from twin.estimation import filter_memory, optimizer, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.stepper import BASE, Structure
from twin.report import explorer, html, wording
from twin.report.html import Story
from twin.simulation import kernel

#: What else does the same as a spring over a small travel.
ALIKE = {"spring": ("detent",)}


def slow(seconds: float, most: float, top: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Sines up to `top` Hz: no edge, no rest, nothing quick."""
    time = np.round(np.arange(round(seconds / 0.002)) * 0.002, 9)
    lines = np.geomspace(0.15, top, 6)
    phases = rng.uniform(0.0, TURN, 6)
    duty = sum(np.sin(TURN * f * time + p) / np.sqrt(f) for f, p in zip(lines, phases, strict=True))
    return time, np.round(most * duty / np.abs(duty).max(), 2)


def diagnosed(effect: Concealed, candidates: Sequence[str], seed: int, most: float, top: float) -> Diagnosis:
    rng = np.random.default_rng(seed)
    rig = draw_rig(rng)
    run = simulate(rig, [effect], *slow(10.0, most, top, rng), seed)
    count = TURN / rig.counts_per_revolution
    recording = Recording("slow", run.time, run.duty, run.counts * count, "%", "rad", count)
    return diagnose.diagnose([recording], Structure.of(BASE), candidates=candidates)


@pytest.mark.parametrize(
    ("effect", "rival", "seed", "most", "top"),
    [
        # Of a signal that changes little in a few milliseconds, lag and delay make the same: it comes late.
        (Concealed("motor_lag", {"time": 0.006}), "input_delay", 5, 45.0, 0.8),
        # Over a tenth of a radian the sine of the angle is a straight line, and so is a detent near its middle.
        (Concealed("spring", {"stiffness": 1.06, "rest": 0.0}), "gravity", 2, 20.0, 1.0),
    ],
    ids=["lag", "spring"],
)
def test_what_the_recording_cannot_separate_is_shown_as_two(effect, rival, seed, most, top):
    found = diagnosed(effect, (effect.id, rival, *ALIKE.get(effect.id, ())), seed, most, top)
    assert found.verdict == "explained"
    (named,) = found.findings
    rivals = [u.ids[1] for u in found.undecided]
    names = {named.id, *rivals}
    assert {effect.id, rival} <= names <= {effect.id, rival, *ALIKE.get(effect.id, ())}
    said = wording.headline(found)
    assert "cannot tell which" in said and all(wording.title(i) in said for i in names)
    for pair in found.undecided:
        assert named.id == pair.ids[0] and named.probability == pair.probabilities[0] < 0.9
        assert dict(found.ranking)[pair.ids[1]] == pair.probabilities[1] > 0.1
    assert sum(p for _, p in found.ranking) <= 1.0 + 1e-9
    # Both parts of the recording are shown, by the name that the user knows.
    assert [(t.name, t.role) for t in found.traces] == [("slow", "train"), ("slow", "holdout")]
    assert np.isfinite(explorer._spliced(found.recordings[0], found.traces, "after")).all()
    # Where so little travel leaves no input that would decide, it says so.
    assert all(wording.title(i) in found.experiment.why for i in (named.id, rivals[0]))


def point(criterion: float, *effects: str) -> Fit:
    structure = Structure.of([*BASE, *effects])
    nothing = np.zeros((0, 0))
    return Fit(structure, {}, 1.0, (), criterion, 1.0, nothing, np.zeros(0), nothing)


def searched(gap: float, *also: str) -> SearchResult:
    """A search that chose gravity and found a spring `gap` units of the criterion behind, `also` known before."""
    before, one = point(3000.0, *also), point(1000.0, *also, "gravity")
    two = point(1000.0 + gap, *also, "spring")
    more = point(1000.0 + 1.0, *also, "gravity", "coulomb_friction")
    rivals = (Hypothesis(("gravity",), one), Hypothesis(("coulomb_friction",), more), Hypothesis(("spring",), two))
    swaps = (Alternative("gravity", "spring", two),) if gap < UNDECIDED_MARGIN else ()
    return SearchResult(before, one, (Round(before, rivals, 1.0),), FitProblem(()), (point(3000.0, *also),), swaps)


@pytest.mark.parametrize("also", [(), ("motor_lag",)])
def test_a_rival_takes_its_share_and_a_larger_model_none(also):
    even = probabilities.probabilities(searched(0.0, *also))[0]
    known = 1.0 - thresholds.PROB_NONE_OF_THESE
    assert even["gravity"] == pytest.approx(0.5 * known)
    odds = probabilities.probabilities(searched(2.0 * thresholds.TEMPERATURE * np.log(4.0), *also))[0]
    assert odds["gravity"] == pytest.approx(0.8 * known)
    assert probabilities.probabilities(searched(1500.0, *also))[0]["gravity"] == pytest.approx(known)
    assert probabilities.undecided(searched(1500.0, *also)) == ()
    (pair,) = probabilities.undecided(searched(0.5 * UNDECIDED_MARGIN, *also))
    assert pair.ids == ("gravity", "spring") and sum(pair.probabilities) == pytest.approx(known)


def test_what_the_first_model_has_is_no_rival_to_what_is_missing():
    """Nor does it take the chances of what was tried and did not earn a place."""
    ranking = dict(probabilities.probabilities(searched(0.0, "motor_lag"))[1])
    assert set(ranking) == {"gravity", "spring", "coulomb_friction"} and ranking["coulomb_friction"] == 0.0
    before, tried = point(1000.0, "motor_lag"), point(995.0, "motor_lag", "spring")
    nothing = SearchResult(
        before, before, (Round(before, (Hypothesis(("spring",), tried),), 1.0, False),), FitProblem(())
    )
    ((effect, probability),) = probabilities.probabilities(nothing)[1]
    assert effect == "spring" and 0.4 < probability < 0.7


def test_a_curve_in_the_place_of_a_name_takes_its_place_in_the_ranking():
    won = searched(1500.0)
    assert dict(probabilities.probabilities(won)[1])["gravity"] > 0.9
    curve = point(100.0, "unknown_position")
    drawn = SearchResult(won.first, curve, won.rounds, FitProblem(()))
    assert dict(probabilities.probabilities(drawn)[1])["gravity"] < 0.01


def test_what_one_name_explains_about_as_well_as_two_is_the_one():
    """While it slides, friction that is larger one way is friction and a constant torque."""
    two, one = point(1000.0, "coulomb_friction", "constant_offset"), point(1000.0, "friction_asymmetry")
    assert (
        model_comparison.criterion_difference_penalised(one, two)
        == -UNDECIDED_MARGIN
        == -model_comparison.criterion_difference_penalised(two, one)
    )
    clear = point(1000.0 + 2.0 * UNDECIDED_MARGIN, "friction_asymmetry")
    assert (
        model_comparison.criterion_difference_penalised(clear, two)
        == UNDECIDED_MARGIN
        == -model_comparison.criterion_difference_penalised(two, clear)
    )
    # Each other exchange is one name for one.
    assert model_comparison.criterion_difference_penalised(point(1005.0, "gravity"), point(1000.0, "spring")) == 5.0
    found = SearchResult(
        point(9000.0),
        one,
        (),
        FitProblem(()),
        (point(9000.0),),
        (Alternative("friction_asymmetry", "constant_offset", two),),
    )
    given = probabilities.probabilities(found)[0]["friction_asymmetry"] / (1.0 - thresholds.PROB_NONE_OF_THESE)
    assert given == pytest.approx(1.0 / (1.0 + np.exp(-UNDECIDED_MARGIN / (2.0 * thresholds.TEMPERATURE))))


def test_the_experiment_is_for_the_likeliest_rival_and_not_for_one_name_more():
    last, rival = point(1000.0, "motor_lag"), point(1010.0, "input_delay")
    torque = point(1003.0, "motor_lag", "constant_offset")
    swaps = (Alternative("dead_band", "constant_offset", torque), Alternative("motor_lag", "input_delay", rival))
    for offered, closest in ((swaps, [rival]), (swaps[:1], [torque]), ((), [])):
        assert diagnose._closest_rival(SearchResult(point(3000.0), last, (), FitProblem(()), (), offered)) == closest


def test_the_user_is_told_of_both():
    told = result.to_json(example())["undecided"]
    assert told == [
        {"ids": ["gravity", "spring"], "probabilities": [0.62, 0.37], "experiment": "travel over more than half a turn"}
    ]
    page = html.html(Story(diagnosis=example(), rig=RIG))
    for words in ("gravity on the link or spring", "62\u202f%", "37\u202f%", "travel over more than half a turn"):
        assert words in page


def test_an_effect_that_came_along_with_another_stands_for_itself():
    """Of a winner that brought dry friction only that is left: what was better than dry friction alone is a rival."""
    tried = {"position_dependent_friction": 1000.0, "load_dependent_friction": 1020.0, "coulomb_friction": 1030.0}
    before, rivals = point(3000.0), tuple(Hypothesis((e,), point(c, e)) for e, c in tried.items())
    last = Structure.of([*BASE, "coulomb_friction"])
    contest = round_margin.margin_of([Round(before, rivals, 1.0)], last, "coulomb_friction")
    assert contest.gain == 1970.0
    assert [(h.added, behind) for h, behind in contest.rivals] == [(("load_dependent_friction",), -10.0)]


def test_what_looked_better_than_the_winner_and_did_not_show_is_no_rival():
    tried = {"spring": 1000.0, "load_change": 900.0, "gravity": 1010.0}
    before, rivals = point(3000.0), tuple(Hypothesis((e,), point(c, e)) for e, c in tried.items())
    this = Round(before, rivals, 1.0, refused=frozenset({"load_change"}))
    contest = round_margin.margin_of([this], Structure.of([*BASE, "spring"]), "spring")
    assert [h.added for h, _ in contest.rivals] == [("gravity",)]


def test_a_round_that_nothing_won_says_nothing_of_what_later_took_a_place():
    first = tuple(Hypothesis((e,), point(c, e)) for e, c in (("input_delay", 1000.0), ("motor_lag", 1004.0)))
    joint = point(1002.0, "joint_elasticity")
    later = (("gravity", 990.0), ("motor_lag", 999.0))
    others = tuple(Hypothesis((e,), point(c, "joint_elasticity", e)) for e, c in later)
    rounds = [Round(point(3000.0), first, 1.0), Round(joint, others, 1.0, won=False)]
    contest = round_margin.margin_of(rounds, Structure.of([*BASE, "motor_lag"]), "motor_lag")
    assert [(h.added, behind) for h, behind in contest.rivals] == [(("input_delay",), -4.0)]


def test_a_rattling_rig_is_said_to_hide_effects():
    fit = {"holdout": {"before": Fitness(0.1, 1.0, math.nan), "after": Fitness(0.05, 0.5, math.nan)}}
    for rough, rattles in ((0.5 * thresholds.MIN_GAIN, False), (2.0 * thresholds.MIN_GAIN, True)):
        said = diagnose._remarks(searched(500.0), fit, rough)
        assert [s.startswith("The motor rattles in its gap") for s in said] == ([True] if rattles else [])


@pytest.mark.parametrize(("after", "worse"), [(0.05, False), (0.2, True)])
def test_a_larger_model_that_held_out_data_speak_against_is_said_to_be(after, worse):
    """A curve without a name no less than a name."""
    fit = {"holdout": {"before": Fitness(0.1, 1.0, math.nan), "after": Fitness(after, 10.0 * after, math.nan)}}
    said = diagnose._remarks(searched(500.0), fit, 0.0)
    assert [s.startswith("The likelihood prefers the larger") for s in said] == [True] * worse


def test_what_is_followed_but_not_judged_is_said():
    fit = {"holdout": {"before": Fitness(0.1, 1.0, math.nan), "after": Fitness(0.05, 0.5, math.nan)}}
    hidden = {"calm": None, "loud": np.array([True, False, False, False])}
    cases = [SimpleNamespace(recording=SimpleNamespace(name=n), rattle_mask=h) for n, h in hidden.items()]
    (said,) = diagnose._remarks(replace(searched(500.0), problem=SimpleNamespace(recordings=cases)), fit, 0.0)
    assert said.startswith("loud: in 25 % of what was fitted")


@pytest.mark.parametrize("coasts", [False, True])
@pytest.mark.parametrize("offered", [("constant_offset",), ()])
def test_while_an_axis_is_pushed_dead_bands_that_differ_may_be_a_constant_torque(offered, coasts):
    """The readings are the same until it coasts; where they differ without that torque, nothing is in doubt."""
    plain = Structure.of(BASE).without("backlash")
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 4.0, "dead_band_reverse": 7.0}
    time = 0.002 * np.arange(4000)
    command = np.where(np.sin(4.0 * time) >= 0.0, 30.0, -25.0) * (1.0 + 0.5 * np.sin(0.9 * time))
    if coasts:
        command = np.where(np.mod(time, 2.0) > 1.0, 0.0, command)
    drive = prepared_recording.prepare_recording(
        Recording("", time, command, np.zeros(4000), "%", "rad", 1e-3), plain
    ).drive
    moved = kernel.predict(drive, kernel.vector(plain, values), kernel.start_state(0.0, 0.0, 0.0)).reading
    noise = np.random.default_rng(7).normal(0.0, 1e-3, 4000)
    cases = [
        prepared_recording.prepare_recording(Recording("axis", time, command, moved + noise, "%", "rad", 1e-3), plain)
    ]
    process_noise = filter_memory.process_noise_of(cases[0], 0.2)
    last = optimizer.levenberg_marquardt(FitProblem(cases, process_noise=process_noise), plain, values, tuple(values))
    swaps = dead_band_rivals.offset_for_dead_bands(FitProblem(cases), last, offered)
    told = [("dead_band", "constant_offset")] if offered and not coasts else []
    assert [(w.effect, w.rival) for w in swaps] == told
    for swap in swaps:
        own = swap.point.values
        assert own["offset"] == pytest.approx(0.5 * 3.0 * 0.4, rel=0.1)
        assert [own["dead_band_forward"], own["dead_band_reverse"]] == pytest.approx([5.5, 5.5], rel=0.1)
        found = SearchResult(last, last, (), FitProblem(cases), (), (swap,))
        (doubt,) = probabilities.undecided(found)
        assert doubt.ids == ("dead_band", "constant_offset") and doubt.probabilities[0] > doubt.probabilities[1] > 0.1
        assert "command" in doubt.experiment and probabilities.probabilities(found)[1] == (
            ("constant_offset", doubt.probabilities[1]),
        )
    # What does not differ by more than is known needs no torque.
    even = dict.fromkeys(("dead_band_forward", "dead_band_reverse"), 5.0)
    assert not dead_band_rivals.offset_for_dead_bands(
        FitProblem(cases), replace(last, values=last.values | even), ("constant_offset",)
    )


def test_a_rival_in_a_lesser_valley_does_not_speak_for_what_contains_it() -> None:
    """Friction over a turn brings plain friction along; from where it ended the plain one does as much."""
    plain, wider = "coulomb_friction", "position_dependent_friction"
    winner = Hypothesis((wider,), point(1000.0, wider))
    this = Round(point(3000.0), (winner, Hypothesis((plain,), point(2500.0, plain))), 1.0)
    assert alternatives.overtaking_fits([this], plain, wider) == [winner.point]
    bettered = growth.with_better_fit(this, point(1010.0, plain))
    assert [h.deviance for h in bettered.rivals] == [1000.0, 1010.0]
    assert alternatives.overtaking_fits([bettered], plain, wider) == []
    assert growth.with_better_fit(this, point(2600.0, plain)).rivals == this.rivals
