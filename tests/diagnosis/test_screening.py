"""Where a candidate begins: lines of the missing torque are found wherever they lie."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from axis_runs import run, steps
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.diagnosis import residual_torque, screening, selection_round
from twin.diagnosis.plausibility import is_plausible
from twin.effects.catalogue import CANDIDATES
from twin.estimation import filter_memory, likelihood, local_optima, multistart, preparation, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model import equations
from twin.model.stepper import Structure


def model_at(problem: FitProblem, structure: Structure, values: Mapping[str, float]) -> Fit:
    """The model with these values, not fitted."""
    return likelihood.evaluate(problem.at(1.0), structure, preparation.complete_values(structure, values))


def grids_beside(
    missing: residual_torque.MissingTorque, recording: Recording, structure: Structure
) -> dict[str, list[dict[str, float]]]:
    """What is tried of each candidate where this torque is missing."""
    problem = FitProblem([prepared_recording.prepare_recording(recording, structure)])
    return screening.trials_for_torque(problem, missing, model_at(problem, structure, {}))


def tried_beside(
    missing: residual_torque.MissingTorque, recording: Recording, structure: Structure, effect: str, name: str
) -> list[float]:
    """What is tried of a candidate's parameter where this torque is missing."""
    return [row[name] for row in grids_beside(missing, recording, structure)[effect]]


def lines(position, torque, effect: str, name: str, unit: str = "rad", pushed=None) -> list[float]:
    """What is tried of a candidate's rate where this torque (N,) is missing at these positions (N,), every 2 ms, under
    such a command (N,).
    """
    time = 0.002 * np.arange(len(torque))
    structure = Structure.of(["inertia", "viscous_friction", "dead_band"])
    duty = np.where(time % 1.0 < 0.5, 30.0, 0.0) if pushed is None else pushed
    speed = np.gradient(position, time)
    missing = residual_torque.MissingTorque(time, torque, position, speed, np.gradient(speed, time), duty, 0.002)
    return tried_beside(missing, Recording("made", time, duty, position, "%", unit, 1e-4), structure, effect, name)


@pytest.mark.parametrize("end", [0.5, 30.0, 30000.0])
@pytest.mark.parametrize("ids", [("inertia", "dead_band"), ("inertia", "viscous_friction", "dead_band")])
def test_every_candidate_is_tried_however_long_the_recording(end: float, ids: tuple[str, ...]) -> None:
    """A fade within its bounds, and also beside a first model that knows no viscous friction."""
    time, structure = np.linspace(0.0, end, 2001), Structure.of(ids)
    wave = np.sin(20.0 * np.pi * time / end)
    recording = Recording("made", time, 30.0 * wave, 5.0 * wave, "%", "rad", 1e-4)
    missing = residual_torque.MissingTorque(time, wave, 5.0 * wave, wave, wave, 30.0 * wave, float(time[1]))
    tried = grids_beside(missing, recording, structure)
    assert set(tried) == set(CANDIDATES) and all(tried.values())
    times = [row["fade_time"] for row in tried["thermal_fade"]]
    assert all(1.0 <= t <= 3600.0 for t in times) and len(times) == len(set(times))


def test_what_depends_on_the_position_is_looked_for_along_the_way_where_a_speed_is_read() -> None:
    """A ripple of ten times a turn over eight turns, and stops that no reading went beyond."""
    structure = Structure.of(["inertia", "viscous_friction", "dead_band"])
    there = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
    time = 0.002 * np.arange(15000)
    duty = np.full(len(time), 13.5) + steps(np.random.default_rng(2), len(time), 500, 1.0)
    wave = {"ripple_torque": 0.5, "ripple_order": 10.0, "ripple_phase": 0.4}
    y, states = run(structure.with_("torque_ripple"), there | wave, time, duty)
    speed = states[:, 1]
    assert 40.0 < np.ptp(y) < 60.0 and np.ptp(speed) < 2.0
    case = prepared_recording.prepare_recording(Recording("made", time, duty, speed, "%", "rad/s", 1e-4), structure)
    assert np.abs(case.positions - (y - y[0])).max() < 0.01 * np.ptp(y)
    tried = screening.trial_grids(FitProblem([case]), model_at(FitProblem([case]), structure, there))
    assert min(abs(row["ripple_order"] - 10.0) for row in tried["torque_ripple"]) < 0.2
    for row in tried["end_stop"]:
        assert row["stop_upper"] > 0.9 * np.ptp(y) and row["stop_lower"] < 0.1 * np.ptp(y)
    fitted = local_optima.refit(
        FitProblem([case], process_noise=filter_memory.process_noise_of(case, local_optima.MIN_MEMORY)),
        structure,
        there,
    )
    longer = local_optima.refit(
        FitProblem([case], process_noise=fitted.process_noise), structure.with_("torque_ripple"), there | wave
    )
    assert is_plausible(FitProblem([case]), longer)


