"""The axis as C: the same syntax tree as the Python text, printed in another tongue."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from functools import cache

from twin.codegen.python import module
from twin.model.stepper import Structure

_OPERATORS = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Gt: ">",
    ast.Lt: "<",
    ast.GtE: ">=",
    ast.LtE: "<=",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.And: "&&",
    ast.Or: "||",
}
_FUNCTIONS = {"abs": "fabs", "min": "fmin", "max": "fmax", "int": "trunc"}
#: Names that are arrays in the texts: states, memory and queue are written to, parameters and settings are read.
_ARRAYS = {n: f"double *{n}" for n in ("x", "y", "m", "q", "xd")}
_ARRAYS |= {n: f"const double *{n}" for n in ("p", "g", "k", "pd")}
#: The functions of the axis that a simulation calls.
ROOTS = ("step", "sensor")
#: Where a function gives a value and its derivative, it returns the first and writes the second here.
_SLOPE = "slope_of_result_"


def _name(name: str) -> str:
    """A scalar's name in C: headers of systems define `far`, `small` and others as macros, but none that ends so."""
    return name if name in _ARRAYS else f"{name}_"


def _element(array: str, index: ast.expr) -> str:
    """An element of an array; what the structure has no number for is read where it does not matter, as zero."""
    match index:
        case ast.Constant(int(place)) if place >= 0:
            return f"{array}[{place}]"
        case ast.Constant(int()) | ast.UnaryOp(ast.USub(), ast.Constant()):
            return "0.0"
    return f"{array}[(size_t){_expression(index)}]"


def _expression(node: ast.expr) -> str:
    match node:
        case ast.Constant(value):
            return repr(value)
        case ast.Name(name):
            return _name(name)
        case ast.Call(ast.Name("zero"), []):
            return "0.0"
        case ast.Call(ast.Name("row"), [ast.Name(name), index]):
            return _element(name, index)
        case ast.Subscript(ast.Name(name), index):
            return _element(name, index)
        case ast.UnaryOp(ast.USub(), operand):
            return f"(-{_expression(operand)})"
        case ast.BinOp(left, ast.Pow(), ast.Constant(2)):
            return f"({_expression(left)} * {_expression(left)})"
        case ast.BinOp(left, ast.Pow(), right):
            return f"pow({_expression(left)}, {_expression(right)})"
        case ast.BinOp(left, operator, right):
            return f"({_expression(left)} {_OPERATORS[type(operator)]} {_expression(right)})"
        case ast.Compare(left, [operator], [right]):
            return f"({_expression(left)} {_OPERATORS[type(operator)]} {_expression(right)})"
        case ast.BoolOp(operator, values):
            return "(" + f" {_OPERATORS[type(operator)]} ".join(map(_expression, values)) + ")"
        case ast.IfExp(test, body, orelse):
            return f"({_expression(test)} ? {_expression(body)} : {_expression(orelse)})"
        case ast.Call(ast.Name("min" | "max" as name), [first, *rest]) if len(rest) > 1:
            # C's take two.
            return f"{_FUNCTIONS[name]}({_expression(first)}, {_expression(ast.Call(node.func, rest, []))})"
        case ast.Call(ast.Name(name), arguments):
            return f"{_FUNCTIONS.get(name, name)}({', '.join(map(_expression, arguments))})"
    raise ValueError(f"no C for {ast.unparse(node)!r}")


