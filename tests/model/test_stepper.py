"""The stepper against closed forms, an independent integrator and itself at finer steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from axis_runs import run, sane, steps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from twin.effects.catalogue import BASE, EFFECTS
from twin.model.stepper import STATES, Structure
from twin.simulation import kernel

COUNT = 2.0 * math.pi / 10000.0
PLAIN = {"input_gain": 0.3, "viscous_friction": 2.0, "dead_band_forward": 4.0, "dead_band_reverse": 5.0}
RIDE = list(STATES).index("ride")
GAP = {"backlash_gap": 0.04, "motor_share": 0.25, "friction_share": 0.7}


def clock(seconds: float, step: float = 0.002) -> np.ndarray:
    return np.arange(round(seconds / step) + 1) * step


def test_a_link_held_on_a_slope_stays_for_an_hour():
    structure = Structure.of(("inertia", "viscous_friction", "gravity", "coulomb_friction"))
    values = {"input_gain": 0.3, "viscous_friction": 2.0, "coulomb_friction": 3.0}
    values |= {"gravity_gain": 4.0, "gravity_angle": 0.0}
    start = kernel.start_state(0.8, 0.0, 0.0)  # 4 sin(0.8) = 2.87 < 3
    position, states = run(structure, values, clock(3600.0, 0.02), np.zeros(180001), start, longest=0.02)
    assert np.abs(position - 0.8).max() < 1e-9
    start = kernel.start_state(0.86, 0.0, 0.0)  # 4 sin(0.86) = 3.03 > 3: it slides
    position, states = run(structure, values, clock(5.0), np.zeros(2501), start)
    assert position[-1] < 0.85 and states[-1, 1] == 0.0


def test_what_fades_for_ever_comes_to_rest():
    """Numbers near 1e-310 cost twenty times the time: an axis left alone must not keep them."""
    structure = Structure.of((*BASE, "motor_lag", "thermal_fade"))
    values = PLAIN | GAP | {"viscous_friction": 6.0, "lag_time": 0.05, "fade": 0.3, "fade_time": 0.2}
    time = clock(200.0, 0.02)
    command = np.where(time < 1.0, 60.0, 0.0)
    _, states = run(structure, values, time, command, kernel.start_state(0.0, 0.5, 0.0), longest=0.02)
    assert np.all(states[60, [1, 3, 4, 5]] != 0.0), "all of it moves at first"
    assert np.all(states[-1, [1, 3, 4, 5]] == 0.0)
    assert np.all((states == 0.0) | (np.abs(states) >= 1e-150))


@pytest.mark.parametrize("friction, b, speed", [(1.0, 2.0, 5.0), (3.0, 0.6, 2.0), (0.7, 6.0, 9.0)])
def test_coast_down_stops_when_the_closed_form_says(friction, b, speed):
    structure = Structure.of(("inertia", "viscous_friction", "coulomb_friction"))
    values = {"input_gain": 0.3, "viscous_friction": b, "coulomb_friction": friction}
    time = clock(3.0)
    position, states = run(structure, values, time, np.zeros(len(time)), kernel.start_state(0.0, speed, 0.0))
    stop = math.log(1.0 + b * speed / friction) / b
    moving = states[:, 1] > 0.0
    assert time[moving][-1] < stop + 1e-6 and time[~moving][0] > stop - 1e-6
    way = speed / b - friction / b**2 * math.log(1.0 + b * speed / friction)
    assert position[-1] == pytest.approx(way, abs=COUNT / 10)
    assert np.all(states[~moving, 1] == 0.0)


def rebound_of_a_bumper(speed: float, stiffness: float, damping: float) -> float:
    """Speed at which a damped spring that never pulls lets go of a mass."""
    rate = math.sqrt(stiffness)
    ratio = damping / (2.0 * rate)
    damped = math.sqrt(1.0 - ratio**2)
    return speed * math.exp(-ratio / damped * (math.pi - math.atan2(2.0 * ratio * damped, 1.0 - 2.0 * ratio**2)))


def rebound_of_a_hard_body(speed: float, hysteresis: float) -> float:
    """The same where damping grows with depth: the way out begins at the depth at which the way in ended."""
    depth = speed - math.log1p(hysteresis * speed) / hysteresis
    most = 1.0 / hysteresis
    return brentq(lambda out: -out - math.log1p(-hysteresis * out) / hysteresis - depth, 0.0, most * (1.0 - 1e-9))


@pytest.mark.parametrize("damping, hysteresis", [(0.0, 0.0), (20.0, 0.0), (150.0, 0.0), (0.0, 0.3), (0.0, 2.0)])
@pytest.mark.parametrize("speed, stiffness", [(0.4, 1e4), (3.0, 1e4), (3.0, 1e5)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_stop_throws_back_what_its_losses_leave(side, speed, stiffness, damping, hysteresis):
    structure = Structure.of(("inertia", "viscous_friction", "end_stop"))
    values = {"input_gain": 0.3, "viscous_friction": 0.0, "stop_upper": 0.1, "stop_lower": -0.1}
    values |= {"stop_stiffness": stiffness, "stop_damping": damping, "stop_hysteresis": hysteresis}
    time = clock(0.15 / speed + 0.05)
    _, states = run(structure, values, time, np.zeros(len(time)), kernel.start_state(0.0, side * speed, 0.0))
    expected = speed
    if damping:
        expected = rebound_of_a_bumper(speed, stiffness, damping)
    elif hysteresis:
        expected = rebound_of_a_hard_body(speed, hysteresis)
    assert -side * states[-1, 1] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("duty", [15.0, 30.0, 60.0])
def test_dead_time_after_a_reversal_from_rest(duty):
    structure = Structure.of(BASE)
    values = PLAIN | GAP | {"viscous_friction": 0.0}
    time = clock(0.3, 0.0001)
    start = kernel.start_state(0.0, 0.0, -0.5 * GAP["backlash_gap"])  # the motor still touches the lower flank
    _, states = run(structure, values, time, np.full(len(time), duty), start)
    effective = PLAIN["input_gain"] * (duty - PLAIN["dead_band_forward"])
    dead = math.sqrt(2.0 * GAP["motor_share"] * GAP["backlash_gap"] / effective)
    moves = time[np.flatnonzero(states[:, 1] > 0.0)[0]]
    assert dead <= moves < dead + 2e-4
    # The impact keeps the momentum: motor_share of the motor's speed is left.
    before = states[states[:, 1] == 0.0][-1, 3]
    after = states[np.flatnonzero(states[:, 1] > 0.0)[0]]
    assert after[1] == after[3] == pytest.approx(GAP["motor_share"] * before, rel=0.02)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_contact_only_pushes_and_impacts_only_lose(seed, stiff):
    """Two bodies without friction: momentum is what the command gave, energy never more than it put in."""
    rng = np.random.default_rng(seed)
    structure = Structure.of((*BASE, "tooth_compliance") if stiff else BASE)
    values = sane(structure, rng) | {"viscous_friction": 0.0, "dead_band_forward": 0.0, "dead_band_reverse": 0.0}
    share, half = values["motor_share"], 0.5 * values["backlash_gap"]
    time = clock(1.0)
    command = steps(rng, len(time), 60)
    start = kernel.start_state(0.0, rng.normal(), rng.uniform(-half, half))
    start[3] = rng.normal()
    _, x = run(structure, values, time, command, start)
    gap, velocity, motor = x[:, 2], x[:, 1], x[:, 3]
    momentum = share * motor + (1.0 - share) * velocity
    given_to = momentum[0] + np.concatenate([[0.0], np.cumsum(values["input_gain"] * command[:-1] * np.diff(time))])
    assert np.allclose(momentum, given_to, rtol=0.0, atol=1e-9)
    work = np.diff(x[:, 0] + gap) * values["input_gain"] * command[:-1]
    energy = 0.5 * share * motor**2 + 0.5 * (1.0 - share) * velocity**2
    if not stiff:
        assert np.abs(gap).max() <= half + 1e-12
        assert np.all(np.diff(energy) <= work + 1e-9)
        # What pushes the link comes through a flank: its speed changes only after one has been touched, and
        # away from it.
        pushed = np.diff(velocity)
        upper = gap[1:] >= half - 1e-12
        lower = gap[1:] <= -half + 1e-12
        assert np.all(pushed[upper & (gap[:-1] >= half - 1e-12)] >= -1e-12)
        assert np.all(pushed[lower & (gap[:-1] <= -half + 1e-12)] <= 1e-12)
    else:
        rate = 2.0 * math.pi * values["tooth_frequency"]
        wound = np.maximum(np.abs(gap) - half, 0.0)
        stored = energy + 0.5 * rate**2 * share * (1.0 - share) * wound**2
        assert stored[-1] - stored[0] <= work.sum() + 0.01 * np.abs(work).sum()


def reference_states(values: dict[str, float], duty: float, seconds: float) -> tuple[float, float, float, float]:
    """Two bodies from rest on the lower flank to the end, by an adaptive integrator with an event at contact."""
    c, b, f = values["input_gain"], values["viscous_friction"], values["coulomb_friction"]
    share, part, gap = values["motor_share"], values["friction_share"], values["backlash_gap"]
    dry = values["dry_share"]
    torque = c * (duty - values["dead_band_forward"])

    def apart(_, y):
        return [y[1], (torque - part * b * y[1] - dry * f) / share]

    def contact(_, y):
        return y[0] - gap

    contact.terminal = True
    precise = {"rtol": 1e-11, "atol": 1e-13}
    first = solve_ivp(apart, (0.0, seconds), [0.0, 0.0], events=contact, **precise)
    speed = share * first.y[1, -1]

    def together(_, y):
        return [y[1], torque - b * y[1] - f]

    second = solve_ivp(together, (first.t[-1], seconds), [0.0, speed], **precise)
    return second.y[0, -1], second.y[1, -1]


@pytest.mark.parametrize("seed", range(6))
def test_gap_and_friction_against_an_adaptive_integrator(seed):
    rng = np.random.default_rng(seed)
    structure = Structure.of((*BASE, "coulomb_friction"))
    values = sane(structure, rng)
    time = clock(0.5)
    start = kernel.start_state(0.0, 0.0, -0.5 * values["backlash_gap"])
    position, states = run(structure, values, time, np.full(len(time), 55.0), start)
    expected, speed = reference_states(values, 55.0, time[-1])
    assert position[-1] == pytest.approx(expected, abs=COUNT / 10)
    assert states[-1, 1] == pytest.approx(speed, abs=1e-4)


@pytest.mark.parametrize("law", ["gravity", "spring", "torque_ripple", "quadratic_drag", "periodic_disturbance"])
def test_smooth_torques_against_an_adaptive_integrator(law):
    rng = np.random.default_rng(7)
    structure = Structure.of(("inertia", "viscous_friction", law))
    v = sane(structure, rng)
    time = clock(1.0)
    command = steps(rng, len(time), 125)

    def torque(t, x, w):
        return {
            "gravity": lambda: -v["gravity_gain"] * math.sin(x - v["gravity_angle"]),
            "spring": lambda: -v["spring_stiffness"] * (x - v["spring_rest"]),
            "torque_ripple": lambda: v["ripple_torque"] * math.sin(v["ripple_order"] * x - v["ripple_phase"]),
            "quadratic_drag": lambda: -v["quadratic_drag"] * w * abs(w),
            "periodic_disturbance": lambda: (
                v["disturbance"] * math.sin(2.0 * math.pi * v["disturbance_frequency"] * t - v["disturbance_phase"])
            ),
        }[law]()

    y = [0.3, 0.0]
    for i in range(0, len(time) - 1, 125):

        def motion(t, y, u=command[i]):
            return [y[1], v["input_gain"] * u - v["viscous_friction"] * y[1] + torque(t, *y)]

        y = solve_ivp(motion, (time[i], time[min(i + 125, len(time) - 1)]), y, rtol=1e-11, atol=1e-13).y[:, -1]
    position, _ = run(structure, v, time, command, kernel.start_state(0.3, 0.0, 0.0))
    assert position[-1] == pytest.approx(y[0], abs=COUNT / 10)


def test_lag_is_exact():
    structure = Structure.of(("inertia", "viscous_friction", "motor_lag"))
    values = {"input_gain": 0.3, "viscous_friction": 0.0, "lag_time": 0.03}
    time = clock(0.2, 0.01)
    _, states = run(structure, values, time, np.full(len(time), 40.0), longest=0.02)
    assert np.allclose(states[:, 4], 40.0 * -np.expm1(-time / 0.03), rtol=0.0, atol=1e-12)
    speed = 0.3 * 40.0 * (time + 0.03 * np.expm1(-time / 0.03))
    assert np.allclose(states[:, 1], speed, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_a_lag_has_the_dead_band_before_or_behind_it(share):
    """An independent integrator with a dead-band on either side of the lag, which together are the drive's own."""
    structure = Structure.of(("inertia", "viscous_friction", "dead_band", "motor_lag"))
    values = PLAIN | {"lag_time": 0.03, "lag_dead_band": share}
    forward, reverse = PLAIN["dead_band_forward"], PLAIN["dead_band_reverse"]

    def passed(u, of):
        return max(u - of * forward, 0.0) + min(u + of * reverse, 0.0)

    # What the first dead-band does not hold back of what lies within it, the second one takes.
    def through(u):
        return passed(u, 1.0) + share * min(max(u, -reverse), forward)

    time = clock(2.0)
    command = np.repeat([40.0, -25.0, 3.0, 12.0, 0.0, -7.0, 20.0, 5.0], 126)[: len(time)]
    y, read = [0.0, 0.0, 0.0], [0.0]
    for u in command[:-1]:

        def motion(t, y, u=u):
            drive = PLAIN["input_gain"] * passed(y[2], share)
            return [y[1], drive - PLAIN["viscous_friction"] * y[1], (through(u) - y[2]) / 0.03]

        y = solve_ivp(motion, (0.0, 0.002), y, rtol=1e-9, atol=1e-11, max_step=2e-4).y[:, -1]
        read.append(y[0])
    position, _ = run(structure, values, time, command)
    assert np.abs(position - read).max() < COUNT / 50


