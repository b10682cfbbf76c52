"""What the controller does once every sample, written in the stepper's small part of Python.

The code generator turns this text into one plain Python module, together with the laws and the stepper of the same
structure. The co-simulation runs it, numba compiles it for hundreds of draws, and the controller FMU embeds it. `x` is
the observer's state at this sample and `y` the state predicted to the moment at which the command computed now will
act; `m` memory, `q` the commands still under way (newest first), `g` the design.

The command from the reading at one sample leaves at the next, as on a rig and between the FMUs of any master. The model
is run forward over that sample and the input delay. Functions that take `s` are sections of `sample`
(`twin.codegen.sections`).
"""

# mypy: ignore-errors
# ruff: noqa: SIM102, SIM108, F821

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Mapping
from functools import cache
from math import floor, sqrt
from types import SimpleNamespace
from typing import ClassVar

from twin.codegen import c
from twin.codegen.python import Numbering, numbering, resolve
from twin.codegen.python import module as axis_module
from twin.model.stations import back_emf, behind_lag, clipped, dry_friction
from twin.model.stepper import EVERYTHING, STATES, Structure

#: Memory of the controller between samples.
MEMORY = ("started", "nominal", "disturbance", "acceleration", "jerk", "holding", "goal", "flank", "crossings")

#: The design's numbers, in the order of `g`. {x}, {u}: units of axis and input.
SETTINGS: dict[str, tuple[str, str]] = {
    "sample_time": ("s", "period of the loop"),
    "pieces": ("1", "internal steps of the observer in one period"),
    "whole": ("1", "whole periods in the input delay"),
    "part": ("s", "what the input delay has beyond whole periods"),
    "resolution": ("{x}", "one count of the sensor; 0: not quantised"),
    "limit": ("{u}", "largest command, either way"),
    "position_gain": ("1/s^2", "acceleration per position error"),
    "velocity_gain": ("1/s", "acceleration per velocity error"),
    "acceleration_gain": ("1", "acceleration per acceleration error, where a lag has to be led"),
    "observer_position": ("1", "share of the innovation that corrects the position"),
    "observer_velocity": ("1/s", "share of the innovation that corrects the velocity"),
    "observer_disturbance": ("1/s^2", "share of the innovation that corrects the torque not modelled"),
    "rest_speed": ("{x}/s", "speed below which the observer cannot tell motion from rest"),
    "blur": ("{u}", "effective command within which the dead-band is passed in a straight line"),
    "braking": ("1", "share of the available torque on which a large step counts for braking"),
    "hunting": ("{x}/s^2", "load or friction that holds the flank, so that the loop cannot hunt across the gap"),
    "calming": ("1/s", "acceleration per velocity that brakes a loop caught hunting across the gap"),
    "tolerance": ("{x}", "error at rest left alone where the loop would hunt; beyond twice that it is not"),
}


def answer(target, emf, heat, place, limit, p):
    """The smallest command at which the drive passes on `target`, or the one that comes closest to it."""
    # What a warm motor that turns passes on without a command.
    rest = drive(0.0, emf, heat, place, p)
    side = 1.0
    if target < rest:
        side = -1.0
    wanted = side * (target - rest)
    low = 0.0
    high = 0.0
    peak = 0.0
    most = 0.0
    # In parts, because a sagging supply makes a drive that passes on less where more is commanded.
    for i in range(16):
        high = limit * (i + 1.0) / 16.0
        got = side * (drive(side * high, emf, heat, place, p) - rest)
        if got > most:
            most = got
            peak = high
        if got >= wanted:
            break
        low = high
    if wanted == 0.0:
        high = 0.0
    elif most < wanted:
        high = peak
    else:
        for _ in range(36):
            middle = 0.5 * (low + high)
            got = side * (drive(side * middle, emf, heat, place, p) - rest)
            if got >= wanted:
                high = middle
            else:
                low = middle
    return side * high


def invert(target, emf, heat, place, p, g):
    """The command for an effective command; through zero a straight line, so that noise does not jump a dead-band."""
    rest = drive(0.0, emf, heat, place, p)
    asked = target - rest
    if asked > g.blur or asked < -g.blur:
        command = answer(target, emf, heat, place, g.limit, p)
    else:
        upper = answer(rest + g.blur, emf, heat, place, g.limit, p)
        lower = answer(rest - g.blur, emf, heat, place, g.limit, p)
        command = lower + (asked + g.blur) * (upper - lower) / (2.0 * g.blur)
    return command


def clip(value, bound):
    """The value, held within the bound either way."""
    return clipped(value, bound, bound)


