"""The chain of stations, and the stepper that moves it through time.

    command -> drive -> motor -> transmission -> link -> sensor
                                                  ^ loads, friction, disturbance

The stepper below is written once, in a small part of Python: scalars, `if`, `for ... in range`, `sqrt`
and `exp`. `x.name` is a state, `p.name` a parameter, `k.name` a quantity known of the recording and
`has.name` whether the structure contains an effect. The writers turn this text into Python that runs,
into its exact derivative, and into C. It is not called from here.

Accelerations and inertias are relative to the inertia of the axis, so that torque and acceleration are the
same number (paper, eq. 2).

What is not smooth stands here in the open. Dry friction takes from the torque what it can (`net`), so that
rest is rest. Backlash is two bodies: `advance` holds torques over a step and finds each stick, slip, contact
and separation inside it from the exact parabola, so no event is stepped over (Brogliato, Nonsmooth Mechanics,
2016; inelastic impact).
"""

# mypy: ignore-errors
# ruff: noqa: F821

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import exp, sqrt

from twin.effects.catalogue import BASE, EFFECTS
from twin.effects.effect import Effect
from twin.quantities import Parameter

#: States of the stepper: unit and meaning. The gap is motor position minus link position.
STATES: dict[str, tuple[str, str]] = {
    "position": ("{x}", "position of the link"),
    "velocity": ("{x}/s", "velocity of the link"),
    "gap": ("{x}", "motor position minus link position"),
    "motor_velocity": ("{x}/s", "velocity of the motor, seen at the link"),
    "lag": ("{u}", "command that acts behind the lag"),
    "heat": ("1", "warming of the motor"),
    "time": ("s", "time since the start"),
}

#: Quantities known of a recording that a law may read.
KNOWN: dict[str, tuple[str, str]] = {
    "payload": ("kg*m^2", "inertia of the payload about the axis"),
    "moment": ("kg*m", "first moment of the payload about the axis"),
}


@dataclass(frozen=True)
class Structure:
    """Which physics a model contains: a tuple of effect ids, in the order of the catalogue."""

    ids: tuple[str, ...]

    @staticmethod
    def of(ids: Iterable[str]) -> Structure:
        """The structure with these effects and those that they cannot be without."""
        wanted = set(ids)
        while more := {i for e in wanted for i in EFFECTS[e].includes} - wanted:
            wanted |= more
        return Structure(tuple(i for i in EFFECTS if i in wanted))

    @property
    def effects(self) -> tuple[Effect, ...]:
        return tuple(EFFECTS[i] for i in self.ids)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(p for e in self.effects for p in e.parameters)

    @property
    def substeps(self) -> int:
        """Internal steps per 2 ms."""
        return max((e.substeps for e in self.effects), default=1)

    @property
    def named(self) -> tuple[str, ...]:
        """The effects one would name: those beyond the base that no other effect brings with it."""
        brought = {i for e in self.effects for i in e.includes}
        return tuple(i for i in self.ids if i not in (*BASE, "tooth_compliance") and i not in brought)

    def with_(self, *ids: str) -> Structure:
        return Structure.of((*self.ids, *ids))

    def without(self, *ids: str) -> Structure:
        return Structure.of(i for i in self.ids if i not in ids)

    @property
    def elastic(self) -> bool:
        return "joint_elasticity" in self or "tooth_compliance" in self

    def __contains__(self, effect: str) -> bool:
        return effect in self.ids

    def __repr__(self) -> str:
        return " + ".join(self.ids)


#: Everything at once: the estimation kernel is written for this and told what is on.
EVERYTHING = Structure.of(EFFECTS)


def net(torque, forward, reverse, velocity):
    """What dry friction of size `forward` or `reverse` (by direction of motion) leaves of a torque."""
    left = 0.0
    if velocity > 0.0:
        left = torque - forward
    elif velocity < 0.0:
        left = torque + reverse
    elif torque > forward:
        left = torque - forward
    elif torque < -reverse:
        left = torque + reverse
    return left


def tension(gap, speed, half, stiffness, damping):
    """Torque through compliant teeth or an elastic joint; gap and speed are motor minus link. It never pulls."""
    pull = 0.0
    if gap > half:
        pull = stiffness * (gap - half) + damping * speed
        if pull < 0.0:
            pull = 0.0
    elif gap < -half:
        pull = stiffness * (gap + half) + damping * speed
        if pull > 0.0:
            pull = 0.0
    return pull


