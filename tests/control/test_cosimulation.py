"""The closed loop: model in process and FMU in FMPy, references, hunting, uncertainty."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from controlled_axis import axis

from twin.control import controller as controllers
from twin.control.controller import Controller
from twin.control.cosimulation import find_limit_cycle, judge, make_reference, run, simulate, to_json, unaware
from twin.control.design import design
from twin.control.monte_carlo import draw, robustness, trial
from twin.control.reference import Reference, check, read_reference
from twin.effects import knots
from twin.effects.catalogue import BASE, UNKNOWN
from twin.effects.catalogue import EFFECTS as EFFECT_PAGES
from twin.errors import BadInput
from twin.fmi.python_fmu import export
from twin.model.fitted_model import Model, dumps, loads

HARD = {"gravity_gain": 3.0, "coulomb_friction": 1.0, "delay": 0.005, "lag_time": 0.01}
EFFECTS = ("gravity", "coulomb_friction", "input_delay", "motor_lag")
#: What no command can undo, or nobody knows in time.
NAMED = {
    "backlash", "tooth_compliance", "end_stop", "joint_elasticity", "load_change", "periodic_disturbance",
    "disturbance_pulse", "unknown_time", "unknown_drag", "presliding_friction", "flexible_load", "input_delay",
}  # fmt: skip
PLANTED = {
    "constant_offset": {"offset": 2.0},
    "detent": {"detent_torque": 1.5, "detent_angle": 0.2},
    "friction_run_in": {"coulomb_friction": 1.0, "run_in_friction": 1.0},
    "sticky_sector": {"coulomb_friction": 1.0, "sector_friction": 1.0},
    "viscous_asymmetry": {"viscous_asymmetry": 0.3},
    "coulomb_friction": {"coulomb_friction": 2.0},
    "encoder_eccentricity": {"eccentricity": 0.02},
    "friction_asymmetry": {"coulomb_friction": 2.0, "friction_asymmetry": 0.8},
    "gravity": {"gravity_gain": 6.0, "gravity_angle": 0.5},
    "input_delay": {"delay": 0.02},
    "load_dependent_friction": {"load_friction": 0.4},
    "motor_lag": {"lag_time": 0.05},
    "position_dependent_friction": {"coulomb_friction": 2.0, "friction_variation": 1.0},
    "quadratic_drag": {"quadratic_drag": 0.3},
    "spring": {"spring_stiffness": 5.0, "spring_rest": 0.3},
    "stribeck_friction": {"coulomb_friction": 1.0, "stribeck_friction": 1.0, "stribeck_velocity": 0.2},
    "supply_sag": {"supply_sag": 0.003},
    "thermal_fade": {"fade": 0.3, "fade_time": 5.0, "fade_reference": 20.0},
    "torque_ripple": {"ripple_torque": 1.5, "ripple_order": 12.0},
}


@pytest.mark.parametrize("effect", PLANTED)
def test_what_is_modelled_is_cancelled(effect: str) -> None:
    """Whatever acts, the link follows within three encoder counts on a swing of half a radian."""
    model = axis(effect, **PLANTED[effect])
    made = design(model, 2.4)
    position, _ = trial(model, made, reference := make_reference("sine", made))
    assert np.max(np.abs(position - reference.position)) < 3 * model.resolution


def test_a_known_delay_costs_no_tracking() -> None:
    """What must happen a delay from now is read off the reference's own derivatives."""
    errors = []
    for delay in (0.0, 0.02):
        model = axis("input_delay", delay=delay)
        made = design(model, 2.4)
        errors.append(rms(model, made, make_reference("sine", made)))
    assert errors[1] < 2.0 * errors[0] and errors[1] < 0.2 * model.resolution


