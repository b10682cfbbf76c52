"""Torque over position, of no known shape."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.knots import line, parameters


def law(q: Any, p: Any) -> Any:
    return line(q.position, "unknown_position", p)


EFFECT = Effect(
    id="unknown_position",
    title="torque of unknown origin over position",
    station="load",
    slot="load",
    parameters=parameters("unknown_position", "{x}/s^2", "position", "{x}", -1.0, 2.0),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence="A torque over position of no known shape acts on the link, drawn from {unknown_position_from} on.",
    reference="de Boor, A Practical Guide to Splines, 1978",
    confused_with={
        "spring": "travel further: a spring grows in proportion",
        "end_stop": "travel further: a stop acts only beyond its angle",
        "unknown_angle": "more than two turns: does it repeat?",
    },
)
