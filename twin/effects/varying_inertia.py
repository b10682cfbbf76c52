"""Inertia that varies with the angle, as behind a crank.

A law has one slot, and this one's is the inertia; `unknown_inertia` is the torque by which its slope keeps the energy,
and brings this one with it.
"""

from __future__ import annotations

from typing import Any

from twin.effects import waves
from twin.effects.effect import Effect

HARMONICS = 3


def law(q: Any, p: Any) -> Any:
    return waves.line(p.unknown_inertia_order * q.position, "unknown_inertia", HARMONICS, p)


EFFECT = Effect(
    id="varying_inertia",
    title="inertia of unknown shape over the angle",
    station="inertia",
    slot="mass",
    parameters=(
        *waves.parameters("unknown_inertia", HARMONICS, "1"),
        # What its slope makes has no angle in its unit.
        waves.order("unknown_inertia_order", "1/{x}"),
    ),
    law=law,
    depends_on=("position", "acceleration"),
    promises=frozenset({"memoryless"}),
    sentence="The inertia at the link changes with the angle: {unknown_inertia_sin_1} and {unknown_inertia_cos_1}.",
    reference="Nakamura, Advanced Robotics: Redundancy and Optimization, 1991",
    confused_with={"load_change": "the same angles again and again: what the angle makes comes back with it"},
    substeps=2,
)