def test_a_jump_of_the_acceleration_is_taken_for_a_jump_not_for_a_jerk() -> None:
    model = axis("input_delay", delay=0.02)
    made = design(model, 2.4)
    time = np.arange(2000) * made.sample_time
    rise = np.where(time < 1.0, 0.0, np.where(time < 2.0, 2.0, np.where(time < 3.0, -2.0, 0.0)))
    pace = np.concatenate([[0.0], np.cumsum(rise[:-1]) * made.sample_time])
    place = np.concatenate([[0.0], np.cumsum(pace[:-1] + 0.5 * made.sample_time * rise[:-1]) * made.sample_time])
    position, command = trial(model, made, Reference("trapezoid", time, place, pace, rise))
    assert np.max(np.abs(position - place)) < 0.01
    holds = (rise + 1.5 * pace) / 0.3 + np.where(pace != 0.0, 10.0, 0.0)
    assert np.max(np.abs(command)) < 1.5 * np.max(np.abs(holds))


#: Strong enough to be felt; what is not here is in PLANTED.
MORE = {
    "inertia": {"input_gain": 0.5},
    "viscous_friction": {"viscous_friction": 4.0},
    "drive_saturation": {"saturation_limit": 30.0},
    "dead_band": {"dead_band_forward": 10.0, "dead_band_reverse": 8.0},
    "backlash": {"backlash_gap": 0.02},
    "tooth_compliance": {"backlash_gap": 0.02, "tooth_frequency": 60.0},
    "payload": {"own_inertia": 0.01},
    "payload_gravity": {"own_inertia": 0.01},
    "end_stop": {"stop_upper": 2.0, "stop_lower": -2.0},
    "joint_elasticity": {"joint_frequency": 12.0},
    "disturbance_pulse": {"pulse_torque": 1.5, "pulse_start": 0.5},
    "motor_sensor": {"backlash_gap": 0.05},
    "load_change": {"load_added": 0.5, "load_time": 3.0},
    "periodic_disturbance": {"disturbance": 1.0, "disturbance_frequency": 1.0},
    "unknown_input": {f"unknown_input_{i:02d}": 5.0 * math.sin(i) for i in range(1, 13)},
    "unknown_position": knots.through("unknown_position", np.linspace(-1.0, 1.0, 12), 3.0 * np.sin(np.arange(1, 13))),
    "unknown_angle": {"unknown_angle_sin_1": 2.0, "unknown_angle_cos_3": 1.0},
    "unknown_gain": {"unknown_gain_sin_1": 0.3, "unknown_gain_cos_3": 0.2},
    "unknown_push": {"unknown_push_forward_sin_1": 8.0, "unknown_push_reverse_cos_2": 5.0},
    "varying_inertia": {"unknown_inertia_sin_1": 0.3, "unknown_inertia_cos_3": 0.2},
    "unknown_inertia": {"unknown_inertia_sin_1": 0.3, "unknown_inertia_cos_3": 0.2},
    "unknown_velocity": knots.through("unknown_velocity", np.linspace(-4.0, 4.0, 12), 2.0 * np.sin(np.arange(1, 13))),
    "unknown_time": {"unknown_time_01": 1.0},
    "unknown_drag": {"unknown_drag_01": 1.0},
    "presliding_friction": {"presliding_friction": 2.0},
    "flexible_load": {"flexible_load_share": 0.3},
}  # fmt: skip
#: In every model: to be blind to them is to have the usual value.
ALWAYS = {"input_gain": 0.3, "viscous_friction": 1.5, "dead_band_forward": 0.0, "dead_band_reverse": 0.0}


def rms(model: Model, made: Controller, reference: Reference) -> float:
    # Each shape without a name would be compiled anew; plain Python gives the same.
    nameless = set(UNKNOWN) & set(model.structure.ids)
    position = simulate(model, made, reference).position if nameless else trial(model, made, reference)[0]
    return float(np.sqrt(np.mean((position - reference.position) ** 2)))


#: How slowly a sensor was read is said of a recording and is part of no model.
MODELLED = [i for i in EFFECT_PAGES if i != "sensor_hold"]


