"""Resistance that grows with the square of speed."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.math_ops import absolute
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return -p.quadratic_drag * q.velocity * absolute(q.velocity)


EFFECT = Effect(
    id="quadratic_drag",
    title="drag with the square of speed",
    station="friction",
    slot="drag",
    parameters=(Parameter("quadratic_drag", "1/{x}", "drag over inertia, per speed squared", 0.0, 0.0),),
    law=law,
    depends_on=("velocity",),
    promises=frozenset({"dissipative", "odd", "memoryless"}),
    sentence="Resistance grows with the square of speed, by {quadratic_drag}.",
    reference="Batchelor, An Introduction to Fluid Dynamics, 1967",
    confused_with={
        "drive_saturation": "coast-downs from high speed: drag acts without duty",
        "supply_sag": "coast-downs from high speed",
        "thermal_fade": "repeat the first block at the end",
    },
    screen=Screen("quadratic_drag"),
)