def test_delay_shifts_the_command_by_any_time():
    rng = np.random.default_rng(3)
    structure = Structure.of(BASE)
    values = sane(structure, rng)
    delay, time = 0.0073, clock(1.0)
    command = steps(rng, len(time), 60)
    late, _ = run(structure.with_("input_delay"), values | {"delay": delay}, time, command)
    # The same command on stamps of its own, later by hand, read at the old stamps.
    stamps = np.union1d(time, time + delay)
    held = np.searchsorted(time, stamps - delay + 1e-12, side="right") - 1
    shifted = np.where(held >= 0, command[np.maximum(held, 0)], 0.0)
    by_hand, _ = run(structure, values, stamps, shifted)
    assert np.allclose(late, by_hand[np.searchsorted(stamps, time)], rtol=0.0, atol=COUNT / 100)


def test_stamps_left_out_change_nothing():
    rng = np.random.default_rng(5)
    structure = Structure.of((*BASE, "coulomb_friction", "gravity"))
    values = sane(structure, rng)
    time = clock(2.0)
    command = steps(rng, len(time), 80)
    whole, _ = run(structure, values, time, command)
    keep = np.union1d(np.arange(0, len(time), 80), rng.choice(len(time), 300, replace=False))
    some, _ = run(structure, values, time[keep], command[keep])
    assert np.allclose(some, whole[keep], rtol=0.0, atol=COUNT / 50)