def friction(place, speed, heading, through, share, time, p):
    """Dry friction to be overcome: the teeth transmit `through` without it, and carry `share` of it; `heading` lies in
    [-1, 1].
    """
    side = 1.0
    if heading < 0.0:
        side = -1.0
    held = 0.0
    # Friction may depend on the torque that it is part of; the map contracts.
    for _ in range(12):
        held = heading * dry_friction(place, speed, side, through + share * held, time, p)
    return held


def approach(error, available, g):
    """Speed at which to close an error: in proportion while small, as braking allows when large."""
    slope = g.position_gain / g.velocity_gain
    size = error
    if error < 0.0:
        size = -error
    edge = available / (slope * slope)
    if size <= edge:
        speed = slope * size
    else:
        speed = sqrt(2.0 * available * (size - 0.5 * edge))
    if error < 0.0:
        speed = -speed
    return speed


def carry(x, p, k, q, index, g):
    """Move a state over one period in which the command under way at `index` takes over after the delay's part."""
    count = int(g.pieces)
    rest = g.sample_time - g.part
    if g.part > 0.0:
        for _ in range(count):
            step(x, p, k, q[index + 1], g.part / g.pieces)
    for _ in range(count):
        step(x, p, k, q[index], rest / g.pieces)
    return 0.0


def turning(place, y, p):
    """Torque on the motor beside the drive's, over inertia, with the link at a place."""
    torque = 0.0
    if has.backlash:
        if has.shaft:
            torque = p.shaft_share * shaft(place + y.gap, p)
    return torque


def pulling(place, speed, y, k, p):
    """Torque on the link at a place and speed, over inertia."""
    torque = load(place, speed, y.time, k.moment, p)
    if has.shaft:
        part = 1.0
        if has.backlash:
            part = 1.0 - p.shaft_share
        torque = torque + part * shaft(place, p)
    return torque


def innovation(x, m, p, g, measured, s):
    """What was read less what the observer expected; it begins at the first reading."""
    reading = measured
    if g.resolution > 0.0:
        reading = g.resolution * floor(measured / g.resolution + 0.5)
    if m.started == 0.0:
        m.started = 1.0
        m.nominal = p.offset
        m.acceleration = s.acceleration
        x.position = reading - sensor(reading, x.gap, p)
    s.error = reading - x.position - sensor(x.position, x.gap, p)


def crossings(x, m, p, reference, s):
    """How often the teeth have changed their flank since the reference last did, and whether they are apart."""
    s.apart = 0
    if has.backlash:
        if x.velocity != x.motor_velocity and x.gap < 0.5 * p.backlash_gap and x.gap > -0.5 * p.backlash_gap:
            s.apart = 1
    if reference != m.goal:
        m.goal = reference
        m.crossings = 0.0
        m.holding = 0.0
    if has.backlash:
        touched = m.flank
        if x.gap >= 0.5 * p.backlash_gap:
            touched = 1.0
        elif x.gap <= -0.5 * p.backlash_gap:
            touched = -1.0
        if touched != m.flank:
            m.flank = touched
            m.crossings = m.crossings + 1.0


def observer(x, m, p, g, s):
    """Correct the state and the torque that is not modelled."""
    if has.motor_sensor:
        # Nobody sees the link while it flies through the gap.
        if s.apart == 0:
            x.position = x.position + g.observer_position * s.error
            x.velocity = x.velocity + g.observer_velocity * s.error
    else:
        x.position = x.position + g.observer_position * s.error
        x.velocity = x.velocity + g.observer_velocity * s.error
    if has.motor_sensor:
        x.motor_velocity = x.motor_velocity + g.observer_velocity * s.error
        if s.apart != 0:
            x.gap = clip(x.gap + g.observer_position * s.error, 0.5 * p.backlash_gap)
    elif s.apart == 0:
        x.motor_velocity = x.motor_velocity + g.observer_velocity * s.error
    else:
        x.gap = clip(x.gap - g.observer_position * s.error, 0.5 * p.backlash_gap)
    if m.holding == 0.0 or m.crossings >= 6.0:
        m.disturbance = m.disturbance + g.observer_disturbance * s.error
    p.offset = m.nominal + m.disturbance


def prediction(x, y, q, p, g, k):
    """Move the state to the next sample, and a copy of it on to the moment at which the new command acts."""
    whole = int(g.whole)
    carry(x, p, k, q, whole, g)
    for i in range(len(x)):
        y[i] = x[i]
    for j in range(whole):
        carry(y, p, k, q, whole - 1 - j, g)
    if g.part > 0.0:
        for _ in range(int(g.pieces)):
            step(y, p, k, q[0], g.part / g.pieces)
    return 0.0


