"""The search: what is offered, what a spring is, and what counts as showing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps

from twin.diagnosis import (
    alternatives,
    forward_selection,
    growth,
    model_comparison,
    round_margin,
    screening,
    search_result,
    selection_round,
    thresholds,
)
from twin.diagnosis.plausibility import is_plausible
from twin.effects.catalogue import BASE, CANDIDATES
from twin.estimation import (
    filter_memory,
    fit,
    likelihood,
    local_optima,
    maximum_likelihood,
    optimizer,
    parameter_bounds,
    preparation,
    prepared_recording,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.stepper import Structure
from twin.simulation import kernel


def test_candidates_that_a_linear_axis_has_not_are_not_tried() -> None:
    structure = Structure.of(["inertia", "viscous_friction"])
    time = 0.002 * np.arange(3000)
    duty = 40.0 * np.sign(np.sin(3.0 * time))
    blank = Recording("sled", time, duty, np.zeros(3000), "%", "m", 1e-5)
    p = kernel.vector(structure, {"input_gain": 0.02, "viscous_friction": 2.0})
    read = kernel.predict(
        prepared_recording.prepare_recording(blank, structure).drive, p, kernel.start_state(0.0, 0.0, 0.0)
    ).reading
    sled = Recording("sled", time, duty, 1e-5 * np.round(read / 1e-5), "%", "m", 1e-5)
    found = forward_selection.search([sled], structure, {}, ("gravity", "encoder_eccentricity"))
    assert found.rounds == () and found.last.structure == structure
    assert abs(found.last.values["input_gain"] - 0.02) < 1e-4


def test_a_gap_as_wide_as_any_is_no_gap() -> None:
    """It follows readings that are late, from an axis that has none."""
    rigid, time = Structure.of(["inertia", "viscous_friction", "dead_band"]), 0.004 * np.arange(2000)
    duty = steps(np.random.default_rng(1), len(time), 100, 40.0)
    values = {"input_gain": 4.0, "viscous_friction": 8.0, "dead_band_forward": 3.0, "dead_band_reverse": 3.0}
    y, _ = run(rigid, values, time, duty)
    late = np.round(np.interp(time - 0.06, time, y) / 1e-3) * 1e-3
    found = forward_selection.search(
        [Recording("late", time, duty, late, "%", "rad", 1e-3)], Structure.of(BASE), {}, ()
    )
    assert found.first.structure == found.last.structure == rigid


def test_an_elastic_joint_and_teeth_are_one_spring() -> None:
    """Where one takes the other's place it is as stiff, within its bounds."""
    joint = {"joint_frequency": 30.0, "joint_damping": 0.2}
    base = preparation.with_tooth_compliance(Structure.of(BASE))
    for frequency, teeth in ((38.0, 40.0), (12.0, 40.0), (39.9, 40.0)):
        found = preparation.complete_values(base, joint | {"joint_frequency": frequency})
        assert (found["tooth_frequency"], found["tooth_damping"]) == (teeth, 0.2)
    known = {"tooth_frequency": 90.0, "tooth_damping": 0.1}
    assert preparation.complete_values(base, joint | known)["tooth_frequency"] == 90.0
    _, hardest_joint = parameter_bounds.bounds_of("joint_frequency")
    softest_teeth, _ = parameter_bounds.bounds_of("tooth_frequency")
    assert hardest_joint == softest_teeth


def test_what_a_rough_likelihood_gives_anywhere_is_no_gain(monkeypatch) -> None:
    """A gain counts for what it is above the changes that next to nothing makes."""
    structure = Structure.of(["inertia", "viscous_friction", "backlash"])
    blank = Recording("still", 0.002 * np.arange(50), np.full(50, 30.0), np.zeros(50), "%", "rad", 1e-4)
    case = prepared_recording.prepare_recording(blank, structure)
    process_noise = filter_memory.process_noise_of(case, thresholds.SHORTEST_MEMORY)
    values = preparation.complete_values(structure, {"backlash_gap": 0.02})
    before = fit.Fit(structure, values, process_noise, ("backlash_gap",), 0.0, 1.0, np.eye(1), np.zeros(1), np.eye(1))
    after = replace(before, values={**values, "backlash_gap": 0.03}, deviance=-3.0 * thresholds.MIN_GAIN)
    for jump, shown in ((0.0, True), (1.0, True), (4.0, False)):

        def trembling(problem, structure, trials, jump=jump):
            own = after if trials[0]["backlash_gap"] > 0.025 else before
            return [own.deviance + jump * thresholds.MIN_GAIN * (-1.0) ** i for i in range(len(trials))]

        monkeypatch.setattr(likelihood, "deviances", trembling)
        assert selection_round.is_confirmed(FitProblem([case]), before, after) is shown


