"""The stepper that moves the chain of stations through time.

    command -> drive -> motor -> transmission -> link -> sensor
                                                  ^ loads, friction, disturbance

The stepper below is written once, in a small part of Python: scalars, `if`, `for ... in range`, `sqrt`
and `exp`. `x.name` is a state, `p.name` a parameter, `k.name` a quantity known of the recording and
`has.name` whether the structure contains an effect, or any law in a slot. Functions that take `s` are sections of
`piece`, and `s.name` is its variable `name` (`twin.codegen.sections`). The writers turn this text into
Python that runs, into its exact derivative, and into C. It is not called from here.

Accelerations and inertias are relative to the inertia of the axis, so that torque and acceleration are the
same number (paper, eq. 2).

What is not smooth stands here in the open. Dry friction takes from the torque what it can (`net`), so that
rest is rest. Backlash is two bodies: a `piece` ends at each stick, reversal and contact, so that no event is
stepped over (Brogliato, Nonsmooth Mechanics, 2016; inelastic impact).
"""

# mypy: ignore-errors
# ruff: noqa: SIM102, F821, F841

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import exp, sqrt

from twin.effects.catalogue import BASE, EFFECTS
from twin.effects.effect import Effect
from twin.effects.parameter import Parameter
from twin.model.stations import (
    STATIONS,
    back_emf,
    before_lag,
    beyond,
    carried,
    dry_friction,
    heating,
    mesh_damping,
    mesh_stiffness,
    on_link,
    on_motor,
    ringing_rate,
    ringing_ratio,
    tension,
    tugging,
)

