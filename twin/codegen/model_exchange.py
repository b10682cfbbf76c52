"""The axis for an outside solver: rates under fixed modes, and the events at which the modes change.

In the stepper's language, with the laws of the stations. Functions that take `s` are sections of `rates`
(`twin.codegen.sections`). A body slides forwards (mode 1), backwards (-1) or is held
(0); the solver finds the zeros of the margins, and `settle` then chooses anew. Rigid contact and dead time are
not expressed here: structures that have them are for co-simulation only.

The margins have a hysteresis, as event indicators need it. Each is `HYSTERESIS` above zero at the moment at which the
mode may change. So it is never zero when a mode begins, and its sign changes whatever the motion does next.
"""

# mypy: ignore-errors
# ruff: noqa: F821, F841, SIM102

from __future__ import annotations

import ast
import inspect
import textwrap
from dataclasses import replace
from functools import cache

from twin.codegen import c, directional_derivative
from twin.codegen.python import Numbering, module, numbering, resolve
from twin.model.stations import (
    back_emf,
    before_lag,
    behind_lag,
    bend_rate,
    carried,
    dry_friction,
    first_order,
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
from twin.model.stepper import STATES, Structure

#: What stands behind the states: their rates, the modes, the margins whose zeros are events, and torques.
BEHIND = (
    "rate_position", "rate_velocity", "rate_gap", "rate_motor_velocity", "rate_lag", "rate_heat", "rate_bend",
    "rate_ride", "rate_ride_velocity",
    "mode_motor", "mode_link", "margin_motor", "margin_link", "margin_upper", "margin_lower",
    "push_motor", "push_link", "forward_motor", "reverse_motor", "forward_link", "reverse_link",
)  # fmt: skip


def offered(structure: Structure) -> bool:
    """Whether the structure can be given to an outside solver."""
    rigid = "backlash" in structure and not structure.elastic
    return not rigid and "input_delay" not in structure


def continuous(structure: Structure) -> tuple[str, ...]:
    """The states that a solver integrates, in the stepper's order."""
    present = {
        "gap": "backlash" in structure,
        "motor_velocity": "backlash" in structure,
        "lag": "motor_lag" in structure,
        "heat": "thermal_fade" in structure,
        "bend": "bristle" in structure.slots,
        "ride": "rider" in structure.slots,
        "ride_velocity": "rider" in structure.slots,
    }
    return tuple(name for name in STATES if name != "time" and present.get(name, True))


def margins(structure: Structure) -> tuple[str, ...]:
    """The event indicators."""
    sticks = "grip" in structure.slots
    two = "backlash" in structure
    held = (("margin_motor",) if two else ()) + ("margin_link",) if sticks else ()
    return held + (("margin_upper", "margin_lower") if two else ())


def left_over(torque, forward, reverse, mode):
    """What dry friction leaves of a torque on a body in a mode."""
    left = 0.0
    if mode > 0.0:
        left = torque - forward
    elif mode < 0.0:
        left = torque + reverse
    return left


def margin(torque, forward, reverse, mode, velocity):
    """How far a body is within its mode: a velocity, or the torque that friction can still hold over what it holds.

    Below zero the mode contradicts the motion. The hysteresis of 1e-9 is far below what can be measured. It is far
    above the rounding of a solver, which stops a little before or behind the zero.
    """
    within = mode * velocity
    if mode == 0.0:
        within = forward - torque
        if reverse + torque < within:
            within = reverse + torque
        within = within / (1.0 + forward + reverse)
    return within + 1e-9


def chosen(torque, forward, reverse):
    """The mode of a body at rest."""
    mode = 0.0
    if torque > forward:
        mode = 1.0
    elif torque < -reverse:
        mode = -1.0
    return mode


def two_bodies(x, p, k, s):
    """The shares of motor and link, and the torque wound up between them; without backlash all is link."""
    s.half = 0.0
    s.mass_m = 0.0
    s.share = 0.0
    s.dry = 0.0
    s.turned = 0.0
    s.speed_m = x.velocity
    s.wound = 0.0
    if has.backlash:
        s.half = 0.5 * p.backlash_gap
        s.mass_m = p.motor_share
        s.share = p.friction_share
        s.dry = p.dry_share
        s.turned = p.shaft_share
        s.speed_m = x.motor_velocity
        side = 0
        if s.half <= 0.0:
            side = 2
        elif x.gap > s.half:
            side = 1
        elif x.gap < -s.half:
            side = -1
        rate = ringing_rate(p)
        ratio = ringing_ratio(p)
        stiffness = mesh_stiffness(rate, s.mass_m)
        damping = mesh_damping(ratio, rate, s.mass_m)
        s.wound = tension(x.gap, s.speed_m - x.velocity, side, s.half, stiffness, damping)
    s.mass_l = 1.0 - s.mass_m
    if has.mass:
        added = mass(x.position, x.time, k.payload, p)
        s.mass_l = s.mass_l + added


def drive_rates(x, p, s):
    """Torque of the drive, and the rates of heat and lag."""
    emf = back_emf(s.speed_m, p)
    if has.thermal_fade:
        cold = drive(s.command, emf, 0.0, x.position + x.gap, p)
        settled = heating(cold, emf, p)
        warms = first_order(settled, x.heat, p.fade_time)
        x.rate_heat = warms
    acting = drive(s.command, emf, x.heat, x.position + x.gap, p)
    if has.motor_lag:
        fed = before_lag(acting, s.command, p)
        follows = first_order(fed, x.lag, p.lag_time)
        x.rate_lag = follows
        acting = behind_lag(x.lag, p)
    s.torque = p.input_gain * acting


def torque_rates(x, p, k, s):
    """Torques on motor and link, without dry friction, and the rate at which bristles bend."""
    s.pull = 0.0
    if has.load:
        s.pull = load(x.position, x.velocity, x.time, k.moment, p)
    if has.bristle:
        bends = bend_rate(s.speed_m, x.bend, p.presliding_travel)
        x.rate_bend = bends
    s.tug = 0.0
    if has.rider:
        s.tug = tugging(x.ride, x.ride_velocity, p.flexible_load_stiffness, p.flexible_load_damping)
    s.resist_l = drag(x.position, x.velocity, p)
    resist_m = s.resist_l
    if has.backlash:
        resist_m = drag(x.position, s.speed_m, p)
    push_m = on_motor(s.torque, resist_m, x.position + x.gap, x.bend, s.share, s.turned, p)
    push_l = on_link(s.pull, s.resist_l, x.position, s.tug, s.share, s.turned, p)
    x.push_motor = push_m - s.wound
    x.push_link = push_l + s.wound
    if has.backlash:
        s.through = s.wound
    else:
        # Each is half of the axis, as far as the teeth are concerned.
        half_m = push_m + 0.5 * s.resist_l
        half_l = push_l - 0.5 * s.resist_l
        s.through = carried(half_m, half_l, 0.5, s.mass_l - 0.5, 1.0 / s.mass_l)
        x.push_link = push_m + push_l


def friction_rates(x, p, s):
    """What dry friction leaves of the torques in the modes, and how far the bodies are within them."""
    s.left_m = x.push_motor
    s.left_l = x.push_link
    if has.grip:
        forward = dry_friction(x.position, x.velocity, 1.0, s.through, x.time, p)
        reverse = dry_friction(x.position, x.velocity, -1.0, s.through, x.time, p)
        x.forward_motor = s.dry * forward
        x.reverse_motor = s.dry * reverse
        x.forward_link = forward - x.forward_motor
        x.reverse_link = reverse - x.reverse_motor
        s.left_m = left_over(x.push_motor, x.forward_motor, x.reverse_motor, x.mode_motor)
        s.left_l = left_over(x.push_link, x.forward_link, x.reverse_link, x.mode_link)
        within_m = margin(x.push_motor, x.forward_motor, x.reverse_motor, x.mode_motor, s.speed_m)
        within_l = margin(x.push_link, x.forward_link, x.reverse_link, x.mode_link, x.velocity)
        x.margin_motor = within_m
        x.margin_link = within_l


def rates(x, p, k, command):
    """Fill the rates, margins and torques from the states and modes."""
    two_bodies(x, p, k, s)
    drive_rates(x, p, s)
    torque_rates(x, p, k, s)
    friction_rates(x, p, s)
    x.rate_position = x.velocity
    x.rate_velocity = left_l / mass_l
    x.rate_ride = x.ride_velocity
    x.rate_ride_velocity = -x.rate_velocity - tug
    if has.backlash:
        x.rate_gap = speed_m - x.velocity
        x.rate_motor_velocity = left_m / mass_m
        # Of the size of one, as the others are: a gap is some hundredths of a radian.
        x.margin_upper = 100.0 * (x.gap - half)
        x.margin_lower = 100.0 * (x.gap + half)
    return 0.0


def settle(x, p, k, command):
    """Choose the modes anew; return 1 where one changed or a body came to rest."""
    changed = 0.0
    if has.grip:
        done = rates(x, p, k, command)
        if has.backlash:
            if x.mode_motor * x.motor_velocity <= 0.0:
                mode = chosen(x.push_motor, x.forward_motor, x.reverse_motor)
                if x.mode_motor == 0.0 and x.motor_velocity > 0.0:
                    mode = 1.0
                elif x.mode_motor == 0.0 and x.motor_velocity < 0.0:
                    mode = -1.0
                elif x.motor_velocity != 0.0:
                    x.motor_velocity = 0.0
                    changed = 1.0
                if mode != x.mode_motor:
                    x.mode_motor = mode
                    changed = 1.0
        if x.mode_link * x.velocity <= 0.0:
            mode = chosen(x.push_link, x.forward_link, x.reverse_link)
            if x.mode_link == 0.0 and x.velocity > 0.0:
                mode = 1.0
            elif x.mode_link == 0.0 and x.velocity < 0.0:
                mode = -1.0
            elif x.velocity != 0.0:
                x.velocity = 0.0
                changed = 1.0
            if mode != x.mode_link:
                x.mode_link = mode
                changed = 1.0
    return changed


#: They are asked for now and then: compiled for speed and into one another they take a minute.
_SELDOM = """#if defined __GNUC__
#define SELDOM __attribute__((cold, noinline))
#else
#define SELDOM
#endif

"""


def _numbering(structure: Structure) -> Numbering:
    """The stepper's numbers, with what stands behind its states."""
    return replace(numbering(structure, False), states={n: i for i, n in enumerate((*STATES, *BEHIND))})


def _functions(structure: Structure) -> list[ast.FunctionDef]:
    """`rates`, `settle` and what they call, of a structure."""
    sticks = (left_over, margin, chosen) if "grip" in structure.slots else ()
    written = (*sticks, two_bodies, drive_rates, torque_rates, friction_rates, rates, settle)
    text = "\n".join(textwrap.dedent(inspect.getsource(f)) for f in written)
    return [f for f in resolve(text, _numbering(structure)).body if isinstance(f, ast.FunctionDef)]


def write(structure: Structure) -> str:
    """C text beside the stepper's: `rates` and `settle`, both `double (double *x, p, k, double command)`."""
    tree = ast.Module([*module(structure).body, *_functions(structure)], [])
    more = c.called_by(tree, "rates", "settle") - c.called_by(tree, *c.ROOTS)
    return c.text(f for f in tree.body if isinstance(f, ast.FunctionDef) and f.name in more)


@cache
def write_derivatives(structure: Structure) -> str:
    """C text of the exact derivatives, one direction at a time.

    `step_t` and `sensor_t`, and `rates_t` where an outside solver is offered. Beside each value stands its slope. `xd`
    and `pd` hold the slopes of states and parameters, and the last argument takes that of the result.
    """
    solved = offered(structure)
    more = [f for f in _functions(structure) if f.name not in ("settle", "chosen")] if solved else []
    tree = directional_derivative.write(structure, _numbering(structure), more)
    text = c.functions(tree, "step_t", "sensor_t", *(("rates_t",) if solved else ()))
    return _SELDOM + text.replace("static double", "SELDOM static double")
