"""The laws as LaTeX, from the same trace that the kernel and the FMU run.

Torques are over the inertia of the axis, so every term is an acceleration. `[condition]` is 1 where the condition
holds and 0 elsewhere (Iverson's bracket). All of it is within what LaTeX's mathematics and matplotlib's both know.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import sympy
from sympy.printing.latex import LatexPrinter

from twin.effects.catalogue import EFFECTS
from twin.model.equations import argument, reads, trace
from twin.model.stepper import Structure

#: How a condition that stands for 1 or 0 begins.
BRACKET = r"\left["

#: Symbols of parameters; `@` stands for the axis' coordinate. A parameter without one is written by its name.
SYMBOLS: dict[str, str] = {
    "input_gain": "c",
    "viscous_friction": "b",
    "dead_band_forward": r"\delta_{f}",
    "dead_band_reverse": r"\delta_{r}",
    "backlash_gap": "g",
    "motor_share": "J_{m}",
    "friction_share": r"\beta_{m}",
    "dry_share": r"\phi_{m}",
    "shaft_share": r"\rho_{m}",
    "tooth_frequency": "f_{t}",
    "tooth_damping": r"\zeta_{t}",
    "joint_frequency": "f_{j}",
    "joint_damping": r"\zeta_{j}",
    "own_inertia": "J_{0}",
    "payload_angle": r"\varphi_{p}",
    "coulomb_friction": "f_{c}",
    "stribeck_friction": "f_{s}",
    "stribeck_velocity": "v_{s}",
    "friction_asymmetry": "f_{a}",
    "run_in_friction": "f_{i}",
    "run_in_time": "T_{i}",
    "sector_friction": "f_{w}",
    "sector_angle": "@_{w}",
    "sector_width": "w_{w}",
    "sector_order": "n_{w}",
    "friction_variation": r"f_{\varphi}",
    "friction_angle": r"\varphi_{f}",
    "load_friction": r"\mu",
    "offset": r"\tau_{0}",
    "viscous_asymmetry": "b_{a}",
    "quadratic_drag": "b_{2}",
    "gravity_gain": "a_{g}",
    "gravity_angle": r"\varphi_{g}",
    "spring_stiffness": "k_{s}",
    "spring_rest": "@_{s}",
    "ripple_torque": "a_{r}",
    "ripple_order": "n_{r}",
    "ripple_phase": r"\varphi_{r}",
    "detent_torque": "a_{n}",
    "detent_angle": "@_{n}",
    "detent_width": "w_{n}",
    "detent_order": "n_{n}",
    "stop_stiffness": "k_{e}",
    "stop_damping": "d_{e}",
    "stop_hysteresis": "h_{e}",
    "stop_upper": "@_{+}",
    "stop_lower": "@_{-}",
    "lag_time": "T_{e}",
    "lag_dead_band": r"\lambda_{e}",
    "delay": "t_{d}",
    "load_added": r"\Delta J",
    "load_time": "t_{J}",
    "eccentricity": "e",
    "eccentricity_angle": r"\varphi_{e}",
    "disturbance": "a_{d}",
    "disturbance_frequency": "f_{d}",
    "disturbance_phase": r"\varphi_{d}",
    "pulse_torque": "a_{p}",
    "pulse_start": "t_{p}",
    "pulse_length": "T_{p}",
    "pulse_edge": r"\varepsilon_{p}",
    "supply_sag": "s",
    "sag_switched": "w_{s}",
    "sag_emf": r"\rho_{s}",
    "sag_reference": "u_{s}",
    "saturation_limit": r"u_{\max}",
    "fade": r"\kappa",
    "fade_emf": r"\rho_{h}",
    "fade_time": "T_{h}",
    "fade_reference": "u_{h}",
    "refresh": "T_{s}",
    "presliding_friction": "F_{z}",
    "presliding_travel": "d_{z}",
    "flexible_load_share": r"\mu_{r}",
    "flexible_load_stiffness": "k_{r}",
    "flexible_load_damping": "b_{r}",
}
_ARGUMENTS = {
    "position": "@",
    "velocity": r"\dot{@}",
    "gap": r"\gamma",
    "time": "t",
    "command": "u",
    "emf": r"u_{\omega}",
    "heat": "h",
    "bend": "z",
    "tug": "a_{y}",
    "moment": "S_{p}",
    "payload": "J_{p}",
    "direction": r"\sigma",
    "transmitted": r"\lambda",
}
#: A law with more parameters than this is a table; it is written as a function of what it reads.
_MOST = 6
_COORDINATES = {"rad": r"\theta", "m": "x", "kcount": "n"}


@dataclass(frozen=True)
class Term:
    """What one effect puts into an equation, with its sign in front."""

    effect: str
    text: str


@dataclass(frozen=True)
class Equation:
    """One equation of a structure; `says` tells what it is about."""

    says: str
    left: str
    terms: tuple[Term, ...]

    @property
    def text(self) -> str:
        """The whole equation as LaTeX; an inequality has no terms."""
        return _join(self.left, [t.text for t in self.terms]) if self.terms else self.left


def _join(left: str, terms: list[str]) -> str:
    right = " ".join(terms)
    right = f"-{right[2:]}" if right.startswith("- ") else right.removeprefix("+ ")
    return f"{left} = {right}"


def coordinate(axis_unit: str = "rad") -> str:
    """The symbol of the link's position."""
    return _COORDINATES[axis_unit]


