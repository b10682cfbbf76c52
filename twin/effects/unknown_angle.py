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
        angle = k * p.unknown_angle_order * q.position
        total = (
            total
            + getattr(p, f"unknown_angle_sin_{k}") * sin(angle)
            + getattr(p, f"unknown_angle_cos_{k}") * cos(angle)
        )
    return total


EFFECT = Effect(
    id="unknown_angle",
    title="torque of unknown origin over the angle within a turn",
    station="load",
    slot="load",
    parameters=(
        *(
            Parameter(f"unknown_angle_{wave}_{k}", "{x}/s^2", f"part that goes with {wave} of {k} times the phase", 0.0)
            for k in range(1, HARMONICS + 1)
            for wave in ("sin", "cos")
        ),
        Parameter("unknown_angle_order", "1", "times a turn that it repeats", None, 1e-3, start=1.0, estimated=False),
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
)