def reference_ahead(m, g, reference, speed, s):
    """The reference at that moment: goal, pace, rise and jerk are its position, speed, acceleration and jerk."""
    ahead = g.sample_time * (1.0 + g.whole) + g.part
    # The lesser of two jerks in a row: a jump of the acceleration is none that goes on.
    fresh = (s.acceleration - m.acceleration) / g.sample_time
    s.jerk = 0.0
    if fresh * m.jerk > 0.0:
        s.jerk = m.jerk
        if fresh * fresh < s.jerk * s.jerk:
            s.jerk = fresh
    m.acceleration = s.acceleration
    m.jerk = fresh
    s.goal = reference + ahead * (speed + ahead * (0.5 * s.acceleration + ahead * s.jerk / 6.0))
    s.pace = speed + ahead * (s.acceleration + 0.5 * ahead * s.jerk)
    s.rise = s.acceleration + ahead * s.jerk


def plant_ahead(y, p, k, s):
    """Inertia and torques at that moment."""
    s.total = 1.0 + mass(y.position, y.time, k.payload, p)
    s.turn = turning(y.position, y, p)
    s.pull = s.turn + pulling(y.position, y.velocity, y, k, p)
    s.resist = drag(y.position, y.velocity, p)
    s.emf = back_emf(y.motor_velocity, p)


def wished_acceleration(y, p, g, s):
    """The acceleration that brings the link to the reference, no faster than it can brake."""
    s.away = s.goal - y.position
    s.side = 1.0
    if s.away < 0.0:
        s.side = -1.0
    s.held = dry_friction(y.position, 0.0, s.side, 0.0, y.time, p)
    most = -s.side * p.input_gain * drive(-s.side * g.limit, 0.0, y.heat, y.position + y.gap, p)
    spare = g.braking * (most - s.side * s.pull + s.held) / s.total + s.side * s.rise
    least = 0.05 * most / s.total
    if spare < least:
        spare = least
    s.closing = approach(s.away, spare, g)
    s.wish = s.rise + g.velocity_gain * (s.closing + s.pace - y.velocity)


def hold(y, m, g, speed, s):
    """Leave a loop alone that has come to rest near its goal and would hunt across the gap."""
    # Where neither load nor friction holds the flank, a loop that has come to rest near its goal had better leave it.
    quiet = 0.0
    if clip(s.pull, g.hunting - s.held) == s.pull and clip(y.velocity, g.rest_speed) == y.velocity:
        if speed == 0.0 and s.acceleration == 0.0:
            quiet = 1.0
    # Three swings across the gap at rest are hunting, whatever should have held it.
    if m.crossings >= 6.0:
        quiet = 1.0
    if s.side * s.away > 2.0 * g.tolerance:
        m.holding = 0.0
    elif s.side * s.away < g.tolerance and quiet > 0.0:
        m.holding = 1.0
    if m.holding > 0.0:
        s.closing = 0.0
        # The load is held up; what hunts is gently braked: without the pull to the goal little keeps it swinging.
        s.wish = s.resist / s.total
        if m.crossings >= 6.0:
            s.wish = s.wish - g.calming * y.velocity


def needed_torque(y, p, g, s):
    """The torque that gives the wished acceleration, friction overcome."""
    heading = clip(2.0 * y.velocity / g.rest_speed, 2.0) + clip((s.pace + s.closing) / g.rest_speed, 1.0)
    heading = clip(heading, 1.0)
    # The teeth move the link, and carry what holds it.
    mass_l = s.total - 0.5
    share = 0.5
    dry = 0.5
    if has.backlash:
        mass_l = s.total - p.motor_share
        share = 1.0 - p.friction_share
        dry = 1.0 - p.dry_share
    through = mass_l * s.wish - share * s.resist - (s.pull - s.turn)
    s.stiction = friction(y.position, y.velocity, heading, through, dry, y.time, p)
    s.torque = s.total * s.wish - s.pull - s.resist + s.stiction


def led_torque(y, p, k, g, s):
    """The torque that brings the acceleration to the wished one through a lag, in time."""
    # The acceleration that the lag's state gives now, and what it would take to change it in time.
    acting = behind_lag(y.lag, p)
    current = (p.input_gain * acting + s.pull + s.resist - s.stiction) / s.total
    jump = s.wish + g.acceleration_gain * (s.rise - current) - current + p.lag_time * s.jerk
    moved = 0.25 * g.sample_time
    place = y.position + moved * y.velocity
    reached = y.velocity + moved * current
    later = turning(place, y, p) + pulling(place, reached, y, k, p) + drag(place, reached, p)
    s.torque = p.input_gain * acting + s.total * jump - p.lag_time * (later - s.pull - s.resist) / moved