def _filled(pattern: str, axis_unit: str) -> str:
    return pattern.replace("@", coordinate(axis_unit))


def symbol(name: str, axis_unit: str = "rad") -> str:
    """LaTeX of a parameter."""
    if name in SYMBOLS:
        return _filled(SYMBOLS[name], axis_unit)
    return r"\mathrm{" + name.replace("_", r"\ ") + "}"


_SINE, _COSINE = sympy.Function("sine"), sympy.Function("cosine")


class _Printer(LatexPrinter):  # type: ignore[misc]
    """Sums, sines and piecewise laws as one would write them by hand."""

    def _print_Function(self, expr: sympy.Expr, exp: object = None) -> str:
        name = {"sine": r"\sin", "cosine": r"\cos"}.get(expr.func.__name__)
        if name is None:
            return str(super()._print_Function(expr, exp))
        return rf"{_raised(name, exp)}\left({self._print(expr.args[0])}\right)"

    def _as_ordered_terms(self, expr: sympy.Expr, order: object = None) -> list[sympy.Expr]:
        terms = super()._as_ordered_terms(expr, order=order)
        return sorted(terms, key=lambda t: (t.could_extract_minus_sign(), not t.is_number, not _moves(t)))

    def _print_Relational(self, expr: sympy.Expr) -> str:
        upright = expr.reversed if _moves(expr.rhs) and not _moves(expr.lhs) else expr
        return str(super()._print_Relational(upright))

    def _needs_mul_brackets(self, expr: sympy.Expr, first: bool = False, last: bool = False) -> bool:
        if isinstance(expr, sympy.Piecewise) and _bracket(expr):
            return False
        return bool(super()._needs_mul_brackets(expr, first=first, last=last))

    def _print_Piecewise(self, expr: sympy.Expr) -> str:
        if _bracket(expr):
            return rf"{BRACKET}{self._print(expr.args[0].cond)}\right]"
        said = []
        for value, condition in _flat(expr):
            when = r"\mathrm{otherwise}" if condition == sympy.true else rf"\mathrm{{if}}\ {self._print(condition)}"
            said.append(rf"{self._print(value)}\ \ {when}")
        return r",\quad ".join(said)

    def _print_Max(self, expr: sympy.Expr, exp: object = None) -> str:
        return self._called(_raised(r"\max", exp), expr)

    def _print_Min(self, expr: sympy.Expr, exp: object = None) -> str:
        return self._called(_raised(r"\min", exp), expr)

    def _called(self, name: str, expr: sympy.Expr) -> str:
        ordered = sorted(expr.args, key=lambda a: (a.count_ops(), str(a)))
        return rf"{name}\left({', '.join(self._print(a) for a in ordered)}\right)"


def _raised(name: str, exponent: object) -> str:
    """A function's name, with the power that its value is taken to."""
    return name if exponent is None else rf"{name}^{{{exponent}}}"


def _moves(expression: sympy.Expr) -> bool:
    """Whether an expression contains what changes along a recording."""
    return bool(expression.free_symbols & {argument(n) for n in _ARGUMENTS})


def _bracket(expr: sympy.Piecewise) -> bool:
    """Whether it is 1 where a condition holds and 0 elsewhere."""
    pieces = _flat(expr)
    return [p[0] for p in pieces] == [1, 0] and pieces[1][1] == sympy.true


