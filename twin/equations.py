"""The laws as SymPy expressions: traced once, source of every other text."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace

import sympy

from twin.axis import Structure
from twin.effects.catalogue import EFFECTS
from twin.effects.effect import SLOTS


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


def reads(effect_id: str) -> set[str]:
    """The arguments of its slot that the law of an effect depends on. Raises ValueError as `trace` does."""
    traced = trace(effect_id)
    return {s.name for s in traced.expression.free_symbols & set(traced.arguments)}


def timed(structure: Structure) -> bool:
    """Whether some law counts the time since the start, itself or as heat: such a model cannot begin anywhere else."""
    return any({"time", "heat"} & reads(e.id) for e in structure.effects if e.law is not None)
