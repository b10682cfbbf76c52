"""The geared drive and its effects against formulas worked out by hand."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import gearmotor_rig as gear
from concealed import Concealed
from excitations import EXCITATIONS, FREE

Array = NDArray[np.float64]

# 5 N m at the link at 50 % duty forwards (0.45 x 100/3 V / 0.6 ohm x 0.02 N m/A x 10), inertias of 0.4 and 0.6 kg m^2.
RIG = gear.Rig(
    counts_per_revolution=20000,
    encoder_phase=0.3,
    supply=100.0 / 3.0,
    resistance=0.6,
    inductance=3e-5,
    motor_constant=0.02,
    ratio=10.0,
    motor_inertia=0.004,
    link_inertia=0.6,
    motor_viscous=0.005,
    link_viscous=0.5,
    dead_band_forward=5.0,
    dead_band_reverse=4.0,
    backlash_gap=0.04,
    gap_start=0.0,
    mesh_stiffness=3e5,
    mesh_damping=60.0,
    mesh_film=1e-4,
    mesh_variation=0.05,
    mesh_error=5e-6,
    teeth=60.0,
    commutation=0.002,
    commutator_bars=9.0,
    pwm_steps=10000.0,
    noise_density=0.01,
    noise_time=0.01,
    noise_at_motor=0.5,
)
DAMPING = 100.0 * (0.005 + 0.02**2 / 0.6) + 0.5  # N m s/rad
SMOOTH = {"mesh_variation": 0.0, "mesh_error": 1e-12, "commutation": 0.0}
TIGHT = RIG.with_(backlash_gap=1e-9, **SMOOTH)


def clock(duration: float, step: float = 0.002) -> Array:
    return np.arange(round(duration / step) + 1) * step


def held(rig: gear.Rig, level: float, duration: float, *effects: Concealed, step: float = 0.002) -> gear.Simulated:
    """A run without noise at one duty."""
    time = clock(duration, step)
    return gear.simulate(rig, effects, time, np.full(time.size, level), None)


def torque(duty: float, rig: gear.Rig = RIG) -> float:
    """Of the drive at the link, N m, at standstill, forwards."""
    on = (duty - rig.dead_band_forward) / 100.0
    return on * rig.supply / rig.resistance * rig.motor_constant * rig.ratio


# ---- the rig ----


def test_numbers_of_a_first_model() -> None:
    values = RIG.model_values()
    assert RIG.inertia == pytest.approx(1.0)
    assert values["input_gain"] == pytest.approx(torque(6.0) / 1.0)
    assert values["viscous_friction"] == pytest.approx(DAMPING / 1.0)
    assert values["motor_share"] == pytest.approx(0.4)
    assert values["friction_share"] == pytest.approx((DAMPING - 0.5) / DAMPING)
    assert values["tooth_frequency"] == pytest.approx(math.sqrt(3e5 / 0.24) / (2.0 * math.pi))
    assert values["tooth_damping"] == pytest.approx(60.0 / (2.0 * math.sqrt(3e5 * 0.24)))
    assert RIG.half_torque == pytest.approx(values["input_gain"] * 45.5)
    assert RIG.half_speed == pytest.approx(RIG.half_torque / DAMPING)
    assert values.items() <= RIG.truths().items()


def test_population() -> None:
    rng = np.random.default_rng(3)
    for _ in range(100):
        rig = gear.draw_rig(rng)
        v = rig.model_values()
        assert 0.15 <= 1.0 / v["viscous_friction"] <= 2.0001
        mean = 0.5 * (v["dead_band_forward"] + v["dead_band_reverse"])
        assert 0.999 <= v["input_gain"] / v["viscous_friction"] * (60.0 - mean) <= 15.001
        assert min(v["dead_band_forward"], v["dead_band_reverse"]) >= 3.0
        assert max(v["dead_band_forward"], v["dead_band_reverse"]) <= 9.0
        assert 0.5 <= math.degrees(v["backlash_gap"]) <= 5.0
        assert 0.0999 <= v["motor_share"] <= 0.6001
        assert 79.9 <= v["tooth_frequency"] <= 250.1
        assert 0.3 < rig.resistance < 30.0
        assert 4096 <= rig.counts_per_revolution <= 40000


@pytest.mark.parametrize(("duty", "sign", "lost"), [(40.0, 1.0, 5.0), (-60.0, -1.0, 4.0)])
def test_steady_speed(duty: float, sign: float, lost: float) -> None:
    run = held(RIG, duty, 10.0)
    expected = RIG.model_values()["input_gain"] * (abs(duty) - lost) / DAMPING
    assert np.mean(run.velocity[-500:]) == pytest.approx(sign * expected, rel=1e-3)
    emf = RIG.motor_constant * RIG.ratio * expected
    current = ((abs(duty) - lost) / 100.0 * RIG.supply - emf) / RIG.resistance
    assert np.mean(run.current[-500:]) == pytest.approx(sign * current, rel=1e-2)


def test_first_acceleration_and_time_constant() -> None:
    run = held(TIGHT, 50.0, 2.0)
    expected = torque(50.0) / DAMPING * (1.0 - np.exp(-DAMPING * run.time))  # inertia 1
    assert run.velocity == pytest.approx(expected, abs=2e-3 * expected[-1])


@pytest.mark.parametrize("duty", [4.9, -3.9, 0.0])
def test_dead_band(duty: float) -> None:
    assert not np.any(held(RIG, duty, 0.5).current)


def test_gap_crossing_time() -> None:
    rig = RIG.with_(gap_start=-0.5, **SMOOTH)
    run = held(rig, 50.0, 0.2, step=1e-4)
    touch = run.time[np.argmax(run.velocity > 0.0)]
    motor = DAMPING - 0.5
    gone = torque(50.0) / motor * (touch - 0.4 / motor * -math.expm1(-motor * touch / 0.4))
    assert gone == pytest.approx(rig.backlash_gap, rel=0.02)
    assert touch == pytest.approx(math.sqrt(2.0 * 0.04 * 0.4 / torque(50.0)), rel=0.05)


def test_momentum_through_the_impacts() -> None:
    rig = RIG.with_(gap_start=-0.5, **SMOOTH)
    run = held(rig, 50.0, 0.3, step=1e-4)
    motor = run.motor_position / rig.ratio
    momentum = 0.4 * np.gradient(motor, run.time) + 0.6 * run.velocity
    given = torque(50.0) * run.time - (DAMPING - 0.5) * (motor - motor[0]) - 0.5 * run.position
    assert momentum[10:-1] == pytest.approx(given[10:-1], abs=0.01 * given[-1])


def test_impacts_lose_energy_and_never_make_any() -> None:
    # Without a drive a slow push carries the link to and fro against the motor.
    rig = RIG.with_(link_viscous=1e-9, motor_viscous=1e-9, resistance=1e9, **SMOOTH)
    time = clock(3.0, 2e-4)
    push = Concealed("periodic_disturbance", {"outside_torque": 2.0, "outside_frequency": 0.25, "outside_phase": 0.0})
    run = gear.simulate(rig, [push], time, np.zeros(time.size), None)
    motor = np.gradient(run.motor_position / rig.ratio, time)
    energy = 0.5 * (0.4 * motor**2 + 0.6 * run.velocity**2)
    work = np.cumsum(2.0 * np.sin(2.0 * math.pi * 0.25 * time) * run.velocity) * 2e-4
    lost = work - energy
    assert lost.min() > -0.01 * work.max()
    assert lost[-1] > 0.0


def test_tooth_frequency() -> None:
    rig = TIGHT.with_(mesh_film=1e-9, mesh_damping=10.0, mesh_stiffness=3e4)
    run = held(rig, 50.0, 0.1, step=1e-4)
    twist = run.motor_position / rig.ratio - run.position
    spectrum = np.abs(np.fft.rfft((twist - twist.mean()) * np.hanning(twist.size), 16 * twist.size))
    peak = np.fft.rfftfreq(16 * twist.size, 1e-4)[np.argmax(spectrum)]
    assert peak == pytest.approx(rig.model_values()["tooth_frequency"], rel=0.03)


def test_counts_are_of_what_is_shown() -> None:
    run = held(RIG, 30.0, 1.0)
    left = run.shown * RIG.counts_per_revolution / (2.0 * math.pi) + RIG.encoder_phase - run.counts
    assert run.counts.dtype == np.int64
    assert left.min() >= 0.0
    assert left.max() < 1.0


def test_stamps_do_not_matter() -> None:
    time = clock(2.0)
    duty = np.where(np.sin(7.0 * time) > 0.0, 40.0, -50.0)
    plain = gear.simulate(RIG, [], time, duty, 0)
    kept = np.flatnonzero(np.diff(duty, prepend=0.0) != 0.0)
    kept = np.union1d(kept, [0, 17, 18, 400, time.size - 1])  # uneven: the edges and a few more
    few = gear.simulate(RIG, [], time[kept], duty[kept], 0)
    assert few.position == pytest.approx(plain.position[kept], abs=2e-4)
    fine = clock(2.0, 1e-5)
    finer = gear.simulate(RIG, [], fine, duty[np.minimum((fine / 0.002 + 1e-6).astype(int), time.size - 1)], 0)
    assert finer.position[::200] == pytest.approx(plain.position, abs=2e-3)


# ---- noise ----


def test_noise_density() -> None:
    # Velocity of an inertia with a damper under white noise: variance density^2 / (2 damping inertia).
    time = clock(60.0)
    runs = [gear.simulate(TIGHT, [], time, np.zeros(time.size), seed).velocity[2000:] for seed in range(4)]
    short = 1.0 + DAMPING * RIG.noise_time  # what its correlation takes away
    assert np.mean(np.square(runs)) == pytest.approx(RIG.noise_density**2 / (2.0 * DAMPING * short), rel=0.3)


# ---- effects ----


@pytest.mark.parametrize("effect", ["friction_asymmetry", "position_dependent_friction", "stribeck_friction"])
def test_carrier(effect: str) -> None:
    drawn = gear.draw_effect(np.random.default_rng(2), effect, RIG, 0.1)
    assert drawn.carrier is not None
    assert drawn.carrier.id == "coulomb_friction"
    assert drawn.carrier.parameters.items() <= drawn.parameters.items()
    # What varies never outweighs what it is a part of: friction stays friction.
    varying = sum(abs(v) for n, v in drawn.parameters.items() if n.endswith(("_motor", "_link")) and "dry" not in n)
    assert varying == pytest.approx(0.1 * RIG.half_torque * RIG.inertia)
    assert varying <= sum(drawn.carrier.parameters.values()) + 1e-9


# ---- one by one; the link is free in a wide gap where the drive is not to matter ----

FREE_LINK = RIG.with_(backlash_gap=50.0, link_viscous=1e-12)
STUCK = Concealed("coulomb_friction", {"dry_motor": 1e3})


def offset(link: float) -> Concealed:
    return Concealed("constant_offset", {"offset_link": link})


def test_dry_friction_holds() -> None:
    dry = Concealed("coulomb_friction", {"dry_link": 1.0})
    below, above = (held(FREE_LINK, 0.0, 1.0, dry, offset(t)) for t in (0.9, 1.1))
    assert not np.any(below.velocity)
    assert above.velocity == pytest.approx(0.1 / 0.6 * above.time, abs=1e-6)


def test_coast_down_time() -> None:
    time = clock(4.0)
    duty = np.where(time < 2.0, 50.0, 0.0)
    rig = TIGHT.with_(motor_viscous=0.015)
    dry = Concealed("coulomb_friction", {"dry_motor": 0.4, "dry_link": 0.6})
    run = gear.simulate(rig, [dry], time, duty, None)
    start, damping = run.velocity[1000], DAMPING + 1.0
    stopped = time[1000:][np.argmax(run.velocity[1000:] == 0.0)] - 2.0
    assert stopped == pytest.approx(math.log(1.0 + damping * start / 1.0) / damping, rel=0.01)
    assert not np.any(run.velocity[-200:])


def test_friction_in_steady_running() -> None:
    end = held(TIGHT, 50.0, 8.0, Concealed("friction_asymmetry", {"dry_link": 0.5, "asymmetry_link": 0.2})).velocity[-1]
    assert end == pytest.approx((torque(50.0) - 0.7) / DAMPING, rel=2e-3)
    end = held(TIGHT, 50.0, 8.0, Concealed("load_dependent_friction", {"efficiency_link": 0.4})).velocity[-1]
    assert end == pytest.approx(torque(50.0) / (DAMPING - 0.5 + 0.5 / 0.6), rel=2e-3)
    end = held(TIGHT, 50.0, 8.0, Concealed("quadratic_drag", {"drag_motor": 0.1, "drag_link": 0.2})).velocity[-1]
    assert 0.3 * end**2 + DAMPING * end == pytest.approx(torque(50.0), rel=2e-3)
    stribeck = {"dry_motor": 0.5, "stribeck_motor": 0.4, "stribeck_speed": 3.0, "stribeck_exponent": 1.0}
    end = held(TIGHT, 50.0, 8.0, Concealed("stribeck_friction", stribeck)).velocity[-1]
    assert DAMPING * end + 0.5 + 0.4 * math.exp(-end / 3.0) == pytest.approx(torque(50.0), rel=2e-3)


def test_friction_over_a_turn() -> None:
    # It would hold 1.0 - 0.5 at the angle 0 and 1.0 + 0.5 half a turn on.
    friction = {"dry_link": 1.0, "turn_link": 0.5, "turn_phase": -0.5 * math.pi}
    run = held(FREE_LINK, 0.0, 60.0, Concealed("position_dependent_friction", friction), offset(0.8))
    # Energy: 0.8 a = 1.0 a - 0.5 sin(a) where it stops.
    stop = run.position[-1]
    assert run.velocity[-1] == 0.0
    assert 0.2 * stop == pytest.approx(0.5 * math.sin(stop), abs=1e-3)


def test_static_balance() -> None:
    level = RIG.dead_band_forward + 5.0
    run = held(TIGHT, level, 30.0, Concealed("gravity", {"gravity_torque": 1.0, "gravity_angle": 0.1}))
    assert math.sin(run.position[-1] - 0.1) == pytest.approx(torque(level), rel=1e-3)
    run = held(TIGHT, level, 30.0, Concealed("spring", {"spring_rate": 2.0, "spring_angle": -0.2}))
    assert run.position[-1] == pytest.approx(torque(level) / 2.0 - 0.2, abs=1e-4)
    stop = {"stop_upper_stiffness": 50.0, "stop_upper_angle": 0.7, "stop_loss": 0.2}
    run = held(TIGHT, level, 30.0, Concealed("end_stop", stop))
    assert run.position[-1] == pytest.approx(0.7 + torque(level) / 50.0, abs=1e-4)


def test_end_stop_throws_back() -> None:
    # Hunt and Crossley: e about 1 - (2/3) loss speed.
    stop = {"stop_lower_stiffness": 500.0, "stop_lower_angle": -1.0, "stop_loss": 0.2}
    run = held(FREE_LINK, 0.0, 3.0, Concealed("end_stop", stop), offset(-0.3), step=2e-4)
    down = run.velocity.min()
    back = run.velocity[np.argmin(run.position) :].max()
    assert down == pytest.approx(-1.0, rel=0.01)  # sqrt(2 x 0.5 x 1)
    assert back == pytest.approx(1.0 - 2.0 / 3.0 * 0.2, abs=0.03)


def test_joint_rings_at_its_frequency() -> None:
    joint = gear.draw_effect(np.random.default_rng(1), "joint_elasticity", TIGHT, 0.3)
    run = held(TIGHT, 50.0, 1.2, joint)
    swing = np.gradient(run.velocity, run.time)
    peaks = np.flatnonzero((swing[1:-1] > swing[:-2]) & (swing[1:-1] >= swing[2:]))
    assert np.diff(run.time[peaks])[:2] == pytest.approx(1.0 / 3.0, rel=0.05)


def test_electrical_side_at_a_stall() -> None:
    on = 0.45
    still = on * RIG.supply / RIG.resistance
    time = clock(0.3)
    for place in (gear.VOLTAGE_LAG, gear.WINDING_LAG):
        run = held(RIG, 50.0, 0.3, STUCK, Concealed("motor_lag", {"lag_time": 0.06, "lag_place": place}))
        assert run.current == pytest.approx(still * -np.expm1(-time / 0.06), abs=2e-3 * still)
    run = held(RIG, 50.0, 0.3, STUCK, Concealed("motor_lag", {"lag_time": 0.06, "lag_place": gear.COMMAND_LAG}))
    expected = np.maximum(-50.0 * np.expm1(-time / 0.06) - 5.0, 0.0) / 45.0 * still
    assert run.current == pytest.approx(expected, abs=2e-3 * still)
    run = held(RIG, 50.0, 0.3, STUCK, Concealed("supply_sag", {"source_resistance": 0.2, "source_time": 0.01}))
    assert run.current[-1] == pytest.approx(on * RIG.supply / (RIG.resistance + on**2 * 0.2), rel=1e-6)
    run = held(RIG, 50.0, 0.3, STUCK, Concealed("drive_saturation", {"clip": 30.0}))
    assert run.current[-1] == pytest.approx(0.25 / 0.45 * still, rel=1e-6)


def test_heat_balance() -> None:
    heat = {"heating": 0.01, "cooling": 2.0, "heat_resistance": gear.COPPER, "heat_flux": 0.001}
    run = held(RIG, 50.0, 10.0, STUCK, Concealed("thermal_fade", heat))
    kelvin = (0.45 * RIG.supply / (RIG.resistance * run.current[-1]) - 1.0) / gear.COPPER
    hot = RIG.resistance * (1.0 + gear.COPPER * kelvin)
    assert kelvin > 1.0
    assert 2.0 * kelvin == pytest.approx(0.01 * hot * run.current[-1] ** 2, rel=1e-4)


def test_delay_shifts() -> None:
    time, duty = EXCITATIONS["random_steps"](5.0, np.random.default_rng(1), FREE)
    late = np.concatenate([np.zeros(15), duty[:-15]])
    shifted = gear.simulate(RIG, [], time, late, 3)
    delayed = gear.simulate(RIG, [Concealed("input_delay", {"delay": 0.03})], time, duty, 3)
    assert delayed.position == pytest.approx(shifted.position, abs=1e-9)


def test_encoder_eccentricity_is_of_the_sensor() -> None:
    wobble = Concealed("encoder_eccentricity", {"eccentricity": 0.02, "eccentricity_phase": 0.4})
    plain, wrong = held(RIG, 50.0, 2.0), held(RIG, 50.0, 2.0, wobble)
    assert np.array_equal(plain.velocity, wrong.velocity)
    assert np.array_equal(plain.position, wrong.position)
    assert wrong.shown - plain.position == pytest.approx(0.02 * np.sin(plain.position + 0.4), abs=1e-12)


def test_load_is_taken_up() -> None:
    load = Concealed("load_change", {"load_added": 0.6, "load_time": 1.0})
    run = held(FREE_LINK, 0.0, 2.0, load, offset(0.6))
    assert run.velocity[[500, 1000]] == pytest.approx([1.0, 1.5], abs=1e-3)


def test_disturbance_moves_link_and_motor() -> None:
    shake = {"outside_torque": 1.0, "outside_frequency": 0.5, "outside_phase": 0.0}
    run = held(TIGHT, 0.0, 12.0, Concealed("periodic_disturbance", shake))
    assert run.velocity[-2000:].max() == pytest.approx(1.0 / math.hypot(math.pi, DAMPING), rel=0.01)


def test_detent_holds_up_to_its_depth() -> None:
    magnet = Concealed("detent", {"detent_torque": 1.0, "detent_angle": 0.0, "detent_width": 0.2})
    rig = FREE_LINK.with_(link_viscous=3.0)  # too slow to run over the brim
    kept, lost = (held(rig, 0.0, 10.0, magnet, offset(t)) for t in (0.9, 1.1))
    assert abs(kept.position).max() < 0.2
    assert lost.position[-1] > 1.0
