"""The textbook's rig and its effects against formulas worked out by hand."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import textbook_rig as textbook
from concealed import Concealed
from excitations import EXCITATIONS, FREE

Array = NDArray[np.float64]

RIG = textbook.Rig(
    input_gain=0.2,
    motor_viscous=1.5,
    link_viscous=0.5,
    dead_band_forward=5.0,
    dead_band_reverse=4.0,
    gap=0.04,
    motor_share=0.4,
    mesh_stiffness=1e5,
    mesh_damping=60.0,
    noise=0.02,
    dry_share=0.5,
    edge=0.01,
    counts_per_revolution=20000,
    encoder_phase=0.3,
)
TIGHT = RIG.with_(gap=0.0)
LOOSE = RIG.with_(gap=1e3, link_viscous=0.0)  # the link is by itself


def held(rig: textbook.Rig, level: float, duration: float, *effects: Concealed) -> textbook.Simulated:
    """A run without noise at one duty."""
    time = 0.002 * np.arange(round(duration / 0.002) + 1)
    return textbook.simulate(rig, effects, time, np.full(time.size, level), None)


def end(rig: textbook.Rig, level: float, id: str, **parameters: float) -> float:
    """Speed at the end of a long run."""
    return float(held(rig, level, 8.0, Concealed(id, parameters)).velocity[-1])


# ---- the rig ----


@pytest.mark.parametrize(("duty", "expected"), [(40.0, 0.2 * 35.0 / 2.0), (-60.0, -0.2 * 56.0 / 2.0)])
def test_steady_speed(duty: float, expected: float) -> None:
    assert held(RIG, duty, 8.0).velocity[-1] == pytest.approx(expected, rel=1e-4)


def test_first_acceleration_and_time_constant() -> None:
    run = held(TIGHT, 50.0, 2.0)
    assert run.velocity == pytest.approx(0.2 * 45.0 / 2.0 * -np.expm1(-2.0 * run.time), abs=0.03)


@pytest.mark.parametrize("duty", [4.9, -3.9, 0.0])
def test_dead_band(duty: float) -> None:
    assert not np.any(held(RIG, duty, 0.5).motor_position)


def test_gap_crossing_time() -> None:
    run = held(RIG.with_(motor_viscous=0.0), 50.0, 0.2)
    touch = run.time[np.argmax(run.velocity > 0.0)]
    assert touch == pytest.approx(math.sqrt(2.0 * 0.02 * 0.4 / 9.0), abs=0.003)


def test_tooth_frequency() -> None:
    run = held(TIGHT.with_(mesh_damping=2.0), 50.0, 0.4)
    twist = run.motor_position - run.position
    spectrum = np.abs(np.fft.rfft((twist - twist.mean()) * np.hanning(twist.size), 16 * twist.size))
    peak = np.fft.rfftfreq(16 * twist.size, 0.002)[np.argmax(spectrum)]
    assert peak == pytest.approx(RIG.model_values()["tooth_frequency"], rel=0.03)


def test_counts_are_of_the_position() -> None:
    run = held(RIG, 30.0, 1.0)
    left = run.position * RIG.counts_per_revolution / (2.0 * math.pi) + RIG.encoder_phase - run.counts
    assert run.counts.dtype == np.int64 and left.min() >= 0.0 and left.max() < 1.0


def test_noise_moves_an_inertia_as_it_should() -> None:
    """What is held for 2 ms has a density of its square times 2 ms; on motor and link, that of both together."""
    time = 0.002 * np.arange(30001)
    runs = [textbook.simulate(TIGHT, [], time, np.zeros(time.size), seed).velocity[1000:] for seed in range(4)]
    assert np.mean(np.square(runs)) == pytest.approx(2.0 * 0.02**2 * 0.002 / (2.0 * 2.0), rel=0.3)


# ---- one by one ----


def test_resistances_in_steady_running() -> None:
    push = 0.2 * 45.0
    assert end(TIGHT, 50.0, "coulomb_friction", coulomb=1.0) == pytest.approx((push - 1.0) / 2.0, rel=1e-3)
    assert end(TIGHT, 50.0, "friction_asymmetry", dry_reverse=1.0) == pytest.approx(push / 2.0, rel=1e-3)
    v = end(TIGHT, 50.0, "quadratic_drag", drag=0.3)
    assert 0.3 * v**2 + 2.0 * v == pytest.approx(push, rel=1e-3)
    v = end(TIGHT, 50.0, "stribeck_friction", coulomb=0.5, stribeck=0.4, stribeck_speed=4.0)
    assert 2.0 * v + 0.5 + 0.4 * math.exp(-((v / 4.0) ** 2)) == pytest.approx(push, rel=1e-3)
    # The link's damping and its own half of the friction pass the teeth.
    v = end(TIGHT, 50.0, "load_dependent_friction", dry_load=0.4)
    passed = 0.5 * v / (1.0 - 0.5 * 0.4)
    assert 2.0 * v + 0.4 * passed == pytest.approx(push, rel=1e-3)
    v = end(TIGHT, 50.0, "other_cubic_drag", cubic=0.1)
    assert 0.1 * v**3 + 2.0 * v == pytest.approx(push, rel=1e-3)
    assert end(TIGHT, -50.0, "other_gain_asymmetry", gain_asymmetry=0.2) == pytest.approx(-0.24 * 46.0 / 2.0, rel=1e-3)
    assert end(TIGHT, -50.0, "viscous_asymmetry", viscous_asymmetry=1.0) == pytest.approx(-9.2 / 3.5, rel=1e-3)


def test_friction_slows_a_free_link_as_it_varies_over_the_turn() -> None:
    wave = {"coulomb": 1.0, "dry_wave": 0.5, "dry_wave_phase": 0.3, "offset": 3.0}
    run = held(LOOSE, 0.0, 2.0, Concealed("position_dependent_friction", wave))
    # Energy: half of it acts on the link.
    a = run.position[-1]
    worked = 3.0 * a - 0.5 * (a - 0.5 * (math.cos(a + 0.3) - math.cos(0.3)))
    assert 0.5 * 0.6 * run.velocity[-1] ** 2 == pytest.approx(worked, rel=0.01)


def test_static_balance() -> None:
    push = 0.2 * 5.0
    run = held(TIGHT, 10.0, 20.0, Concealed("gravity", {"gravity": 2.0, "gravity_phase": -0.1}))
    assert math.sin(run.position[-1] - 0.1) == pytest.approx(push / 2.0, rel=1e-3)
    run = held(TIGHT, 10.0, 20.0, Concealed("spring", {"spring": 4.0, "spring_rest": -0.2}))
    assert run.position[-1] == pytest.approx(push / 4.0 - 0.2, rel=1e-3)
    stop = {"stop_upper": 0.7, "stop_stiffness": 50.0, "stop_damping": 10.0}
    run = held(TIGHT, 10.0, 20.0, Concealed("end_stop", stop))
    assert run.position[-1] == pytest.approx(0.7 + push / 50.0, rel=1e-3)
    bump = {"bump": -0.8 * push, "bump_angle": 1.0, "bump_width": 0.2, "spring": 1.0}
    at = held(TIGHT, 10.0, 20.0, Concealed("other_bump", bump)).position[-1]
    assert at == pytest.approx(push * (1.0 - 0.8 * math.exp(-0.5 * ((at - 1.0) / 0.2) ** 2)), rel=1e-3)


def test_the_drive() -> None:
    assert end(TIGHT, 50.0, "drive_saturation", clip=30.0) == pytest.approx(0.2 * 25.0 / 2.0, rel=1e-3)
    v = end(TIGHT, 50.0, "supply_sag", sag=0.3)
    lost = 0.3 * (50.0 - textbook.EMF * 1.5 * v / 0.2) / 50.0
    assert 2.0 * v == pytest.approx(0.2 * (50.0 * (1.0 - lost) - 5.0), rel=1e-3)
    v = end(TIGHT, 50.0, "thermal_fade", fade=0.1, fade_time=0.5)
    assert 2.0 * v == pytest.approx(9.0 * (1.0 - 0.1 * (45.0 / 40.0) ** 2), rel=1e-3)
    run = held(TIGHT.with_(motor_viscous=0.0, link_viscous=0.0), 50.0, 1.0, Concealed("motor_lag", {"lag": 0.1}))
    assert run.velocity[-1] == pytest.approx(9.0 * (1.0 - 0.1 * -math.expm1(-10.0)), rel=1e-3)


def test_delay_shifts() -> None:
    time, duty = EXCITATIONS["random_steps"](5.0, np.random.default_rng(1), FREE)
    late = np.concatenate([np.zeros(15), duty[:-15]])
    shifted = textbook.simulate(RIG, [], time, late, 3)
    delayed = textbook.simulate(RIG, [Concealed("input_delay", {"delay": 0.03})], time, duty, 3)
    assert np.array_equal(delayed.position, shifted.position)


def test_encoder_eccentricity_is_of_the_sensor() -> None:
    wobble = Concealed("encoder_eccentricity", {"eccentricity": 0.02, "eccentricity_phase": 0.4})
    plain, wrong = held(RIG, 50.0, 2.0), held(RIG, 50.0, 2.0, wobble)
    assert np.array_equal(plain.position, wrong.position)
    shown = (wrong.counts - plain.counts) * 2.0 * math.pi / RIG.counts_per_revolution
    assert shown == pytest.approx(0.02 * np.sin(plain.position + 0.4), abs=4e-4)


def test_torques_by_time_and_angle_and_a_load_that_is_taken_up() -> None:
    shake = {"shake": 1.0, "shake_frequency": 0.5, "shake_phase": 0.0}
    run = held(TIGHT, 0.0, 12.0, Concealed("periodic_disturbance", shake))
    assert run.velocity[-2000:].max() == pytest.approx(1.0 / math.hypot(math.pi, 2.0), rel=0.01)
    ripple = {"ripple": 0.5, "ripple_order": 6.0, "ripple_phase": 0.5 * math.pi}
    run = held(TIGHT.with_(motor_viscous=0.0, link_viscous=0.0), 50.0, 1.0, Concealed("torque_ripple", ripple))
    # The ripple moves it before the drive does.
    begun, a = run.position[[0, -1]]
    worked = 9.0 * (a - begun) + 0.5 / 6.0 * math.sin(6.0 * a)
    assert 0.5 * run.velocity[-1] ** 2 == pytest.approx(worked, rel=1e-3)
    load = Concealed("load_change", {"load_time": 1.0, "load_factor": 2.0, "offset": 0.6})
    assert held(LOOSE, 0.0, 2.0, load).velocity[[500, 1000]] == pytest.approx([1.5, 2.0], rel=0.01)


def test_joint_rings_at_its_frequency() -> None:
    joint = textbook.draw_effect(np.random.default_rng(1), "joint_elasticity", TIGHT, 0.3)
    run = held(TIGHT, 50.0, 1.2, joint)
    swing = np.gradient(run.velocity, run.time)
    peaks = np.flatnonzero((swing[1:-1] > swing[:-2]) & (swing[1:-1] >= swing[2:]))
    assert np.diff(run.time[peaks])[:2] == pytest.approx(1.0 / 3.0, rel=0.05)
