"""The words that a physical law may use.

Each works on plain floats and on SymPy expressions. So one function is both the law that runs and the text from which
every other language is written.
"""

from __future__ import annotations

import math
from typing import Any

import sympy


def _symbolic(*arguments: Any) -> bool:
    return any(isinstance(a, sympy.Basic) for a in arguments)


def sin(x: Any) -> Any:
    return sympy.sin(x) if _symbolic(x) else math.sin(x)


def cos(x: Any) -> Any:
    return sympy.cos(x) if _symbolic(x) else math.cos(x)


def exp(x: Any) -> Any:
    return sympy.exp(x) if _symbolic(x) else math.exp(x)


def tanh(x: Any) -> Any:
    return sympy.tanh(x) if _symbolic(x) else math.tanh(x)


def sqrt(x: Any) -> Any:
    return sympy.sqrt(x) if _symbolic(x) else math.sqrt(x)


def absolute(x: Any) -> Any:
    return sympy.Abs(x) if _symbolic(x) else abs(x)


def minimum(x: Any, y: Any) -> Any:
    return sympy.Min(x, y) if _symbolic(x, y) else min(x, y)


def maximum(x: Any, y: Any) -> Any:
    return sympy.Max(x, y) if _symbolic(x, y) else max(x, y)


def where(condition: Any, x: Any, y: Any) -> Any:
    """x where the condition holds, y elsewhere; conditions are plain comparisons (<, >, <=, >=)."""
    if _symbolic(condition):
        return sympy.Piecewise((x, condition), (y, True))
    return x if condition else y