def crossing(distance, speed, acceleration, limit):
    """Time until `distance` (> 0) is covered, or `limit` if it is not covered before."""
    time = limit
    if distance > 0.0:
        if speed > 0.0:
            under = speed * speed + 2.0 * acceleration * distance
            if under > 0.0:
                time = 2.0 * distance / (speed + sqrt(under))
        elif acceleration > 0.0:
            time = (sqrt(speed * speed + 2.0 * acceleration * distance) - speed) / acceleration
    return time


def stopping(speed, acceleration, limit):
    """Time until the speed is zero, or `limit` if it does not come to that."""
    time = limit
    if speed * acceleration < 0.0:
        time = -speed / acceleration
    return time


def advance(x, push_m, push_l, grip_mf, grip_mr, grip_lf, grip_lr, mass_m, mass_l, half, h):
    """Move motor and link by h under constant torques, from event to event.

    push: torque on each body; grip: size of its dry friction forwards and in reverse; mass: its inertia;
    half: half the gap. At most two bodies, so a handful of events; the loop's bound is never met in motion.
    """
    remaining = h
    for _ in range(16):
        if remaining <= 0.0:
            break
        left_m = net(push_m, grip_mf, grip_mr, x.motor_velocity)
        left_l = net(push_l, grip_lf, grip_lr, x.velocity)
        pull_m = left_m / mass_m
        pull_l = left_l / mass_l
        closing = x.motor_velocity - x.velocity
        relative = pull_m - pull_l
        meshed = 0
        if x.gap >= half:
            if closing > 0.0 or (closing == 0.0 and relative >= 0.0):
                meshed = 1
                x.gap = half
        if meshed == 0 and x.gap <= -half:
            if closing < 0.0 or (closing == 0.0 and relative <= 0.0):
                meshed = 1
                x.gap = -half
        if meshed == 1:
            total = mass_m + mass_l
            if closing != 0.0:
                x.velocity = (mass_m * x.motor_velocity + mass_l * x.velocity) / total
            left = net(push_m + push_l, grip_mf + grip_lf, grip_mr + grip_lr, x.velocity)
            pull = left / total
            stop = stopping(x.velocity, pull, remaining)
            if stop < remaining:
                x.position = x.position + 0.5 * stop * x.velocity
                x.velocity = 0.0
                remaining = remaining - stop
            else:
                x.position = x.position + remaining * (x.velocity + 0.5 * remaining * pull)
                x.velocity = x.velocity + remaining * pull
                remaining = 0.0
            x.motor_velocity = x.velocity
        else:
            stop_m = stopping(x.motor_velocity, pull_m, remaining)
            stop_l = stopping(x.velocity, pull_l, remaining)
            up = crossing(half - x.gap, closing, relative, remaining)
            down = crossing(half + x.gap, -closing, -relative, remaining)
            event = 0
            span = remaining
            if stop_m < span:
                event = 1
                span = stop_m
            if stop_l < span:
                event = 2
                span = stop_l
            if up < span:
                event = 3
                span = up
            if down < span:
                event = 4
                span = down
            x.position = x.position + span * (x.velocity + 0.5 * span * pull_l)
            x.gap = x.gap + span * (closing + 0.5 * span * relative)
            x.velocity = x.velocity + span * pull_l
            x.motor_velocity = x.motor_velocity + span * pull_m
            remaining = remaining - span
            if event == 0:
                remaining = 0.0
            elif event == 1:
                x.motor_velocity = 0.0
            elif event == 2:
                x.velocity = 0.0
            elif event == 3:
                x.gap = half
            else:
                x.gap = -half
    return 0.0


