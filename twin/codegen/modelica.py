"""The axis as a Modelica package: the same laws as equations, with units and documentation from the pages.

Modelica cannot state two things as the stepper does, and the text says so at their place. Dry friction, which holds
exactly in the stepper, is a bristle here that gives by one microradian (Canudas de Wit et al., A new model for control
of systems with friction, IEEE TAC 40, 1995). Rigid contact across the backlash is a stiff, well damped spring.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy
from sympy.printing.str import StrPrinter

from twin.codegen.python import laws_by_slot
from twin.effects.catalogue import pages
from twin.model.equations import expression, trace
from twin.model.fitted_model import Model
from twin.model.stations import (
    angular,
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
from twin.model.stepper import KNOWN
from twin.model.variables import known_read

#: Travel of a held body, axis unit, and the bristle's damping, s.
PRESLIDING = 1e-6
BRISTLE_TIME = 2e-4
#: Ring of rigid contact, Hz: far above what an axis does, low enough for any solver.
CONTACT_FREQUENCY = 300.0
_RESTING = "start = 0, fixed = true"


class _Printer(StrPrinter):  # type: ignore[misc]
    """Expressions in Modelica, with other names for some symbols."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__()
        self.given = given

    def _print_Symbol(self, expr: sympy.Symbol) -> str:
        name = str(expr.name)
        return self.given.get(name, name).removeprefix("p.")

    def _print_Pow(self, expr: sympy.Expr, rational: bool = False) -> str:
        base, exponent = expr.args
        if exponent == -1:
            return f"1/{self._atom(base)}"
        if exponent == sympy.Rational(1, 2):
            return f"sqrt({self._print(base)})"
        return f"{self._atom(base)}^{self._atom(exponent)}"

    def _atom(self, expr: sympy.Expr) -> str:
        plain = expr.is_Symbol or (expr.is_Number and expr.is_nonnegative)
        return str(self._print(expr)) if plain else f"({self._print(expr)})"

    def _print_Float(self, expr: sympy.Expr) -> str:
        return repr(float(expr))

    def _print_Rational(self, expr: sympy.Expr) -> str:
        return f"({expr.p}/{expr.q})"

    def _print_Abs(self, expr: sympy.Expr) -> str:
        return f"abs({self._print(expr.args[0])})"

    def _nested(self, name: str, arguments: tuple[sympy.Expr, ...]) -> str:
        first, *rest = (self._print(a) for a in arguments)
        for other in rest:
            first = f"{name}({first}, {other})"
        return str(first)

    def _print_Max(self, expr: sympy.Expr) -> str:
        return self._nested("max", expr.args)

    def _print_Min(self, expr: sympy.Expr) -> str:
        return self._nested("min", expr.args)

    def _without_event(self, value: sympy.Expr, test: sympy.Expr, other: sympy.Expr) -> str:
        """What turns at the zero of `other`, without an event there; "" for anything else."""
        if not isinstance(test, sympy.StrictLessThan | sympy.StrictGreaterThan) or (test.lhs, test.rhs) != (other, 0):
            return ""
        below = isinstance(test, sympy.StrictLessThan)
        if below and value == -other:
            return f"abs({self._print(other)})"
        return f"{'max' if below else 'min'}({self._print(other)}, 0)" if value.is_zero else ""

    def _print_Piecewise(self, expr: sympy.Expr) -> str:
        if len(expr.args) == 2:
            (value, test), (other, _) = expr.args
            if short := self._without_event(value, test, other):
                return short
        *cases, (last, _) = expr.args
        said = "".join(f"if {self._print(test)} then {self._print(value)} else " for value, test in cases)
        return f"({said}{self._print(last)})"


def _text(value: str) -> str:
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'


