"""The axis as plain Python text: what numba compiles and what the FMU embeds.

Two forms of the same text. For one structure: only its effects, `has.x` folded away, parameters numbered in the
structure's order. Switched: every effect is behind a switch, so that one compiled kernel serves all structures. In `p`
the parameters come first. The switches of the effects follow, then those of the slots and that of the commonest
structures.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import sympy
from sympy.printing.pycode import PythonCodePrinter

from twin.codegen.sections import joined
from twin.effects.catalogue import EFFECTS
from twin.effects.effect import SLOTS
from twin.model.equations import trace
from twin.model.stepper import EVERYTHING, KNOWN, STATES, STEPPER, Structure


class _Printer(PythonCodePrinter):  # type: ignore[misc]
    """Expressions in the stepper's small part of Python."""

    def __init__(self) -> None:
        super().__init__({"fully_qualified_modules": False})

    def _print_Heaviside(self, expr: sympy.Expr) -> str:
        return f"(1.0 if {self._print(expr.args[0])} > 0.0 else 0.0)"

    def _print_sign(self, expr: sympy.Expr) -> str:
        return f"(1.0 if {self._print(expr.args[0])} >= 0.0 else -1.0)"

    def _print_Integer(self, expr: sympy.Expr) -> str:
        return f"{int(expr)}.0"

    def _print_Rational(self, expr: sympy.Expr) -> str:
        return f"({int(expr.p)}.0/{int(expr.q)}.0)"

    def _print_Pow(self, expr: sympy.Expr, **options: Any) -> str:
        base, exponent = expr.args
        # A product: a processor has no powers, and whole ones are all that slopes bring.
        if exponent.is_Integer and 0 < abs(int(exponent)) <= 4:
            product = "*".join([self.parenthesize(base, 70)] * abs(int(exponent)))
            return f"({product})" if exponent > 0 else f"(1.0/({product}))"
        return str(super()._print_Pow(expr, **options))


def code(expression: sympy.Expr) -> str:
    """An expression as Python text."""
    return str(_Printer().doprint(expression))


@dataclass(frozen=True)
class Numbering:
    """Where each name lives: index of parameters, states, known quantities, and what `has.x` becomes."""

    parameters: Mapping[str, int]
    states: Mapping[str, int]
    known: Mapping[str, int]
    has: Callable[[str], ast.expr]

    def absent(self, name: str) -> bool:
        """Whether the text can do without an effect altogether."""
        switch = self.has(name)
        return isinstance(switch, ast.Constant) and not switch.value

    def offering(self, always: Collection[str], possible: Collection[str]) -> Numbering:
        """The same numbers for a text in which some effects are always there and others only possible."""
        there, perhaps = ({*ids, *(EFFECTS[i].slot for i in ids)} for ids in (always, possible))

        def has(name: str) -> ast.expr:
            return ast.Constant(name in there) if name in there or name not in perhaps else self.has(name)

        return replace(self, has=has)


def _index(order: Mapping[str, Any] | tuple[str, ...]) -> dict[str, int]:
    return {name: i for i, name in enumerate(order)}


def numbering(structure: Structure, switched: bool) -> Numbering:
    names = tuple(p.name for p in structure.parameters)

    def switch(name: str) -> ast.expr:
        if not switched:
            return ast.Constant(name in structure or name in structure.slots)
        place = len(names) + (*structure.ids, *SLOTS, "common").index(name)
        return ast.parse(f"p[{place}] != 0.0", mode="eval").body

    return Numbering(_index(names), _index(tuple(STATES)), _index(tuple(KNOWN)), switch)


class _Resolve(ast.NodeTransformer):
    """Replace p.x, x.x, k.x and has.x, and fold the branches that a fixed structure decides."""

    def __init__(self, numbers: Numbering) -> None:
        self.numbers = numbers

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        holder = node.value.id if isinstance(node.value, ast.Name) else ""
        if holder == "has":
            return self.numbers.has(node.attr)
        tables = {"p": self.numbers.parameters, "x": self.numbers.states, "k": self.numbers.known}
        if holder not in tables:
            return node
        table = tables[holder]
        # A parameter of an absent effect stands only in branches that are folded away.
        return ast.Subscript(node.value, ast.Constant(table.get(node.attr, -1)), node.ctx)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        self.generic_visit(node)
        decisive = isinstance(node.op, ast.Or)
        undecided = [v for v in node.values if not isinstance(v, ast.Constant)]
        if any(isinstance(v, ast.Constant) and v.value is decisive for v in node.values):
            return ast.Constant(decisive)
        if not undecided:
            return ast.Constant(not decisive)
        return ast.BoolOp(node.op, undecided) if len(undecided) > 1 else undecided[0]

    def visit_If(self, node: ast.If) -> Any:
        self.generic_visit(node)
        if isinstance(node.test, ast.Constant):
            return (node.body if node.test.value else node.orelse) or ast.Pass()
        return node


def resolve(text: str, numbers: Numbering) -> ast.Module:
    """Parse text, put sections in their place and numbers in place of names; doc strings go."""
    tree = joined(ast.parse(textwrap.dedent(text)))
    for function in tree.body:
        if isinstance(function, ast.FunctionDef) and isinstance(function.body[0], ast.Expr):
            function.body = function.body[1:]
    resolved: ast.Module = _Resolve(numbers).visit(tree)
    return ast.fix_missing_locations(resolved)


def laws_by_slot(structure: Structure, numbers: Numbering | None = None) -> dict[str, list[str]]:
    """Ids of the effects that have a law, by slot, in order; with `numbers` only those that may be present there."""
    present = [e for e in structure.effects if not (numbers and numbers.absent(e.id))]
    return {slot: [e.id for e in present if e.slot == slot] for slot in SLOTS if slot != "structure"}


def law_text(laws: Mapping[str, Iterable[str]]) -> str:
    """The functions drive, load, drag, grip, mass and sensor, each effect behind `has.x`."""
    lines: list[str] = []
    for slot, ids in laws.items():
        arguments = SLOTS[slot][0]
        lines.append(f"def {slot}({', '.join(arguments)}, p):")
        if slot == "drive":
            lines.append("    acts = command")
        else:
            lines.append("    acts = 0.0")
        for effect in ids:
            body = code(trace(effect).expression)
            lines.append(f"    if has.{effect}:")
            if slot == "drive":
                # Laws of the drive apply in turn: each reads what the one before it passed on.
                lines.append(f"        command = {body}")
                lines.append("        acts = command")
            else:
                lines.append(f"        acts = acts + {body}")
        lines.append("    return acts")
    return "\n".join(lines)


def stepper_text() -> str:
    return "\n".join(textwrap.dedent(inspect.getsource(f)) for f in STEPPER)


def module(structure: Structure, switched: bool = False, numbers: Numbering | None = None) -> ast.Module:
    """Laws and stepper of a structure as one syntax tree; functions take (…, p) with p a flat sequence."""
    numbers = numbers or numbering(structure, switched)
    return resolve(law_text(laws_by_slot(structure, numbers)) + "\n" + stepper_text(), numbers)


@cache
def write(structure: Structure) -> str:
    """Python text for one structure, standard library only: `step(x, p, k, command, h)` and `sensor`."""
    return "from math import cos, exp, sin, sqrt, tanh\n\n\n" + ast.unparse(module(structure)) + "\n"


def write_switched() -> str:
    """Python text with every effect behind a switch."""
    return "from math import cos, exp, sin, sqrt, tanh\n\n\n" + ast.unparse(module(EVERYTHING, True)) + "\n"
