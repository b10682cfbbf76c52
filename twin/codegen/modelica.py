"""The axis as a Modelica package: the same laws as equations, with units and documentation from the pages.

Modelica cannot state two things as the stepper does, and the text says so at their place. Dry friction, which holds
exactly in the stepper, is a bristle here that gives by one microradian (Canudas de Wit et al., A new model for control
of systems with friction, IEEE TAC 40, 1995). Rigid contact across the backlash is a stiff, well damped spring.
"""

from __future__ import annotations

import html
import re

import sympy
from sympy.printing.str import StrPrinter

from twin.codegen.python import laws_by_slot
from twin.effects.catalogue import pages
from twin.model.equations import trace
from twin.model.fitted_model import Model
from twin.model.stepper import KNOWN
from twin.model.variables import known_read

#: Travel of a held body, axis unit, and the bristle's damping, s.
PRESLIDING = 1e-6
BRISTLE_TIME = 2e-4
#: Ring of rigid contact, Hz: far above what an axis does, low enough for any solver.
CONTACT_FREQUENCY = 300.0
_RESTING = "start = 0, fixed = true"


class _Printer(StrPrinter):  # type: ignore[misc]
    """Expressions in Modelica."""

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

    def _print_Piecewise(self, expr: sympy.Expr) -> str:
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


def _law(effect: str, given: dict[str, str]) -> str:
    """A law with the model's own names in place of the slot's arguments."""
    expression = trace(effect).expression
    names = {s: sympy.Symbol(given.get(s.name, s.name).removeprefix("p.")) for s in expression.free_symbols}
    return str(_Printer().doprint(expression.xreplace(names)))


def _sum(model: Model, slot: str, given: dict[str, str]) -> str:
    if model.holds_moments:
        given = {"time": "(time + time_start)", **given}
    laws = [f"({_law(i, given)})" for i in laws_by_slot(model.structure)[slot]]
    return " + ".join(laws) or "0"


def _drive(model: Model, x: str, u: str) -> tuple[list[str], list[str], str]:
    """The chain from command to torque: declarations, equations and the name of what acts."""
    declared, equations, has = [], [], model.structure.__contains__
    acting = model.input_name
    if has("input_delay"):
        declared.append(_declare("Real", "arriving", u, "command after the dead time"))
        equations.append(f"arriving = delay({acting}, delay_time);")
        acting = "arriving"
    if has("supply_sag") or has("thermal_fade"):
        speed = "motor_velocity" if has("backlash") else "velocity"
        declared.append(_declare("Real", "emf", u, "back-EMF, as command"))
        equations.append(f"emf = viscous_friction*{speed}/input_gain;")
    arriving = acting
    for effect in laws_by_slot(model.structure)["drive"]:
        if effect == "thermal_fade":
            declared.append(_declare("Real", "heat", "1", "warming of the motor", more=_RESTING))
            equations.append(f"der(heat) = ((({acting} - fade_emf*emf)/fade_reference)^2 - heat)/fade_time;")
        name = f"after_{effect}"
        declared.append(_declare("Real", name, u, f"command after {effect.replace('_', ' ')}"))
        equations.append(f"{name} = {_law(effect, {'command': acting})};")
        acting = name
    if has("motor_lag"):
        declared.append(_declare("Real", "lag", u, "command behind the lag", more=_RESTING))
        kept, passed = "", "lag"
        if has("dead_band"):
            kept = f" + lag_dead_band*min(max({arriving}, -dead_band_reverse), dead_band_forward)"
            passed = "max(lag - lag_dead_band*dead_band_forward, 0) + min(lag + lag_dead_band*dead_band_reverse, 0)"
        equations.append(f"der(lag) = ({acting}{kept} - lag)/lag_time;")
        declared.append(_declare("Real", "behind_lag", u, "command that acts behind the lag"))
        equations.append(f"behind_lag = {passed};")
        acting = "behind_lag"
    declared.append(_declare("Real", "torque", f"{x}/s^2", "torque of the drive over inertia"))
    equations.append(f"torque = input_gain*{acting};")
    return declared, equations, acting