def noisy(wave) -> np.ndarray:
    return wave + 3.0 * np.random.default_rng(1).standard_normal(len(wave))


def recorded(structure: Structure, values, time, duty, shaken, per_turn: float) -> Recording:
    """What an encoder reads of a run under the command as it was shaken, beside the command as it was meant."""
    y, _ = run(structure, values, time, shaken)
    count = 2.0 * np.pi / per_turn
    return Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count)


@settings(max_examples=30, deadline=None)
@given(end=st.floats(10.0, 120.0), frequency=st.floats(0.5, 24.0), phase=st.floats(0.0, 6.0))
def test_a_disturbance_is_looked_for_at_its_own_frequency_however_long_the_recording(end, frequency, phase) -> None:
    """A line is as narrow as the recording is long; a climb finds it from within a quarter of that width."""
    time = np.arange(0.0, end, 0.002)
    wave = np.sin(2.0 * np.pi * frequency * time + phase)
    found = lines(np.sin(time), noisy(wave), "periodic_disturbance", "disturbance_frequency")
    assert abs(found[0] - frequency) <= 0.26 / end


@pytest.mark.parametrize("order", [7, 23, 58])
def test_a_ripple_on_whole_turns_is_looked_for_in_whole_numbers(order) -> None:
    position = 25.0 * np.sin(0.4 * 0.002 * np.arange(10000))
    found = lines(position, noisy(np.sin(order * position + 1.0)), "torque_ripple", "ripple_order")
    assert found[0] == pytest.approx(order)


@pytest.mark.parametrize("order", [7, 31, 58])
def test_a_ripple_of_the_motor_is_looked_for_although_its_gap_turns_it_around(order) -> None:
    """Half a gap ahead of the link under one push and behind it under the other, so that both cancel over its angle."""
    time = 0.002 * np.arange(10000)
    position, push = 9.0 * np.sin(0.4 * time), np.where(time % 2.0 < 1.0, 30.0, -30.0)
    wave = np.sin(order * position + 1.0) * np.sign(push)
    found = lines(position, noisy(wave), "torque_ripple", "ripple_order", pushed=push)
    assert order in np.round(found, 6)
    assert order not in np.round(lines(position, noisy(wave), "torque_ripple", "ripple_order", pushed=abs(push)), 6)


@pytest.mark.parametrize("order", [40.0, 137.0, 290.0])
@pytest.mark.parametrize(("unit", "travel"), [("rad", 0.6), ("m", 6.0)])
def test_a_ripple_on_a_short_or_linear_travel_is_looked_for_anywhere(order, unit, travel) -> None:
    """A linear axis has no turn; neither has one that moves by less than half of one."""
    position = 0.5 * travel * np.sin(0.4 * 0.002 * np.arange(20000))
    rate = 0.6 * order / travel
    found = lines(position, noisy(np.sin(rate * position + 1.0)), "torque_ripple", "ripple_order", unit)
    assert min(abs(f - rate) for f in found) <= 0.26 * 2.0 * np.pi / travel


def test_a_ripple_that_is_seen_twice_is_looked_for() -> None:
    """One that is allowed to be named has to be tried."""
    position = 1.1 * np.sin(0.4 * 0.002 * np.arange(20000))
    found = lines(position, noisy(np.sin(7.0 * position + 1.0)), "torque_ripple", "ripple_order")
    assert 2.0 < 7.0 * np.ptp(position) / (2.0 * np.pi) < 2.6
    assert min(abs(f - 7.0) for f in found) <= 0.26 * 2.0 * np.pi / np.ptp(position)


