"""Friction that grows with the torque that the gears transmit."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.math_ops import absolute
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return p.load_friction * absolute(q.transmitted)


EFFECT = Effect(
    id="load_dependent_friction",
    title="friction that grows with the transmitted torque",
    station="friction",
    slot="grip",
    parameters=(Parameter("load_friction", "1", "dry friction per unit of transmitted torque", 0.0, 0.0, 0.95),),
    law=law,
    depends_on=("load", "direction"),
    promises=frozenset({"dissipative", "odd", "memoryless"}),
    sentence="Friction takes {load_friction} of the torque that the gears transmit.",
    reference="Duclusaud et al., Extended friction models for the physics simulation of servo actuators, ICRA 2025",
    confused_with={
        "coulomb_friction": "drive at several torques: this one grows with the torque",
        "gravity": "raise and lower the same load",
    },
    screen=Screen("load_friction"),
)
