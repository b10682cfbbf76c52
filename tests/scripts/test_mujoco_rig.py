"""The generator of recordings against formulas worked out by hand: the tool's judge is judged first."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from concealed import Concealed, Trip, visibility
from excitations import EXCITATIONS, Limits
from make_recording import CANDIDATES, make, write
from mujoco_rig import (
    Rig,
    Simulated,
    Stepping,
    draw_effect,
    draw_rig,
    simulate,
)

RIG = Rig(
    input_gain=0.4,
    viscous_friction=2.0,
    dead_band_forward=5.0,
    dead_band_backward=7.0,
    backlash=0.05,
    motor_share=0.25,
    motor_friction_share=0.6,
    teeth_frequency=150.0,
    teeth_damping=0.3,
    motor_noise=0.02,
    link_noise=0.02,
    counts_per_revolution=10000,
    encoder_phase=0.3,
)
AT_ONCE = Stepping(settle=0.0)


def play(
    pieces: list[tuple[float, float]],
    *effects: Concealed,
    rig: Rig = RIG,
    seed: int | None = None,
    stepping: Stepping = AT_ONCE,
) -> Simulated:
    """Duties held for so many seconds each, at 2 ms."""
    duty = np.concatenate([np.full(round(length * 500), level) for length, level in pieces])
    time = np.arange(len(duty)) * 0.002
    return simulate(rig, effects, time, duty, seed, stepping)


@pytest.mark.parametrize(("duty", "acting"), [(40.0, 35.0), (-40.0, -33.0), (4.9, 0.0), (-6.9, 0.0)])
def test_steady_speed_is_gain_over_friction(duty: float, acting: float) -> None:
    run = play([(6.0, duty)])
    assert run.velocity[-1] == pytest.approx(0.4 * acting / 2.0, rel=2e-5, abs=1e-9)


def test_coast_down_has_the_time_constant() -> None:
    # All viscous friction on the motor would open the gap while coasting; equal deceleration keeps it shut.
    rig = replace(RIG, motor_friction_share=RIG.motor_share)
    run = play([(3.0, 40.0), (1.0, 0.0)], rig=rig)
    speed = run.velocity[1501:1990:100]
    assert np.diff(np.log(speed)) == pytest.approx(-2.0 * 0.2, rel=2e-3)


def test_the_gap_is_crossed_in_the_time_that_its_width_and_the_motor_inertia_give() -> None:
    rig = replace(RIG, viscous_friction=0.01, motor_share=0.2)
    link_moves = []
    for duty in (20.0, 60.0):
        run = play([(1.0, 6.0), (4.0, 0.0), (0.5, -duty)], rig=rig)  # push the motor to one side, gently
        steady = run.velocity[2499]
        start = np.flatnonzero(np.abs(run.velocity[2500:] - steady) > 1e-3)[0] * 0.002
        closing = run.motor_velocity[2499] - steady
        gap = run.motor_position[2499] - run.position[2499] + 0.5 * rig.backlash
        push = 0.4 * (duty - 7.0) / 0.2
        expected = (closing + np.sqrt(closing**2 + 2.0 * push * gap)) / push
        assert start == pytest.approx(expected, abs=0.003)
        link_moves.append(start)
    assert link_moves[0] / link_moves[1] == pytest.approx(np.sqrt(53.0 / 13.0), rel=0.1)


def test_at_rest_the_dead_time_is_the_root_of_the_gap_over_the_torque() -> None:
    # Gap 0.05, motor in its middle: half of it is crossed from rest.
    run = play([(0.5, 30.0)])
    first = np.flatnonzero(run.velocity > 1e-3)[0] * 0.002
    assert first == pytest.approx(np.sqrt(2.0 * 0.25 * 0.025 / (0.4 * 25.0)), abs=0.003)


def test_teeth_push_and_do_not_pull_and_give_as_a_spring_does() -> None:
    run = play([(3.0, 40.0)])
    press = run.motor_position[-1] - run.position[-1] - 0.5 * RIG.backlash
    # In steady motion the teeth carry what the link's own friction eats.
    carried = 2.0 * 0.4 * run.velocity[-1]
    stiffness = (2.0 * np.pi * 150.0) ** 2 * 0.25 * 0.75
    assert press == pytest.approx(carried / stiffness, rel=0.03)


def test_energy_of_the_drive_is_what_moves_and_what_friction_eats() -> None:
    drag = Concealed("quadratic_drag", {"gain": 0.05})
    run = play([(2.0, 40.0), (1.0, -30.0), (1.0, 0.0)], drag, rig=replace(RIG, backlash=1e-4))
    work = np.sum(run.torque * run.motor_velocity) * 0.002
    eaten = np.sum(2.0 * run.velocity**2 + 0.05 * np.abs(run.velocity) ** 3) * 0.002
    moving = 0.5 * run.velocity[-1] ** 2
    assert work == pytest.approx(eaten + moving, rel=0.01)


def test_dry_friction_sticks() -> None:
    # 12 % acts as 7 %, 2.8 rad/s^2, under a friction of 3 and over one of 2.
    held = play([(5.0, 12.0)], Concealed("coulomb_friction", {"magnitude": 3.0}))
    assert abs(held.motor_position[-1] - held.motor_position[500]) < 1e-5
    # The motor's part of the friction alone lets it cross the gap; once it leans on the link, both stay.
    assert abs(held.position[-1] - held.position[500]) < 1e-6
    slides = play([(5.0, 12.0)], Concealed("coulomb_friction", {"magnitude": 2.0}))
    assert slides.velocity[-1] == pytest.approx((2.8 - 2.0) / 2.0, rel=1e-3)


def test_dry_friction_holds_a_link_on_a_slope() -> None:
    rig = replace(RIG, motor_friction_share=0.0)
    pull, hold = (
        Concealed("constant_offset", {"torque": 1.0}),
        Concealed("coulomb_friction", {"magnitude": 1.2}),
    )
    run = play([(10.0, 0.0)], pull, hold, rig=rig)
    assert abs(run.position[-1] - run.position[0]) < 1e-5  # a sixtieth of a count


@pytest.mark.parametrize(
    ("effect", "duty", "speed"),
    [
        (Concealed("coulomb_friction", {"magnitude": 4.0}), 40.0, (14.0 - 4.0) / 2.0),
        (Concealed("friction_asymmetry", {"forward": 4.0, "backward": 0.0}), 40.0, (14.0 - 4.0) / 2.0),
        (Concealed("friction_asymmetry", {"forward": 4.0, "backward": 0.0}), -42.0, -14.0 / 2.0),
        (Concealed("stribeck_friction", {"magnitude": 4.0, "speed": 0.5}), 40.0, 7.0),
        (Concealed("constant_offset", {"torque": -2.0}), 40.0, 6.0),
        (Concealed("quadratic_drag", {"gain": 0.5}), 40.0, (np.sqrt(4.0 + 2.0 * 14.0) - 2.0)),
        (Concealed("drive_saturation", {"limit": 25.0}), 40.0, 0.4 * 20.0 / 2.0),
        # Link: T = 0.8 w + 0.4 k T. Motor: 14 = T + 1.2 w + 0.6 k T. With k = 0.2:
        (Concealed("load_dependent_friction", {"share": 0.2}), 40.0, 14.0 / (1.2 + 0.8 * 1.12 / 0.92)),
        (Concealed("other_brake_coast", {"damping": 9.0}), 40.0, 7.0),
        (Concealed("other_speed_hump", {"torque": 1.0, "speed": 6.5, "width": 1e3}), 40.0, 6.5),
    ],
)
def test_steady_speed_with_an_effect(effect: Concealed, duty: float, speed: float) -> None:
    assert play([(6.0, duty)], effect).velocity[-1] == pytest.approx(speed, rel=2e-3)


def test_supply_sags_and_motor_heats_to_where_the_algebra_says() -> None:
    # Back-emf in percent at speed w is 0.7 b w / c.
    sag = play([(6.0, 50.0)], Concealed("supply_sag", {"resistance": 0.2, "time": 0.005}))
    speed = sag.velocity[-1]
    supply = (0.4 * 5.0 + 2.0 * speed) / (0.4 * 50.0)
    current = 50.0 * supply - 0.7 * 2.0 * speed / 0.4
    assert supply == pytest.approx(1.0 - 0.2 * 50.0 * current / 2500.0, rel=1e-3)
    fade = play([(12.0, 50.0)], Concealed("thermal_fade", {"fade": 0.5, "time": 1.0}))
    speed = fade.velocity[-1]
    heat = ((50.0 - 0.7 * 2.0 * speed / 0.4) / 50.0) ** 2
    assert speed == pytest.approx(0.4 * 45.0 / 2.0 / (1.0 + 0.5 * heat), rel=1e-3)


def test_gravity_and_spring_and_stop_hold_where_torques_balance() -> None:
    push = (1.0, 15.0)  # 4 rad/s^2
    hung = play([push] * 25, Concealed("gravity", {"gain": 8.0, "phase": 0.4}))
    assert hung.position[-1] == pytest.approx(np.arcsin(0.5) - 0.4, abs=2e-3)
    wound = play([push] * 25, Concealed("spring", {"stiffness": 2.0, "rest": 0.3}))
    assert wound.position[-1] == pytest.approx(2.3, abs=2e-3)
    stop = Concealed("end_stop", {"low": -1e6, "high": 1.0, "stiffness": 2e4, "damping": 0.2})
    assert play([push] * 8, stop).position[-1] == pytest.approx(1.0 + 4.0 / 2e4, abs=1e-5)
    free = play([(3.0, -40.0)], stop)
    assert free.position == pytest.approx(play([(3.0, -40.0)]).position, abs=1e-12)


def test_lag_and_delay_shift_the_torque() -> None:
    pieces = [(0.1, 0.0), (0.9, 50.0)]
    late = play(pieces, Concealed("input_delay", {"time": 0.0137}))
    base = play(pieces)
    assert late.position == pytest.approx(np.interp(late.time - 0.0137, base.time, base.position), abs=5e-4)
    lagged = play(pieces, Concealed("motor_lag", {"time": 0.04}))
    since = lagged.time - 0.1
    assert lagged.torque == pytest.approx(
        np.where(since > 0.0, 18.0 * (1.0 - np.exp(-since / 0.04)), 0.0), abs=18.0 * 0.005
    )


def test_an_elastic_joint_rings_at_its_frequency() -> None:
    rig = replace(RIG, viscous_friction=0.05)
    run = play([(4.0, 50.0)], Concealed("joint_elasticity", {"frequency": 8.0, "damping": 0.02}), rig=rig)
    ringing = run.velocity - np.polyval(np.polyfit(run.time, run.velocity, 3), run.time)
    power = np.abs(np.fft.rfft(ringing * np.hanning(len(ringing))))
    peak = np.fft.rfftfreq(len(ringing), 0.002)[np.argmax(power)]
    # The gear's tenth of the link's inertia turns with the motor.
    assert peak == pytest.approx(8.0, abs=0.3)


def test_a_load_change_changes_the_acceleration() -> None:
    effect = Concealed("load_change", {"factor": 1.8, "time": 3.0})
    run = play([(3.0, 40.0), (0.5, 60.0)], effect)
    rate = (run.velocity[1700] - run.velocity[1600]) / 0.2
    mean = run.velocity[1600:1701].mean()
    assert rate == pytest.approx((0.4 * 55.0 - 2.0 * mean) / (0.25 + 0.75 * 1.8), rel=2e-3)


def test_the_eccentric_encoder_moves_nothing() -> None:
    effect = Concealed("encoder_eccentricity", {"amplitude": 0.03, "phase": 0.5})
    run, base = play([(4.0, 40.0)], effect), play([(4.0, 40.0)])
    assert np.array_equal(run.position, base.position)
    shift = (run.counts - base.counts) * 2.0 * np.pi / 10000.0
    assert shift == pytest.approx(0.03 * np.sin(base.position + 0.5), abs=7e-4)


def test_counts_are_the_position_to_within_a_count() -> None:
    run = play([(2.0, 40.0)])
    offset = run.counts - run.position * 10000.0 / (2.0 * np.pi)
    assert offset.min() > 0.3 - 1.0 and offset.max() <= 0.3


def test_noise_has_its_density() -> None:
    # Torque noise of density D per root hertz walks the speed by D sqrt(t).
    rig = replace(RIG, viscous_friction=1e-3, motor_noise=0.03, link_noise=0.04, backlash=1e-5)
    end = [play([(0.4, 0.0)], rig=rig, seed=k) for k in range(60)]
    momentum = np.array([0.25 * r.motor_velocity[-1] + 0.75 * r.velocity[-1] for r in end])
    assert momentum.std() == pytest.approx(0.05 * np.sqrt(0.4), rel=0.3)


def test_a_finer_step_changes_less_than_the_noise() -> None:
    pieces = [(0.4, 40.0), (0.3, -30.0), (0.3, 0.0)]
    coarse, fine = play(pieces).position, play(pieces, stepping=Stepping(settle=0.0, step=1e-4)).position
    assert 0.0 < np.abs(fine - coarse).max() < 2.0 * np.pi / 10000.0


def test_several_effects_at_once() -> None:
    rng = np.random.default_rng(8)
    effects = [draw_effect(rng, i, RIG, 0.1, 3.0) for i in ("coulomb_friction", "gravity", "joint_elasticity")]
    time, duty = EXCITATIONS["random_steps"](3.0, rng, Limits())
    assert visibility(Trip(simulate, time, duty, 1), RIG, effects) > 3.0


def test_visibility_rises_from_nothing_with_size() -> None:
    rng = np.random.default_rng(4)
    time, duty = EXCITATIONS["square"](3.0, rng, Limits())
    trip = Trip(simulate, time, duty, 1)
    seen = [visibility(trip, RIG, [Concealed("coulomb_friction", {"magnitude": size})]) for size in (0.0, 0.2, 2.0)]
    assert seen[0] == 0.0 < seen[1] < seen[2]


def test_the_shipped_recording_is_drawn_by_its_seed(tmp_path: Path) -> None:
    names = {make(seed, 0.1)[1].id for seed in range(20)}
    assert names == set(CANDIDATES)
    write(tmp_path, seed=1)
    assert (tmp_path / "recording.csv").stat().st_size < 700_000
    table = np.loadtxt(tmp_path / "recording.csv", delimiter=",", skiprows=1)
    _, effect, run = make(1)
    assert table[:, 0] == pytest.approx(np.arange(30000) * 0.002, abs=1e-9)
    assert np.array_equal(table[:, 1], run.duty) and np.array_equal(table[:, 2], run.counts)
    assert json.loads((tmp_path / "truth.json").read_text())["effects"][0]["id"] == effect.id
    # What the tool gets to read must not give the answer away.
    assert effect.id not in (tmp_path / "rig.toml").read_text() + (tmp_path / "recording.csv").read_text()


def test_drawn_rigs_are_within_the_population() -> None:
    rng = np.random.default_rng(0)
    for rig in (draw_rig(rng) for _ in range(200)):
        assert 0.15 <= 1.0 / rig.viscous_friction <= 2.0
        assert min(rig.dead_band_forward, rig.dead_band_backward) >= 3.0
        assert max(rig.dead_band_forward, rig.dead_band_backward) <= 9.0
        assert 0.5 <= np.degrees(rig.backlash) <= 5.0
        assert 0.1 <= rig.motor_share <= 0.4
        loss = 0.5 * (rig.dead_band_forward + rig.dead_band_backward)
        assert 0.99 <= rig.input_gain * (60.0 - loss) / rig.viscous_friction <= 15.01


@pytest.mark.parametrize("name", EXCITATIONS)
@pytest.mark.parametrize("duration", [5.0, 60.0])
def test_excitations_fill_their_time_within_their_limits(name: str, duration: float) -> None:
    time, duty = EXCITATIONS[name](duration, np.random.default_rng(1), Limits(duty=60.0))
    assert len(time) == len(duty) == round(duration / 0.002)
    assert np.diff(time) == pytest.approx(0.002)
    assert 20.0 < np.abs(duty).max() <= 60.0
    assert duty.min() < 0.0 < duty.max() or duration < 10.0


def test_the_rich_protocol_keeps_its_promises() -> None:
    time, duty = EXCITATIONS["rich"](60.0, np.random.default_rng(2), Limits())
    change = np.abs(np.diff(duty))
    assert np.count_nonzero((change > 0.0) & (change < 0.1)) > 3000  # ramps
    before, after = duty[:-1], duty[1:]
    coasts = {round(abs(b)) for b, a in zip(before, after, strict=True) if abs(b) > 20.0 and a == 0.0}
    plugging = {round(abs(b)) for b, a in zip(before, after, strict=True) if b * a < 0.0 and abs(b - a) > 20.0}
    assert len(coasts) >= 3 and len(plugging) >= 3
    span = np.flatnonzero(change)[4]
    assert np.array_equal(duty[:span], duty[-len(duty) :][:span])
    block = round(4.2 / (4.2 * 2 + 9.6 + 10.2 + 7.2 + 8.0 + 9.0) * 60.0 * 500)
    assert np.count_nonzero(duty[:block] != duty[-block:]) < 10
    assert time[-1] == pytest.approx(59.998)