def _unit(unit: str) -> tuple[str, str]:
    """The attribute and a remark for the comment. Modelica's grammar of units has no percent."""
    if "%" in unit:
        return "", f" [{unit}]"
    above: list[str] = []
    below: list[str] = []
    for sign, name, power in re.findall(r"([*/]?)([^*/^]+)(?:\^(-?\d+))?", unit):
        (below if sign == "/" else above).append(name + power)
    top = ".".join(above)
    bottom = ".".join(below)
    if len(below) > 1:
        bottom = f"({bottom})"
    return f'unit = "{top}/{bottom}"' if below else f'unit = "{top}"', ""


def _declare(kind: str, name: str, unit: str, meaning: str, value: str = "", more: str = "") -> str:
    attribute, remark = _unit(unit)
    inside = ", ".join(a for a in (attribute, more) if a)
    equal = f" = {value}" if value else ""
    return f"    {kind} {name}{f'({inside})' if inside else ''}{equal} {_text(meaning + remark)};"


@dataclass
class _Axis:
    """The block that is being written: its model, declarations and equations."""

    model: Model
    declared: list[str] = field(default_factory=list)
    equations: list[str] = field(default_factory=list)

    def has(self, name: str) -> bool:
        """Whether the structure contains an effect, or any law in a slot."""
        return name in self.model.structure or name in self.model.structure.slots

    @property
    def two(self) -> bool:
        """Whether motor and link are two bodies."""
        return self.has("backlash")

    @property
    def speed(self) -> str:
        """The motor's speed."""
        return "motor_velocity" if self.two else "velocity"

    def add(self, name: str, unit: str, meaning: str, equals: str) -> None:
        """A variable and the equation that says what it equals."""
        self.declared.append(_declare("Real", name, unit, meaning))
        self.equations.append(f"{name} = {equals};")

    def state(self, name: str, unit: str, meaning: str, rate: str) -> None:
        """A variable that starts at rest, and its rate."""
        self.declared.append(_declare("Real", name, unit, meaning, more=_RESTING))
        self.equations.append(f"der({name}) = {rate};")

    def station(self, function: Callable[..., Any], *arguments: sympy.Expr | str | float) -> str:
        """A law between the stations: of names in the block, expressions, or numbers that decide which way it goes."""
        return _printed(self.formula(function, *arguments))

    def formula(self, function: Callable[..., Any], *arguments: sympy.Expr | str | float) -> sympy.Expr:
        given = [sympy.Symbol(a, real=True) if isinstance(a, str) else a for a in arguments]
        slots = {name: sympy.Symbol(name, real=True) for name in ("grip", "bristle", "rider")}
        slots["shaft"] = sympy.Symbol("shaft_motor" if function is on_motor else "shaft_link", real=True)
        return expression(function, self.model.structure, *given, slots=slots)

    def sum(self, slot: str, given: dict[str, str]) -> str:
        """The laws of a slot, with the names of the block in place of the slot's arguments."""
        if self.model.holds_moments:
            given = {"time": "(time + time_start)", **given}
        laws = [f"({_law(i, given)})" for i in laws_by_slot(self.model.structure)[slot]]
        return " + ".join(laws) or "0"


def _printed(formula: sympy.Expr, given: Mapping[str, str] | None = None) -> str:
    """A formula with the names of the block: parameters lose their prefix, others are as `given`."""
    return str(_Printer(given or {}).doprint(formula))


def _law(effect: str, given: dict[str, str]) -> str:
    """A law with the model's own names in place of the slot's arguments."""
    return _printed(trace(effect).expression, given)


#: Position and velocity of the link, as arguments of laws.
_LINK = {"position": "position", "velocity": "velocity"}