def _flat(expr: sympy.Piecewise) -> list[tuple[sympy.Expr, sympy.Expr]]:
    """The pieces in order, with those of a last piece that is piecewise itself in its place."""
    pieces = [(p.expr, p.cond) for p in expr.args]
    if isinstance(pieces[-1][0], sympy.Piecewise) and pieces[-1][1] == sympy.true:
        return [*pieces[:-1], *_flat(pieces[-1][0])]
    return pieces


def _plain(number: sympy.Float) -> sympy.Expr:
    """Whole numbers and multiples of pi in place of their decimals."""
    value = float(number)
    if value == int(value):
        return sympy.Integer(int(value))
    turns = value / math.pi
    return sympy.Integer(round(turns)) * sympy.pi if turns and abs(turns - round(turns)) < 1e-12 else number


def _upright(function: sympy.Function, odd: bool) -> Callable[[sympy.Expr], sympy.Expr]:
    """Sines with the coordinate in front: sin(x - a), not -sin(a - x)."""

    def turn(inner: sympy.Expr) -> sympy.Expr:
        leading = [t for t in sympy.Add.make_args(inner) if _moves(t)]
        if leading and leading[0].could_extract_minus_sign():
            return (-1 if odd else 1) * function(-inner)
        return function(inner)

    return turn


def _latex(expression: sympy.Expr, axis_unit: str, command: str = "u") -> str:
    expression = expression.xreplace({n: _plain(n) for n in expression.atoms(sympy.Float)})
    expression = expression.replace(sympy.sin, _upright(_SINE, True)).replace(sympy.cos, _upright(_COSINE, False))
    names = {argument(n): _filled(t, axis_unit) for n, t in _ARGUMENTS.items()}
    names[argument("command")] = command
    names |= {s: symbol(s.name[2:], axis_unit) for s in expression.free_symbols if s.name.startswith("p.")}
    return str(_Printer({"symbol_names": names, "mul_symbol": r"\,", "full_prec": False}).doprint(expression))


def law(effect_id: str, axis_unit: str = "rad", command: str = "u") -> str:
    """The law of an effect alone, or the equation on its page where it acts through the stepper."""
    effect = EFFECTS[effect_id]
    if effect.law is None:
        x = coordinate(axis_unit)
        text = re.sub(r"\\le(?![a-z])", r"\\leq", effect.equation or "")
        return text.replace(r"\theta", x if x.startswith("\\") else f" {x}")
    traced = trace(effect_id)
    if len(traced.parameters) > _MOST:
        read = [s for s in traced.arguments if s in traced.expression.free_symbols]
        names = {**_ARGUMENTS, "command": command}
        inside = ", ".join(_filled(names[s.name], axis_unit) for s in read)
        return rf"\mathrm{{{effect_id.replace('_', chr(92) + ' ')}}}\left({inside}\right)"
    return _latex(traced.expression, axis_unit, command)


def _signed(text: str) -> str:
    return f"- {text[1:].lstrip()}" if text.startswith("-") else f"+ {text}"


#: How what a law remembers comes about: what it is, its rate and what that is, times what makes both plain.
_MEMORY = {
    "heat": ("warming", r"T_{h}\,\dot{h}", r"\left(\frac{v_{h=0} - \rho_{h}\,u_{\omega}}{u_{h}}\right)^{2} - h"),
    "bend": ("bending of bristles", r"d_{z}\,\dot{z}", r"\dot{@} - \left|\dot{@}\right|\,z"),
    "tug": ("swing of what rides along", "a_{y}", r"k_{r}\,y + b_{r}\,\dot{y} = -\ddot{@} - \ddot{y}"),
}
_LEFT = {
    "drive": ("the command that acts", "v"),
    "load": ("motion", r"\ddot{@}"),
    "shaft": ("motion", r"\ddot{@}"),
    "drag": ("motion", r"\ddot{@}"),
    "bristle": ("motion", r"\ddot{@}"),
    "rider": ("motion", r"\ddot{@}"),
    "grip": ("size of the dry friction", "F"),
    "mass": ("inertia, in units of the axis' own", "J"),
    "sensor": ("what the sensor reads", r"@_{\mathrm{measured}}"),
}


def _left(slot: str, axis_unit: str) -> str:
    return _filled(_LEFT[slot][1], axis_unit)


