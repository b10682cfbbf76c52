"""The laws between the stations of the chain, each written once.

    command -> drive -> motor -> transmission -> link -> sensor

The stepper, the rates for an outside solver, the Modelica text and the controller all use these functions. They are in
the stepper's language: scalars, `if`, `sqrt` and `exp`; `p.name` is a parameter, `has.name` says whether the structure
contains an effect or any law in a slot, and a slot's name calls its laws. `twin.model.equations.expression` makes a
formula of each.
"""

# mypy: ignore-errors
# ruff: noqa: F821

from __future__ import annotations


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


def back_emf(speed, p):
    """Back-EMF of the motor, as a command; zero where nothing in the drive feels it."""
    emf = 0.0
    if has.supply_sag or has.thermal_fade:
        emf = p.viscous_friction * speed / p.input_gain
    return emf


def heating(passed, emf, p):
    """Warming at which the motor would settle: the square of its current, which `passed` drives against the EMF."""
    return ((passed - p.fade_emf * emf) / p.fade_reference) ** 2


def first_order(target, value, time):
    """Rate at which a first-order lag with this time constant brings a value to its target."""
    return (target - value) / time


def before_lag(acting, command, p):
    """What the lag is fed with: what acts, and the part of the dead-band that lies behind the lag."""
    fed = acting
    if has.dead_band:
        kept = clipped(command, p.dead_band_forward, p.dead_band_reverse)
        fed = acting + p.lag_dead_band * kept
    return fed


def behind_lag(lag, p):
    """The command that acts behind the lag: less the part of the dead-band that lies there."""
    acting = lag
    if has.dead_band:
        acting = beyond(lag, p.lag_dead_band * p.dead_band_forward, p.lag_dead_band * p.dead_band_reverse)
    return acting


def angular(frequency):
    """Angular frequency, rad/s, of a frequency in Hz."""
    return 6.283185307179586 * frequency


def ringing_rate(p):
    """Angular frequency at which motor and link ring: of the teeth, or of the joint, which is the softer spring."""
    rate = 0.0
    if has.tooth_compliance:
        rate = angular(p.tooth_frequency)
    if has.joint_elasticity:
        rate = angular(p.joint_frequency)
    return rate


def ringing_ratio(p):
    """Damping ratio of that ringing."""
    ratio = 0.0
    if has.tooth_compliance:
        ratio = p.tooth_damping
    if has.joint_elasticity:
        ratio = p.joint_damping
    return ratio


def mesh_stiffness(rate, mass_m):
    """Stiffness between motor and link, which ring at this rate; the motor has the share `mass_m` of the inertia."""
    return rate * rate * mass_m * (1.0 - mass_m)


def mesh_damping(ratio, rate, mass_m):
    """Damping between motor and link, whose ringing has this rate and damping ratio."""
    return 2.0 * ratio * rate * mass_m * (1.0 - mass_m)


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


def carried(push_m, push_l, mass_m, mass_l, per_total):
    """Torque through the gears that makes motor and link move as one; `per_total` is one over their inertia."""
    return (push_m * mass_l - push_l * mass_m) * per_total


def on_motor(torque, resist, place, bend, share, turned, p):
    """Torques on the motor: drive, its share of the drag, bristles, its share of what acts on the shaft."""
    push = torque + share * resist
    if has.bristle:
        held = bristle(bend, p)
        push = push + held
    if has.shaft:
        turn = shaft(place, p)
        push = push + turned * turn
    return push


def on_link(pull, resist, place, tug, share, turned, p):
    """Torques on the link: loads, its share of the drag, what rides on it, its share of what acts on the shaft."""
    push = pull + (1.0 - share) * resist
    if has.rider:
        drawn = rider(tug, p)
        push = push + drawn
    if has.shaft:
        turn = shaft(place, p)
        push = push + (1.0 - turned) * turn
    return push


def dry_friction(place, speed, direction, through, time, p):
    """Size of the dry friction in a direction of motion: friction that would push is none."""
    size = grip(place, speed, direction, through, time, p)
    if size < 0.0:
        size = 0.0
    return size


def tugging(way, speed, stiffness, damping):
    """Acceleration by which a spring and a damper draw back what rides on the link."""
    return stiffness * way + damping * speed


def bend_rate(speed, bend, travel):
    """Rate at which bristles bend: the nearer they are to sliding the less they follow the motion."""
    size = speed
    if speed < 0.0:
        size = -speed
    return (speed - size * bend) / travel


#: The functions in the order in which they call one another.
STATIONS = (
    clipped, beyond, back_emf, heating, first_order, before_lag, behind_lag, angular, ringing_rate, ringing_ratio,
    mesh_stiffness, mesh_damping, tension, carried, on_motor, on_link, dry_friction, tugging, bend_rate,
)  # fmt: skip