def test_where_nothing_is_missing_there_is_something_to_try_all_the_same() -> None:
    position = np.sin(0.002 * np.arange(5000))
    assert lines(position, np.zeros(5000), "torque_ripple", "ripple_order")
    assert lines(position, np.zeros(5000), "periodic_disturbance", "disturbance_frequency", "m")


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize(
    ("effect", "law"),
    [
        ("constant_offset", {"offset": 0.8}),
        ("torque_ripple", {"ripple_torque": 1.5, "ripple_order": 23.0, "ripple_phase": 0.4}),
    ],
)
def test_a_torque_is_looked_for_on_the_motor_and_on_the_link(effect, law, share) -> None:
    """Across the gap they are apart: a motor that is pulled shows otherwise than a link, and cogs at another angle."""
    structure = preparation.base_structure()
    values = {
        "input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0,
        "backlash_gap": 0.06, "motor_share": 0.3, "friction_share": 0.6, "tooth_frequency": 90.0, "tooth_damping": 0.4,
    }  # fmt: skip
    rng = np.random.default_rng(9)
    time = 0.002 * np.arange(5000)
    duty = steps(rng, len(time), 150, 40.0)
    shaken = duty + 0.1 * rng.standard_normal(len(time))
    made = recorded(structure.with_(effect), values | law | {"shaft_share": share}, time, duty, shaken, 16384.0)
    cases = preparation.prepare_recordings([made], structure).recordings
    before = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.05)), structure, values
    )
    trials = screening.trial_grids(FitProblem(cases), before)
    (entry,) = screening.score_candidates(FitProblem(cases), before, {effect: trials[effect]})
    begun = screening.most_likely_values(
        FitProblem(cases, process_noise=before.process_noise), entry.structure, entry.places
    )
    found = local_optima.refit(FitProblem(cases, process_noise=before.process_noise), entry.structure, begun)
    assert found.values["shaft_share"] == pytest.approx(share, abs=0.15)
    name, size = next(iter(law.items()))
    assert found.values[name] == pytest.approx(size, rel=0.1)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_torque_that_dead_bands_had_taken_over_is_found_on_its_own_side_of_the_gap(share) -> None:
    """Half on either side it promises a tenth of what it does on the motor, and climbs to the link."""
    structure = preparation.base_structure()
    values = {
        "input_gain": 0.089, "viscous_friction": 3.0, "dead_band_forward": 5.4, "dead_band_reverse": 5.8,
        "backlash_gap": 0.038, "motor_share": 0.33, "friction_share": 0.68, "tooth_frequency": 110.0,
        "tooth_damping": 0.4,
    }  # fmt: skip
    law = {"offset": -0.16, "shaft_share": share}
    time = 0.002 * np.arange(5000)
    duty = 40.0 * np.sin(2.0 * np.pi * (0.2 + 0.2 * time) * time)
    shaken = duty + 0.1 * np.random.default_rng(0).standard_normal(len(time))
    made = recorded(structure.with_("constant_offset"), values | law, time, duty, shaken, 10000.0)
    cases = preparation.prepare_recordings([made], structure).recordings
    before = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.1)), structure, values
    )
    trials = screening.trial_grids(FitProblem(cases), before, ["constant_offset"])["constant_offset"]
    (entry,) = screening.score_candidates(FitProblem(cases), before, {"constant_offset": trials})
    begun = screening.most_likely_values(
        FitProblem(cases, process_noise=before.process_noise), entry.structure, entry.places
    )
    found = local_optima.refit(FitProblem(cases, process_noise=before.process_noise), entry.structure, begun)
    assert found.values["shaft_share"] == pytest.approx(share, abs=0.1)
    assert found.values["offset"] == pytest.approx(law["offset"], rel=0.1)


