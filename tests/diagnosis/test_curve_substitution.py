"""Torques over the position that cancel each other are one curve."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from axis_runs import SANE, run, steps
from scipy.interpolate import interp1d

from twin.diagnosis import curve_substitution, diagnose, nonparametric, thresholds
from twin.diagnosis.nonparametric import CurveTerm
from twin.effects.catalogue import CANDIDATES
from twin.effects.knots import KNOTS, names, spots, through
from twin.estimation import likelihood, optimizer, preparation, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording
from twin.model.stepper import Structure

STRUCTURE = Structure.of(("inertia", "viscous_friction", "dead_band"))
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
BOTH = STRUCTURE.with_("gravity", "spring")
COUNT = 2.0 * np.pi / 16384
STIFFENING = 0.8  # 1/(rad^2 s^2): torque over inertia is this times the cube of the angle
#: The cube at twelve knots.
SPOTS = np.linspace(-2.0, 2.0, KNOTS)
CURVE = through("unknown_position", SPOTS, -STIFFENING * SPOTS**3)
#: A spring, and gravity that pulls against it about the middle, or with it.
AGAINST = {"gravity_gain": 4.8, "gravity_angle": np.pi, "spring_stiffness": 4.8, "spring_rest": 0.0}
WITH = {**AGAINST, "gravity_angle": 0.0}


def recorded(truth: Structure, largest: float = 25.0, **values: float) -> Recording:
    """Half a minute with commands up to the largest and white torque noise, read by an encoder."""
    rng = np.random.default_rng(2)
    time = 0.002 * np.arange(15000)
    command = steps(rng, len(time), 300, largest)
    y, _ = run(truth, VALUES | values, time, command + 0.3 * rng.standard_normal(len(time)))
    return Recording(
        name="made", time=time, input=command, output=np.round(y / COUNT) * COUNT, input_unit="%", output_unit="rad",
        resolution=COUNT,
    )  # fmt: skip


def named(recording: Recording) -> tuple[list[PreparedRecording], Fit]:
    """Gravity and spring, fitted from where they cancel and from where they do not."""
    cases = [prepared_recording.prepare_recording(recording, BOTH)]
    free = free_parameters(BOTH)
    fits = [
        optimizer.fit_with_process_noise(FitProblem(cases), BOTH, VALUES | begin, free) for begin in (AGAINST, WITH)
    ]
    return cases, min(fits, key=lambda p: p.deviance)


@cache
def stiffening() -> tuple[list[PreparedRecording], Fit]:
    return named(recorded(STRUCTURE.with_("unknown_position"), **CURVE))


@pytest.mark.parametrize("effect", [c for c in CANDIDATES if c != "gravity"])
def test_any_effect_may_stand_beside_gravity(effect: str) -> None:
    """Only torques that follow from the position alone can be pieces of a curve over it: a stop has damping, too."""
    cases, both = stiffening()[0], STRUCTURE.with_("gravity", effect)
    sane = {p.name: float(np.mean(SANE[p.name])) for p in both.parameters if p.name in SANE}
    last = likelihood.evaluate(
        FitProblem(cases, process_noise=1.0), both, preparation.complete_values(both, VALUES | sane)
    )
    found = curve_substitution.substitute_cancelling(FitProblem(cases), STRUCTURE, last)
    assert found is None or set(found.ids) <= {"gravity", "spring", "torque_ripple", "constant_offset"}


def test_a_spring_that_stiffens_is_not_a_spring_and_gravity():
    cases, last = stiffening()
    pieces = curve_substitution.substitute_cancelling(FitProblem(cases), STRUCTURE, last)
    assert pieces is not None and set(pieces.ids) == {"gravity", "spring"}
    passed = np.asarray(cases[0].positions)
    assert curve_substitution._remaining_stiffness(passed, last, pieces.ids) < thresholds.MAX_CANCELLED_STIFFNESS
    assert pieces.curve.structure == STRUCTURE.with_("unknown_position")
    got, size = pieces.curve.values, np.sqrt(np.diag(pieces.curve.covariance) * pieces.curve.scale)
    planted = interp1d(SPOTS, -STIFFENING * SPOTS**3, fill_value="extrapolate")
    for name, spot in zip(names("unknown_position"), spots("unknown_position", got), strict=True):
        if name in pieces.curve.free:
            true = float(planted(spot))
            assert got[name] == pytest.approx(true, abs=4.0 * size[pieces.curve.free.index(name)] + 0.3)


def test_what_is_left_is_what_algebra_leaves():
    """x - sin x over -1.5 to 1.5, against x."""
    at = np.linspace(-1.5, 1.5, 2001)
    both = Fit(BOTH, VALUES | AGAINST, 1.0, (), 0.0, 1.0, np.eye(0), np.zeros(0), np.eye(0))
    torques = curve_substitution._effect_torques(("gravity", "spring"), both, at)
    assert torques.sum(axis=0) == pytest.approx(-4.8 * (at - np.sin(at)))


@pytest.mark.parametrize("travel", [1.0, 5.0])
@pytest.mark.parametrize("strength", [0.5, 0.8, 1.0, 1.3])
def test_what_is_left_of_their_stiffness_is_what_it_is_where_they_cancel_most(travel, strength):
    """However far the axis goes on from there: gravity's is largest against the spring where it stands on its head, and
    that place a hanging pendulum passes on a long travel only."""
    passed = np.linspace(-travel, travel, 2001)
    hanging = 1.0 if travel > np.pi else -np.cos(travel)
    for begin, most in ((AGAINST, 1.0), (WITH, hanging)):
        values = VALUES | begin | {"gravity_gain": 4.8 * strength}
        both = Fit(BOTH, values, 1.0, (), 0.0, 1.0, np.eye(0), np.zeros(0), np.eye(0))
        left = abs(1.0 - strength * most) / min(strength, 1.0)
        found = curve_substitution._remaining_stiffness(passed, both, ("gravity", "spring"))
        assert found == pytest.approx(left, abs=0.01)


@pytest.mark.parametrize(
    ("values", "largest", "drawn"),
    [
        (AGAINST, 12.0, True),  # over a short travel nothing tells them from a curve
        (AGAINST, 40.0, False),  # over a long one they do more
        (WITH, 12.0, False),
    ],
)
def test_names_stay_where_they_do_not_cancel_or_do_more(values, largest, drawn):
    cases, last = named(recorded(BOTH, largest, **values))
    assert (curve_substitution.substitute_cancelling(FitProblem(cases), STRUCTURE, last) is not None) is drawn


#: A resistance that has a hump on one side of a straight line over speed, at twelve knots.
SPEEDS = np.linspace(-15, 15, KNOTS)
HUMP = {
    **through("unknown_velocity", SPEEDS, 2.0 * SPEEDS + 8.0 * np.exp(-0.5 * (SPEEDS - 6.0) ** 2)),
    "viscous_friction": 0.0,
}


@pytest.mark.parametrize(
    ("effect", "truth", "values", "variable"),
    [
        ("spring", "spring", {"spring_stiffness": 4.8}, None),
        ("spring", "unknown_position", CURVE, "position"),
        ("quadratic_drag", "quadratic_drag", {"quadratic_drag": 0.05}, None),
        ("quadratic_drag", "unknown_velocity", HUMP, "velocity"),
        ("encoder_eccentricity", "encoder_eccentricity", {"eccentricity": 0.01, "eccentricity_angle": 1.0}, None),
        ("encoder_eccentricity", "unknown_gain", {"unknown_gain_sin_1": 0.08, "unknown_gain_cos_1": -0.05}, "gain"),
    ],
)
def test_a_name_stays_unless_its_law_is_not_what_is_there(effect, truth, values, variable):
    one = STRUCTURE.with_(effect)
    cases = [prepared_recording.prepare_recording(recorded(STRUCTURE.with_(truth), 25.0, **values), one)]
    begin = VALUES | {p.name: float(np.mean(SANE[p.name])) for p in one.parameters if p.name in SANE}
    last = optimizer.fit_with_process_noise(
        FitProblem(cases), one, preparation.complete_values(one, begin | VALUES), free_parameters(one)
    )
    found = curve_substitution.best_substitution(FitProblem(cases), STRUCTURE, last)
    if variable is None:
        assert found is None
    else:
        assert found is not None and found.ids == (effect,)
        assert found.curve.structure == STRUCTURE.with_(f"unknown_{variable}")
        assert found.curve.deviance < last.deviance - 100.0


@pytest.mark.parametrize(
    ("effect", "values"),
    [("spring", {"spring_stiffness": 4.8, "spring_rest": 0.3}), ("quadratic_drag", {"quadratic_drag": 0.05})],
)
def test_a_curve_does_what_the_names_do_where_its_sketch_is_led_astray(effect, values):
    """What the missing torque shows may be rattle; a spring and a drag are lines that twelve knots draw as they are."""
    one = STRUCTURE.with_(effect)
    cases = [prepared_recording.prepare_recording(recorded(one, 25.0, **values), one)]
    last = optimizer.fit_with_process_noise(
        FitProblem(cases), one, preparation.complete_values(one, VALUES | values), free_parameters(one)
    )
    variable = "position" if effect == "spring" else "velocity"
    without = curve_substitution._without_effects(last, [effect])
    sketched = nonparametric.sketch_curve(FitProblem(cases), without, CurveTerm(variable))
    wild = {n: 30.0 * (-1.0) ** i for i, n in enumerate(names(f"unknown_{variable}"))}
    misled = replace(sketched, values=sketched.values | wild, free=without.free)
    begun = curve_substitution._torques_as_curve(misled, last, [effect], variable)
    assert nonparametric.fit_curve(FitProblem(cases), begun).deviance < last.deviance + 20.0


@pytest.mark.parametrize(("chance", "drawn"), [(0.001, True), (0.2, False)])
def test_a_curve_takes_no_name_s_place_unless_it_foretells(monkeypatch, chance, drawn):
    """Twelve knots follow what else the model lacks, too."""
    one = STRUCTURE.with_("spring")
    cases = [prepared_recording.prepare_recording(recorded(STRUCTURE.with_("unknown_position"), 25.0, **CURVE), one)]
    begin = preparation.complete_values(one, VALUES | {"spring_stiffness": 4.8})
    last = optimizer.fit_with_process_noise(FitProblem(cases), one, begin, free_parameters(one))
    monkeypatch.setattr(curve_substitution.cross_validation, "gain_p_value", lambda cases, smaller, larger: chance)
    assert (curve_substitution.substitute_curve(FitProblem(cases), STRUCTURE, last, "position") is not None) is drawn


@pytest.mark.parametrize(("rough", "drawn"), [(0.0, False), (0.02, False), (0.06, True)])
def test_a_law_may_miss_a_little_of_what_a_machine_does(rough, drawn):
    """A spring whose torque swings about the straight line by a share of what it does.

    It moves about half as far as the knots reach, so that the share is twice as large there.
    """
    torque = -4.8 * (SPOTS + rough * np.sqrt(2.0) * SPOTS.std() * np.sin(4.0 * SPOTS))
    truth, one = STRUCTURE.with_("unknown_position"), STRUCTURE.with_("spring")
    cases = [
        prepared_recording.prepare_recording(recorded(truth, 25.0, **through("unknown_position", SPOTS, torque)), one)
    ]
    begin = preparation.complete_values(one, VALUES | {"spring_stiffness": 4.8})
    last = optimizer.fit_with_process_noise(FitProblem(cases), one, begin, free_parameters(one))
    assert (curve_substitution.substitute_curve(FitProblem(cases), STRUCTURE, last, "position") is not None) is drawn


def test_a_name_that_does_nothing_beside_the_curve_goes():
    """A fade made up for what the spring missed; beside the curve a friction that is there stays."""
    truth, both = STRUCTURE.with_("unknown_position", "coulomb_friction"), STRUCTURE.with_("spring", "coulomb_friction")
    more = both.with_("thermal_fade")
    cases = [prepared_recording.prepare_recording(recorded(truth, 25.0, coulomb_friction=0.3, **CURVE), more)]
    begin = preparation.complete_values(more, VALUES | {"spring_stiffness": 3.0, "coulomb_friction": 0.3})
    last = optimizer.fit_with_process_noise(FitProblem(cases), more, begin, free_parameters(more))
    found = curve_substitution.best_substitution(FitProblem(cases), STRUCTURE, last)
    assert found is not None and found.curve.structure == truth


def test_one_torque_or_what_the_first_model_knows_is_no_piece():
    cases, last = stiffening()
    assert curve_substitution.substitute_cancelling(FitProblem(cases), STRUCTURE.with_("gravity"), last) is None


@pytest.mark.parametrize(("overtone", "verdict"), [(0.15, "partly_explained"), (0.6, "unexplained")])
def test_a_ripple_with_an_overtone_is_a_ripple_and_one_of_many_is_none(overtone: float, verdict: str) -> None:
    rng, time = np.random.default_rng(8), 0.002 * np.arange(8000)
    wave = {"unknown_angle_order": 9.0, "unknown_angle_sin_1": 3.0, "unknown_angle_cos_2": 3.0 * overtone}
    duty = steps(rng, len(time), 200, 30.0)
    y, _ = run(STRUCTURE.with_("unknown_angle"), VALUES | wave, time, duty)
    recording = Recording("made", time, duty, np.round(y / COUNT) * COUNT, "%", "rad", COUNT)
    found = diagnose.diagnose([recording], STRUCTURE, candidates=("torque_ripple", "gravity", "coulomb_friction"))
    assert found.verdict == verdict
    assert [f.id for f in found.findings] == (["torque_ripple"] if verdict == "partly_explained" else [])
    if found.findings:
        assert found.findings[0].parameters["ripple_order"].value == pytest.approx(9.0, rel=0.01)


def test_overtones_are_what_a_wave_has_beside_its_first_and_between_the_directions() -> None:
    """Turned by any phase they are as large; and no ripple of another order is the curve's."""
    blank = preparation.complete_values(STRUCTURE.with_("unknown_push", "torque_ripple"), VALUES)
    nothing = np.zeros(0)

    def point(structure: Structure, values: dict[str, float]) -> Fit:
        return Fit(structure, values, 1.0, (), 0.0, 1.0, np.eye(0), nothing, np.eye(0))

    named = point(STRUCTURE.with_("torque_ripple"), blank | {"ripple_order": 12.0})
    for phase in (0.0, 0.7, 2.0):
        own = {"unknown_push_order": 12.1}
        for way, sign in (("forward", 1.0), ("reverse", -1.0)):
            # A first wave of 2, of which 0.2 depend on the direction, and a third one of 0.5.
            own |= {f"unknown_push_{way}_sin_1": 2.0 * np.cos(phase) - sign * 0.2 * np.sin(phase)}
            own |= {f"unknown_push_{way}_cos_1": 2.0 * np.sin(phase) + sign * 0.2 * np.cos(phase)}
            own |= {f"unknown_push_{way}_sin_3": 0.5}
        curve = point(STRUCTURE.with_("unknown_push"), blank | own)
        assert curve_substitution.overtone_share(curve) == pytest.approx(np.hypot(0.2, 0.5) / 2.0)
        assert curve_substitution.is_ripple(named, curve)
        assert not curve_substitution.is_ripple(replace(named, values=named.values | {"ripple_order": 24.0}), curve)
        assert not curve_substitution.is_ripple(replace(named, structure=STRUCTURE.with_("gravity")), curve)
        opposite = {n: -v for n, v in own.items() if "reverse" in n}
        assert curve_substitution.overtone_share(replace(curve, values=curve.values | opposite)) > 1.0
    assert curve_substitution.overtone_share(named) == np.inf
