"""Laws that act near one angle: how often a turn it comes, how wide it is, and where a search looks for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from twin.effects.effect import Recorded
from twin.effects.math_ops import minimum
from twin.effects.parameter import Parameter

#: A quarter of a period, rad: no law of one place is wider.
_QUARTER = 1.5707963267948966


def order(name: str) -> Parameter:
    """How often a turn the place comes; on a travel of less than a turn, so seldom that it comes once."""
    return Parameter(name, "rad/{x}", "times a turn that it comes", None, 1e-3, start=1.0, estimated=False)


def half_width(times: Any, width: Any) -> Any:
    """The width as a phase, rad."""
    return minimum(times * width, _QUARTER)


def orders(recorded: Recorded, most: int) -> list[float]:
    """Times a turn that a place may come: up to `most` where the axis makes a turn, else once in the travel."""
    if recorded.turns and recorded.travel > 2.0 * math.pi:
        return [float(n) for n in range(1, most + 1)]
    once = math.pi / max(recorded.travel, 1e-9)
    return [min(once, 1.0) if recorded.turns else once]


def grid(recorded: Recorded, times: float, widths: Sequence[float]) -> list[tuple[float, float]]:
    """Half-width and middle of places in one period, at every half-width; `widths` as phases, rad."""
    period = min(2.0 * math.pi / times, recorded.travel)
    found = []
    for width in widths:
        count = max(round(period * times / width), 1)
        found += [(width / times, recorded.lowest + (i + 0.5) * period / count) for i in range(count)]
    return found


def passed(recorded: Recorded, times: float, angle: float, width: float) -> bool:
    """Whether a place is narrower than its period, and one of its repetitions lies within the travel."""
    period = 2.0 * math.pi / times
    ahead = (angle - recorded.lowest + width) % period
    return times * width < 0.95 * _QUARTER and ahead < recorded.travel + 2.0 * width