def test_what_many_promise_in_shared_runs_is_what_each_does_in_its_own(monkeypatch) -> None:
    """Over several turns: of the smallest friction that varies with the angle some would push, which is none."""
    structure = preparation.base_structure()
    values = {
        "input_gain": 3.0, "viscous_friction": 3.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0,
        "backlash_gap": 0.03, "motor_share": 0.4, "friction_share": 0.6, "tooth_frequency": 60.0, "tooth_damping": 0.5,
    }  # fmt: skip
    time = 0.002 * np.arange(6000)
    duty = 40.0 * np.sin(2.0 * np.pi * (0.2 + 0.1 * time) * time)
    law = {"coulomb_friction": 0.4, "dry_share": 0.5, "gravity_gain": 0.5, "gravity_angle": 0.3}
    made = recorded(structure.with_("coulomb_friction", "gravity"), values | law, time, duty, duty, 40000.0)
    cases = preparation.prepare_recordings([made], structure).recordings
    before = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.1)), structure, values
    )
    rows = screening.trial_grids(FitProblem(cases), before)
    rows = {e: tried for e, tried in rows.items() if e not in screening.WITHOUT_SCORE_TEST}
    runs = []
    run = likelihood.evaluate
    monkeypatch.setattr(likelihood, "evaluate", lambda *given: runs.append(given) or run(*given))
    together = {e.effect: e.promised_gain for e in screening.score_candidates(FitProblem(cases), before, rows)}
    shared = len(runs)
    alone = {}
    for effect, tried in rows.items():
        alone[effect] = max(
            screening.score_candidates(FitProblem(cases), before, {effect: [row]})[0].promised_gain for row in tried
        )
    assert len(together) == len(rows) and shared < 0.5 * (len(runs) - shared)
    # An impact that comes an instant earlier is worth a unit either way.
    assert max(together.values()) > 9.0 * before.overdispersion
    assert together == pytest.approx(alone, rel=0.05, abs=2.0 * before.overdispersion)


def test_a_side_of_the_gap_that_is_known_is_not_asked_again() -> None:
    structure = preparation.base_structure()
    time = 0.002 * np.arange(2000)
    duty = 30.0 * np.sin(time)
    made = recorded(structure, {"input_gain": 0.4, "viscous_friction": 2.0}, time, duty, duty, 4096.0)
    cases = preparation.prepare_recordings([made], structure).recordings
    open_, known = structure.with_("gravity"), structure.with_("torque_ripple", "coulomb_friction")
    for base, sides in ((open_, 2), (known, 1)):
        rows = screening.trial_grids(FitProblem(cases), model_at(FitProblem(cases), base, {}))
        assert len(rows["constant_offset"]) == len(rows["friction_asymmetry"]) == sides
        assert len(rows["spring"]) == 1, "a spring pulls at the link"


