"""The second generator of recordings against formulas worked out by hand."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from circuit_rig import Rig, Simulated, Stepping, simulate
from concealed import Concealed

# Back-EMF takes 1.2 of the viscous friction of 2, the motor 0.2 and the link 0.6.
RIG = Rig(
    stall_torque=40.0, back_emf=0.03, motor_viscous=0.2, link_viscous=0.6, motor_inertia=0.25, gap=0.05,
    teeth_stiffness=1.6e5, teeth_damping=100.0, dead_band_forward=5.0, dead_band_reverse=7.0, start=0.0,
    start_in_gap=0.01, noise=0.02, noise_time=0.02, counts_per_revolution=10000, encoder_phase=0.3,
)  # fmt: skip


def play(
    pieces: list[tuple[float, float]],
    *effects: Concealed,
    rig: Rig = RIG,
    seed: int | None = None,
    substeps: int = 100,
) -> Simulated:
    """Duties held for so many seconds each."""
    duty = np.concatenate([np.full(round(length * 500), level) for length, level in pieces])
    return simulate(rig, effects, np.arange(len(duty)) * 0.002, duty, seed, Stepping(0.0, substeps))


@pytest.mark.parametrize(("duty", "acting"), [(40.0, 0.35), (-40.0, -0.33), (4.9, 0.0), (-6.9, 0.0)])
def test_steady_speed_is_torque_over_friction(duty: float, acting: float) -> None:
    assert play([(8.0, duty)]).velocity[-1] == pytest.approx(40.0 * acting / 2.0, rel=2e-5, abs=1e-9)


def test_teeth_carry_what_the_link_eats() -> None:
    run = play([(8.0, 40.0)])
    press = run.motor_position[-1] - run.position[-1] - 0.025
    assert press * RIG.teeth_stiffness == pytest.approx(0.6 * 7.0, rel=1e-3)


def test_the_gap_is_crossed_from_where_the_motor_stands() -> None:
    # From 0.01 to 0.025 under 14 rad/s^2 on a quarter of the inertia; back-EMF takes a hundredth by then.
    run = play([(0.5, 40.0)])
    assert run.time[np.argmax(run.velocity > 0.0)] == pytest.approx(np.sqrt(2.0 * 0.015 * 0.25 / 14.0), abs=0.003)


@pytest.mark.parametrize(
    ("parameters", "duty", "speed"),
    [
        ({"coulomb": 3.0}, 40.0, 11.0 / 2.0),
        ({"coulomb": 3.0, "dry_at_motor": 0.3, "bristle": 1e-4}, -40.0, -10.2 / 2.0),
        ({"coulomb": 3.0, "one_way": 0.5}, 40.0, 9.5 / 2.0),
        ({"coulomb": 3.0, "one_way": 0.5}, -40.0, -11.7 / 2.0),
        ({"coulomb": 3.0, "excess": 2.0, "excess_speed": 0.5}, 40.0, 11.0 / 2.0),
        ({"offset_motor": 2.0}, 40.0, 16.0 / 2.0),
        ({"offset_link": -2.0}, 40.0, 12.0 / 2.0),
        ({"drag": 0.5}, 40.0, np.sqrt(4.0 + 2.0 * 14.0) - 2.0),
        ({"saturation": 25.0}, 40.0, 8.0 / 2.0),
        ({"slant": 0.5}, 40.0, 14.0 / 2.5),
        ({"slant": 0.5}, -40.0, -13.2 / 1.5),
        ({"hump": 1.0, "hump_speed": 6.5, "hump_width": 1e3}, 40.0, 13.0 / 2.0),
        # The teeth carry 0.6 w and what they make of it: at the link T = 0.6 w + 0.2 T, at the motor T = 0.6 w.
        ({"per_load": 0.2}, 40.0, 14.0 / (1.4 + 0.6 / 0.8)),
        ({"per_load": 0.2, "load_at_motor": 1.0}, 40.0, 14.0 / (1.4 + 0.6 * 1.2)),
        # Lag and delay are over by then.
        ({"filter_time": 0.05}, 40.0, 14.0 / 2.0),
        ({"winding_time": 0.05}, 40.0, 14.0 / 2.0),
        ({"delay": 0.05}, 40.0, 14.0 / 2.0),
    ],
)
def test_steady_speed_with_an_effect(parameters: dict[str, float], duty: float, speed: float) -> None:
    run = play([(12.0, duty)], Concealed("coulomb_friction", parameters))
    assert run.velocity[-1] == pytest.approx(speed, rel=2e-4)


def test_supply_sags_and_motor_heats_to_where_the_algebra_says() -> None:
    def current(speed: float) -> float:
        return 2.0 * speed / 40.0 - 1.2 * speed / 40.0  # what friction without back-EMF takes

    sag = play([(12.0, 55.0)], Concealed("supply_sag", {"source_resistance": 0.2}))
    bridge = 0.5
    rail = 1.0 - 0.2 * bridge * current(sag.velocity[-1])
    assert bridge * rail - 0.03 * sag.velocity[-1] == pytest.approx(current(sag.velocity[-1]), rel=1e-3)
    warm = play([(40.0, 55.0)], Concealed("thermal_fade", {"heating": 400.0, "cooling_time": 5.0}))
    kelvin, amps, speed = warm.temperature[-1], warm.current[-1], warm.velocity[-1]
    assert kelvin == pytest.approx(400.0 * 5.0 * amps**2, rel=1e-2) and kelvin > 50.0
    assert 40.0 * (1.0 - 0.002 * kelvin) * amps == pytest.approx(0.8 * speed, rel=1e-3)
    assert bridge - 0.03 * (1.0 - 0.002 * kelvin) * speed == pytest.approx((1.0 + 0.0039 * kelvin) * amps, rel=1e-3)


def test_gravity_and_spring_and_stop_hold_where_torques_balance() -> None:
    push = [(30.0, 15.0)]  # 4 rad/s^2
    hung = play(push, Concealed("gravity", {"gravity": 8.0, "gravity_phase": 0.4}))
    assert hung.position[-1] == pytest.approx(np.arcsin(0.5) - 0.4, abs=2e-3)
    wound = play(push, Concealed("spring", {"spring": 2.0, "spring_rest": 0.3}))
    assert wound.position[-1] == pytest.approx(2.3, abs=2e-3)
    bent = play(push, Concealed("other_cubic_spring", {"cubic": 4.0, "cubic_flat": 0.5}))
    assert bent.position[-1] == pytest.approx(1.5, abs=2e-3)
    stop = Concealed("end_stop", {"stop_upper": 1.0, "stop_stiffness": 2e4, "stop_damping": 60.0})
    assert play(push, stop).position[-1] == pytest.approx(1.0 + 4.0 / 2e4, abs=1e-5)


def test_an_elastic_joint_rings_at_its_frequency_and_a_heavier_link_accelerates_less() -> None:
    joint = {"gear_inertia": 0.05, "coupling_stiffness": (2.0 * np.pi * 8.0) ** 2 * 0.3 * 0.7, "coupling_damping": 0.2}
    run = play([(4.0, 50.0)], Concealed("joint_elasticity", joint), rig=RIG._replace(back_emf=0.0))
    ringing = run.velocity - np.polyval(np.polyfit(run.time, run.velocity, 5), run.time)
    power = np.abs(np.fft.rfft(ringing * np.hanning(len(ringing))))
    assert np.fft.rfftfreq(len(ringing), 0.002)[np.argmax(power)] == pytest.approx(8.0, abs=0.3)
    heavy = play([(1.0, 50.0)], Concealed("load_change", {"load_factor": 2.0, "load_time": 0.0}))
    assert heavy.velocity[-1] == pytest.approx(9.0 * (1.0 - np.exp(-2.0 / 1.75)), rel=0.02)


def test_friction_holds_a_link_on_a_slope_and_bristles_give() -> None:
    for bristle, least, most in ((0.0, 0.0, 1e-9), (1e-3, 1e-3, 2e-3)):
        hold = Concealed("coulomb_friction", {"coulomb": 1.5, "bristle": bristle})
        run = play([(10.0, 0.0)], hold, Concealed("constant_offset", {"offset_link": 1.0}))
        assert np.abs(run.position[2500:] - run.position[-1]).max() < 1e-6
        assert least <= run.position[-1] <= most


def test_the_noise_has_its_density_and_its_seed() -> None:
    rig = RIG._replace(back_emf=0.0, motor_viscous=0.0, link_viscous=0.0, gap=1e-5, start_in_gap=0.0)
    runs = [play([(2.0, 0.0)], rig=rig, seed=k) for k in range(60)]
    # White torque of density D per root hertz walks the speed by D sqrt(t).
    assert np.std([r.velocity[-1] for r in runs]) == pytest.approx(0.02 * np.sqrt(2.0), rel=0.3)
    assert np.array_equal(runs[3].counts, play([(2.0, 0.0)], rig=rig, seed=3).counts)


def test_a_finer_step_changes_less_than_a_count() -> None:
    pieces = [(0.4, 40.0), (0.3, -30.0), (0.3, 0.0)]
    change = play(pieces, substeps=200).position - play(pieces).position
    assert np.abs(change).max() < 2.0 * np.pi / 10000.0
