"""How two linear gains become a gain and a phase, or a gain and a rest position."""

from __future__ import annotations

import math


def polar(at_zero: float, at_quarter: float) -> tuple[float, float]:
    """Gains of sin(x) and sin(x - pi/2) -> amplitude, angle of sin(x - angle)."""
    return math.hypot(at_zero, at_quarter), math.atan2(at_quarter, at_zero)


def affine(at_zero: float, at_one: float) -> tuple[float, float]:
    """Gains of x and x - 1 -> gain and rest of gain * (x - rest)."""
    gain = at_zero + at_one
    return gain, at_one / gain if gain else 0.0