@pytest.mark.parametrize("effect", MODELLED)
def test_every_effect_is_cancelled_for_a_gain_or_named_as_what_cannot_be(effect: str) -> None:
    """The null case of the above: on the same rig a controller that does not know the effect tracks worse."""
    known = {"payload": 0.005, "moment": 0.02} if effect.startswith("payload") else {}
    model = replace(axis(effect, **(PLANTED.get(effect) or MORE[effect])), known=known)
    if effect in BASE:
        blind = model.with_values({n: v for n, v in ALWAYS.items() if n in MORE[effect]} | {"backlash_gap": 0.0})
    else:
        left = model.structure.without(effect)
        blind = replace(model, structure=left, values={p.name: model.values[p.name] for p in left.parameters})
    aware = design(model, 2.4)
    named = any(says.startswith(f"{effect}:") for says in aware.remarks)
    unknowing = design(blind, 2.4)
    if effect == "drive_saturation":
        # It costs no accuracy but foresight: who does not know that braking is weak shoots past the goal.
        reference = make_reference("step", aware, 6.0)
        beyond = [float(np.max(trial(model, c, reference)[0])) - 6.0 for c in (unknowing, aware)]
        gain = beyond[0] / max(beyond[1], model.resolution)
    else:
        reference = make_reference("sine", aware)
        gain = rms(model, unknowing, reference) / rms(model, aware, reference)
    assert named or gain > 1.5, gain
    assert named == (effect in NAMED)


def test_a_shape_without_a_name_is_compiled_beside_the_named_effects() -> None:
    model = axis("unknown_angle", **MORE["unknown_angle"])
    made = design(model)
    reference = make_reference("minimum-jerk", made, duration=2.0)
    np.testing.assert_allclose(trial(model, made, reference)[0], simulate(model, made, reference).position, atol=1e-9)


def test_fmu_and_model_and_compiled_kernel_give_the_same_loop(tmp_path: Path) -> None:
    model = axis(*EFFECTS, **HARD, backlash_gap=0.01)
    made = design(model)
    reference = make_reference("minimum-jerk", made)
    in_process = simulate(model, made, reference)
    in_fmpy = run(export(model, tmp_path / "axis.fmu"), made, reference)
    compiled, _ = trial(model, made, reference)
    np.testing.assert_allclose(in_fmpy.position, in_process.position, atol=1e-9)
    np.testing.assert_allclose(compiled, in_process.position, atol=1e-9)


@pytest.mark.parametrize("gap", [0.005, 0.02])
@pytest.mark.parametrize("share", [0.25, 0.5])
def test_hunting_comes_as_the_describing_function_says_and_goes_with_the_gap_aware_mode(
    gap: float, share: float
) -> None:
    model = axis(backlash_gap=gap, motor_share=share)
    made = design(model)
    tracking = simulate(model, made, make_reference("minimum-jerk", made))
    assert tracking.limit_cycle is None
    found = tracking.hunting
    assert found is not None and found.unaware is not None and made.limit_cycle == found.predicted
    assert found.unaware.frequency == pytest.approx(found.predicted.frequency, rel=0.1)
    assert found.unaware.amplitude == pytest.approx(found.predicted.amplitude, rel=0.25)
    assert found.verdict == "confirmed" and "confirmed" in tracking.says[-1]


@pytest.mark.parametrize("rings", [25.0, 60.0, 235.0])
@pytest.mark.parametrize("damping", [0.1, 1.3])
@pytest.mark.parametrize("pull", [0.0, 6.0])
def test_compliant_teeth_hunt_no_more_or_less(rings: float, damping: float, pull: float) -> None:
    """A link without friction: the gap-aware mode leaves no limit cycle, or a smaller one."""
    teeth = {"tooth_frequency": rings, "tooth_damping": damping, "backlash_gap": 0.02}
    model = axis("tooth_compliance", "gravity", **teeth, gravity_gain=pull, gravity_angle=0.4)
    made = design(model)
    reference = make_reference("minimum-jerk", made)
    runs = [judge(c, reference, *trial(model, c, reference)) for c in (unaware(made), made)]
    before, after = (r.limit_cycle for r in runs)
    assert before or pull, "without load it hunts, or there is nothing to show"
    # Nothing takes the swing from a link without friction or load, but for teeth that rebound little.
    assert after is None or (before and damping < 1.0 and not pull and after.amplitude < 0.9 * before.amplitude)
    rest = reference.time > reference.rests_from + 1.0
    assert np.max(np.abs(runs[1].error[rest])) < 3 * made.settings["tolerance"]


