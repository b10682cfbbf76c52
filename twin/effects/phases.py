"""How what a law would like at phase zero, and of its derivative by the phase there, becomes a gain and a phase."""

from __future__ import annotations

import math


def polar(gain: float, lean: float) -> tuple[float, float]:
    """Sizes of sin(x) and -cos(x) -> amplitude, angle of sin(x - angle)."""
    return math.hypot(gain, lean), math.atan2(lean, gain)


def affine(gain: float, lean: float) -> tuple[float, float]:
    """Sizes of x and -1 -> gain and rest of gain * (x - rest)."""
    return gain, lean / gain if gain else 0.0
