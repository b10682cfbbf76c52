"""Sines and cosines of a phase: the shape over an angle of what no other page describes."""

from __future__ import annotations

from typing import Any

from twin.effects.math_ops import cos, sin
from twin.effects.parameter import Parameter


def names(prefix: str, count: int) -> tuple[str, ...]:
    """Names of the parts of `count` waves, in order: prefix_sin_1, prefix_cos_1, prefix_sin_2, ..."""
    return tuple(f"{prefix}_{wave}_{k}" for k in range(1, count + 1) for wave in ("sin", "cos"))


def parameters(prefix: str, count: int, unit: str, more: str = "") -> tuple[Parameter, ...]:
    """The parts of the waves, zero where there is nothing."""
    return tuple(
        Parameter(n, unit, f"part that goes with {wave} of {k} times the phase{more}", 0.0)
        for n, wave, k in ((n, *n.split("_")[-2:]) for n in names(prefix, count))
    )


def order(name: str, unit: str = "rad/{x}") -> Parameter:
    """How often a turn the first wave repeats."""
    return Parameter(name, unit, "times a turn that it repeats", None, 1e-3, start=1.0, estimated=False)


def line(angle: Any, prefix: str, count: int, p: Any) -> Any:
    """The sum of the waves at an angle, which is the phase."""
    total = 0.0
    for k in range(1, count + 1):
        total = (
            total + getattr(p, f"{prefix}_sin_{k}") * sin(k * angle) + getattr(p, f"{prefix}_cos_{k}") * cos(k * angle)
        )
    return total


def slope(angle: Any, prefix: str, count: int, p: Any) -> Any:
    """How steeply the sum of the waves rises with the phase."""
    total = 0.0
    for k in range(1, count + 1):
        total = (
            total
            + k * getattr(p, f"{prefix}_sin_{k}") * cos(k * angle)
            - k * getattr(p, f"{prefix}_cos_{k}") * sin(k * angle)
        )
    return total