@pytest.mark.parametrize("effect", [e for e in EFFECTS if e != "inertia"])
def test_a_finer_step_moves_nothing_by_a_tenth_of_a_count(effect):
    moved = []
    time = clock(1.0)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        friction = ("coulomb_friction",) if seed % 2 else ()
        structure = Structure.of((*BASE, effect, *friction))
        values = sane(structure, rng)
        command = steps(rng, len(time), int(rng.integers(20, 200)))
        coarse, _ = run(structure, values, time, command, longest=0.002001 / structure.substeps)
        fine, _ = run(structure, values, time, command, longest=0.00005)
        moved.append(np.abs(coarse - fine).max())
    assert max(moved) < COUNT / 10
    assert np.median(moved) < COUNT / 20


def test_structures_are_complete_and_ordered():
    structure = Structure.of(("stribeck_friction", "dead_band", "inertia"))
    assert structure.ids == ("inertia", "dead_band", "coulomb_friction", "stribeck_friction")
    assert "coulomb_friction" in structure and structure.without("stribeck_friction").named == ("coulomb_friction",)
    assert {p.name for p in structure.parameters} >= {"stribeck_velocity", "input_gain"}
    assert len(STATES) == len(kernel.start_state(0.0, 0.0, 0.0))


@pytest.mark.parametrize("share", [1.0, 0.8, 0.3])
def test_friction_that_grows_with_load_knows_what_the_teeth_transmit(share):
    """At a steady speed that is the drag of the link and what holds it; the motor's own drag never meets the teeth."""
    structure = Structure.of((*BASE, "tooth_compliance", "load_dependent_friction"))
    values = sane(structure, np.random.default_rng(0)) | {
        "load_friction": 0.3, "friction_share": share, "dry_share": 0.6,
    }  # fmt: skip
    time = clock(12.0 / values["viscous_friction"])
    _, states = run(structure, values, time, np.full(len(time), 40.0))
    drag = values["viscous_friction"] * states[-1, 1]
    # The teeth carry what they make of the link's part of the friction, too.
    through = (1.0 - share) * drag / (1.0 - 0.4 * 0.3)
    drive = values["input_gain"] * (40.0 - values["dead_band_forward"])
    assert drag + 0.3 * through == pytest.approx(drive, rel=1e-3)