def test_load_that_holds_the_flank_refutes_the_prediction_and_needs_no_tolerance() -> None:
    model = axis("gravity", gravity_gain=9.0, gravity_angle=0.4, backlash_gap=0.02)
    made = design(model, 2.0)
    tracking = simulate(model, made, make_reference("minimum-jerk", made))
    assert tracking.hunting is not None and tracking.hunting.verdict == "refuted"
    assert abs(tracking.error[-1]) < 0.2 * made.settings["tolerance"]
    assert to_json(tracking)["hunting"]["unaware"] is None


def test_without_a_gap_nothing_hunts_and_nothing_is_predicted() -> None:
    model = axis("coulomb_friction", coulomb_friction=1.0)
    made = design(model)
    assert made.limit_cycle is None
    assert simulate(model, made, make_reference("minimum-jerk", made)).limit_cycle is None


def test_elastic_joint_is_left_in_peace() -> None:
    model = axis("joint_elasticity", joint_frequency=12.0, joint_damping=0.1)
    made = design(model)
    rigid = design(axis(), None)
    tracking = simulate(model, made, make_reference("minimum-jerk", made))
    assert made.bandwidth < rigid.bandwidth
    assert tracking.peak < 0.01


def test_integral_action_takes_a_torque_that_no_model_knows() -> None:
    model = axis("constant_offset", offset=3.0)
    made = design(axis(), 2.4)
    tracking = simulate(model, made, make_reference("step", made))
    assert abs(tracking.error[-1]) < 2 * model.resolution


def test_large_step_does_not_wind_up() -> None:
    made = design(model := axis("gravity", gravity_gain=3.0), 2.4)
    tracking = simulate(model, made, make_reference("step", made, amplitude=6.0))
    assert np.max(np.abs(tracking.input)) >= 0.999 * made.settings["limit"]
    assert np.max(tracking.position) < 6.03
    assert tracking.settled is not None


def test_hunting_is_measured_on_a_sine_and_not_in_noise() -> None:
    time = np.arange(0, 4, 0.002)
    found = find_limit_cycle(time, 0.01 * np.sin(2 * np.pi * 3 * time), 1e-4)
    assert found is not None
    assert (found.amplitude, found.frequency) == (pytest.approx(0.01, rel=0.01), pytest.approx(3.0, rel=0.01))
    assert find_limit_cycle(time, 0.01 * np.exp(-3 * time) * np.sin(18 * time), 1e-4) is None
    assert find_limit_cycle(time, np.zeros_like(time), 1e-4) is None


@pytest.mark.parametrize("kind", ["minimum-jerk", "sine", "step"])
def test_references_are_within_reach_and_consistent(kind: str) -> None:
    made = design(axis())
    r = make_reference(kind, made)
    if kind != "step":
        np.testing.assert_allclose(np.gradient(r.position, r.time)[1:-1], r.velocity[1:-1], atol=1e-3)
        np.testing.assert_allclose(np.gradient(r.velocity, r.time)[2:-2], r.acceleration[2:-2], atol=0.05)
    assert np.max(np.abs(r.velocity)) <= made.reachable_speed
    assert r.travel == pytest.approx(1.0, rel=0.01)


