"""The laws as SymPy expressions: traced once, source of every other text."""

from __future__ import annotations

import ast
import inspect
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from twin.effects.catalogue import EFFECTS
from twin.effects.effect import SLOTS
from twin.model.stations import STATIONS
from twin.model.stepper import Structure


@dataclass(frozen=True)
class Trace:
    """A law as an expression of its slot's arguments and its own parameters."""

    expression: sympy.Expr
    arguments: tuple[sympy.Symbol, ...]
    parameters: tuple[sympy.Symbol, ...]  # named "p.<parameter>"


def argument(name: str) -> sympy.Symbol:
    return sympy.Symbol(name, real=True)


def parameter(name: str) -> sympy.Symbol:
    return sympy.Symbol(f"p.{name}", real=True)


@cache
def trace(effect_id: str) -> Trace:
    """Trace the law of an effect. Raises ValueError for an effect that acts through the stepper itself."""
    effect = EFFECTS[effect_id]
    if effect.law is None:
        raise ValueError(f"{effect_id} has no law of its own")
    arguments = tuple(argument(name) for name in SLOTS[effect.slot][0])
    parameters = tuple(parameter(p.name) for p in effect.parameters)
    q = SimpleNamespace(**{s.name: s for s in arguments})
    others = {s: parameter(s) for i in effect.includes for s in (p.name for p in EFFECTS[i].parameters)}
    p = SimpleNamespace(**{s.name[2:]: s for s in parameters}, **others)
    expression = sympy.sympify(effect.law(q, p))
    return Trace(expression, arguments, parameters + tuple(others.values()))


#: Functions of the stations as syntax trees, by name.
_STATIONS = {
    f.name: f
    for station in STATIONS
    for f in ast.parse(inspect.getsource(station)).body
    if isinstance(f, ast.FunctionDef)
}
_ARITHMETIC: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Gt: operator.gt,
    ast.Lt: operator.lt,
    ast.GtE: operator.ge,
    ast.LtE: operator.le,
    ast.Eq: operator.eq,
}


class _Run:
    """One run of a station's function on SymPy expressions; where a test stays open both ways are followed."""

    def __init__(self, structure: Structure, slots: Mapping[str, sympy.Expr], variables: dict[str, Any]) -> None:
        self.structure = structure
        self.slots = slots
        self.variables = variables

    def value(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value):
                return value
            case ast.Name(name):
                return self.variables[name]
            case ast.Attribute(ast.Name("has"), name):
                return name in self.structure or name in self.structure.slots
            case ast.Attribute(ast.Name("p"), name):
                return parameter(name)
            case ast.UnaryOp(ast.USub(), inner):
                return -self.value(inner)
            case ast.BinOp(left, kind, right):
                return _ARITHMETIC[type(kind)](self.value(left), self.value(right))
            case ast.Compare(left, [kind], [right]):
                return _COMPARISONS[type(kind)](self.value(left), self.value(right))
            case ast.BoolOp(ast.Or(), tests):
                return any(self.value(test) for test in tests)
            case ast.Call(ast.Name(name), _) if name in self.slots:
                return self.slots[name]
            case ast.Call(ast.Name(name), given):
                arguments = [None if ast.unparse(a) == "p" else self.value(a) for a in given]
                return _run(_STATIONS[name], self.structure, self.slots, arguments)
        raise ValueError(f"no expression for {ast.unparse(node)!r}")

    def block(self, statements: Iterable[ast.stmt]) -> Any:
        """Run statements; what a return gives, else None."""
        for node in statements:
            match node:
                case ast.Return(value) if value is not None:
                    return self.value(value)
                case ast.Assign([ast.Name(name)], value):
                    self.variables[name] = self.value(value)
                case ast.If(test, body, orelse):
                    self.branch(self.value(test), body, orelse)
        return None

    def branch(self, test: Any, body: list[ast.stmt], orelse: list[ast.stmt]) -> None:
        if test in (True, False):
            self.block(body if test else orelse)
            return
        other = _Run(self.structure, self.slots, dict(self.variables))
        self.block(body)
        other.block(orelse)
        for name, value in other.variables.items():
            mine = self.variables[name]
            self.variables[name] = value if mine == value else sympy.Piecewise((mine, test), (value, True))


def _run(
    function: ast.FunctionDef, structure: Structure, slots: Mapping[str, sympy.Expr], arguments: Iterable[Any]
) -> Any:
    names = [a.arg for a in function.args.args]
    return _Run(structure, slots, dict(zip(names, arguments, strict=True))).block(function.body)


def expression(
    station: Callable[..., Any], structure: Structure, *arguments: Any, slots: Mapping[str, sympy.Expr] | None = None
) -> sympy.Expr:
    """A law between the stations (`twin.model.stations`) as a formula, for a structure.

    Parameters
    ----------
    station
        The function.
    structure
        Decides what `has.name` is.
    arguments
        In place of the function's own, without `p`: expressions, or numbers that decide which way it goes.
    slots
        What the laws of a slot come to, by the slot's name.

    Returns
    -------
    sympy.Expr
        In the arguments and the parameters, which are named "p.<parameter>".
    """
    function = _STATIONS[station.__name__]
    takes_parameters = any(a.arg == "p" for a in function.args.args)
    found = _run(function, structure, slots or {}, (*arguments, None) if takes_parameters else arguments)
    return sympy.sympify(found)


@cache
def _vectorised(effect_id: str) -> Callable[..., NDArray[np.float64]]:
    """The law as a function of arrays, arguments of the slot first, then parameters."""
    law = trace(effect_id)
    compiled: Callable[..., NDArray[np.float64]] = sympy.lambdify(
        [*law.arguments, *law.parameters], law.expression, "numpy", dummify=True, cse=True
    )
    return compiled


def along(
    effect_id: str, states: Mapping[str, NDArray[np.float64]], values: Mapping[str, float]
) -> NDArray[np.float64]:
    """What the law gives (N,) at these states (N,), by the names of the slot's arguments; all others are zero.

    Raises ValueError as `trace` does.
    """
    law = trace(effect_id)
    given = [states.get(s.name, 0.0) for s in law.arguments]
    # What an effect brings along may have parameters that nothing acts on, and no value for them.
    read = law.expression.free_symbols
    found = _vectorised(effect_id)(
        *given, *(values[s.name.removeprefix("p.")] if s in read else 0.0 for s in law.parameters)
    )
    return np.broadcast_to(found, np.broadcast(*states.values()).shape).astype(np.float64)


def reads(effect_id: str) -> set[str]:
    """The arguments of its slot that the law of an effect depends on. Raises ValueError as `trace` does."""
    traced = trace(effect_id)
    return {s.name for s in traced.expression.free_symbols & set(traced.arguments)}


def timed(structure: Structure) -> bool:
    """Whether some law counts the time since the start, itself or as heat: such a model cannot begin anywhere else."""
    return any({"time", "heat"} & reads(e.id) for e in structure.effects if e.law is not None)
