"""Torque in proportion to angle: cable, hose, counterbalance."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.parameter import Parameter
from twin.effects.phases import affine


def law(q: Any, p: Any) -> Any:
    return -p.spring_stiffness * (q.position - p.spring_rest)


EFFECT = Effect(
    id="spring",
    title="spring (cable, hose, counterbalance)",
    station="load",
    slot="load",
    parameters=(
        Parameter("spring_stiffness", "1/s^2", "torque over inertia per unit of travel", 0.0, 0.0),
        Parameter("spring_rest", "{x}", "position at which the spring is at rest", None),
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence="Something elastic pulls the link back towards {spring_rest} with {spring_stiffness} per unit of travel.",
    reference="Den Hartog, Mechanical Vibrations, 1956",
    confused_with={
        "end_stop": "rest in mid-travel: a stop acts only beyond its angle",
        "gravity": "travel over more than half a turn",
    },
    screen=Screen("spring_stiffness", "spring_rest", affine),
)