def test_an_effect_bent_into_something_else_is_not_that_effect() -> None:
    """Each rule at a value that keeps the name and at one that does not; the rest of the model stays as it is."""
    time = 0.002 * np.arange(5000)
    turning = Recording("turning", time, np.full(5000, 30.0), 3.0 * np.sin(time), "%", "rad", 1e-4)
    for effect, name, kept, bent in (
        ("torque_ripple", "ripple_order", 7.0, 1.0),
        ("periodic_disturbance", "disturbance_frequency", 1.7, 0.1),
        ("periodic_disturbance", "disturbance_frequency", 4.0, 8.0),  # 0.16 and 0.04 counts
        ("spring", "spring_rest", 5.0, 50.0),
        ("joint_elasticity", "motor_share", 0.3, 0.02),
        ("joint_elasticity", "motor_share", 0.9, 0.98),
        ("joint_elasticity", "joint_damping", 0.45, 0.6),
        ("stribeck_friction", "stribeck_velocity", 0.2, parameter_bounds.bounds_of("stribeck_velocity")[0]),
        ("stribeck_friction", "stribeck_velocity", 2e-3, 5e-4),  # two counts, and half of one, in a tenth of a second
        ("motor_lag", "lag_time", 0.0012, 0.0008),  # more and less than half the time between two readings
        ("input_delay", "delay", 0.0012, 0.0008),
        ("encoder_eccentricity", "eccentricity", 0.03, 0.5),
        ("gravity", "gravity_angle", -1.0, -2562.0),
        ("end_stop", "stop_upper", 2.9, 0.0),
        ("load_change", "load_time", 5.0, 0.2),
        ("thermal_fade", "fade", 0.2, -0.2),
    ):
        structure = Structure.of([*BASE, effect])
        cases = [prepared_recording.prepare_recording(turning, structure)]
        values = preparation.complete_values(structure, {"disturbance": 0.01, "fade": 0.1})
        for value, right in ((kept, True), (bent, False)):
            point = likelihood.evaluate(FitProblem(cases, process_noise=1.0), structure, {**values, name: value})
            assert is_plausible(FitProblem(cases), point) is right, (effect, value)


@pytest.mark.parametrize(("speed", "right"), [(0.1, True), (0.02, False)])  # 6.4 counts, and a quarter of one
def test_friction_that_falls_within_a_count_is_what_bristles_do(speed: float, right: bool) -> None:
    time = 0.002 * np.arange(5000)
    turning = Recording("turning", time, np.full(5000, 30.0), 3.0 * np.sin(time), "%", "rad", 3.1e-4)
    structure = Structure.of([*BASE, "stribeck_friction"])
    cases = [prepared_recording.prepare_recording(turning, structure)]
    friction = {"coulomb_friction": 0.2, "stribeck_friction": 2.3, "stribeck_velocity": speed}
    values = preparation.complete_values(structure, friction)
    assert (
        is_plausible(FitProblem(cases), likelihood.evaluate(FitProblem(cases, process_noise=1.0), structure, values))
        is right
    )


def test_what_a_first_model_has_and_the_rig_has_not_speaks_against_nothing_that_is_added() -> None:
    time = 0.002 * np.arange(5000)
    turning = Recording("turning", time, np.full(5000, 30.0), 3.0 * np.sin(time), "%", "rad", 1e-4)
    first = Structure.of([*BASE, "input_delay"])
    cases = [prepared_recording.prepare_recording(turning, first)]

    def at(structure: Structure, **values: float) -> Fit:
        return likelihood.evaluate(
            FitProblem(cases, process_noise=1.0),
            structure,
            preparation.complete_values(structure, {"delay": 2e-4, **values}),
        )

    for rest, right in ((1.0, True), (50.0, False)):
        longer = at(first.with_("spring"), spring_rest=rest)
        assert is_plausible(FitProblem(cases), longer, at(first)) is right and not is_plausible(
            FitProblem(cases), longer
        )
        # A delay that the addition has eaten up was one before.
        assert not is_plausible(FitProblem(cases), longer, at(first, delay=0.01))