def sample(x, y, m, q, p, g, k, reference, speed, acceleration, measured):
    """One sample: correct, predict, decide. Returns the command to be applied from the next sample on."""
    innovation(x, m, p, g, measured, s)
    crossings(x, m, p, reference, s)
    observer(x, m, p, g, s)
    prediction(x, y, q, p, g, k)
    reference_ahead(m, g, reference, speed, s)
    plant_ahead(y, p, k, s)
    wished_acceleration(y, p, g, s)
    hold(y, m, g, speed, s)
    needed_torque(y, p, g, s)
    if has.motor_lag:
        led_torque(y, p, k, g, s)
    command = clip(invert(torque / p.input_gain, emf, y.heat, y.position + y.gap, p, g), g.limit)

    for j in range(len(q) - 1):
        q[len(q) - 1 - j] = q[len(q) - 2 - j]
    q[0] = command
    return command


def follow(time, place, pace, rise, z, plant, kp, longest, x, y, m, q, p, g, k, position, command):
    """The closed loop over a reference: plant state `z` under parameters `plant`, controller beside it.

    `on.effect` and `late.name` are switches and parameters of the plant, which may differ from the controller's.
    Returns 1 where the plant ran away.
    """
    period = g[0]
    delay = 0.0
    if on.input_delay:
        delay = late.delay
    whole = int(delay / period + 1e-9)
    part = delay - whole * period
    if part < 0.0:
        part = 0.0
    ahead = 0.0
    for i in range(len(time)):
        position[i] = z[0]
        command[i] = ahead
        measured = z[0] + sensor(z[0], z[2], plant)
        ahead = sample(x, y, m, q, p, g, k, place[i], pace[i], rise[i], measured)
        for half in range(2):
            span = part
            back = i - whole - 1
            if half == 1:
                span = period - part
                back = i - whole
            acting = 0.0
            if back >= 0:
                acting = command[back]
            if span > 0.0:
                pieces = int(span / longest + 0.999999)
                for _ in range(pieces):
                    step(z, plant, kp, acting, span / pieces)
        if z[0] - z[0] != 0.0:
            return 1.0
    return 0.0


#: The functions and the sections of `sample`.
FUNCTIONS = (
    answer, invert, clip, friction, approach, carry, turning, pulling, prediction, innovation, crossings, observer,
    reference_ahead, plant_ahead, wished_acceleration, hold, needed_torque, led_torque, sample,
)  # fmt: skip


class _Name(ast.NodeTransformer):
    """m.name, g.name and y.name -> numbered places; the rest is left to the axis writer."""

    tables: ClassVar = {"m": MEMORY, "g": tuple(SETTINGS), "y": tuple(STATES)}

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        holder = node.value.id if isinstance(node.value, ast.Name) else ""
        if holder not in self.tables:
            return node
        return ast.Subscript(node.value, ast.Constant(self.tables[holder].index(node.attr)), node.ctx)


def sampled_text() -> str:
    text = "\n".join(textwrap.dedent(inspect.getsource(f)) for f in FUNCTIONS)
    return ast.unparse(ast.fix_missing_locations(_Name().visit(ast.parse(text))))


def module(structure: Structure, numbers: Numbering | None = None) -> ast.Module:
    """Laws, stepper and controller of a structure as one syntax tree."""
    numbers = numbers or numbering(structure, False)
    return ast.Module([*axis_module(structure, numbers=numbers).body, *resolve(sampled_text(), numbers).body], [])


def write(structure: Structure) -> str:
    """Plain Python text, standard library only: `sample(...)`, `step(...)` and the laws."""
    return "from math import cos, exp, floor, sin, sqrt, tanh\n\n\n" + ast.unparse(module(structure)) + "\n"


@cache
def functions(structure: Structure) -> SimpleNamespace:
    """The text of a structure that has constant_offset, as Python functions: `sample`, `step`, `drive`, `load`, ..."""
    names = {}
    exec(compile(write(structure), "<controller>", "exec"), names)
    return SimpleNamespace(**{name: f for name, f in names.items() if callable(f)})


class _Length(ast.NodeTransformer):
    """len(name) -> its number, for a tongue whose arrays do not know theirs."""

    def __init__(self, lengths: Mapping[str, int]) -> None:
        self.lengths = lengths

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id == "len":
            return ast.Constant(self.lengths[node.args[0].id])
        return node


def write_c(structure: Structure, queue: int) -> str:
    """C99 text, needs only math.h and stddef.h: `sample(...)`, for a queue of this many commands."""
    tree = _Length({"x": len(STATES), "q": queue}).visit(module(structure))
    return "#include <math.h>\n#include <stddef.h>\n\n" + c.functions(tree, "sample")


def write_switched(offered: Structure) -> str:
    """The same with each effect on offer behind a switch, for one compiled kernel."""
    tree = module(EVERYTHING, numbering(EVERYTHING, True).offering((), offered.ids))
    return "from math import cos, exp, floor, sin, sqrt, tanh\n\n\n" + ast.unparse(tree) + "\n"