def step(x, p, k, command, h):
    """Move the axis by h under a constant command: forces at the predicted middle of the step.

    Of second order; for forces of position alone it is the symplectic leapfrog.
    """
    half = 0.0
    mass_m = 0.5
    share = 0.5
    if has.backlash:
        half = 0.5 * p.backlash_gap
        mass_m = p.motor_share
        share = p.friction_share
    # Compliant teeth and an elastic joint are the same spring beyond the gap: the softer one is what is seen.
    stiffness = 0.0
    damping = 0.0
    if has.tooth_compliance:
        rate = 6.283185307179586 * p.tooth_frequency
        stiffness = rate * rate * mass_m * (1.0 - mass_m)
        damping = 2.0 * p.tooth_damping * rate * mass_m * (1.0 - mass_m)
    if has.joint_elasticity:
        rate = 6.283185307179586 * p.joint_frequency
        stiffness = rate * rate * mass_m * (1.0 - mass_m)
        damping = 2.0 * p.joint_damping * rate * mass_m * (1.0 - mass_m)
    added = mass(x.time + 0.5 * h, k.payload, p)
    mass_l = 1.0 - mass_m + added

    emf = 0.0
    if has.viscous_friction:
        emf = p.viscous_friction * x.motor_velocity / p.input_gain
    acting = drive(command, emf, x.heat, p)
    if has.thermal_fade:
        warm = (command / p.fade_reference) ** 2
        x.heat = warm + (x.heat - warm) * exp(-h / p.fade_time)
    mean = acting
    if has.motor_lag:
        behind = x.lag - acting
        decay = exp(-h / p.lag_time)
        mean = acting + behind * (1.0 - decay) * p.lag_time / h
        x.lag = acting + behind * decay
    torque = p.input_gain * mean

    middle = 0.5 * h
    pull = load(x.position, x.velocity, x.time, k.moment, p)
    resist_l = drag(x.position, x.velocity, p)
    resist_m = drag(x.position, x.motor_velocity, p)
    through = 0.5 * (torque - pull)
    forward = grip(x.position, x.velocity, 1.0, through, p)
    reverse = grip(x.position, x.velocity, -1.0, through, p)
    if forward < 0.0:
        forward = 0.0
    if reverse < 0.0:
        reverse = 0.0
    if stiffness == 0.0 and x.motor_velocity == x.velocity:
        left = net(torque + pull + resist_l, forward, reverse, x.velocity)
        gain_l = left / (mass_m + mass_l)
        gain_m = gain_l
    else:
        left_m = net(torque + share * resist_m, share * forward, share * reverse, x.motor_velocity)
        left_l = net(
            pull + (1.0 - share) * resist_l, (1.0 - share) * forward, (1.0 - share) * reverse, x.velocity
        )
        gain_m = left_m / mass_m
        gain_l = left_l / mass_l
    if stiffness > 0.0:
        wound = tension(x.gap, x.motor_velocity - x.velocity, half, stiffness, damping)
        gain_m = gain_m - wound / mass_m
        gain_l = gain_l + wound / mass_l
    speed_l = x.velocity + middle * gain_l
    speed_m = x.motor_velocity + middle * gain_m
    if speed_l * x.velocity < 0.0:
        speed_l = 0.0
    if speed_m * x.motor_velocity < 0.0:
        speed_m = 0.0

    place = x.position + middle * x.velocity
    pull = load(place, speed_l, x.time + middle, k.moment, p)
    resist_l = drag(place, speed_l, p)
    resist_m = drag(place, speed_m, p)
    through = 0.5 * (torque - pull)
    forward = grip(place, speed_l, 1.0, through, p)
    reverse = grip(place, speed_l, -1.0, through, p)
    if forward < 0.0:
        forward = 0.0
    if reverse < 0.0:
        reverse = 0.0
    push_m = torque + share * resist_m
    push_l = pull + (1.0 - share) * resist_l
    reach = half
    if stiffness > 0.0:
        wound = tension(
            x.gap + middle * (x.motor_velocity - x.velocity), speed_m - speed_l, half, stiffness, damping
        )
        push_m = push_m - wound
        push_l = push_l + wound
        reach = 1e9
    grip_mf = share * forward
    grip_mr = share * reverse
    grip_lf = forward - grip_mf
    grip_lr = reverse - grip_mr
    done = advance(x, push_m, push_l, grip_mf, grip_mr, grip_lf, grip_lr, mass_m, mass_l, reach, h)
    x.time = x.time + h
    return done


#: The stepper's functions, in the order in which they call one another.
STEPPER = (net, tension, crossing, stopping, advance, step)