def test_a_spring_that_is_bent_into_a_constant_is_no_rival_to_one() -> None:
    """It fits as well with its rest far outside the travel, and would halve the probability of what is there."""
    rng = np.random.default_rng(6)
    plain = Structure.of(["inertia", "viscous_friction", "dead_band"])
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
    time, count = 0.002 * np.arange(6000), 2.0 * np.pi / 16384.0
    duty = np.where(time % 1.0 < 0.5, steps(rng, len(time), 500, 40.0), 0.0)
    shaken = duty + 0.05 * rng.standard_normal(len(time))
    for planted in ({"offset": 0.3}, {"spring_stiffness": 0.3, "spring_rest": 0.5}):
        there = plain.with_("constant_offset" if "offset" in planted else "spring")
        y, _ = run(there, values | planted, time, shaken)
        recording = Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count)
        cases = [prepared_recording.prepare_recording(recording, plain)]
        before = local_optima.refit(
            FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.1)), plain, values
        )
        found = selection_round.run_round(FitProblem(cases), before, [], ("constant_offset", "spring"))
        assert found.won and found.rivals[0].added == there.named[-1:]
        assert (("spring",) in [h.added for h in found.rivals]) is ("offset" not in planted)


def test_where_a_recording_begins_is_no_stop() -> None:
    time = 0.002 * np.arange(2500)
    rising = Recording("rising", time, np.full(2500, 30.0), 3.0 * (1.0 - np.cos(time)), "%", "rad", 1e-4)
    structure = Structure.of([*BASE, "end_stop"])
    cases = [prepared_recording.prepare_recording(rising, structure)]
    values = preparation.complete_values(structure, {})
    for name, value, right in (
        ("stop_upper", 5.99, True), ("stop_lower", 0.001, False), ("stop_lower", -1.0, True), ("stop_upper", 7.0, True),
    ):  # fmt: skip
        point = likelihood.evaluate(FitProblem(cases, process_noise=1.0), structure, {**values, name: value})
        assert is_plausible(FitProblem(cases), point) is right, (name, value)
    # What is met at the other end is none the less for it.
    point = likelihood.evaluate(
        FitProblem(cases, process_noise=1.0), structure, {**values, "stop_lower": 0.001, "stop_upper": 5.99}
    )
    assert is_plausible(FitProblem(cases), point)


@pytest.mark.parametrize("lower", [-1e3, -0.3])
def test_a_stop_that_nothing_met_is_nowhere(lower: float) -> None:
    """At the furthest reading it would do nothing, either, but the next recording may go further."""
    rng = np.random.default_rng(12)
    stopped = Structure.of(["inertia", "viscous_friction", "dead_band", "end_stop"])
    values = {
        "input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0,
        "stop_stiffness": 8e3, "stop_damping": 30.0, "stop_hysteresis": 0.0, "stop_upper": 0.3, "stop_lower": lower,
    }  # fmt: skip
    time, count = 0.002 * np.arange(6000), 2.0 * np.pi / 16384.0
    duty = steps(rng, len(time), 400, 25.0)
    y, _ = run(stopped, values, time, duty + 0.05 * rng.standard_normal(len(time)))
    made = Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count)
    cases = [prepared_recording.prepare_recording(made, stopped)]
    begun = {**values, "stop_lower": max(lower, float(y.min()) + count)}
    last = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.1)), stopped, begun
    )
    found = growth.without_unmet_stops(FitProblem(cases), last)
    assert y.max() > 0.3 and (lower == -1e3 or y.min() < lower)
    assert found.values["stop_upper"] == pytest.approx(0.3, abs=2e-3)
    assert found.values["stop_lower"] == pytest.approx(lower, abs=2e-3)
    assert maximum_likelihood.to_model(FitProblem(cases), found, [made]).says("end_stop").count("none met") == (
        lower == -1e3
    )


def test_friction_that_acts_only_where_the_way_ends_is_a_stop() -> None:
    time = 0.002 * np.arange(2500)
    rising = Recording("rising", time, np.full(2500, 30.0), 1.5 * (1.0 - np.cos(time)), "%", "rad", 1e-4)
    structure = Structure.of([*BASE, "position_dependent_friction"])
    cases = [prepared_recording.prepare_recording(rising, structure)]
    values = {**preparation.complete_values(structure, {}), "coulomb_friction": 0.0, "friction_variation": 2.0}
    for angle, coulomb, right in ((0.0, 0.0, True), (-3.1, 0.0, False), (-3.1, 1.9, True)):
        tried = {**values, "friction_angle": angle, "coulomb_friction": coulomb}
        assert (
            is_plausible(FitProblem(cases), likelihood.evaluate(FitProblem(cases, process_noise=1.0), structure, tried))
            is right
        ), (angle, coulomb)