def _memory(effect_id: str, axis_unit: str) -> list[Equation]:
    """How what the effect's law remembers comes about."""
    effect = EFFECTS[effect_id]
    kept = [_MEMORY[n] for n in _MEMORY if effect.law is not None and n in reads(effect_id)]
    return [
        Equation(what, _filled(rate, axis_unit), (Term(effect_id, f"+ {_filled(right, axis_unit)}"),))
        for what, rate, right in kept
    ]


def equation(effect_id: str, axis_unit: str = "rad") -> str:
    """What an effect adds to the axis, in LaTeX; dots stand for the rest."""
    return r",\quad ".join([_added(effect_id, axis_unit), *(e.text for e in _memory(effect_id, axis_unit))])


def _added(effect_id: str, axis_unit: str) -> str:
    effect = EFFECTS[effect_id]
    text = law(effect_id, axis_unit)
    if effect.slot == "structure":
        if "=" in text:
            return text
        if effect.station in ("drive", "motor"):
            return f"{_left('drive', axis_unit)} = {text}"
        return rf"{_left('load', axis_unit)} = {text} + \ldots"
    if effect.slot == "drive":
        return f"{_left('drive', axis_unit)} = {text}"
    start = {"sensor": coordinate(axis_unit), "mass": "1"}.get(effect.slot, r"\ldots")
    return f"{_left(effect.slot, axis_unit)} = {start} {_signed(text)}"


def _drive(structure: Structure, axis_unit: str) -> tuple[str, list[Equation]]:
    """The command that acts, and how each law of the drive hands it on to the next."""
    chain = [e for e in structure.effects if e.slot == "drive"]
    given = law("input_delay", axis_unit) if "input_delay" in structure else "u"
    found = []
    for number, effect in enumerate(chain, start=1):
        passed = "v" if number == len(chain) else f"u_{{{number}}}"
        found.append(Equation(effect.title, passed, (Term(effect.id, f"+ {law(effect.id, axis_unit, given)}"),)))
        given = passed
    return given, found


def _page_equations(structure: Structure, axis_unit: str, acting: str) -> list[Equation]:
    """What effects without a law of their own say on their page, where u is the command that reaches them."""
    found = []
    for e in structure.effects:
        if e.law is None and e.id not in ("inertia", "input_delay", "tooth_compliance"):
            text = re.sub(r"(?<![\\\w{])u(?![\w_(])", lambda _: acting, law(e.id, axis_unit))
            for part in text.split(r",\quad "):
                left, equals, right = part.partition(" = ")
                found.append(Equation(e.title, left.strip(), (Term(e.id, f"+ {right.strip()}"),) if equals else ()))
    return found


def equations(structure: Structure, axis_unit: str = "rad") -> tuple[Equation, ...]:
    """The structure's equations for the axis in mesh, each term with the effect that it comes from."""
    x = coordinate(axis_unit)
    terms = {
        slot: [Term(e.id, _signed(law(e.id, axis_unit))) for e in structure.effects if e.slot == slot]
        for slot in ("drag", "bristle", "rider", "load", "shaft", "grip", "mass", "sensor")
    }
    acting, drive = _drive(structure, axis_unit)
    drives = "u_{e}" if "motor_lag" in structure else acting
    motion = [Term("inertia", f"+ {symbol('input_gain')}\\,{drives}"), *terms["drag"], *terms["bristle"]]
    motion += [*terms["rider"], *terms["load"], *terms["shaft"]]
    if terms["grip"]:
        motion.append(Term(terms["grip"][0].effect, rf"- F\,\mathrm{{sgn}}\left(\dot{{{x}}}\right)"))
    left = rf"J\,\ddot{{{x}}}" if terms["mass"] else rf"\ddot{{{x}}}"
    found = [Equation("motion, gears in mesh", left, tuple(motion))]
    if terms["mass"]:
        found.append(Equation(_LEFT["mass"][0], "J", (Term("inertia", "+ 1"), *terms["mass"])))
    if terms["grip"]:
        found.append(Equation(_LEFT["grip"][0], "F", tuple(terms["grip"])))
    found += drive + _page_equations(structure, axis_unit, acting)
    found += [kept for e in structure.effects for kept in _memory(e.id, axis_unit)]
    if terms["sensor"]:
        read = (Term("inertia", f"+ {x}"), *terms["sensor"])
        found.append(Equation(_LEFT["sensor"][0], _left("sensor", axis_unit), read))
    return tuple(found)
