"""Torque over the angle within a turn, of no known shape."""

from __future__ import annotations

from typing import Any

from twin.effects import waves
from twin.effects.effect import Effect

HARMONICS = 6


def law(q: Any, p: Any) -> Any:
    return waves.line(p.unknown_angle_order * q.position, "unknown_angle", HARMONICS, p)


EFFECT = Effect(
    id="unknown_angle",
    title="torque of unknown origin over the angle within a turn",
    station="load",
    slot="load",
    parameters=(
        *waves.parameters("unknown_angle", HARMONICS, "{x}/s^2"),
        waves.order("unknown_angle_order"),
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence=(
        "A torque that repeats {unknown_angle_order} times a turn acts on the link and has none of the known shapes; "
        "{unknown_angle_sin_1} and {unknown_angle_cos_1} of it are its first wave."
    ),
    reference="Davis, Fourier Series and Orthogonal Functions, 1963",
    confused_with={
        "gravity": "more than one turn: gravity is one sine",
        "torque_ripple": "more than one turn: a ripple is one sine, several per turn",
        "unknown_position": "more than two turns: does it repeat?",
    },
    substeps=2,
)