def test_a_weak_torque_shows_although_a_filter_that_forgets_fast_does_not_see_it() -> None:
    """Nothing rattles here, so that what a long memory says needs no second opinion."""
    rng = np.random.default_rng(21)
    plain = Structure.of(["inertia", "viscous_friction", "dead_band"])
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
    weak = {"spring_stiffness": 2e-4, "spring_rest": 0.5}
    time, count = 0.002 * np.arange(15000), 2.0 * np.pi / 16384.0
    duty = steps(rng, len(time), 300, 40.0)
    shaken = duty + 0.01 * rng.standard_normal(len(time))
    y, _ = run(plain.with_("spring"), values | weak, time, shaken)
    recording = Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count)
    cases = [prepared_recording.prepare_recording(recording, plain)]
    process_noise = filter_memory.process_noise_of(cases[0], 0.1)
    before = local_optima.refit(FitProblem(cases, process_noise=process_noise), plain, values)
    after = local_optima.refit(
        FitProblem(cases, process_noise=process_noise), plain.with_("spring"), {**before.values, **weak}
    )
    assert model_comparison.overdispersion([before, after]) < thresholds.WHITE_OVERDISPERSION
    smaller, larger = selection_round._refit_both(
        FitProblem(cases), before, after, filter_memory.process_noise_of(cases[0], 0.025)
    )
    assert not model_comparison.criterion_difference(larger, smaller) > 0.0
    assert selection_round.is_confirmed(FitProblem(cases), before, after)


def test_a_model_learns_nothing_from_one_that_is_no_longer_what_its_names_say() -> None:
    """A load that changed before the recording is another gain, and leaves no number its own size."""
    recording = Recording("made", 0.002 * np.arange(5000), np.zeros(5000), np.zeros(5000), "%", "rad", 1e-3)
    structure, nothing = Structure.of(BASE).with_("load_change"), np.eye(0)
    cases = [prepared_recording.prepare_recording(recording, structure)]

    def at(moment: float, deviance: float) -> fit.Fit:
        values = preparation.complete_values(structure, {"load_time": moment, "load_added": 0.5})
        return fit.Fit(structure, values, 1.0, (), deviance, 1.0, nothing, np.zeros(0), nothing)

    here, bent, learned = at(5.0, 0.0), at(-3.0, -900.0), at(6.0, -20.0)
    assert selection_round._better_plausible(FitProblem(cases), here, [bent, learned]) is learned
    assert selection_round._better_plausible(FitProblem(cases), here, [bent]) is here
    assert (
        selection_round._better_plausible(FitProblem(cases), bent, [at(-4.0, -950.0)]) is not bent
    )  # it was none before, either
    less = replace(bent, structure=Structure.of(BASE), values={}, deviance=1e6)
    assert growth.best_smaller(FitProblem(cases), here, [bent, less], less) is here


def test_what_the_first_model_has_stays_where_what_contains_it_goes() -> None:
    first = Structure.of([*BASE, "coulomb_friction"])
    smaller = growth.smaller_structures(first.with_("stribeck_friction"), first)
    assert [s.ids for s in smaller] == [first.ids]
    alone = growth.smaller_structures(first.with_("stribeck_friction"), Structure.of(BASE))
    assert {s.named for s in alone} == {("coulomb_friction",), ()}


def of_innovations(count: int, variance: float) -> fit.Fit:
    """A fit with so many innovations of one variance."""
    nothing = np.eye(0)
    deviance = count * (1.0 + np.log(variance))
    return fit.Fit(Structure.of(BASE), {}, 1.0, (), deviance, variance, nothing, np.zeros(0), nothing)


@pytest.mark.parametrize("removed", [0.5, 10.0, 1000.0])
@pytest.mark.parametrize("count", [2000, 50000])
def test_what_a_law_misses_of_its_own_effect_is_no_other_effect(removed: float, count: int) -> None:
    """Beside a law that took much variance away, another effect has to do more than that law may err by."""
    begun = of_innovations(count, 1.0 + removed)
    for times, is_other in ((0.9, False), (1.1, True)):
        # A law that errs by a twentieth, and an effect that makes up for so many times of its error.
        left = times * (removed * thresholds.LAW_TOLERANCE**2 + thresholds.MIN_GAIN / count)
        less, more = of_innovations(count, 1.0 + left), of_innovations(count, 1.0)
        kept = growth.best_smaller(FitProblem([]), more, [less, begun], begun)
        assert kept is (more if is_other else less)