#: States of the stepper: unit and meaning. The gap is motor position minus link position.
STATES: dict[str, tuple[str, str]] = {
    "position": ("{x}", "position of the link"),
    "velocity": ("{x}/s", "velocity of the link"),
    "gap": ("{x}", "motor position minus link position"),
    "motor_velocity": ("{x}/s", "velocity of the motor, seen at the link"),
    "lag": ("{u}", "command behind the lag"),
    "heat": ("1", "warming of the motor"),
    "bend": ("1", "how far the motor's friction is bent, as a share of what it gives before it slides"),
    "ride": ("{x}", "position of what rides on the link minus that of the link"),
    "ride_velocity": ("{x}/s", "velocity of what rides on the link minus that of the link"),
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
        return tuple(p for e in self.effects for p in self.acting(e))

    def acting(self, effect: Effect) -> tuple[Parameter, ...]:
        """The effect's parameters that have something to act on here."""
        return tuple(p for p in effect.parameters if not p.acts_on or p.acts_on in {*self.ids, *self.slots})

    @property
    def slots(self) -> frozenset[str]:
        """The slots in which at least one effect has a law."""
        return frozenset(e.slot for e in self.effects)

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

    def brought_by(self, effect: str, first: Structure) -> tuple[str, ...]:
        """What the effect brought with it and neither another effect needs nor the first model had."""
        needed = {i for e in self.effects if e.id != effect for i in e.includes} | set(first.ids)
        return tuple(i for i in EFFECTS[effect].includes if i not in BASE and i not in needed)

    @property
    def elastic(self) -> bool:
        return "joint_elasticity" in self or "tooth_compliance" in self

    @property
    def toothed(self) -> bool:
        """Whether motor and link meet across a gap, with no softer joint between them."""
        return "backlash" in self and "joint_elasticity" not in self

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


def reaching(distance, speed, acceleration, limit):
    """Time until a distance of either sign is covered, or `limit` if it is not covered before."""
    time = limit
    if distance < 0.0:
        distance = -distance
        speed = -speed
        acceleration = -acceleration
    if distance > 0.0:
        # Most of the time it is out of reach.
        within = 0.0
        if speed > 0.0:
            within = limit * speed
        if acceleration > 0.0:
            within = within + 0.5 * limit * limit * acceleration
        if within > distance:
            under = speed * speed + 2.0 * acceleration * distance
            if speed > 0.0:
                if under > 0.0:
                    time = 2.0 * distance / (speed + sqrt(under))
            elif acceleration > 0.0:
                time = (sqrt(under) - speed) / acceleration
    return time


def stopping(speed, acceleration, limit):
    """Time until the speed is zero, or `limit` if it does not come to that."""
    time = limit
    if speed * (speed + limit * acceleration) < 0.0:
        time = -speed / acceleration
    return time


def faded(value):
    """Whether what decays for ever has come to nothing: processors take numbers near 1e-310 twenty times as long.

    A zero that is there already is left alone, and so keeps its derivative.
    """
    gone = 0
    if value != 0.0 and value < 1e-150 and value > -1e-150:
        gone = 1
    return gone


def cos_of_root(square):
    """cos(sqrt(square)), which is cosh(sqrt(-square)) below zero; for squares between -4 and 4."""
    return 1.0 + square * (-0.5 + square * (1.0 / 24.0 + square * (-1.0 / 720.0 + square * (1.0 / 40320.0
        + square * (-1.0 / 3628800.0 + square * (1.0 / 479001600.0 - square / 87178291200.0))))))  # fmt: skip


def sinc_of_root(square):
    """sin(sqrt(square)) / sqrt(square), likewise."""
    return 1.0 + square * (-1.0 / 6.0 + square * (1.0 / 120.0 + square * (-1.0 / 5040.0 + square * (1.0 / 362880.0
        + square * (-1.0 / 39916800.0 + square * (1.0 / 6227020800.0 - square / 1307674368000.0))))))  # fmt: skip


def mean_beyond(before, after, mean, upper, lower):
    """Mean of what is beyond -lower or upper of a value on its way; where it crosses one of them, as on a line."""
    first = beyond(before, upper, lower)
    last = beyond(after, upper, lower)
    result = beyond(mean, upper, lower)
    # It keeps to one side where nothing is lost on the way that is not lost at both ends.
    if (first - last) * (first - last) < 0.999999 * (before - after) * (before - after):
        if first != 0.0 or last != 0.0:
            result = 0.5 * (last * last - first * first) / (after - before)
    return result


def bent_by(bend, way, give):
    """How far bristles are bent after a way in one direction: the nearer they are to sliding the less they follow."""
    side = 1.0
    if way < 0.0:
        side = -1.0
    return side + (bend - side) * exp(-side * way / give)


def halved(length, rate, most):
    """A length, halved until it is no more than `most` at a rate: one that a parameter moved would have a slope."""
    for _ in range(12):
        if length * rate <= most:
            break
        length = 0.5 * length
    return length


def bodies(x, p, k, s):
    """The two bodies, the gap between them, and the spring in it where teeth or a joint give."""
    s.half = 0.0
    s.mass_m = 0.5
    s.share = 0.5
    s.dry = 0.5
    s.turned = 0.0
    if has.backlash:
        s.half = 0.5 * p.backlash_gap
        s.mass_m = p.motor_share
        s.share = p.friction_share
        s.dry = p.dry_share
        s.turned = p.shaft_share
    # Compliant teeth and an elastic joint are the same spring beyond the gap: the softer one is what is seen.
    s.elastic = 0
    s.rate = 0.0
    s.decline = 0.0
    s.stiffness = 0.0
    s.damping = 0.0
    if has.tooth_compliance or has.joint_elasticity:
        s.elastic = 1
        s.rate = ringing_rate(p)
        ratio = ringing_ratio(p)
        s.decline = 2.0 * ratio * s.rate
        s.stiffness = mesh_stiffness(s.rate, s.mass_m)
        s.damping = mesh_damping(ratio, s.rate, s.mass_m)
    added = 0.0
    if has.mass:
        added = mass(x.position + 0.5 * s.h * x.velocity, x.time + 0.5 * s.h, k.payload, p)
    s.mass_l = 1.0 - s.mass_m + added
    s.total = s.mass_m + s.mass_l
    s.per_total = 1.0 / s.total


def contact(x, s):
    """The flank that touches: 1 the upper, -1 the lower, 2 both (there is no gap), 0 neither. Rigid ones knock."""
    s.side = 0
    s.closing = x.motor_velocity - x.velocity
    if s.half <= 0.0:
        s.side = 2
    elif x.gap >= s.half:
        if s.closing >= 0.0 or (s.elastic == 1 and x.gap > s.half):
            s.side = 1
    elif x.gap <= -s.half:
        if s.closing <= 0.0 or (s.elastic == 1 and x.gap < -s.half):
            s.side = -1
    if s.side != 0 and s.elastic == 0:
        if s.closing != 0.0:
            joint = (s.mass_m * x.motor_velocity + s.mass_l * x.velocity) / s.total
            if has.rider:
                # A blow leaves it as it was.
                x.ride_velocity = x.ride_velocity + x.velocity - joint
            x.velocity = joint
            x.motor_velocity = joint
            s.closing = 0.0
        if s.side == 2:
            x.gap = 0.0
        elif s.side == 1:
            x.gap = s.half
        else:
            x.gap = -s.half


def length_at_contact(x, p, s):
    """How long the piece may be alone in the gap, and where a spring presses.

    What presses is a spring with a damper, whose motion between two torques is known (`swing`): in pieces that only
    the torques need. Where a flank separates or a body stops within one, the step uses `fine` pieces like everything
    else. Coarse pieces before a ringing has decayed would make its end depend on the smallest change of the model. A
    body with so much damping that a step would pass its rest would chatter.
    """
    # Alone in the gap the light motor comes to its speed soon, and what is fine for the axis is coarse for it.
    if s.side == 0:
        if s.h > 0.0005:
            s.h = 0.0005
        slows = s.share * p.viscous_friction / s.mass_m
        # No motor that there is stops sooner.
        if slows > 200.0:
            slows = 200.0
        s.h = halved(s.h, slows, 0.015)
    s.flow = 0
    s.lean = 0.0
    s.fine = s.h
    if s.elastic == 1 and s.side != 0:
        if s.fine > 0.0005:
            s.fine = 0.0005
        ringing = 0
        if s.closing > 0.0002 or s.closing < -0.0002:
            ringing = 1
        if ringing == 1:
            s.fine = halved(s.fine, s.rate, 0.08)
        s.fine = halved(s.fine, s.decline, 1.0)
        if s.side == 2:
            s.flow = 1
        else:
            s.lean = s.side * s.half
            if tension(x.gap, s.closing, s.side, s.half, s.stiffness, s.damping) != 0.0:
                s.flow = 1
        if s.flow == 1:
            if ringing == 1:
                s.h = halved(s.h, s.rate, 0.5)
            s.h = halved(s.h, s.rate, 3.0)
            s.h = halved(s.h, s.decline, 4.0)
        else:
            s.h = s.fine


def length_at_loads(x, p, s):
    """How long the piece may be in a stop, on the way to one, and with what rides on the link."""
    # Fine in a stop, also where the link turns around in it; on its way there it does not feel it yet.
    if has.end_stop:
        depth = x.position - p.stop_upper
        ahead = -depth
        if x.position <= p.stop_lower:
            depth = p.stop_lower - x.position
        if x.velocity < 0.0:
            ahead = p.stop_lower - x.position
        if depth >= 0.0:
            s.flow = 0
            if s.h > s.fine:
                s.h = s.fine
            hard = sqrt(p.stop_stiffness)
            s.h = halved(s.h, hard, 0.02)
            s.h = halved(s.h, p.stop_damping + p.stop_stiffness * p.stop_hysteresis * depth, 1.0)
        elif x.velocity * ahead > 0.0:
            until = ahead / x.velocity
            if until > 1e-9 and until < s.h:
                s.h = until
    # However firmly something is held that rides on the link, it does not shake it; its swing is followed.
    if has.rider:
        firm = 1.0 + p.flexible_load_share / s.mass_l
        s.h = halved(s.h, p.flexible_load_damping * firm, 0.5)
        swings = sqrt(p.flexible_load_stiffness * firm)
        s.h = halved(s.h, swings, 0.3)
    if s.fine > s.h:
        s.fine = s.h


def unset(s):
    """What only some paths through the piece fill: each variable has a number on all of them."""
    s.warm = 0.0
    s.gain_l = 0.0
    s.gain_m = 0.0
    s.tug = 0.0
    s.acting = 0.0
    s.fed = 0.0
    s.decay = 0.0
    s.together = 0
    s.hook = 1.0
    s.whole = 1.0
    s.turn = 0.0
    s.yields = 0.0
    s.after_l = 0.0
    s.after_m = 0.0
    s.twist_after = 0.0
    s.closing_after = 0.0


def start_of_piece(x, s):
    """The point at which the torques are asked for first."""
    s.middle = 0.5 * s.h
    s.moment = x.time
    s.place = x.position
    s.speed_l = x.velocity
    s.speed_m = x.motor_velocity
    s.heat = x.heat
    s.twist = x.gap
    s.together = 0
    s.travel = 0.0
    s.holds = 1


def middle_of_piece(x, p, s):
    """The point at which the torques are asked for again, as those at the start predict it."""
    s.moment = x.time + s.middle
    if s.flow == 1:
        s.place = x.position + 0.5 * s.middle * (x.velocity + s.after_l)
        s.speed_l = s.after_l
        s.speed_m = s.after_m
        s.twist = s.twist_after
    else:
        s.place = x.position + s.middle * x.velocity
        s.speed_l = x.velocity + s.middle * s.gain_l
        if s.speed_l * x.velocity < 0.0:
            s.speed_l = 0.0
        s.speed_m = s.speed_l
        if s.together == 0:
            s.speed_m = x.motor_velocity + s.middle * s.gain_m
            if s.speed_m * x.motor_velocity < 0.0:
                s.speed_m = 0.0
        s.twist = x.gap + s.middle * s.closing
    if has.thermal_fade:
        s.heat = x.heat + (s.warm - x.heat) * s.middle / p.fade_time


def drive_torque(x, p, s):
    """Torque of the drive, behind its lag."""
    if s.stage == 0 or s.varies == 1:
        emf = back_emf(s.speed_m, p)
        if has.thermal_fade:
            if s.stage == 0:
                cold = drive(s.command, emf, 0.0, s.place + s.twist, p)
                s.warm = heating(cold, emf, p)
        s.acting = drive(s.command, emf, s.heat, s.place + s.twist, p)
    mean = s.acting
    if has.motor_lag:
        s.fed = before_lag(s.acting, s.command, p)
        # The mean over the first half predicts the middle; the mean over the whole moves the axis.
        if s.stage == 0:
            s.decay = exp(-s.middle / p.lag_time)
            mean = s.fed + (x.lag - s.fed) * (1.0 - s.decay) * p.lag_time / s.middle
        else:
            s.decay = s.decay * s.decay
            mean = s.fed + (x.lag - s.fed) * (1.0 - s.decay) * p.lag_time / s.h
        if has.dead_band:
            lagging = s.fed + (x.lag - s.fed) * s.decay
            upper = p.lag_dead_band * p.dead_band_forward
            lower = p.lag_dead_band * p.dead_band_reverse
            mean = mean_beyond(x.lag, lagging, mean, upper, lower)
    s.torque = p.input_gain * mean


def torques(x, p, k, s):
    """Torques on motor and link, without what the gears transmit and without dry friction."""
    pull = 0.0
    if has.load:
        pull = load(s.place, s.speed_l, s.moment, k.moment, p)
    resist_l = drag(s.place, s.speed_l, p)
    resist_m = resist_l
    if s.speed_m != s.speed_l:
        resist_m = drag(s.place, s.speed_m, p)
    leaning = x.bend
    if has.bristle:
        if s.stage == 1:
            leaning = bent_by(x.bend, 0.5 * s.middle * (x.motor_velocity + s.speed_m), p.presliding_travel)
    if has.rider:
        if s.stage == 0:
            s.tug = tugging(x.ride, x.ride_velocity, p.flexible_load_stiffness, p.flexible_load_damping)
        else:
            ride = x.ride + s.middle * x.ride_velocity
            speed = x.ride_velocity - s.speed_l + x.velocity - s.middle * s.tug
            s.tug = tugging(ride, speed, p.flexible_load_stiffness, p.flexible_load_damping)
    s.push_m = on_motor(s.torque, resist_m, s.place + s.twist, leaning, s.share, s.turned, p)
    s.push_l = on_link(pull, resist_l, s.place, s.tug, s.share, s.turned, p)


def transmission(s):
    """What the teeth transmit: the spring's torque, or what makes two bodies move as one."""
    s.through = 0.0
    if s.elastic == 1:
        s.through = tension(s.twist, s.speed_m - s.speed_l, s.side, s.half, s.stiffness, s.damping)
        s.push_m = s.push_m - s.through
        s.push_l = s.push_l + s.through
    elif s.side != 0:
        s.through = carried(s.push_m, s.push_l, s.mass_m, s.mass_l, s.per_total)
        if s.side * s.through < 0.0 and s.side != 2:
            s.through = 0.0


def accelerations(x, p, s):
    """Dry friction takes what it can, and what is left of the torques moves the bodies: together or each alone."""
    s.left_m = s.push_m
    s.left_l = s.push_l
    left = s.push_m + s.push_l
    if has.grip:
        forward = 0.0
        reverse = 0.0
        # Only what is at rest needs both.
        if x.motor_velocity >= 0.0 or x.velocity >= 0.0:
            forward = dry_friction(s.place, s.speed_l, 1.0, s.through, s.moment, p)
        if x.motor_velocity <= 0.0 or x.velocity <= 0.0:
            reverse = dry_friction(s.place, s.speed_l, -1.0, s.through, s.moment, p)
        s.left_m = net(s.push_m, s.dry * forward, s.dry * reverse, x.motor_velocity)
        s.left_l = net(s.push_l, (1.0 - s.dry) * forward, (1.0 - s.dry) * reverse, x.velocity)
        left = net(left, forward, reverse, x.velocity)
    s.together = 0
    if s.elastic == 0:
        if s.side == 2 or (s.side != 0 and s.side * (s.left_m * s.mass_l - s.left_l * s.mass_m) >= 0.0):
            s.together = 1
    if s.together == 1:
        s.gain_l = left * s.per_total
        s.gain_m = s.gain_l
    else:
        s.gain_m = s.left_m * s.per_m
        s.gain_l = s.left_l * s.per_l


def mobility(x, s):
    """How much the spring's two ends yield: what friction holds does not move, and the other body swings against it."""
    s.yields_m = s.per_m
    s.yields_l = s.per_l
    if has.grip:
        if x.motor_velocity == 0.0 and s.left_m == 0.0:
            s.yields_m = 0.0
        if x.velocity == 0.0 and s.left_l == 0.0:
            s.yields_l = 0.0
    if s.stage == 1 and s.yields_m + s.yields_l != s.yields:
        s.holds = 0
    s.yields = s.yields_m + s.yields_l


def swing(x, s):
    """The bodies after half the piece (stage 0) or all of it, as a damped spring moves them under constant torques."""
    s.after_l = x.velocity
    s.after_m = x.motor_velocity
    s.twist_after = x.gap
    s.closing_after = s.closing
    if s.yields > 0.0 and s.holds == 1:
        free_m = s.left_m + s.through
        free_l = s.left_l - s.through
        apart = free_m * s.yields_m - free_l * s.yields_l
        bent = apart - s.yields * s.stiffness * (x.gap - s.lean)
        lasts = s.middle
        if s.stage == 0:
            s.hook = s.yields * s.stiffness
            loss = s.yields * s.damping * s.middle
            bend = s.hook * s.middle * s.middle - 0.25 * loss * loss
            fades = exp(-0.5 * loss)
            swings = cos_of_root(bend)
            sway = sinc_of_root(bend)
            s.turn = s.middle * fades * sway
            s.whole = fades * (swings + 0.5 * loss * sway)
        else:
            # Once more as far.
            lasts = s.h
            first = s.turn
            s.turn = first * (2.0 * s.whole - s.yields * s.damping * first)
            s.whole = s.whole * s.whole - s.hook * first * first
        s.twist_after = x.gap + s.turn * s.closing + (1.0 - s.whole) * bent / s.hook
        s.closing_after = (s.whole - s.turn * s.yields * s.damping) * s.closing + s.turn * bent
        given = (apart * lasts - s.closing_after + s.closing) / s.yields
        s.after_m = x.motor_velocity + s.yields_m * (free_m * lasts - given)
        s.after_l = x.velocity + s.yields_l * (free_l * lasts + given)
        if s.stage == 1:
            shift = (0.5 * apart * s.h * s.h - s.twist_after + x.gap + s.closing * s.h) / s.yields
            s.travel = s.h * x.velocity + s.yields_l * (0.5 * s.h * s.h * free_l + shift)


def swing_holds(x, p, s):
    """Whether nothing on the way changes what swings: no body stops, no flank separates, no stop is met."""
    if s.after_l * x.velocity <= 0.0 and s.after_l != x.velocity:
        s.holds = 0
    if s.after_m * x.motor_velocity <= 0.0 and s.after_m != x.motor_velocity:
        s.holds = 0
    if s.side != 2:
        if tension(s.twist_after, s.closing_after, s.side, s.half, s.stiffness, s.damping) == 0.0:
            s.holds = 0
    if has.end_stop:
        if x.position + s.travel > p.stop_upper or x.position + s.travel < p.stop_lower:
            s.holds = 0


def next_event(x, p, s):
    """The first stick, reversal or contact on the way, and when: `span`."""
    s.event = 0
    stop = stopping(x.velocity, s.gain_l, s.h)
    if stop < s.span:
        s.event = 1
        s.span = stop
    if s.together == 0:
        relative = s.gain_m - s.gain_l
        stop = stopping(x.motor_velocity, s.gain_m, s.h)
        if stop < s.span:
            s.event = 2
            s.span = stop
        if s.side != 2:
            meet = reaching(s.half - x.gap, s.closing, relative, s.h)
            if meet < s.span:
                s.event = 3
                s.span = meet
            meet = reaching(-s.half - x.gap, s.closing, relative, s.h)
            if meet < s.span:
                s.event = 4
                s.span = meet
    if has.end_stop:
        meet = reaching(p.stop_upper - x.position, x.velocity, s.gain_l, s.h)
        if meet < s.span:
            s.event = 5
            s.span = meet
        meet = reaching(p.stop_lower - x.position, x.velocity, s.gain_l, s.h)
        if meet < s.span:
            s.event = 6
            s.span = meet


def move(x, p, s):
    """Move the bodies on parabolas to the event, and there exactly onto it."""
    if s.together == 0:
        x.gap = x.gap + s.span * (s.closing + 0.5 * s.span * (s.gain_m - s.gain_l))
    x.position = x.position + s.span * (x.velocity + 0.5 * s.span * s.gain_l)
    x.velocity = x.velocity + s.span * s.gain_l
    x.motor_velocity = x.motor_velocity + s.span * s.gain_m
    if s.event == 1:
        x.velocity = 0.0
    elif s.event == 2:
        x.motor_velocity = 0.0
    elif s.event == 3:
        x.gap = s.half
    elif s.event == 4:
        x.gap = -s.half
    elif s.event == 5:
        x.position = p.stop_upper
    elif s.event == 6:
        x.position = p.stop_lower
    if s.together == 1:
        x.motor_velocity = x.velocity


def memories(x, p, s):
    """Move on what else has a state: lag, heat, bristles, what rides on the link, and the time."""
    if has.motor_lag:
        if s.span < s.h:
            s.decay = exp(-s.span / p.lag_time)
        x.lag = s.fed + (x.lag - s.fed) * s.decay
    if has.thermal_fade:
        x.heat = s.warm + (x.heat - s.warm) * exp(-s.span / p.fade_time)
    if has.bristle:
        leant = bent_by(x.bend, 0.5 * s.span * (s.before_m + x.motor_velocity), p.presliding_travel)
        x.bend = leant
    if has.rider:
        # It stays behind by what the link gains.
        x.ride = x.ride + 0.5 * s.span * x.ride_velocity
        lost = 0.5 * s.span * p.flexible_load_damping
        stays = x.ride_velocity * (1.0 - lost) - x.velocity + s.before_l - s.span * p.flexible_load_stiffness * x.ride
        x.ride_velocity = stays / (1.0 + lost)
        x.ride = x.ride + 0.5 * s.span * x.ride_velocity
    x.time = x.time + s.span


def piece(x, p, k, command, h):
    """Move the axis by h, or to the next event if that comes first; return the time moved.

    Torques are those at the predicted middle of the piece, so it is of second order; for torques of position alone it
    is the symplectic leapfrog. Under constant torques positions are parabolas. The first stick, reversal or contact on
    them ends the piece, and the next one starts with the torques at that point. While elastic teeth press, what lies
    between two torques is no parabola but the swing of a damped spring, which is known as well.
    """
    if has.load_change:
        until_change = p.load_time - x.time
        if until_change > 1e-9 and until_change < h:
            h = until_change
    bodies(x, p, k, s)
    contact(x, s)
    length_at_contact(x, p, s)
    length_at_loads(x, p, s)
    per_m = 1.0 / mass_m
    per_l = 1.0 / mass_l
    # Whether the drive gives more or less on the way.
    varies = 0
    if has.supply_sag or has.unknown_gain or has.unknown_push or has.thermal_fade:
        varies = 1
    unset(s)
    for attempt in range(2):
        if attempt == 1:
            flow = 0
            h = fine
        start_of_piece(x, s)
        for stage in range(2):
            if stage == 1:
                middle_of_piece(x, p, s)
            drive_torque(x, p, s)
            torques(x, p, k, s)
            transmission(s)
            accelerations(x, p, s)
            if flow == 1:
                mobility(x, s)
                swing(x, s)
                swing_holds(x, p, s)
                if holds == 0:
                    break
        if holds == 1:
            break
    span = h
    before_m = x.motor_velocity
    before_l = x.velocity
    if flow == 1:
        x.position = x.position + travel
        x.gap = twist_after
        x.velocity = after_l
        x.motor_velocity = after_m
    else:
        next_event(x, p, s)
        move(x, p, s)
    memories(x, p, s)
    return span


def step(x, p, k, command, h):
    """Move the axis by h under a constant command, from event to event.

    Two bodies have a handful of events in a step, and the hardest stop needs some hundred pieces of it. So the loop's
    bound is never reached in motion.
    """
    remaining = h
    for _ in range(1024):
        span = piece(x, p, k, command, remaining)
        remaining = remaining - span
        if remaining <= 0.0:
            break
    if faded(x.velocity):
        x.velocity = 0.0
    if faded(x.motor_velocity):
        x.motor_velocity = 0.0
    if has.motor_lag:
        if faded(x.lag):
            x.lag = 0.0
    if has.thermal_fade:
        if faded(x.heat):
            x.heat = 0.0
    if has.rider:
        if faded(x.ride):
            x.ride = 0.0
        if faded(x.ride_velocity):
            x.ride_velocity = 0.0
    return remaining


#: The stepper's functions and their sections, in the order in which they call one another.
STEPPER = (
    *STATIONS, net, reaching, stopping, faded, cos_of_root, sinc_of_root, mean_beyond, bent_by, halved,
    bodies, contact, length_at_contact, length_at_loads, unset, start_of_piece, middle_of_piece, drive_torque, torques,
    transmission, accelerations, mobility, swing, swing_holds, next_event, move, memories, piece, step,
)  # fmt: skip
