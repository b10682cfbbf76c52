"""The chain of stations, and the stepper that moves it through time.

    command -> drive -> motor -> transmission -> link -> sensor
                                                  ^ loads, friction, disturbance

The stepper below is written once, in a small part of Python: scalars, `if`, `for ... in range`, `sqrt`
and `exp`. `x.name` is a state, `p.name` a parameter, `k.name` a quantity known of the recording and
`has.name` whether the structure contains an effect, or any law in a slot. The writers turn this text into
Python that runs, into its exact derivative, and into C. It is not called from here.

Accelerations and inertias are relative to the inertia of the axis, so that torque and acceleration are the
same number (paper, eq. 2).

What is not smooth stands here in the open. Dry friction takes from the torque what it can (`net`), so that
rest is rest. Backlash is two bodies: `piece` ends at each stick, reversal and contact, so that no event is
stepped over (Brogliato, Nonsmooth Mechanics, 2016; inelastic impact).
"""

# mypy: ignore-errors
# ruff: noqa: SIM102, F821

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import exp, sqrt

from twin.effects.catalogue import BASE, EFFECTS
from twin.effects.effect import Effect
from twin.effects.parameter import Parameter

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


def tension(gap, speed, side, half, stiffness, damping):
    """Torque through compliant teeth or an elastic joint; gap and speed are motor minus link. A flank never pulls."""
    pull = 0.0
    if side == 1:
        pull = stiffness * (gap - half) + damping * speed
        if pull < 0.0:
            pull = 0.0
    elif side == -1:
        pull = stiffness * (gap + half) + damping * speed
        if pull > 0.0:
            pull = 0.0
    elif side == 2:
        pull = stiffness * gap + damping * speed
    return pull


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


def clipped(value, upper, lower):
    """The value, held between -lower and upper."""
    result = value
    if value > upper:
        result = upper
    elif value < -lower:
        result = -lower
    return result


def beyond(value, upper, lower):
    """By how much the value is beyond -lower or upper."""
    kept = clipped(value, upper, lower)
    return value - kept


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


def tugging(way, speed, stiffness, damping):
    """Acceleration by which a spring and a damper draw back what rides on the link."""
    return stiffness * way + damping * speed


def halved(length, rate, most):
    """A length, halved until it is no more than `most` at a rate: one that a parameter moved would have a slope."""
    for _ in range(12):
        if length * rate <= most:
            break
        length = 0.5 * length
    return length