def _statement(node: ast.stmt, indent: str) -> list[str]:
    inner = indent + "    "
    match node:
        case ast.Assign([ast.Tuple([value, ast.Name(slope)])], ast.Call(ast.Name(called), arguments)):
            given = ", ".join([*map(_expression, arguments), f"&{_name(slope)}"])
            return [f"{indent}{_expression(value)} = {called}({given});"]
        case ast.Assign([target], value):
            return [f"{indent}{_expression(target)} = {_expression(value)};"]
        case ast.Expr(ast.Call(ast.Name("put"), [ast.Name(array), ast.Constant(int(index)), value])):
            return [f"{indent}{array}[{index}] = {_expression(value)};"]
        case ast.Expr(value):
            return [f"{indent}{_expression(value)};"]
        case ast.Return(ast.Tuple([value, slope])):
            return [f"{indent}*{_SLOPE} = {_expression(slope)};", f"{indent}return {_expression(value)};"]
        case ast.Return(value) if value is not None:
            return [f"{indent}return {_expression(value)};"]
        case ast.Break():
            return [f"{indent}break;"]
        case ast.Pass():
            return []
        case ast.If(test, body, orelse):
            lines = [f"{indent}if ({_expression(test)}) {{", *_block(body, inner)]
            if orelse:
                lines += [f"{indent}}} else {{", *_block(orelse, inner)]
            return [*lines, f"{indent}}}"]
        case ast.For(ast.Name(name), ast.Call(ast.Name("range"), [count]), body):
            i = _name(name)
            head = f"{indent}for (int {i} = 0; {i} < {_expression(count)}; ++{i}) {{"
            return [head, *_block(body, inner), f"{indent}}}"]
    raise ValueError(f"no C for {ast.unparse(node)!r}")


def _block(body: list[ast.stmt], indent: str) -> list[str]:
    return [line for node in body for line in _statement(node, indent)]


def _function(function: ast.FunctionDef) -> str:
    arguments = [a.arg for a in function.args.args]
    counters = {n.target.id for n in ast.walk(function) if isinstance(n, ast.For) and isinstance(n.target, ast.Name)}
    local = {
        n.id: None
        for n in ast.walk(function)
        if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store) and n.id not in {*arguments, *counters}
    }
    stored = {
        n.value.id
        for n in ast.walk(function)
        if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store) and isinstance(n.value, ast.Name)
    }
    formals = [f"double *{a}" if a in stored else _ARRAYS.get(a, f"double {_name(a)}") for a in arguments]
    if any(isinstance(n, ast.Return) and isinstance(n.value, ast.Tuple) for n in ast.walk(function)):
        formals.append(f"double *{_SLOPE}")
    lines = [f"static double {function.name}({', '.join(formals)})", "{"]
    if local:
        lines.append(f"    double {', '.join(map(_name, sorted(local)))};")
    names = [n for node in function.body for n in ast.walk(node) if isinstance(n, ast.Name)]
    read = {n.id for n in names if isinstance(n.ctx, ast.Load)}
    lines += [f"    (void){_name(a)};" for a in [*arguments, *sorted(local)] if a not in read]
    return "\n".join([*lines, *_block(function.body, "    "), "}"])


def called_by(tree: ast.Module, *roots: str) -> set[str]:
    """Names of a module's functions that run where the named ones do: these, and what they call."""
    found = {f.name: f for f in tree.body if isinstance(f, ast.FunctionDef)}
    called, left = set(roots), list(roots)
    while left:
        more = {n.id for n in ast.walk(found[left.pop()]) if isinstance(n, ast.Name)} & found.keys() - called
        called |= more
        left += more
    return called


def functions(tree: ast.Module, *roots: str) -> str:
    """C text of a module's functions: the named ones and what is called. C99, needs math.h and stddef.h."""
    called = called_by(tree, *roots)
    return text(f for f in tree.body if isinstance(f, ast.FunctionDef) and f.name in called)


def text(functions: Iterable[ast.FunctionDef]) -> str:
    """C text of functions in the stepper's language."""
    return "\n\n".join(map(_function, functions)) + "\n"


@cache
def library(structure: Structure) -> str:
    """C text of a library that moves an axis by `count` internal steps of h: its one function is `advance`."""
    return f"""#include <math.h>

{functions(module(structure), "step")}
#if defined __GNUC__
__attribute__((visibility("default")))
#endif
void advance(double *x, const double *p, const double *k, double command, double h, long count)
{{
    for (long i = 0; i < count; ++i) step(x, p, k, command, h);
}}
"""


def write(structure: Structure) -> str:
    """C text for one structure: `static double step(double *x, const double *p, const double *k, double command,
    double h)`, `sensor(position, gap, p)` and what they call. C99, needs only math.h, no state of its own.
    """
    return "#include <math.h>\n\n" + functions(module(structure), *ROOTS)
