"""Sections: how a long function of the stepper's language is written in named parts.

A section is called as a statement, such as `contact(x, s)`, and its own statements take the place of the call. In a
section `s.name` is the variable `name` of the function that it belongs to. All other names are its own. So a section
costs no time, and its text shows what it reads and writes of the whole.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterable


class _Variables(ast.NodeTransformer):
    """s.name -> name."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        shared = isinstance(node.value, ast.Name) and node.value.id == "s"
        return ast.Name(node.attr, node.ctx) if shared else node


def _stored(nodes: Iterable[ast.AST]) -> set[str]:
    """Names that some statements give a value to."""
    every = (n for node in nodes for n in ast.walk(node))
    return {n.id for n in every if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}


def _shared(section: ast.FunctionDef) -> set[str]:
    """Variables of the whole function that a section reads or writes."""
    attributes = (n for n in ast.walk(section) if isinstance(n, ast.Attribute))
    return {n.attr for n in attributes if isinstance(n.value, ast.Name) and n.value.id == "s"}


def _arguments(function: ast.FunctionDef) -> list[str]:
    return [a.arg for a in function.args.args]


class _Insert(ast.NodeTransformer):
    """Puts the statements of the sections in place of their calls."""

    def __init__(self, sections: dict[str, ast.FunctionDef]) -> None:
        self.sections = sections
        self.used: set[str] = set()

    def visit_Expr(self, node: ast.Expr) -> ast.AST | list[ast.stmt]:
        match node.value:
            case ast.Call(ast.Name(name), arguments) if name in self.sections:
                section = self.sections[name]
                if [ast.unparse(a) for a in arguments] != _arguments(section):
                    raise ValueError(f"section {name!r} takes ({', '.join(_arguments(section))}), by these names")
                self.used.add(name)
                body = [self.visit(copy.deepcopy(statement)) for statement in _body(section)]
                return [s for part in body for s in (part if isinstance(part, list) else [part])]
        return node


def _body(function: ast.FunctionDef) -> list[ast.stmt]:
    """The statements without the docstring."""
    return function.body[1:] if ast.get_docstring(function) is not None else function.body


def _whole(function: ast.FunctionDef, sections: dict[str, ast.FunctionDef]) -> ast.FunctionDef:
    """A function with its sections in place."""
    insert = _Insert(sections)
    own = _stored(function.body)
    whole: ast.FunctionDef = insert.visit(function)
    used = [sections[name] for name in sorted(insert.used)]
    common = own.union(_arguments(function), *map(_shared, used))
    for section in used:
        if clash := _stored(section.body) & common:
            raise ValueError(f"section {section.name!r} has names of its own that the whole has too: {sorted(clash)}")
        if any(isinstance(n, ast.Return) for n in ast.walk(section)):
            raise ValueError(f"section {section.name!r} returns: it can only go on")
    _Variables().visit(whole)
    return whole


def joined(tree: ast.Module) -> ast.Module:
    """Functions with their sections in place of the calls. A section is a function that takes `s`; it goes itself.

    Raises ValueError for a section that returns, is called with other names than it has, or has a name of its own that
    is also one of the whole.
    """
    functions = [f for f in tree.body if isinstance(f, ast.FunctionDef)]
    sections = {f.name: f for f in functions if "s" in _arguments(f)}
    return ast.Module([_whole(f, sections) for f in functions if f.name not in sections], [])
