"""The laws as SymPy expressions: traced once, source of every other text."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace

import numpy as np
import sympy
from numpy.typing import NDArray

from twin.effects.catalogue import EFFECTS
from twin.effects.effect import SLOTS
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