def _drive(axis: _Axis) -> None:
    """The chain from command to torque."""
    u, acting = axis.model.input_unit, axis.model.input_name
    if axis.has("input_delay"):
        axis.add("arriving", u, "command after the dead time", f"delay({acting}, delay_time)")
        acting = "arriving"
    if axis.has("supply_sag") or axis.has("thermal_fade"):
        axis.add("emf", u, "back-EMF, as command", axis.station(back_emf, axis.speed))
    arriving = acting
    for effect in laws_by_slot(axis.model.structure)["drive"]:
        if effect == "thermal_fade":
            settled = axis.formula(heating, acting, "emf")
            axis.state("heat", "1", "warming of the motor", axis.station(first_order, settled, "heat", "fade_time"))
        name = f"after_{effect}"
        axis.add(name, u, f"command after {effect.replace('_', ' ')}", _law(effect, {"command": acting}))
        acting = name
    if axis.has("motor_lag"):
        fed = axis.formula(before_lag, acting, arriving)
        axis.state("lag", u, "command behind the lag", axis.station(first_order, fed, "lag", "lag_time"))
        axis.add("behind_lag", u, "command that acts behind the lag", axis.station(behind_lag, "lag"))
        acting = "behind_lag"
    torque = f"{axis.model.axis_unit}/s^2"
    axis.add("torque", torque, "torque of the drive over inertia", f"input_gain*{acting}")


def _pushes(axis: _Axis) -> None:
    """Torques on motor and link over inertia, without what the gears transmit and without dry friction."""
    x = axis.model.axis_unit
    torque = f"{x}/s^2"
    axis.add("mass", "1", "inertia, in units of that of the axis", f"1 + {axis.sum('mass', _LINK)}")
    axis.add("load", torque, "loads on the link over inertia", axis.sum("load", _LINK))
    axis.add("resist_link", torque, "smooth resistance at the link's speed", axis.sum("drag", _LINK))
    moved = {**_LINK, "velocity": axis.speed}
    axis.add("resist_motor", torque, "smooth resistance at the motor's speed", axis.sum("drag", moved))
    if axis.has("shaft"):
        at_motor = {"position": "(position + gap)" if axis.two else "position"}
        axis.add("shaft_motor", torque, "torques on the shaft, at the motor's place", axis.sum("shaft", at_motor))
        axis.add("shaft_link", torque, "torques on the shaft, at the link's place", axis.sum("shaft", _LINK))
    if axis.has("bristle"):
        rate = axis.station(bend_rate, axis.speed, "bend", "presliding_travel")
        axis.state("bend", "1", "how far friction is bent before it slides", rate)
        axis.add("bristle", torque, "friction that is bent, on the motor", axis.sum("bristle", {}))
    if axis.has("rider"):
        axis.state("ride", x, "position of what rides on the link minus that of the link", "ride_velocity")
        axis.state("ride_velocity", f"{x}/s", "its velocity minus that of the link", "-der(velocity) - tug")
        spring, damper = "flexible_load_stiffness", "flexible_load_damping"
        drawn = axis.station(tugging, "ride", "ride_velocity", spring, damper)
        axis.add("tug", torque, "acceleration by which it is drawn back", drawn)
        axis.add("rider", torque, "what rides along, on the link", axis.sum("rider", {}))
    # Where nothing tells them apart all is link.
    shares = ("friction_share", "shaft_share") if axis.two else (0, 0)
    on_it = axis.station(on_motor, "torque", "resist_motor", "position", "bend", *shares)
    axis.add("push_motor", torque, "torques on the motor over inertia", on_it)
    on_it = axis.station(on_link, "load", "resist_link", "position", "tug", *shares)
    axis.add("push_link", torque, "torques on the link over inertia", on_it)


def _transmitted(axis: _Axis) -> str:
    """What the gears transmit, as dry friction feels it."""
    mass = sympy.Symbol("mass", real=True)
    if not axis.two:
        # Each body is half of the axis, as far as the teeth are concerned.
        push_m, push_l, resist = (sympy.Symbol(n, real=True) for n in ("push_motor", "push_link", "resist_link"))
        half = sympy.Rational(1, 2)
        through = axis.station(carried, push_m + half * resist, push_l - half * resist, half, mass - half, 1 / mass)
        return f"({through})"
    if axis.model.structure.elastic:
        return "contact"
    # Rigid teeth knock without friction: what holds them together counts, not the blow of the spring instead.
    share = sympy.Symbol("motor_share", real=True)
    bearing = axis.station(carried, "push_motor", "push_link", share, mass - share, 1 / mass)
    axis.add("bearing", f"{axis.model.axis_unit}/s^2", "torque that makes motor and link move as one", bearing)
    return (
        "(if backlash_gap <= 0 then bearing elseif gap > 0.5*backlash_gap then max(bearing, 0)"
        " elseif gap < -0.5*backlash_gap then min(bearing, 0) else 0)"
    )