def test_a_larger_model_is_never_behind_the_smaller_one_that_it_contains() -> None:
    """Where what is added does harm to the other filter, it is looked for from nothing, too: no slope leads out of a
    delay of a quarter of a second.
    """
    plain = Structure.of(["inertia", "viscous_friction"])
    values = {"input_gain": 0.4, "viscous_friction": 2.0}
    time, count = 0.002 * np.arange(3000), 2.0 * np.pi / 16384.0
    duty = steps(np.random.default_rng(8), len(time), 40, 40.0)
    read = count * np.round(run(plain, values, time, duty)[0] / count)
    made = Recording("made", time, duty, read, "%", "rad", count)
    problem = FitProblem([prepared_recording.prepare_recording(made, plain)])
    noises = [filter_memory.process_noise_of(problem.recordings[0], memory) for memory in (0.1, 0.05)]
    before = local_optima.refit(problem.at(noises[0]), plain, values)
    longer = plain.with_("input_delay")
    after = likelihood.evaluate(problem.at(noises[0]), longer, {**before.values, "delay": 0.25}, problem.free(longer))
    stuck = optimizer.levenberg_marquardt(problem.at(noises[1]), longer, after.values, after.free)
    smaller, larger = selection_round._refit_both(problem, before, after, noises[1])
    assert larger.structure == longer and stuck.deviance > smaller.deviance + 1000.0
    assert larger.deviance < smaller.deviance + 1.0


def test_a_rival_stands_where_another_does_with_its_own_effect() -> None:
    """What both share is taken over; what each has alone is its own, and nothing of the other's comes along. Of an axis
    at rest no fit moves the values.
    """
    base = Structure.of(["inertia", "viscous_friction", "dead_band"])
    still = Recording("still", 0.002 * np.arange(500), np.zeros(500), np.zeros(500), "%", "rad", 1e-4)
    problem = FitProblem([prepared_recording.prepare_recording(still, base)], process_noise=1.0)

    def with_effect(effect: str, **values: float) -> selection_round.Hypothesis:
        structure = base.with_(effect)
        full = preparation.complete_values(structure, values)
        return selection_round.Hypothesis(
            (effect,), likelihood.evaluate(problem, structure, full, problem.free(structure))
        )

    one = with_effect("motor_lag", input_gain=0.3, dead_band_forward=3.0, lag_time=0.01)
    other = with_effect("input_delay", input_gain=0.4, dead_band_forward=5.0, delay=0.02)
    moved = selection_round._fit_from_other(problem, one, other, base)
    assert moved.added == ("motor_lag",) and moved.point.structure == one.point.structure
    assert moved.point.values == {**one.point.values, "input_gain": 0.4, "dead_band_forward": 5.0}


@pytest.mark.parametrize("coasting", [False, True])
def test_dry_friction_may_be_one_sided_where_nothing_ever_coasts(coasting: bool) -> None:
    """A dead-band that is wider on one side does the same while the drive pushes; coasting tells them apart."""
    rng = np.random.default_rng(4)
    plain = Structure.of(["inertia", "viscous_friction", "dead_band", "coulomb_friction"])
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0,
              "coulomb_friction": 0.8}  # fmt: skip
    time, count = 0.002 * np.arange(6000), 2.0 * np.pi / 16384.0
    pushed = np.where(time // 0.7 % 2.0 < 1.0, 1.0, -1.0) * np.where(time // 2.8 % 2.0 < 1.0, 20.0, 35.0)
    duty = np.where(time % 0.7 < 0.35, pushed, 0.0) if coasting else pushed
    y, _ = run(plain, values, time, duty + 0.05 * rng.standard_normal(len(time)) * (duty != 0.0))
    cases = [
        prepared_recording.prepare_recording(
            Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count), plain
        )
    ]
    last = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.05)), plain, values
    )
    first = plain.without("coulomb_friction")
    wider = alternatives.containing(FitProblem(cases), last, first, CANDIDATES)
    rivals = {w.rival: w for w in wider}
    assert ("friction_asymmetry" in rivals) is not coasting
    if not coasting:
        found = rivals["friction_asymmetry"]
        assert abs(found.point.values["friction_asymmetry"]) == last.values["coulomb_friction"]
        assert model_comparison.criterion_difference(last, found.point) < 1.0
        # What is as good with a parameter more is not named for that.
        assert alternatives.prefer_containing(FitProblem(cases), last, [], wider) == (last, wider)
        # Neither what was not asked for nor what the first model knows comes into question.
        assert alternatives.containing(FitProblem(cases), last, first, ("spring",)) == []
        assert alternatives.containing(FitProblem(cases), last, plain, CANDIDATES) == []