def test_a_load_that_is_held_presses_on_the_teeth_with_the_drive_at_rest():
    """Equal halves share what pulls at one of them: the friction that this presses out of the teeth brakes the fall."""
    structure = Structure.of(("inertia", "viscous_friction", "constant_offset", "load_dependent_friction"))
    values = {"input_gain": 0.3, "viscous_friction": 1.0, "offset": -2.0, "load_friction": 0.4}
    time = clock(20.0)
    _, states = run(structure, values, time, np.zeros(len(time)))
    assert states[-1, 1] == pytest.approx(-(2.0 - 0.4 * 1.0) / 1.0, rel=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_each_body_has_its_own_part_of_the_dry_friction(share):
    """Alone in a wide gap motor and link slow down as if the other were not there."""
    structure = Structure.of((*BASE, "coulomb_friction"))
    values = PLAIN | GAP | {"viscous_friction": 0.0, "backlash_gap": 0.4, "coulomb_friction": 1.5, "dry_share": share}
    time = clock(0.1)
    start = kernel.start_state(0.0, 0.5, 0.0)
    start[3] = 1.0
    _, states = run(structure, values, time, np.zeros(len(time)), start)
    for body, part, inertia in ((3, share, GAP["motor_share"]), (1, 1.0 - share, 1.0 - GAP["motor_share"])):
        assert states[-1, body] == pytest.approx(start[body] - 1.5 * part / inertia * time[-1], abs=1e-9)


@pytest.mark.parametrize("speed", [0.5, -4.0, 12.0])
def test_a_free_link_of_varying_inertia_keeps_its_energy(speed):
    """It is fast where it is light; and pushed, it gains what the push does on its way."""
    structure = Structure.of(("inertia", "viscous_friction", "dead_band", "unknown_inertia"))
    values = PLAIN | {"viscous_friction": 0.0, "dead_band_forward": 0.0, "dead_band_reverse": 0.0}
    waves = {f"unknown_inertia_{wave}_{k}": 0.0 for k in (1, 2, 3) for wave in ("sin", "cos")}
    values |= waves | {"unknown_inertia_order": 2.0, "unknown_inertia_sin_1": 0.3, "unknown_inertia_cos_2": 0.1}
    time = clock(4.0)
    for push in (0.0, 3.0):
        _, x = run(structure, values, time, np.full(len(time), push), kernel.start_state(0.4, speed, 0.0))
        place, velocity = x[:, 0], x[:, 1]
        inertia = 1.0 + 0.3 * np.sin(2.0 * place) + 0.1 * np.cos(4.0 * place)
        energy = 0.5 * inertia * velocity**2 - values["input_gain"] * push * place
        assert np.ptp(energy) < 2e-4 * np.ptp(0.5 * velocity**2)
        assert np.ptp(velocity) > 0.2 * abs(speed)


@pytest.mark.parametrize(("stiffness", "damping"), [(0.0, 3.0), (160.0, 1.0), (400.0, 0.0)])
def test_what_rides_on_the_link_against_an_adaptive_integrator(stiffness, damping):
    """A link of two bodies in mesh, each pulled by the other; the rider's states are relative."""
    structure = Structure.of(("inertia", "viscous_friction", "flexible_load"))
    hold = {"flexible_load_share": 0.4, "flexible_load_stiffness": stiffness, "flexible_load_damping": damping}
    values = {"input_gain": 0.4, "viscous_friction": 2.0, **hold}
    time, command = clock(2.0), np.repeat([40.0, 0.0, -25.0, 10.0], 250)
    _, states = run(structure, values, time, command)

    def motion(t, y, push):
        tug = stiffness * (y[2] - y[0]) + damping * (y[3] - y[1])
        return [y[1], push - 2.0 * y[1] + 0.4 * tug, y[3], -tug]

    y = np.zeros(4)
    for i in range(0, len(command), 250):
        y = solve_ivp(motion, (time[i], time[i + 250]), y, args=(0.4 * command[i],), rtol=1e-10, atol=1e-12).y[:, -1]
    assert states[-1, :2] == pytest.approx(y[:2], abs=COUNT / 4)
    assert states[-1, [RIDE, RIDE + 1]] == pytest.approx([y[2] - y[0], y[3] - y[1]], abs=2e-3)


@pytest.mark.parametrize("stiff", [False, True])
def test_blows_of_the_teeth_leave_what_rides_on_the_link_where_it_is(stiff):
    """Nothing from outside acts: whatever knocks, the momentum of motor, link and rider is what it was."""
    structure = Structure.of((*BASE, "flexible_load", *(("tooth_compliance",) if stiff else ())))
    hold = {"flexible_load_share": 0.5, "flexible_load_stiffness": 200.0, "flexible_load_damping": 1.0}
    values = PLAIN | GAP | {"viscous_friction": 0.0, "tooth_frequency": 150.0, "tooth_damping": 0.2} | hold
    time = clock(1.0)
    start = kernel.start_state(0.0, -1.0, 0.0)
    start[3] = 3.0
    _, x = run(structure, {p.name: values[p.name] for p in structure.parameters}, time, np.zeros(len(time)), start)
    share = GAP["motor_share"]
    momentum = share * x[:, 3] + (1.0 - share) * x[:, 1] + 0.5 * (x[:, 1] + x[:, RIDE + 1])
    assert np.ptp(x[:, 1]) > 0.3 and np.ptp(x[:, RIDE + 1]) > 0.3
    assert momentum == pytest.approx(momentum[0], abs=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_a_ripple_turns_with_the_body_that_it_acts_on(share):
    """Alone in a wide gap motor and link each feel their own part of it, at their own angle."""
    structure = Structure.of((*BASE, "torque_ripple"))
    values = PLAIN | GAP | {"viscous_friction": 0.0, "backlash_gap": 0.4, "shaft_share": share}
    values |= {"ripple_torque": 2.0, "ripple_order": 30.0, "ripple_phase": 0.7}
    time = clock(0.2)
    start = kernel.start_state(0.1, 0.5, -0.1)
    start[3] = 1.0
    _, states = run(structure, values, time, np.zeros(len(time)), start)
    for body, part, inertia in ((3, share, GAP["motor_share"]), (1, 1.0 - share, 1.0 - GAP["motor_share"])):

        def alone(_, y, part=part, inertia=inertia):
            return [y[1], part * 2.0 * math.sin(30.0 * y[0] - 0.7) / inertia]

        begun = [0.0 if body == 3 else 0.1, start[body]]
        expected = solve_ivp(alone, (0.0, time[-1]), begun, rtol=1e-11, atol=1e-13).y[:, -1]
        place = states[-1, 0] + (states[-1, 2] if body == 3 else 0.0)
        assert place == pytest.approx(expected[0], abs=COUNT / 10)
        assert states[-1, body] == pytest.approx(expected[1], abs=1e-3)
