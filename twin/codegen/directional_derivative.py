"""The exact derivative of the axis along one direction, for C: the chain rule, applied to the syntax tree.

As `twin.codegen.forward_derivative`, with one number in place of sixteen: beside every scalar `a` stands `d_a`, `xd`
and `pd` hold the slopes of states and parameters. Laws are differentiated as written, so that nothing has to be
simplified, and a text is there at once.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence

from twin.codegen.forward_derivative import FIXED_ARGUMENTS, SHARED, FunctionDerivative
from twin.codegen.python import Numbering, module
from twin.model.stepper import Structure

#: Derivative of a function, with its argument as {0}.
_OUTER = {
    "sin": "cos({0})",
    "cos": "(-sin({0}))",
    "exp": "exp({0})",
    "sqrt": "(0.5 / sqrt({0}))",
    "tanh": "(1.0 - tanh({0}) * tanh({0}))",
    "abs": "(1.0 if {0} >= 0.0 else -1.0)",
}
_PICKS = {"min": "<=", "max": ">="}


class _ChainRule(FunctionDerivative):
    """Writes the derivative of one function; an expression whose slope is zero has the slope ""."""

    def _derivative(self, value: ast.expr) -> str:
        return self._slope(value) or "zero()"

    def _slope(self, node: ast.expr) -> str:
        match node:
            case ast.Constant():
                return ""
            case ast.Name() | ast.Subscript():
                text = ast.unparse(node)
                return "" if text in FIXED_ARGUMENTS else self._name(text) or ""
            case ast.UnaryOp(ast.USub(), operand):
                slope = self._slope(operand)
                return slope and f"(-{slope})"
            case ast.BinOp(left, operator, right):
                return self._of_two(left, operator, right)
            case ast.IfExp(test, body, orelse):
                return self._either(ast.unparse(test), self._slope(body), self._slope(orelse))
            case ast.Call(ast.Name(name), [inner]) if name in _OUTER:
                slope = self._slope(inner)
                return slope and f"({_OUTER[name].format(f'({ast.unparse(inner)})')} * {slope})"
            case ast.Call(ast.Name(name), [left, right]) if name in _PICKS:
                picked = f"({ast.unparse(left)}) {_PICKS[name]} ({ast.unparse(right)})"
                return self._either(picked, self._slope(left), self._slope(right))
            case ast.Call(ast.Name(name) as function, [first, *rest]) if name in _PICKS:
                return self._slope(ast.Call(function, [first, ast.Call(function, rest, [])], []))
        raise ValueError(f"no derivative for {ast.unparse(node)!r}")

    def _of_two(self, left: ast.expr, operator: ast.operator, right: ast.expr) -> str:
        """The slope of a sum, a product, a quotient or a power."""
        da, db = self._slope(left), self._slope(right)
        if not da and not db:
            return ""
        if isinstance(operator, ast.Add | ast.Sub):
            sign = "-" if isinstance(operator, ast.Sub) else "+"
            return f"({da or '0.0'} {sign} {db})" if db else da
        a, b = f"({ast.unparse(left)})", f"({ast.unparse(right)})"
        match operator:
            case ast.Mult():
                terms = [f"{da} * {b}"] * bool(da) + [f"{a} * {db}"] * bool(db)
            case ast.Div():
                terms = [f"{da} / {b}"] * bool(da) + [f"(-{a}) * {db} / ({b} * {b})"] * bool(db)
            case ast.Pow() if not db:
                terms = [f"{b} * {a} ** ({b} - 1.0) * {da}"] * bool(da)
            case _:
                raise ValueError(f"no derivative for {a} and {b}")
        return f"({' + '.join(terms)})"

    @staticmethod
    def _either(test: str, one: str, other: str) -> str:
        return f"({one or '0.0'} if {test} else {other or '0.0'})" if one or other else ""


def write(structure: Structure, numbers: Numbering, more: Sequence[ast.FunctionDef] = ()) -> ast.Module:
    """Derivatives of laws and stepper of a structure, and of `more` in the same language, resolved by `numbers`.

    Each function `f(a, x, p, k)` becomes `f_t(a, d_a, x, xd, p, pd, k)`, which returns its value and the slope of that.
    """
    functions = [f for f in module(structure, numbers=numbers).body if isinstance(f, ast.FunctionDef)]
    functions += more
    formals = {f.name: tuple(a.arg for a in f.args.args if a.arg not in SHARED) for f in functions}
    return ast.parse("\n\n\n".join(_ChainRule(f, formals).write() for f in functions))