@pytest.mark.parametrize("asymmetry", [0.0, 0.1])
def test_what_did_more_than_the_effect_that_it_contains_is_tried_at_its_own_size(asymmetry: float) -> None:
    """In a round of its own; the last model may have the plain effect, which everything else then competed beside."""
    rng = np.random.default_rng(4)
    plain = Structure.of(["inertia", "viscous_friction", "dead_band", "coulomb_friction", "gravity"])
    longer = plain.with_("friction_asymmetry")
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0,
              "coulomb_friction": 0.8, "gravity_gain": 2.0, "gravity_angle": 0.3,
              "friction_asymmetry": asymmetry}  # fmt: skip
    time, count = 0.002 * np.arange(6000), 2.0 * np.pi / 16384.0
    duty = np.where(time % 0.7 < 0.35, np.where(time // 0.7 % 2.0 < 1.0, 30.0, -30.0), 0.0)
    y, _ = run(longer, values, time, duty + 0.05 * rng.standard_normal(len(time)) * (duty != 0.0))
    cases = [
        prepared_recording.prepare_recording(
            Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count), longer
        )
    ]
    process_noise = filter_memory.process_noise_of(cases[0], 0.05)
    first, without, more = (
        local_optima.refit(FitProblem(cases, process_noise=process_noise), s, values)
        for s in (plain.without("coulomb_friction"), plain, longer)
    )
    rivals = [
        selection_round.Hypothesis(("friction_asymmetry",), more),
        selection_round.Hypothesis(("coulomb_friction",), without),
    ]
    rounds = [selection_round.Round(first, tuple(rivals), 1.0)]
    assert bool(alternatives.overtaking_fits(rounds, "coulomb_friction", "friction_asymmetry")) == bool(asymmetry)
    assert alternatives.overtaking_fits(rounds, "coulomb_friction", "stribeck_friction") == []
    wider = alternatives.containing(FitProblem(cases), without, first.structure, ["friction_asymmetry"], rounds)
    pairs = (("coulomb_friction", "load_dependent_friction"), ("gravity", "spring"))
    swaps = [search_result.Alternative(*pair, without) for pair in pairs]
    best, kept = alternatives.prefer_containing(FitProblem(cases), without, swaps, wider)
    if asymmetry:
        assert best.values["friction_asymmetry"] == pytest.approx(asymmetry, rel=0.05)
        # What could stand for the plain effect goes with it.
        assert [(w.effect, w.rival) for w in kept] == [pairs[1], ("friction_asymmetry", "coulomb_friction")]
        assert alternatives.containing(FitProblem(cases), without, first.structure, ["friction_asymmetry"]) == []
    else:
        assert best is without


def test_a_delay_is_judged_where_a_few_steps_from_its_start_lead() -> None:
    """Beside its valley a delay looks worse than none; what it promises is what it has once it is inside."""
    rng = np.random.default_rng(8)
    plain = Structure.of(["inertia", "viscous_friction", "dead_band"])
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
    time, count = 0.002 * np.arange(4000), 2.0 * np.pi / 16384.0
    duty = steps(rng, len(time), 150, 40.0)
    y, _ = run(plain.with_("input_delay"), values | {"delay": 0.001}, time, duty)
    cases = [
        prepared_recording.prepare_recording(
            Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count), plain
        )
    ]
    base = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.1)), plain, values
    )
    trials = [{"delay": t} for t in (0.006, 0.015)]
    longer = plain.with_("input_delay")
    begun = min(
        likelihood.evaluate(FitProblem(cases, process_noise=base.process_noise), longer, {**base.values, **t}).deviance
        for t in trials
    )
    free = (*base.free, "delay")
    promise, found = screening._direct_start(FitProblem(cases), FitProblem(cases), base, "input_delay", trials, free)
    assert begun > base.deviance
    assert found["delay"] == pytest.approx(0.001, abs=2e-4)
    assert promise > 0.9 * (
        base.deviance - local_optima.refit(FitProblem(cases, process_noise=base.process_noise), longer, found).deviance
    )


def fitted(deviance: float, *effects: str, unit: float = 1.0) -> fit.Fit:
    """A point that nothing was fitted for; a unit of its deviance is worth so little."""
    structure, normal, scatter = Structure.of([*BASE, *effects]), np.eye(1), np.eye(1) * unit
    return fit.Fit(structure, {"input_gain": 0.3}, 1.0, ("input_gain",), deviance, 1.0, normal, np.zeros(1), scatter)


def hypothesis(deviance: float, *effects: str, unit: float = 1.0) -> selection_round.Hypothesis:
    return selection_round.Hypothesis(effects[-1:], fitted(deviance, *effects, unit=unit))


