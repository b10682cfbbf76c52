"""Laws are found in the missing torque, with their sizes and with what the base would do otherwise beside them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from twin.diagnosis import residual_torque, screening, torque_regression
from twin.effects.catalogue import BASE, CANDIDATES
from twin.estimation import filter_memory, preparation, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording
from twin.model.stepper import Structure

Array = NDArray[np.float64]
TIME = 0.002 * np.arange(15000)
#: A way to and fro over several turns, faster and slower, that is no law of its own derivatives.
PLACE = 9.0 * np.sin(0.9 * TIME) + 2.0 * np.sin(2.3 * TIME + 0.4) + 0.5 * np.sin(5.1 * TIME)
SPEED = np.gradient(PLACE, TIME)
COMMAND = 40.0 * np.sin(0.9 * TIME + 1.2) + 15.0 * np.sin(3.7 * TIME)
BEFORE = {
    "input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0,
    "backlash_gap": 0.02, "motor_share": 0.3, "friction_share": 0.5,
}  # fmt: skip
SIGN = np.sign(SPEED)

#: By hand, what each law adds to the torque, and the sizes that it does so with.
LAWS: dict[str, tuple[Callable[[], Array], dict[str, float]]] = {
    "coulomb_friction": (lambda: -1.5 * SIGN, {"coulomb_friction": 1.5}),
    "position_dependent_friction": (
        lambda: -SIGN * (2.0 + 1.2 * np.sin(PLACE - 0.7)),
        {"coulomb_friction": 2.0, "friction_variation": 1.2, "friction_angle": 0.7},
    ),
    "load_dependent_friction": (lambda: -SIGN * 0.15 * np.abs(0.4 * COMMAND), {"load_friction": 0.15}),
    "quadratic_drag": (lambda: -0.06 * SPEED * np.abs(SPEED), {"quadratic_drag": 0.06}),
    "gravity": (lambda: -1.7 * np.sin(PLACE + 0.6), {"gravity_gain": 1.7, "gravity_angle": -0.6}),
    "spring": (lambda: -0.3 * (PLACE - 1.4), {"spring_stiffness": 0.3, "spring_rest": 1.4}),
    "load_change": (
        lambda: -0.4 * np.gradient(SPEED, TIME) * (TIME > 12.0), {"load_added": 0.4, "load_time": 12.0}
    ),
    "torque_ripple": (
        lambda: 1.1 * np.sin(7.0 * PLACE - 2.0), {"ripple_torque": 1.1, "ripple_order": 7.0, "ripple_phase": 2.0}
    ),
    "periodic_disturbance": (
        lambda: 1.3 * np.sin(2.0 * np.pi * 1.9 * TIME - 1.0),
        {"disturbance": 1.3, "disturbance_frequency": 1.9, "disturbance_phase": 1.0},
    ),
}  # fmt: skip


def asked(question, torque: Array, seed: int = 0, **values: float):
    """What a question says where this torque (N,) is missing beside noise of a tenth of its size."""
    noise = 0.1 * float(np.std(torque)) * np.random.default_rng(seed).standard_normal(len(TIME))
    missing = residual_torque.MissingTorque(
        TIME, torque + noise, PLACE, SPEED, np.gradient(SPEED, TIME), COMMAND, 0.002
    )
    structure = Structure.of(BASE)
    case = prepared_recording.prepare_recording(Recording("made", TIME, COMMAND, PLACE, "%", "rad", 1e-4), structure)
    free, none = free_parameters(structure), np.zeros((0, 0))
    known = preparation.complete_values(structure, {**BEFORE, **values})
    base = Fit(structure, known, filter_memory.process_noise_of(case, 0.1), free, 0.0, 1.0, none, np.zeros(0), none)
    return question(FitProblem([case]), missing, base)


def found(torque: Array, seed: int = 0) -> list[torque_regression.TorqueFollower]:
    def ranked(
        problem: FitProblem, missing: residual_torque.MissingTorque, base: Fit
    ) -> list[torque_regression.TorqueFollower]:
        return torque_regression.ranked_by_torque(
            missing, base, screening.trials_for_torque(problem, missing, base, CANDIDATES)
        )

    return asked(ranked, torque, seed)


@pytest.mark.parametrize("effect", LAWS)
def test_each_law_is_found_with_its_sizes_beside_what_the_base_has_wrong(effect):
    """The base pushes a tenth too little, from dead-bands that are too wide, and brakes too much."""
    law, sizes = LAWS[effect]
    pushes = np.where(COMMAND > 0.0, 0.44 * (COMMAND - 3.0), 0.44 * (COMMAND + 3.5))
    does = np.where(COMMAND > 0.0, 0.4 * (COMMAND - 5.0), 0.4 * (COMMAND + 4.0))
    follower = next(f for f in found(law() + pushes - does + 0.5 * SPEED) if f.effect == effect)
    for place in follower.places:
        near = {n: place[n] for n in sizes}
        assert near == pytest.approx(sizes, rel=0.15, abs=0.05)
        assert place["input_gain"] == pytest.approx(0.44, rel=0.05)
        assert place["viscous_friction"] == pytest.approx(1.5, rel=0.1)
    on_either_side = {"dry_share", "shaft_share"} & set(follower.places[0])
    assert len(follower.places) == (2 if on_either_side else 1)


@pytest.mark.parametrize("effect", LAWS)
def test_the_law_that_is_there_comes_first(effect):
    """What contains it can do no less, and has no more to foretell; over whole turns gravity is a ripple, too."""
    law, _ = LAWS[effect]
    best = found(law())
    own = next(f for f in best if f.effect == effect)
    assert own.share > best[0].share - 0.01
    others = [f for f in best if f.share > own.share - 0.01 and f.effect not in (effect, "torque_ripple")]
    assert all(effect in f.structure for f in others)


def test_of_two_that_mask_each_other_each_is_seen_beside_the_other():
    torque = LAWS["position_dependent_friction"][0]() + LAWS["torque_ripple"][0]()
    assert {"position_dependent_friction", "torque_ripple"} <= {f.effect for f in found(torque)}


@settings(max_examples=15, deadline=None)
@given(
    gain=st.floats(-0.1, 0.2), forward=st.floats(-2.0, 2.0), constant=st.floats(-1.0, 1.0),
    braking=st.floats(-1.0, 1.0), seed=st.integers(0, 99),
)  # fmt: skip
def test_what_the_base_can_do_itself_is_followed_by_nothing(gain, forward, constant, braking, seed):
    """A constant torque, too, as long as the drive pushes: dead-bands that differ."""
    torque = gain * COMMAND - forward * (COMMAND > 0.0) + constant - braking * SPEED
    if float(np.std(torque)) > 0.01:
        assert found(torque, seed) == []


def test_noise_and_an_axis_at_rest_are_followed_by_nothing(monkeypatch):
    noise = np.random.default_rng(3).standard_normal(len(TIME))
    assert found(noise) == []
    monkeypatch.setitem(globals(), "SPEED", np.zeros(len(TIME)))
    assert found(noise) == []


def levels(forward: float, reverse: float) -> list[dict[str, float]]:
    return asked(
        lambda problem, missing, base: torque_regression.offset_starts(base, CANDIDATES), COMMAND,
        dead_band_forward=forward, dead_band_reverse=reverse,
    )  # fmt: skip


@pytest.mark.parametrize(("forward", "reverse"), [(0.0, 9.0), (8.0, 0.2)])
def test_where_one_dead_band_has_gone_a_constant_torque_begins_at_what_they_differ_by(forward, reverse):
    places = levels(forward, reverse)
    assert [p["shaft_share"] for p in places] == [0.0, 1.0]
    pushing = COMMAND[np.abs(COMMAND) > 10.0]
    pushed = 0.4 * np.where(pushing > 0.0, pushing - forward, pushing + reverse)
    for p in places:
        equal = p["dead_band_forward"]
        assert p["dead_band_reverse"] == equal
        levelled = 0.4 * np.where(pushing > 0.0, pushing - equal, pushing + equal) + p["offset"]
        np.testing.assert_allclose(levelled, pushed, atol=1e-9)


@pytest.mark.parametrize(("forward", "reverse"), [(3.0, 9.0), (0.0, 0.0)])
def test_a_drive_with_dead_bands_on_both_sides_or_none_needs_no_constant_torque(forward, reverse):
    assert levels(forward, reverse) == []


def test_a_drive_that_a_fit_took_for_none_is_seen_where_the_axis_moves_freely():
    """Where it is held, by stops at both ends here, a torque of any size is missing."""
    pushes = np.where(COMMAND > 0.0, 0.4 * np.maximum(COMMAND - 5.0, 0.0), 0.4 * np.minimum(COMMAND + 4.0, 0.0))
    held = np.where(np.abs(PLACE) > 0.97 * np.abs(PLACE).max(), -30.0 * np.sign(PLACE), 0.0)
    free = asked(
        torque_regression.fit_to_free_motion, pushes - 2.0 * SPEED + held, input_gain=0.001, viscous_friction=0.001
    )
    assert free.values["input_gain"] == pytest.approx(0.4, rel=0.1)
    assert free.values["viscous_friction"] == pytest.approx(2.0, rel=0.15)
    assert free.free == free_parameters(free.structure)


def test_a_drive_that_does_nothing_at_all_is_freed_too():
    pushes = 0.4 * COMMAND
    free = asked(
        torque_regression.fit_to_free_motion, pushes, input_gain=0.0, dead_band_forward=0.0, dead_band_reverse=0.0
    )
    assert free.values["input_gain"] == pytest.approx(0.4, rel=0.1)
    assert asked(torque_regression.fit_to_free_motion, -pushes, input_gain=0.0) is None, "no drive pushes backwards"
    assert all(np.isfinite(v) for f in found(-pushes) for p in f.places for v in p.values())


@settings(max_examples=15, deadline=None)
@given(gain=st.floats(-0.1, 0.4), constant=st.floats(-1.0, 1.0), seed=st.integers(0, 99))
def test_a_base_that_is_about_right_is_left_as_it_is(gain, constant, seed):
    assert asked(torque_regression.fit_to_free_motion, gain * COMMAND + constant, seed) is None
