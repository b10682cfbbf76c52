"""A smooth line through knots: the shape of what no other page describes.

Between two knots it is the cubic that has there the slopes of the parabolas through a knot and its neighbours (Bessel's
interpolation: de Boor, A Practical Guide to Splines, 1978, ch. IV). Every height acts on four pieces at most, and what
is a parabola is drawn as one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any

from twin.effects.math_ops import maximum, minimum
from twin.effects.parameter import Parameter

KNOTS = 12


def names(prefix: str) -> tuple[str, ...]:
    """Names of the values at the knots, in order: prefix_01, prefix_02, ..."""
    return tuple(f"{prefix}_{i:02d}" for i in range(1, KNOTS + 1))


def widths(prefix: str) -> tuple[str, ...]:
    """Names of the distances from each knot to the next, in order: prefix_width_01, prefix_width_02, ..."""
    return tuple(f"{prefix}_width_{i:02d}" for i in range(1, KNOTS))


def parameters(prefix: str, unit: str, over: str, over_unit: str, start: float, span: float) -> tuple[Parameter, ...]:
    """The values at the knots, and where these lie; what the line does outside is the law's to say."""
    each = span / (KNOTS - 1)
    return (
        *(Parameter(n, unit, f"value at knot {i} of {KNOTS}", 0.0) for i, n in enumerate(names(prefix), 1)),
        Parameter(f"{prefix}_from", over_unit, f"{over} at the first knot", None, start=start, estimated=False),
        *(
            Parameter(n, over_unit, f"{over} from knot {i} to the next", None, 1e-9, start=each, estimated=False)
            for i, n in enumerate(widths(prefix), 1)
        ),
    )  # fmt: skip


def through(prefix: str, at: Sequence[float], heights: Sequence[float]) -> dict[str, float]:
    """The parameters of a line through these knots, from the lowest on."""
    between = [float(b - a) for a, b in pairwise(at)]
    values = dict(zip(names(prefix), map(float, heights), strict=True))
    return {**values, f"{prefix}_from": float(at[0]), **dict(zip(widths(prefix), between, strict=True))}


def spots(prefix: str, values: Mapping[str, float]) -> list[float]:
    """Where the knots lie."""
    return list(accumulate((values[n] for n in widths(prefix)), initial=values[f"{prefix}_from"]))


def seat(name: str, values: Mapping[str, float]) -> tuple[str, float] | None:
    """Of the value at a knot: the name of the parameter that starts its line, and where the knot lies; else None."""
    prefix, _, number = name.rpartition("_")
    start = f"{prefix}_from"
    return (start, spots(prefix, values)[int(number) - 1]) if start in values and number.isdigit() else None


def rises(widths: Sequence[Any], heights: Sequence[Any]) -> list[Any]:
    """The slope of the chord from each knot to the next; heights may be numbers, expressions or arrays."""
    return [(b - a) / w for w, (a, b) in zip(widths, pairwise(heights), strict=True)]


def slopes(widths: Sequence[Any], heights: Sequence[Any]) -> list[Any]:
    """The slope at each knot: that of the parabola through it and its neighbours, at an end through the last three."""
    rise = rises(widths, heights)
    bend = [(t - s) / (v + w) for (v, w), (s, t) in zip(pairwise(widths), pairwise(rise), strict=True)]
    middle = [s + w * b for s, w, b in zip(rise, widths, bend, strict=False)]
    return [rise[0] - widths[0] * bend[0], *middle, rise[-1] + widths[-1] * bend[-1]]


def line(x: Any, prefix: str, p: Any) -> Any:
    """The curve through the knots at x. Outside it goes on along the chord of its last piece, as most torques do. The
    slope at an end is less certain, and with it a resistance that fell for long would drive.
    """
    heights = [getattr(p, n) for n in names(prefix)]
    between = [getattr(p, n) for n in widths(prefix)]
    rise, lean = rises(between, heights), slopes(between, heights)
    beyond = x - getattr(p, f"{prefix}_from")
    total = heights[0] + rise[0] * minimum(0.0, beyond)
    for width, chord, (one, other) in zip(between, rise, pairwise(lean), strict=True):
        # What each piece adds to the one before, all of it beyond its end.
        t = maximum(0.0, minimum(1.0, beyond / width))
        total = total + width * t * (one + t * (3.0 * chord - 2.0 * one - other + t * (one + other - 2.0 * chord)))
        beyond = beyond - width
    return total + rise[-1] * maximum(0.0, beyond)


def held(x: Any, prefix: str, p: Any) -> Any:
    """The same, level outside: what has become of a machine by the end stays."""
    first = getattr(p, f"{prefix}_from")
    span = sum(getattr(p, n) for n in widths(prefix))
    return line(maximum(first, minimum(first + span, x)), prefix, p)