def test_a_fade_is_measured_by_the_current_that_a_turning_motor_draws() -> None:
    """Four fifths are back-EMF: of what it draws when held, 1.8 at a reversal, and 0.2 once it is up to speed."""
    rate, half = 4.0, 4.0
    time = 0.002 * np.arange(20000)
    command = np.where(time % (2.0 * half) < half, 40.0, -40.0)
    values = {"input_gain": 0.4, "viscous_friction": rate}
    _, states = run(Structure.of(["inertia", "viscous_friction"]), values, time, command)
    speed, nothing = states[:, 1], np.zeros(len(time))
    missing = residual_torque.MissingTorque(time, nothing, states[:, 0], speed, nothing, command, 0.002)
    # The mean of (0.2 + 1.6 exp(-rate t))^2 over half a period.
    squared = 0.04 + (2.0 * 0.2 * 1.6 / rate + 1.6**2 / (2.0 * rate)) / half
    assert screening._heating_command(missing, values, 40.0) == pytest.approx(40.0 * np.sqrt(squared), rel=0.05)
    # One that is held draws all that its command asks for; of a model that nothing moves no more is known.
    held = residual_torque.MissingTorque(time, nothing, nothing, nothing, nothing, command, 0.002)
    for gain in (0.4, 0.0):
        assert screening._heating_command(held, values | {"input_gain": gain}, 40.0) == pytest.approx(40.0)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_strong_ripple_is_found_from_where_it_follows_what_is_missing(seed) -> None:
    """From nothing the slopes lead to a small ripple out of phase: the link has gone round it by then."""
    structure = preparation.base_structure()
    values = {
        "input_gain": 2.2, "viscous_friction": 6.0, "dead_band_forward": 10.7, "dead_band_reverse": 12.0,
        "backlash_gap": 0.015, "motor_share": 0.3, "friction_share": 0.8, "tooth_frequency": 99.0, "tooth_damping": 0.4,
    }  # fmt: skip
    ripple = {"ripple_torque": 26.0, "ripple_order": 19.0, "ripple_phase": 0.6, "shaft_share": 0.3}
    rng = np.random.default_rng(seed)
    time = 0.002 * np.arange(10000)
    rates, phases = 2.0 * np.pi * np.array([0.13, 0.41, 1.1]), rng.uniform(0.0, 6.0, 3)
    duty = 30.0 * np.sin(np.outer(time, rates) + phases).sum(axis=1)
    shaken = duty + 0.3 * rng.standard_normal(len(time))
    made = recorded(
        preparation.with_tooth_compliance(structure).with_("torque_ripple"), values | ripple, time, duty, shaken, 4096.0
    )
    problem, rough = multistart.coarse_starts([made], structure, {})
    cases = problem.recordings
    before = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.1)),
        structure,
        values | rough[0].values,
    )
    missing = residual_torque.missing_torque(cases[0], before.structure, before.values)
    trials = screening.trials_for_torque(FitProblem(cases), missing, before, ["torque_ripple"])
    found = min(selection_round._fit_followers(FitProblem(cases), before, missing, trials), key=lambda h: h.deviance)
    assert found.point.values["ripple_order"] == pytest.approx(19.0, abs=0.1)
    assert found.point.values["ripple_torque"] == pytest.approx(26.0, rel=0.1)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_lag_is_looked_for_ahead_of_the_dead_band_and_behind_it(share) -> None:
    """A filter of the command crosses the dead-band late, one of the torque does not: no climb leads between them."""
    structure = preparation.base_structure()
    values = {
        "input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 8.0, "dead_band_reverse": 9.0,
        "backlash_gap": 0.03, "motor_share": 0.3, "friction_share": 0.6, "tooth_frequency": 90.0, "tooth_damping": 0.4,
    }  # fmt: skip
    rng = np.random.default_rng(5)
    time = 0.002 * np.arange(7500)
    duty = steps(rng, len(time), 150, 45.0)
    lag = {"lag_time": 0.05, "lag_dead_band": share}
    shaken = duty + 0.1 * rng.standard_normal(len(time))
    made = recorded(
        preparation.with_tooth_compliance(structure).with_("motor_lag"), values | lag, time, duty, shaken, 16384.0
    )
    problem, rough = multistart.coarse_starts([made], structure, {})
    cases = problem.recordings
    before = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.1)), structure, rough[0].values
    )
    trials = screening.trial_grids(FitProblem(cases), before)["motor_lag"]
    (entry,) = screening.score_candidates(FitProblem(cases), before, {"motor_lag": trials})
    begun = screening.most_likely_values(
        FitProblem(cases, process_noise=before.process_noise), entry.structure, entry.places
    )
    found = local_optima.refit(FitProblem(cases, process_noise=before.process_noise), entry.structure, begun)
    assert found.values["lag_dead_band"] == share
    assert found.values["lag_time"] == pytest.approx(0.05, rel=0.03)


def test_a_candidate_moves_nothing_that_is_held() -> None:
    structure = preparation.base_structure()
    values = {
        "input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0,
        "backlash_gap": 0.06, "motor_share": 0.3, "friction_share": 0.6, "tooth_frequency": 90.0, "tooth_damping": 0.4,
    }  # fmt: skip
    time = 0.002 * np.arange(3000)
    duty = steps(np.random.default_rng(4), len(time), 200, 40.0)
    y, _ = run(preparation.with_tooth_compliance(structure), values, time, duty)
    cases = preparation.prepare_recordings([Recording("made", time, duty, y, "%", "rad", 1e-4)], structure).recordings
    known = {n: values[n] for n in ("backlash_gap", "motor_share")}
    before = local_optima.refit(
        FitProblem(cases, known, process_noise=filter_memory.process_noise_of(cases[0], 0.1)), structure, values
    )
    trials = screening.trial_grids(FitProblem(cases, known), before)["joint_elasticity"]
    assert all(known.keys() <= row.keys() for row in trials)
    (entry,) = screening.score_candidates(FitProblem(cases, known), before, {"joint_elasticity": trials})
    assert all(known.items() <= place.items() for place in entry.places)


