"""Straight lines between knots: the shape of what no other page describes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from twin.quantities import Parameter
from twin.words import maximum, minimum

KNOTS = 12


def names(prefix: str) -> tuple[str, ...]:
    """Names of the values at the knots, in order: prefix_01, prefix_02, ..."""
    return tuple(f"{prefix}_{i:02d}" for i in range(1, KNOTS + 1))


def values(prefix: str, p: Any) -> list[Any]:
    return [getattr(p, n) for n in names(prefix)]


def parameters(prefix: str, unit: str, over: str, over_unit: str, start: float, span: float) -> tuple[Parameter, ...]:
    """The values, and the range over which the knots lie evenly; what the line does outside is the law's to say."""
    return (
        *(Parameter(n, unit, f"value at knot {i} of {KNOTS}", 0.0) for i, n in enumerate(names(prefix), 1)),
        Parameter(f"{prefix}_from", over_unit, f"{over} at the first knot", None, start=start, estimated=False),
        Parameter(
            f"{prefix}_span", over_unit, f"{over} from the first knot to the last", None, 1e-6, start=span,
            estimated=False,
        ),
    )  # fmt: skip


def line(x: Any, first: Any, span: Any, heights: Sequence[Any]) -> Any:
    """The line through evenly spaced knots at x; outside it goes on as it ends, as most torques do."""
    spot = (len(heights) - 1) * (x - first) / span
    last = len(heights) - 1
    total = heights[0] + (heights[1] - heights[0]) * minimum(1.0, spot)
    for i in range(2, last):
        total = total + (heights[i] - heights[i - 1]) * maximum(0.0, minimum(1.0, spot - (i - 1)))
    return total + (heights[last] - heights[last - 1]) * maximum(0.0, spot - (last - 1))


def held(x: Any, first: Any, span: Any, heights: Sequence[Any]) -> Any:
    """The same, level outside: what has become of a machine by the end stays."""
    return line(maximum(first, minimum(first + span, x)), first, span, heights)