def _dry_friction(axis: _Axis) -> None:
    """Size of the dry friction each way, and on each body a bristle that bends as the body moves by `presliding`."""
    x = axis.model.axis_unit
    transmitted = _transmitted(axis)
    axis.declared += [
        "    // Dry friction holds exactly in the identified model; here the body gives by `presliding` at most.",
        _declare("constant Real", "presliding", x, "travel until friction is full", repr(PRESLIDING)),
        _declare("constant Real", "bristle_time", "s", "damping of the bristle", repr(BRISTLE_TIME)),
    ]
    for name, direction, way in (("grip_forward", "1.0", "forwards"), ("grip_reverse", "-1.0", "backwards")):
        given = {**_LINK, "direction": direction, "transmitted": transmitted}
        size = axis.formula(dry_friction, "position", "velocity", float(direction), "transmitted", "time")
        text = _printed(size, {"grip": axis.sum("grip", given)})
        axis.add(name, f"{x}/s^2", f"size of the dry friction {way}", text)
    bodies = (("motor", "motor_velocity", "dry_share*"), ("link", "velocity", "(1 - dry_share)*"))
    for body, speed, share in bodies if axis.two else (("link", "velocity", ""),):
        bend = f"bend_{body}"
        rate = axis.station(bend_rate, speed, bend, "presliding")
        axis.state(bend, "1", f"share of its dry friction that holds the {body}", rate)
        held = f"(if {bend} >= 0 then grip_forward else grip_reverse)*({bend} + bristle_time*der({bend}))"
        axis.add(f"friction_{body}", f"{x}/s^2", f"dry friction on the {body} over inertia", f"{share}{held}")


def _transmission(axis: _Axis) -> None:
    """The torque between the two bodies, across the gap."""
    x = axis.model.axis_unit
    rate, ratio = axis.formula(ringing_rate), axis.formula(ringing_ratio)
    if not axis.model.structure.elastic:
        axis.declared += [
            "    // Contact is rigid in the identified model; here it is a stiff spring without rebound.",
            _declare("parameter Real", "contact_frequency", "Hz", "ring of the contact", repr(CONTACT_FREQUENCY)),
            _declare("parameter Real", "contact_damping", "1", "damping ratio, too high to rebound", "3.0"),
        ]
        rate = axis.formula(angular, "contact_frequency")
        ratio = sympy.Symbol("contact_damping", real=True)
    axis.declared += [
        f"    final parameter Real contact_stiffness = {axis.station(mesh_stiffness, rate, 'motor_share')};",
        f"    final parameter Real contact_resistance = {axis.station(mesh_damping, ratio, rate, 'motor_share')};",
        _declare("Real", "motor_velocity", f"{x}/s", "velocity of the motor, seen at the link",
                 more="start = velocity_start, fixed = true"),
    ]  # fmt: skip
    axis.state("gap", x, "motor position minus link position", "motor_velocity - velocity")
    half = sympy.Symbol("backlash_gap", real=True) / 2
    speed = sympy.Symbol("motor_velocity", real=True) - sympy.Symbol("velocity", real=True)
    both, upper, lower = (
        axis.station(tension, "gap", speed, side, half, "contact_stiffness", "contact_resistance")
        for side in (2, 1, -1)
    )
    torque = (
        f"if backlash_gap <= 0 then {both} elseif gap > 0.5*backlash_gap then {upper}"
        f" elseif gap < -0.5*backlash_gap then {lower} else 0"
    )
    axis.add("contact", f"{x}/s^2", "torque from motor to link over inertia", torque)


