"""Resistance over speed, of no known shape."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.knots import line, parameters


def law(q: Any, p: Any) -> Any:
    return -line(q.velocity, "unknown_velocity", p)


EFFECT = Effect(
    id="unknown_velocity",
    title="resistance of unknown origin over speed",
    station="friction",
    slot="drag",
    parameters=parameters("unknown_velocity", "{x}/s^2", "speed", "{x}/s", -10.0, 20.0),
    law=law,
    depends_on=("velocity",),
    promises=frozenset({"memoryless"}),
    sentence="A resistance over speed of no known shape brakes, drawn from {unknown_velocity_from} on.",
    reference="de Boor, A Practical Guide to Splines, 1978",
    confused_with={
        "stribeck_friction": "slow ramps: dwell at low speed",
        "quadratic_drag": "coast-downs from high speed",
        "unknown_input": "coast-downs: a resistance acts without command",
    },
)