def _friction(body: str, speed: str, share: str, x: str) -> tuple[list[str], list[str]]:
    """Dry friction on one body: a bristle that bends between -1 and 1 as the body moves by `presliding`."""
    bend, f = f"bend_{body}", f"friction_{body}"
    declared = [
        _declare("Real", bend, "1", f"share of its dry friction that holds the {body}", "", _RESTING),
        _declare("Real", f, f"{x}/s^2", f"dry friction on the {body} over inertia"),
    ]
    equations = [
        f"presliding*der({bend}) = {speed} - abs({speed})*{bend};",
        f"{f} = {share}*(if {bend} >= 0 then grip_forward else grip_reverse)*({bend} + bristle_time*der({bend}));",
    ]
    return declared, equations


def _transmission(model: Model, x: str) -> tuple[list[str], list[str]]:
    """Two bodies and the torque between them across the gap."""
    structure = model.structure
    declared = [
        _declare("Real", "gap", x, "motor position minus link position", more=_RESTING),
        _declare("Real", "motor_velocity", f"{x}/s", "velocity of the motor, seen at the link",
                 more="start = velocity_start, fixed = true"),
        _declare("Real", "contact", f"{x}/s^2", "torque from motor to link over inertia"),
        _declare("Real", "press", f"{x}/s^2", "what the flanks would transmit if they could pull"),
    ]  # fmt: skip
    if structure.elastic:
        kind = "joint" if "joint_elasticity" in structure else "tooth"
        frequency, damping = f"{kind}_frequency", f"{kind}_damping"
    else:
        frequency, damping = "contact_frequency", "contact_damping"
        declared += [
            "    // Contact is rigid in the identified model; here it is a stiff spring without rebound.",
            _declare("parameter Real", frequency, "Hz", "ring of the contact", repr(CONTACT_FREQUENCY)),
            _declare("parameter Real", damping, "1", "damping ratio, too high to rebound", "3.0"),
        ]
    share = "motor_share*(1 - motor_share)"
    declared += [
        f"    final parameter Real contact_stiffness = (2*3.141592653589793*{frequency})^2*{share};",
        f"    final parameter Real contact_resistance = 4*3.141592653589793*{damping}*{frequency}*{share};",
    ]
    equations = [
        "der(gap) = motor_velocity - velocity;",
        "press = contact_stiffness*(gap - (if gap > 0 then 0.5 else -0.5)*backlash_gap)"
        " + contact_resistance*(motor_velocity - velocity);",
        "contact = if backlash_gap <= 0 then contact_stiffness*gap"
        " + contact_resistance*(motor_velocity - velocity)"
        " elseif gap > 0.5*backlash_gap then max(press, 0)"
        " elseif gap < -0.5*backlash_gap then min(press, 0) else 0;",
    ]
    return declared, equations


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
    structure, x, u = model.structure, model.axis_unit, model.input_unit
    slots = laws_by_slot(structure)
    two = "backlash" in structure
    declared, equations, _ = _drive(model, x, u)
    link = {"position": "position", "velocity": "velocity"}
    declared.append(_declare("Real", "load", f"{x}/s^2", "torques on the link over inertia"))
    on_link, driving = _sum(model, "load", link), "torque"
    if slots["shaft"]:
        on_link += f" + {'(1 - shaft_share)*' if two else ''}({_sum(model, 'shaft', link)})"
        if two:
            driving = "driving"
            on_motor = _sum(model, "shaft", {"position": "(position + gap)"})
            declared.append(_declare("Real", driving, f"{x}/s^2", "torques on the motor over inertia"))
            equations.append(f"{driving} = torque + shaft_share*({on_motor});")
    if slots["bristle"]:
        speed = "motor_velocity" if two else "velocity"
        declared.append(_declare("Real", "bend", "1", "how far friction is bent before it slides", more=_RESTING))
        declared.append(_declare("Real", "pushing", f"{x}/s^2", "torques on the motor over inertia, that friction too"))
        equations.append(f"presliding_travel*der(bend) = {speed} - abs({speed})*bend;")
        equations.append(f"pushing = {driving} + {_sum(model, 'bristle', {})};")
        driving = "pushing"
    if slots["rider"]:
        declared += [
            _declare("Real", "ride", x, "position of what rides on the link minus that of the link", more=_RESTING),
            _declare("Real", "ride_velocity", f"{x}/s", "its velocity minus that of the link", more=_RESTING),
            _declare("Real", "tug", f"{x}/s^2", "acceleration by which it is drawn back"),
        ]
        equations += [
            "tug = flexible_load_stiffness*ride + flexible_load_damping*ride_velocity;",
            "der(ride) = ride_velocity;",
            "der(ride_velocity) = -der(velocity) - tug;",
        ]
        on_link += f" + {_sum(model, 'rider', {})}"
    equations.append(f"load = {on_link};")
    declared.append(_declare("Real", "mass", "1", "inertia, in units of that of the axis"))
    equations.append(f"mass = 1 + {_sum(model, 'mass', link)};")
    drag_link = _sum(model, "drag", link)
    drag_motor = _sum(model, "drag", {"position": "position", "velocity": "motor_velocity"}) if two else drag_link
    # Where nothing tells motor and link apart each is half of the axis.
    inertia, part = ("motor_share", "friction_share") if two else ("0.5", "0.5")
    bearing = (
        f"(({driving} + {part}*({drag_motor}))*(mass - {inertia}) - (load + (1 - {part})*({drag_link}))*{inertia})/mass"
    )
    if not two:
        transmitted = f"({bearing})"
    elif structure.elastic:
        transmitted = "contact"
    else:
        # Rigid teeth knock without friction: what holds them together counts, not the blow of the spring instead.
        declared.append(_declare("Real", "bearing", f"{x}/s^2", "torque that makes motor and link move as one"))
        equations.append(f"bearing = {bearing};")
        transmitted = (
            "(if backlash_gap <= 0 then bearing elseif gap > 0.5*backlash_gap then max(bearing, 0)"
            " elseif gap < -0.5*backlash_gap then min(bearing, 0) else 0)"
        )
    if slots["grip"]:
        declared += [
            "    // Dry friction holds exactly in the identified model; here the body gives by `presliding` at most.",
            _declare("constant Real", "presliding", x, "travel until friction is full", repr(PRESLIDING)),
            _declare("constant Real", "bristle_time", "s", "damping of the bristle", repr(BRISTLE_TIME)),
        ]
        for name, direction in (("grip_forward", "1.0"), ("grip_reverse", "-1.0")):
            way = "forwards" if direction == "1.0" else "backwards"
            declared.append(_declare("Real", name, f"{x}/s^2", f"size of the dry friction {way}"))
            given = {**link, "direction": direction, "transmitted": transmitted}
            equations.append(f"{name} = max({_sum(model, 'grip', given)}, 0);")
    bodies = (("motor", "motor_velocity", "dry_share"), ("link", "velocity", "(1 - dry_share)"))
    for body, speed, share in bodies if two else (("link", "velocity", "1"),):
        if slots["grip"]:
            more, held = _friction(body, speed, share, x)
            declared += more
            equations += held
    gripped = {body: f" - friction_{body}" if slots["grip"] else "" for body in ("motor", "link")}
    if two:
        more, joined = _transmission(model, x)
        declared += more
        equations += joined
        equations += [
            f"motor_share*der(motor_velocity) = {driving} - contact + friction_share*({drag_motor}){gripped['motor']};",
            "(mass - motor_share)*der(velocity) = load + contact"
            f" + (1 - friction_share)*({drag_link}){gripped['link']};",
        ]
    else:
        equations.append(f"mass*der(velocity) = {driving} + load + {drag_link}{gripped['link']};")
    equations += ["der(position) = velocity;", f"position_measured = position + {_sum(model, 'sensor', link)};"]
    ports = [
        _declare("input Real", model.input_name, u, "command"),
        _declare("output Real", "position", x, "position of the link", more="start = position_start, fixed = true"),
        _declare("output Real", "velocity", f"{x}/s", "velocity of the link",
                 more="start = velocity_start, fixed = true"),
        _declare("output Real", "position_measured", x, "what the position sensor reads, not quantised"),
    ]  # fmt: skip
    return "\n".join(
        [
            'package Twin "Identified axes"',
            f"  block Axis {_text('motor-driven axis with ' + '; '.join(e.title for e in structure.effects))}",
            *_parameters(model),
            *ports,
            "  protected" if declared else "",
            *declared,
            "  equation",
            *(f"    {line}" for line in equations),
            f"    annotation(Documentation(info = {_text('<html>' + _documentation(model) + '</html>')}));",
            "  end Axis;",
            "end Twin;",
            "",
        ]
    )