def test_what_the_search_begins_anew_with_shows_by_itself_and_had_not_been_refused(monkeypatch) -> None:
    first, unit = fitted(0.0, unit=100.0), 20.0
    joint, delay = hypothesis(-6000.0, "joint_elasticity", unit=100.0), hypothesis(-3000.0, "input_delay", unit=unit)
    slow = hypothesis(-2500.0, "gravity", unit=unit)
    this = selection_round.Round(first, (joint, delay, slow), 100.0)
    found = search_result.SearchResult(first, joint.point, (this,), FitProblem(()))
    shown = {"input_delay", "gravity"}
    monkeypatch.setattr(
        selection_round, "is_confirmed", lambda cases, before, after: bool({*after.structure.named} & shown)
    )

    def begun(this: selection_round.Round, process_noise: float = 1.0) -> list[str]:
        rounds = forward_selection._narrow_rounds(FitProblem(()), replace(found, rounds=(this,)), process_noise)
        return [r.rivals[0].added[0] for r in rounds]

    assert begun(this) == ["input_delay", "gravity"]
    assert begun(replace(this, refused=frozenset({"input_delay"}))) == ["gravity"]
    assert begun(this, process_noise=2.0) == []
    assert begun(replace(this, won=False)) == []
    # A winner on credit has beaten nobody.
    assert begun(replace(this, rivals=(hypothesis(-1000.0, "joint_elasticity", unit=100.0), delay, slow))) == []
    wider = hypothesis(-9000.0, "coulomb_friction", "stribeck_friction", unit=unit)
    dry = hypothesis(-6000.0, "coulomb_friction", unit=unit)
    assert begun(replace(this, rivals=(dry, wider, slow))) == []
    shown.remove("input_delay")
    assert begun(this) == ["gravity"]
    # Who had won the round is a rival of what the search begins anew with.
    (anew,) = forward_selection._narrow_rounds(FitProblem(()), replace(found, rounds=(this,)), 1.0)
    contest = round_margin.margin_of([anew], slow.point.structure, "gravity")
    assert [h.added[0] for h, _ in contest.rivals] == ["joint_elasticity", "input_delay"]


@pytest.mark.parametrize("deviance", [-9000.0, -5000.0])
def test_the_end_that_lost_by_one_effect_could_stand_in_its_place(deviance: float) -> None:
    one, other = fitted(-6000.0, "gravity", "spring"), fitted(deviance, "gravity", "load_change")
    searches = [search_result.SearchResult(fitted(0.0), end, (), FitProblem(())) for end in (one, other)]
    found = forward_selection._better_search(FitProblem(()), *searches)
    best, lost, effect, rival = (one, other, "spring", "load_change")
    if deviance < -6000.0:
        best, lost, effect, rival = other, one, rival, effect
    assert found.last is best
    assert [(w.effect, w.rival) for w in found.alternatives] == [(effect, rival)] and found.alternatives[
        0
    ].point is lost
    # What is told already is not told twice, and ends that differ by more stand for no single effect.
    again = [replace(s, alternatives=(search_result.Alternative(effect, rival, lost),)) for s in searches]
    assert len(forward_selection._better_search(FitProblem(()), *again).alternatives) == 1
    longer = replace(searches[1], last=fitted(0.0, "gravity", "load_change", "motor_lag"))
    assert forward_selection._better_search(FitProblem(()), searches[0], longer) is searches[0]


@pytest.mark.parametrize("stiffness", [3e-4, 0.0])
def test_a_slow_torque_is_found_beside_a_fast_one_that_nobody_looks_for(monkeypatch, stiffness: float) -> None:
    """A shaking that is no candidate drowns within a tenth of a second what a weak spring does."""
    rng, count = np.random.default_rng(21), 2.0 * np.pi / 16384.0
    plain = Structure.of(["inertia", "viscous_friction", "dead_band"])
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
    there = {"disturbance": 4.0, "disturbance_frequency": 15.0, "disturbance_phase": 0.3}
    there |= {"spring_stiffness": stiffness, "spring_rest": 0.5}
    time = 0.002 * np.arange(15000)
    duty = steps(rng, len(time), 300, 40.0)
    y, _ = run(plain.with_("spring", "periodic_disturbance"), values | there, time, duty)
    cases = [
        prepared_recording.prepare_recording(
            Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count), plain
        )
    ]
    before = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], local_optima.MIN_MEMORY)),
        plain,
        values,
    )
    candidates = ("spring", "thermal_fade")
    lost = selection_round.run_round(FitProblem(cases), before, (), candidates)
    assert not lost.won
    # As if something faster still kept the filter that a recording asks for short.
    monkeypatch.setattr(optimizer, "most_likely_process_noise", lambda cases, structure, values, around: 2.0 * around)
    found = selection_round.retry_with_long_memory(FitProblem(cases), lost, candidates)
    if stiffness == 0.0:
        assert found is lost
    else:
        assert found.won and found.rivals[0].added == ("spring",)
        assert found.rivals[0].point.values["spring_stiffness"] == pytest.approx(stiffness, rel=0.1)


