"""Torque over the angle within a turn, of no known shape."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.quantities import Parameter
from twin.words import cos, sin

HARMONICS = 6


def law(q: Any, p: Any) -> Any:
    total = 0.0
    for k in range(1, HARMONICS + 1):
        total = total + getattr(p, f"unknown_angle_sin_{k}") * sin(k * q.position)
        total = total + getattr(p, f"unknown_angle_cos_{k}") * cos(k * q.position)
    return total


EFFECT = Effect(
    id="unknown_angle",
    title="torque of unknown origin over the angle within a turn",
    station="load",
    slot="load",
    parameters=tuple(
        Parameter(f"unknown_angle_{wave}_{k}", "{x}/s^2", f"part that goes with {wave} of {k} times the angle", 0.0)
        for k in range(1, HARMONICS + 1)
        for wave in ("sin", "cos")
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence=(
        "A torque that repeats with every turn acts on the link and has none of the known shapes; "
        "{unknown_angle_sin_1} and {unknown_angle_cos_1} of it go once per turn."
    ),
    reference="Davis, Fourier Series and Orthogonal Functions, 1963",
    confused_with={
        "gravity": "more than one turn: gravity is one sine",
        "torque_ripple": "more than one turn: a ripple is one sine, several per turn",
        "unknown_position": "more than two turns: does it repeat?",
    },
)