def _motion(axis: _Axis) -> None:
    """What is left of the torques moves the bodies."""
    motor, link = (f" - friction_{body}" if axis.has("grip") else "" for body in ("motor", "link"))
    if axis.two:
        axis.equations += [
            f"motor_share*der(motor_velocity) = push_motor - contact{motor};",
            f"(mass - motor_share)*der(velocity) = push_link + contact{link};",
        ]
    else:
        axis.equations.append(f"mass*der(velocity) = push_motor + push_link{link};")
    reading = f"position_measured = position + {axis.sum('sensor', _LINK)};"
    axis.equations += ["der(position) = velocity;", reading]


def _ports(model: Model) -> list[str]:
    """Input and outputs."""
    x = model.axis_unit
    return [
        _declare("input Real", model.input_name, model.input_unit, "command"),
        _declare("output Real", "position", x, "position of the link", more="start = position_start, fixed = true"),
        _declare("output Real", "velocity", f"{x}/s", "velocity of the link",
                 more="start = velocity_start, fixed = true"),
        _declare("output Real", "position_measured", x, "what the position sensor reads, not quantised"),
    ]  # fmt: skip


def _parameters(model: Model) -> list[str]:
    lines = []
    for p in model.structure.parameters:
        name = "delay_time" if p.name == "delay" else p.name
        bounds = [f"{k} = {float(v)!r}" for k, v in (("min", p.lower), ("max", p.upper)) if abs(v) < float("inf")]
        value = repr(float(model.values[p.name]))
        lines.append(_declare("parameter Real", name, model.unit(p.name), p.meaning, value, ", ".join(bounds)))
    for name in known_read(model):
        unit, meaning = KNOWN[name]
        lines.append(_declare("parameter Real", name, unit, meaning, repr(float(model.known.get(name, 0.0)))))
    x = model.axis_unit
    lines.append(_declare("parameter Real", "position_start", x, "position of the link at the start", "0.0"))
    speed = "velocity of motor and link at the start"
    lines.append(_declare("parameter Real", "velocity_start", f"{x}/s", speed, "0.0"))
    if model.holds_moments:
        origin = "time of the recording at the start: at its end what happened in it is over"
        lines.append(_declare("parameter Real", "time_start", "s", origin, repr(model.time_start)))
    return lines


def _documentation(model: Model) -> str:
    """HTML from the pages of the effects: what each is, its law as it stands in the equations, its source."""
    parts = ["<p>A motor-driven axis. Accelerations and inertias are relative to the inertia of the axis.</p>", "<ul>"]
    for e in model.structure.effects:
        acting = [p for page in pages(e.id) for p in model.structure.acting(page)]
        values = {p.name: f"{model.values[p.name]:.4g} {model.unit(p.name)}".removesuffix(" 1") for p in acting}
        said = html.escape(e.sentence.format(**values))
        law = f"<br><code>{html.escape(_law(e.id, {}))}</code>" if e.law is not None else ""
        parts.append(f"<li><b>{html.escape(e.title)}</b>: {said}{law}<br><i>{html.escape(e.reference)}</i></li>")
    return "".join([*parts, "</ul>"])


def write(model: Model) -> str:
    """A package `Twin` with the block `Axis`: input, outputs and parameters named as in the FMU.

    The parameter `delay` is called `delay_time`, for `delay` is a word of the language.
    """
    axis = _Axis(model)
    _drive(axis)
    _pushes(axis)
    if axis.two:
        _transmission(axis)
    if axis.has("grip"):
        _dry_friction(axis)
    _motion(axis)
    return "\n".join(
        [
            'package Twin "Identified axes"',
            f"  block Axis {_text('motor-driven axis with ' + '; '.join(e.title for e in model.structure.effects))}",
            *_parameters(model),
            *_ports(model),
            "  protected",
            *axis.declared,
            "  equation",
            *(f"    {line}" for line in axis.equations),
            f"    annotation(Documentation(info = {_text('<html>' + _documentation(model) + '</html>')}));",
            "  end Axis;",
            "end Twin;",
            "",
        ]
    )