@pytest.mark.parametrize("friction", [2.0, 0.0])
def test_of_two_effects_that_hide_each_other_one_is_taken_on_credit(friction: float) -> None:
    """And none where a shaking that is no candidate hides it, so that there is no other one beside it to find."""
    count, time = 2.0 * np.pi / 8192.0, 0.002 * np.arange(7000)
    plain = Structure.of(["inertia", "viscous_friction", "dead_band"])
    values = {"input_gain": 0.22, "viscous_friction": 1.2, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
    there = {"gravity_gain": 2.0, "gravity_angle": 0.4, "coulomb_friction": friction}
    shaken = {"disturbance": 0.0 if friction else 4.0, "disturbance_frequency": 0.85, "disturbance_phase": 0.3}
    rise = np.geomspace(0.1, 8.0, len(time) // 2)
    duty = 60.0 * np.sin(2.0 * np.pi * 0.002 * np.cumsum(np.concatenate([rise, rise[::-1]])))
    full = plain.with_("gravity", "coulomb_friction", "periodic_disturbance")
    y, _ = run(full, values | there | shaken, time, duty)
    cases = [
        prepared_recording.prepare_recording(
            Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count), plain
        )
    ]
    before = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], local_optima.MIN_MEMORY)),
        plain,
        values,
    )
    problem = FitProblem(cases)
    gravity = selection_round.screen_candidates(problem, before, screening.trial_grids(problem, before, ["gravity"]))[0]
    assert not model_comparison.is_significant(before, gravity.point)
    # As if its gain were just what it must be to be looked behind.
    just = (before.deviance - gravity.deviance) / thresholds.MIN_GAIN
    lost = selection_round.Round(before, (gravity,), 0.99 * just, won=False)
    found = selection_round._won_with_second(FitProblem(cases), lost, ("gravity", "coulomb_friction"))
    assert found.won is bool(friction) and found.rivals == lost.rivals
    if friction:
        after = selection_round.run_round(FitProblem(cases), found.rivals[0].point, (), ("coulomb_friction",))
        best = after.rivals[0].point.values
        assert after.won and best["coulomb_friction"] == pytest.approx(friction, rel=0.01)
        assert best["gravity_gain"] == pytest.approx(2.0, rel=0.01)
    # What gained less is not looked behind.
    assert not selection_round._won_with_second(
        FitProblem(cases), replace(lost, overdispersion=1.01 * just), CANDIDATES
    ).won


@pytest.mark.parametrize("behind", [0.0, 1.0])
def test_a_lag_is_tried_on_the_other_side_of_the_dead_band(behind: float) -> None:
    """Whichever side a few steps had chosen; what acts on no side is left as it is."""
    count, time = 2.0 * np.pi / 16384.0, 0.002 * np.arange(4000)
    plain = Structure.of(["inertia", "viscous_friction", "dead_band"])
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 8.0, "dead_band_reverse": 5.0}
    full, there = plain.with_("motor_lag"), {"lag_time": 0.03, "lag_dead_band": behind}
    duty = steps(np.random.default_rng(5), len(time), 100, 30.0)
    y, _ = run(full, values | there, time, duty)
    cases = [
        prepared_recording.prepare_recording(
            Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count), plain
        )
    ]
    process_noise = filter_memory.process_noise_of(cases[0], local_optima.MIN_MEMORY)
    before = local_optima.refit(FitProblem(cases, process_noise=process_noise), plain, values)
    for side in (0.0, 1.0):
        begun = local_optima.refit(
            FitProblem(cases, process_noise=process_noise), full, values | there | {"lag_dead_band": side}
        )
        (other,) = selection_round._fit_on_other_gap_side(
            FitProblem(cases), before, selection_round.Hypothesis(("motor_lag",), begun)
        )
        assert other.point.values["lag_dead_band"] == 1.0 - side
        assert (other.deviance < begun.deviance) == (side != behind)
    delay = local_optima.refit(
        FitProblem(cases, process_noise=process_noise), plain.with_("input_delay"), values | {"delay": 0.03}
    )
    assert (
        selection_round._fit_on_other_gap_side(
            FitProblem(cases), before, selection_round.Hypothesis(("input_delay",), delay)
        )
        == []
    )