def test_csv_reference_is_what_it_was(tmp_path: Path) -> None:
    made = design(axis())
    r = make_reference("sine", made)
    path = tmp_path / "reference.csv"
    path.write_text(
        "t,position\n" + "".join(f"{t:.4f},{x:.9f}\n" for t, x in zip(r.time[::10], r.position[::10], strict=True))
    )
    back = read_reference(path, made)
    n = len(back.time)
    np.testing.assert_allclose(back.position, r.position[:n], atol=1e-4)
    np.testing.assert_allclose(back.velocity[50:-50], r.velocity[50 : n - 50], atol=1e-2)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        ("t,x\n0,0\n", r"no column 'position'.*call it 'position \[rad\]'"),
        ("t,position\n0,0\n1,a\n2,0\n3,0\n", "line 3, column 'position': 'a' is no number"),
        ("t,position\n0,0\n1\n2,0\n3,0\n", "line 3"),
        ("t,position\n0,0\n1,nan\n2,0\n3,0\n", "line 3"),
        ("t,position\n0,0\n1,0\n1,0\n3,0\n", "line 4: time"),
        ("t,position\n0,0\n1,1e308\n2,0\n3,0\n", "line 3: position is 1e\\+308, beyond any axis"),
        ("t,position\n0,0\n1,0\n", "at least 4"),
        ("t,position [mm]\n0,0\n1,0\n2,0\n3,0\n", "in mm, the controller's position in rad"),
        ("t,position\n" + "".join(f"{10 * k},0\n" for k in range(60)), r"makes 10 s from row to row.*'time \[ms\]'"),
        ("t,position\n0,0\n1,0\n2,0\n1e9,0\n", "too many"),
    ],
)
def test_unusable_reference_files_are_refused(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "r.csv"
    path.write_text(text)
    with pytest.raises(BadInput, match=says):
        read_reference(path, design(axis()))


@pytest.mark.parametrize("row", ["", "{time}{mark}{position}\n"])
@pytest.mark.parametrize("mark", [",", ";"])
@pytest.mark.parametrize(("time", "per_second"), [("s", 1.0), ("ms", 1e3), ("us", 1e6)])
@pytest.mark.parametrize(("unit", "per_rad"), [("rad", 1.0), ("deg", 180 / math.pi), ("rev", 0.5 / math.pi)])
def test_a_reference_in_other_units_and_dialects_is_the_same(
    tmp_path: Path, row: str, mark: str, time: str, per_second: float, unit: str, per_rad: float
) -> None:
    """The units stand behind the names or in a row of their own; decimal commas go with semicolons."""
    t = np.arange(200) * 0.01
    names = ("time", "position") if row else (f"time [{time}]", f"position_{unit}")
    lines = [f"{per_second * a:.9f}{mark}{per_rad * b:.9f}" for a, b in zip(t, np.sin(t), strict=True)]
    text = "\n".join(lines).replace(".", "," if mark == ";" else ".")
    path = tmp_path / "r.csv"
    path.write_text(mark.join(names) + "\n" + row.format(time=time, mark=mark, position=unit) + text)
    made = design(axis())
    back = read_reference(path, made)
    np.testing.assert_allclose(back.position, np.sin(back.time), atol=1e-6)
    assert len(back.time) == int(1.99 / made.sample_time + 1e-6) + 1


def test_reference_beyond_reach_is_refused_before_anything_runs() -> None:
    made = design(axis())
    fast = make_reference("sine", made, amplitude=50.0, duration=3.0)
    with pytest.raises(BadInput, match=r"asks for [\d.]+ times what full command can do at t = .*reaches 18"):
        run(Path("none.fmu"), made, fast)
    with pytest.raises(BadInput, match="kind"):
        make_reference("square", made)
    with pytest.raises(BadInput, match="amplitude"):
        make_reference("sine", made, amplitude=-1.0)


@pytest.mark.parametrize("kind", ["minimum-jerk", "sine", "step"])
@pytest.mark.parametrize(("lower", "upper"), [(-0.5, 0.4), (2.0, 3.0)])
def test_reference_beyond_a_stop_is_refused_and_a_made_one_stays_between(kind: str, lower: float, upper: float) -> None:
    made = design(axis("end_stop", stop_stiffness=5e3, stop_lower=lower, stop_upper=upper))
    assert controllers.loads(controllers.dumps(made)).ends == (lower, upper)
    inside = make_reference(kind, made)
    check(inside, made)
    assert inside.travel > 0.3 and lower < np.min(inside.position) and np.max(inside.position) < upper
    with pytest.raises(BadInput, match=rf"{kind} reference asks at t = .* beyond a stop: stay between {lower:g} and"):
        check(make_reference(kind, made, amplitude=5.0, duration=60.0), made)
    check(make_reference(kind, design(axis("end_stop", stop_stiffness=0.0)), 5.0, 60.0), design(axis()))


def test_other_structures_names_and_files_are_refused(tmp_path: Path) -> None:
    fmu = export(axis(), tmp_path / "axis.fmu")
    other = design(axis("gravity", gravity_gain=1.0))
    with pytest.raises(BadInput, match=r"the controller has gravity, the FMU has not"):
        run(fmu, other)
    volts = design(replace(axis(), input_unit="V"), limit=12.0)
    with pytest.raises(BadInput, match=r"no input 'voltage', only duty: map it \(voltage=NAME\)"):
        run(fmu, volts)
    assert run(fmu, volts, make_reference("step", volts, amplitude=0.1), {"voltage": "duty"}).peak < 0.2
    with pytest.raises(BadInput, match="cannot map"):
        run(fmu, volts, names={"speed": "velocity"})
    (tmp_path / "text.fmu").write_text("no archive")
    with pytest.raises(BadInput):
        run(tmp_path / "text.fmu", volts)


def test_json_is_plain() -> None:
    model = axis()
    made = design(model)
    said = to_json(simulate(model, made, make_reference("step", made)))
    assert json.loads(json.dumps(said))["format"] == "twin-tracking/1"


def uncertain(**spread: float) -> tuple[object, object]:
    model = axis("gravity", gravity_gain=5.0)
    fitted = tuple(spread)
    return replace(model, fitted=fitted, covariance=np.diag([s**2 for s in spread.values()])), design(model, 2.4)


def test_draws_have_the_covariance_and_stay_in_bounds() -> None:
    model, _ = uncertain(gravity_gain=0.5, dead_band_forward=8.0)
    drawn = draw(model, 2000)
    assert np.std([m.values["gravity_gain"] for m in drawn]) == pytest.approx(0.5, rel=0.1)
    assert min(m.values["dead_band_forward"] for m in drawn) >= 0.0


def test_what_left_no_trace_is_written_read_and_not_drawn() -> None:
    """Its variance has no end; neither has a MODEL.toml that says so an error, nor a draw of it a meaning."""
    model, _ = uncertain(gravity_gain=0.5, dead_band_forward=math.inf)
    text = dumps(replace(model, covariance=np.diag([0.25, math.inf])))
    read = loads(text, "MODEL.toml")
    assert read.std("dead_band_forward") == math.inf and read.std("gravity_gain") == 0.5
    assert {m.values["dead_band_forward"] for m in draw(read, 50)} == {model.values["dead_band_forward"]}
    assert np.std([m.values["gravity_gain"] for m in draw(read, 2000)]) == pytest.approx(0.5, rel=0.1)
    for wrong in ("nan", "-inf"):
        with pytest.raises(BadInput, match="not a finite number"):
            loads(text.replace("0.0, inf]", f"0.0, {wrong}]"), "MODEL.toml")
    with pytest.raises(BadInput, match="not a finite number"):
        loads(text.replace("0.25, 0.0]", "0.25, inf]"), "MODEL.toml")


def test_well_known_axis_meets_its_specification_and_a_vague_one_says_what_to_learn() -> None:
    model, made = uncertain(gravity_gain=0.01, viscous_friction=0.01)
    reference = make_reference("minimum-jerk", made, duration=4.0)
    good = robustness(model, made, reference, draws=20)
    assert good.share == 1.0 and good.learn is None
    model, made = uncertain(gravity_gain=2.0, viscous_friction=0.01)
    poor = robustness(model, made, reference, draws=40, specification=2 * good.median)
    assert poor.share < 0.95 and poor.learn == "gravity_gain"
    assert any("learn gravity_gain better" in sentence for sentence in poor.says)
    assert math.isfinite(poor.median) and poor.worst >= poor.median
    with pytest.raises(BadInput, match="covariance"):
        robustness(axis(), made, reference)