@pytest.mark.parametrize(
    ("effect", "law", "parts"),
    [
        ("input_delay", {"delay": 0.004}, True),
        ("end_stop", {"stop_upper": 6.0, "stop_lower": -1e3, "stop_stiffness": 2e4, "stop_damping": 60.0}, False),
    ],
)
def test_a_start_is_looked_for_in_parts_of_a_long_recording_unless_it_lies_at_a_place(
    monkeypatch, effect, law, parts
) -> None:
    """A stop is met between two of the parts, and found; a delay, which acts all the time, needs less than half."""
    structure = Structure.of(["inertia", "viscous_friction", "dead_band"])
    values = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
    time, count = 0.002 * np.arange(45000), 2.0 * np.pi / 16384.0
    duty = 20.0 * np.sin(3.0 * time) + 40.0 * ((time > 16.0) & (time < 18.0)) - 40.0 * ((time > 19.0) & (time < 21.0))
    y, _ = run(structure.with_(effect), values | law, time, duty)
    made = Recording("made", time, duty, np.round(y / count) * count, "%", "rad", count)
    cases = [prepared_recording.prepare_recording(made, structure)]
    before = local_optima.refit(
        FitProblem(cases, process_noise=filter_memory.process_noise_of(cases[0], 0.1)), structure, values
    )
    read, evaluate = [], likelihood.evaluate

    def looked(seen, *rest):
        read.append(sum(len(case.drive.time) for case in seen.recordings))
        return evaluate(seen, *rest)

    monkeypatch.setattr(likelihood, "evaluate", looked)
    trials = screening.trial_grids(FitProblem(cases), before)[effect]
    (entry,) = screening.score_candidates(FitProblem(cases), before, {effect: trials})
    assert (np.mean(read) < 0.5 * len(time)) == parts
    found = local_optima.refit(FitProblem(cases, process_noise=before.process_noise), entry.structure, entry.places[0])
    name, size = next(iter(law.items()))
    assert found.values[name] == pytest.approx(size, rel=0.02)
    assert entry.promised_gain > 0.8 * (before.deviance - found.deviance)


#: A law of one place or time, and how near the likeliest trial has to be to what was planted.
LOCAL = {
    "disturbance_pulse": ({"pulse_torque": -2.0, "pulse_start": 21.0, "pulse_length": 3.0}, "pulse_start", 1.5),
    "sticky_sector": ({"sector_friction": 2.0, "sector_angle": 0.9, "sector_width": 0.3}, "sector_angle", 0.2),
    "detent": (
        {"detent_torque": 2.0, "detent_angle": -1.1, "detent_width": 0.2, "detent_order": 1.0}, "detent_angle", 0.1,
    ),
}  # fmt: skip


@pytest.mark.parametrize("effect", LOCAL)
@pytest.mark.parametrize("travel", [3.0, 12.0])
def test_what_acts_at_one_place_is_tried_where_the_missing_torque_shows_it(effect: str, travel: float) -> None:
    """Within less than a turn and over several, under noise as large as the effect."""
    planted, name, near = LOCAL[effect]
    rng = np.random.default_rng(3)
    time = 0.002 * np.arange(20000)
    position = 0.5 * travel * np.sin(0.7 * time) * np.cos(0.045 * time)
    velocity = np.gradient(position, time)
    states = {"position": position, "velocity": velocity, "time": time, "direction": np.sign(velocity)}
    law = equations.along(effect, states, {**screening.neutral_values(effect), **planted})
    torque = (-np.sign(velocity) * law if effect == "sticky_sector" else law) + rng.normal(0.0, 2.0, len(time))
    command = 30.0 * np.sign(velocity)
    missing = residual_torque.MissingTorque(time, torque, position, velocity, velocity, command, 0.002)
    structure = Structure.of(["inertia", "viscous_friction", "dead_band"])
    recording = Recording("made", time, command, position, "%", "rad", 1e-4)
    tried = tried_beside(missing, recording, structure, effect, name)
    assert abs((tried[0] - planted[name] + np.pi) % (2.0 * np.pi) - np.pi) < near