def piece(x, p, k, command, h):
    """Move the axis by h, or to the next event if that comes first; return the time moved.

    Torques are those at the predicted middle of the piece, so it is of second order; for torques of position alone it
    is the symplectic leapfrog. Under constant torques positions are parabolas. The first stick, reversal or contact on
    them ends the piece, and the next one starts with the torques at that point. While elastic teeth press, what lies
    between two torques is no parabola but the swing of a damped spring, which is known as well.
    """
    if has.load_change:
        until = p.load_time - x.time
        if until > 1e-9 and until < h:
            h = until
    half = 0.0
    mass_m = 0.5
    share = 0.5
    dry = 0.5
    turned = 0.0
    if has.backlash:
        half = 0.5 * p.backlash_gap
        mass_m = p.motor_share
        share = p.friction_share
        dry = p.dry_share
        turned = p.shaft_share
    # Compliant teeth and an elastic joint are the same spring beyond the gap: the softer one is what is seen.
    elastic = 0
    rate = 0.0
    decline = 0.0
    stiffness = 0.0
    damping = 0.0
    if has.tooth_compliance:
        elastic = 1
        rate = 6.283185307179586 * p.tooth_frequency
        decline = 2.0 * p.tooth_damping * rate
        stiffness = rate * rate * mass_m * (1.0 - mass_m)
        damping = 2.0 * p.tooth_damping * rate * mass_m * (1.0 - mass_m)
    if has.joint_elasticity:
        elastic = 1
        rate = 6.283185307179586 * p.joint_frequency
        decline = 2.0 * p.joint_damping * rate
        stiffness = rate * rate * mass_m * (1.0 - mass_m)
        damping = 2.0 * p.joint_damping * rate * mass_m * (1.0 - mass_m)
    added = 0.0
    if has.mass:
        added = mass(x.position + 0.5 * h * x.velocity, x.time + 0.5 * h, k.payload, p)
    mass_l = 1.0 - mass_m + added
    total = mass_m + mass_l
    per_total = 1.0 / total

    # The flank that touches: 1 the upper, -1 the lower, 2 both (there is no gap), 0 neither.
    side = 0
    closing = x.motor_velocity - x.velocity
    if half <= 0.0:
        side = 2
    elif x.gap >= half:
        if closing >= 0.0 or (elastic == 1 and x.gap > half):
            side = 1
    elif x.gap <= -half:
        if closing <= 0.0 or (elastic == 1 and x.gap < -half):
            side = -1
    if side != 0 and elastic == 0:
        if closing != 0.0:
            joint = (mass_m * x.motor_velocity + mass_l * x.velocity) / total
            if has.rider:
                # A blow leaves it as it was.
                x.ride_velocity = x.ride_velocity + x.velocity - joint
            x.velocity = joint
            x.motor_velocity = joint
            closing = 0.0
        if side == 2:
            x.gap = 0.0
        elif side == 1:
            x.gap = half
        else:
            x.gap = -half

    # Alone in the gap the light motor comes to its speed soon, and what is fine for the axis is coarse for it.
    if side == 0:
        if h > 0.0005:
            h = 0.0005
        slows = share * p.viscous_friction / mass_m
        # No motor that there is stops sooner.
        if slows > 200.0:
            slows = 200.0
        h = halved(h, slows, 0.015)
    # What presses is a spring with a damper, whose motion between two torques is known (`flow`): in pieces that only
    # the torques need. Where a flank separates or a body stops within one, the step uses `fine` pieces like everything
    # else. Coarse pieces before a ringing has decayed would make its end depend on the smallest change of the model. A
    # body with so much damping that a step would pass its rest would chatter.
    flow = 0
    lean = 0.0
    fine = h
    if elastic == 1 and side != 0:
        if fine > 0.0005:
            fine = 0.0005
        ringing = 0
        if closing > 0.0002 or closing < -0.0002:
            ringing = 1
        if ringing == 1:
            fine = halved(fine, rate, 0.08)
        fine = halved(fine, decline, 1.0)
        if side == 2:
            flow = 1
        else:
            lean = side * half
            if tension(x.gap, closing, side, half, stiffness, damping) != 0.0:
                flow = 1
        if flow == 1:
            if ringing == 1:
                h = halved(h, rate, 0.5)
            h = halved(h, rate, 3.0)
            h = halved(h, decline, 4.0)
        else:
            h = fine
    # Likewise fine in a stop, also where the link turns around in it; on its way there it does not feel it yet.
    if has.end_stop:
        depth = x.position - p.stop_upper
        ahead = -depth
        if x.position <= p.stop_lower:
            depth = p.stop_lower - x.position
        if x.velocity < 0.0:
            ahead = p.stop_lower - x.position
        if depth >= 0.0:
            flow = 0
            if h > fine:
                h = fine
            hard = sqrt(p.stop_stiffness)
            h = halved(h, hard, 0.02)
            h = halved(h, p.stop_damping + p.stop_stiffness * p.stop_hysteresis * depth, 1.0)
        elif x.velocity * ahead > 0.0:
            until = ahead / x.velocity
            if until > 1e-9 and until < h:
                h = until
    # However firmly something is held that rides on the link, it does not shake it; its swing is followed.
    if has.rider:
        firm = 1.0 + p.flexible_load_share / mass_l
        h = halved(h, p.flexible_load_damping * firm, 0.5)
        swings = sqrt(p.flexible_load_stiffness * firm)
        h = halved(h, swings, 0.3)
    if fine > h:
        fine = h
    per_m = 1.0 / mass_m
    per_l = 1.0 / mass_l

    # Whether the drive gives more or less on the way.
    varies = 0
    if has.supply_sag:
        varies = 1
    if has.unknown_gain:
        varies = 1
    if has.unknown_push:
        varies = 1
    warm = 0.0
    if has.thermal_fade:
        varies = 1
    gain_l = 0.0
    gain_m = 0.0
    tug = 0.0
    acting = 0.0
    fed = 0.0
    decay = 0.0
    together = 0
    hook = 1.0
    whole = 1.0
    turn = 0.0
    yields = 0.0
    after_l = 0.0
    after_m = 0.0
    twist_after = 0.0
    closing_after = 0.0
    for attempt in range(2):
        if attempt == 1:
            flow = 0
            h = fine
        middle = 0.5 * h
        moment = x.time
        place = x.position
        speed_l = x.velocity
        speed_m = x.motor_velocity
        heat = x.heat
        twist = x.gap
        together = 0
        travel = 0.0
        holds = 1
        for stage in range(2):
            if stage == 1:
                moment = x.time + middle
                if flow == 1:
                    place = x.position + 0.5 * middle * (x.velocity + after_l)
                    speed_l = after_l
                    speed_m = after_m
                    twist = twist_after
                else:
                    place = x.position + middle * x.velocity
                    speed_l = x.velocity + middle * gain_l
                    if speed_l * x.velocity < 0.0:
                        speed_l = 0.0
                    speed_m = speed_l
                    if together == 0:
                        speed_m = x.motor_velocity + middle * gain_m
                        if speed_m * x.motor_velocity < 0.0:
                            speed_m = 0.0
                    twist = x.gap + middle * closing
                if has.thermal_fade:
                    heat = x.heat + (warm - x.heat) * middle / p.fade_time

            if stage == 0 or varies == 1:
                emf = 0.0
                if has.supply_sag:
                    emf = p.viscous_friction * speed_m / p.input_gain
                if has.thermal_fade:
                    emf = p.viscous_friction * speed_m / p.input_gain
                    if stage == 0:
                        cold = drive(command, emf, 0.0, place + twist, p)
                        warm = ((cold - p.fade_emf * emf) / p.fade_reference) ** 2
                acting = drive(command, emf, heat, place + twist, p)
            mean = acting
            if has.motor_lag:
                fed = acting
                if has.dead_band:
                    kept = clipped(command, p.dead_band_forward, p.dead_band_reverse)
                    fed = fed + p.lag_dead_band * kept
                # The mean over the first half predicts the middle; the mean over the whole moves the axis.
                if stage == 0:
                    decay = exp(-middle / p.lag_time)
                    mean = fed + (x.lag - fed) * (1.0 - decay) * p.lag_time / middle
                else:
                    decay = decay * decay
                    mean = fed + (x.lag - fed) * (1.0 - decay) * p.lag_time / h
                if has.dead_band:
                    lagging = fed + (x.lag - fed) * decay
                    upper = p.lag_dead_band * p.dead_band_forward
                    lower = p.lag_dead_band * p.dead_band_reverse
                    mean = mean_beyond(x.lag, lagging, mean, upper, lower)
            torque = p.input_gain * mean
            pull = 0.0
            if has.load:
                pull = load(place, speed_l, moment, k.moment, p)
            resist_l = drag(place, speed_l, p)
            resist_m = resist_l
            if speed_m != speed_l:
                resist_m = drag(place, speed_m, p)

            push_m = torque + share * resist_m
            if has.bristle:
                leaning = x.bend
                if stage == 1:
                    leaning = bent_by(x.bend, 0.5 * middle * (x.motor_velocity + speed_m), p.presliding_travel)
                held = bristle(leaning, p)
                push_m = push_m + held
            push_l = pull + (1.0 - share) * resist_l
            if has.rider:
                if stage == 0:
                    tug = tugging(x.ride, x.ride_velocity, p.flexible_load_stiffness, p.flexible_load_damping)
                else:
                    ride = x.ride + middle * x.ride_velocity
                    speed = x.ride_velocity - speed_l + x.velocity - middle * tug
                    tug = tugging(ride, speed, p.flexible_load_stiffness, p.flexible_load_damping)
                drawn = rider(tug, p)
                push_l = push_l + drawn
            if has.shaft:
                turn_m = shaft(place + twist, p)
                turn_l = shaft(place, p)
                push_m = push_m + turned * turn_m
                push_l = push_l + (1.0 - turned) * turn_l
            # What the teeth transmit: the spring's torque, or what makes two bodies move as one.
            through = 0.0
            if elastic == 1:
                through = tension(twist, speed_m - speed_l, side, half, stiffness, damping)
                push_m = push_m - through
                push_l = push_l + through
            elif side != 0:
                through = (push_m * mass_l - push_l * mass_m) * per_total
                if side * through < 0.0 and side != 2:
                    through = 0.0
            left_m = push_m
            left_l = push_l
            left = push_m + push_l
            if has.grip:
                forward = 0.0
                reverse = 0.0
                # Only what is at rest needs both.
                if x.motor_velocity >= 0.0 or x.velocity >= 0.0:
                    forward = grip(place, speed_l, 1.0, through, moment, p)
                    if forward < 0.0:
                        forward = 0.0
                if x.motor_velocity <= 0.0 or x.velocity <= 0.0:
                    reverse = grip(place, speed_l, -1.0, through, moment, p)
                    if reverse < 0.0:
                        reverse = 0.0
                left_m = net(push_m, dry * forward, dry * reverse, x.motor_velocity)
                left_l = net(push_l, (1.0 - dry) * forward, (1.0 - dry) * reverse, x.velocity)
                left = net(left, forward, reverse, x.velocity)
            together = 0
            if elastic == 0:
                if side == 2 or (side != 0 and side * (left_m * mass_l - left_l * mass_m) >= 0.0):
                    together = 1
            if together == 1:
                gain_l = left * per_total
                gain_m = gain_l
            else:
                gain_m = left_m * per_m
                gain_l = left_l * per_l

            if flow == 1:
                # What friction holds does not move, and the other body swings against it.
                yields_m = per_m
                yields_l = per_l
                if has.grip:
                    if x.motor_velocity == 0.0 and left_m == 0.0:
                        yields_m = 0.0
                    if x.velocity == 0.0 and left_l == 0.0:
                        yields_l = 0.0
                if stage == 1 and yields_m + yields_l != yields:
                    holds = 0
                yields = yields_m + yields_l
                after_l = x.velocity
                after_m = x.motor_velocity
                twist_after = x.gap
                closing_after = closing
                if yields > 0.0 and holds == 1:
                    free_m = left_m + through
                    free_l = left_l - through
                    apart = free_m * yields_m - free_l * yields_l
                    bent = apart - yields * stiffness * (x.gap - lean)
                    lasts = middle
                    if stage == 0:
                        hook = yields * stiffness
                        loss = yields * damping * middle
                        bend = hook * middle * middle - 0.25 * loss * loss
                        fades = exp(-0.5 * loss)
                        swing = cos_of_root(bend)
                        sway = sinc_of_root(bend)
                        turn = middle * fades * sway
                        whole = fades * (swing + 0.5 * loss * sway)
                    else:
                        # Once more as far.
                        lasts = h
                        first = turn
                        turn = first * (2.0 * whole - yields * damping * first)
                        whole = whole * whole - hook * first * first
                    twist_after = x.gap + turn * closing + (1.0 - whole) * bent / hook
                    closing_after = (whole - turn * yields * damping) * closing + turn * bent
                    given = (apart * lasts - closing_after + closing) / yields
                    after_m = x.motor_velocity + yields_m * (free_m * lasts - given)
                    after_l = x.velocity + yields_l * (free_l * lasts + given)
                    if stage == 1:
                        shift = (0.5 * apart * h * h - twist_after + x.gap + closing * h) / yields
                        travel = h * x.velocity + yields_l * (0.5 * h * h * free_l + shift)
                if after_l * x.velocity <= 0.0 and after_l != x.velocity:
                    holds = 0
                if after_m * x.motor_velocity <= 0.0 and after_m != x.motor_velocity:
                    holds = 0
                if side != 2:
                    if tension(twist_after, closing_after, side, half, stiffness, damping) == 0.0:
                        holds = 0
                if has.end_stop:
                    if x.position + travel > p.stop_upper or x.position + travel < p.stop_lower:
                        holds = 0
                if holds == 0:
                    break
        if holds == 1:
            break

    span = h
    before = x.motor_velocity
    before_l = x.velocity
    if flow == 1:
        x.position = x.position + travel
        x.gap = twist_after
        x.velocity = after_l
        x.motor_velocity = after_m
    else:
        event = 0
        stop = stopping(x.velocity, gain_l, h)
        if stop < span:
            event = 1
            span = stop
        if together == 0:
            relative = gain_m - gain_l
            stop = stopping(x.motor_velocity, gain_m, h)
            if stop < span:
                event = 2
                span = stop
            if side != 2:
                meet = reaching(half - x.gap, closing, relative, h)
                if meet < span:
                    event = 3
                    span = meet
                meet = reaching(-half - x.gap, closing, relative, h)
                if meet < span:
                    event = 4
                    span = meet
        if has.end_stop:
            meet = reaching(p.stop_upper - x.position, x.velocity, gain_l, h)
            if meet < span:
                event = 5
                span = meet
            meet = reaching(p.stop_lower - x.position, x.velocity, gain_l, h)
            if meet < span:
                event = 6
                span = meet
        if together == 0:
            x.gap = x.gap + span * (closing + 0.5 * span * (gain_m - gain_l))
        x.position = x.position + span * (x.velocity + 0.5 * span * gain_l)
        x.velocity = x.velocity + span * gain_l
        x.motor_velocity = x.motor_velocity + span * gain_m
        if event == 1:
            x.velocity = 0.0
        elif event == 2:
            x.motor_velocity = 0.0
        elif event == 3:
            x.gap = half
        elif event == 4:
            x.gap = -half
        elif event == 5:
            x.position = p.stop_upper
        elif event == 6:
            x.position = p.stop_lower
        if together == 1:
            x.motor_velocity = x.velocity

    if has.motor_lag:
        if span < h:
            decay = exp(-span / p.lag_time)
        x.lag = fed + (x.lag - fed) * decay
    if has.thermal_fade:
        x.heat = warm + (x.heat - warm) * exp(-span / p.fade_time)
    if has.bristle:
        leaning = bent_by(x.bend, 0.5 * span * (before + x.motor_velocity), p.presliding_travel)
        x.bend = leaning
    if has.rider:
        # It stays behind by what the link gains.
        x.ride = x.ride + 0.5 * span * x.ride_velocity
        slows = 0.5 * span * p.flexible_load_damping
        kept = x.ride_velocity * (1.0 - slows) - x.velocity + before_l - span * p.flexible_load_stiffness * x.ride
        x.ride_velocity = kept / (1.0 + slows)
        x.ride = x.ride + 0.5 * span * x.ride_velocity
    x.time = x.time + span
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


#: The stepper's functions, in the order in which they call one another.
STEPPER = (
    net, tension, reaching, stopping, faded, cos_of_root, sinc_of_root, clipped, beyond, mean_beyond, bent_by, tugging,
    halved, piece, step,
)  # fmt: skip
