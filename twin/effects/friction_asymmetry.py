"""Friction that differs between the two directions of motion."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return p.friction_asymmetry * q.direction


EFFECT = Effect(
    id="friction_asymmetry",
    title="dry friction that differs between the directions",
    station="friction",
    slot="grip",
    parameters=(
        Parameter(
            "friction_asymmetry",
            "{x}/s^2",
            "half the difference of dry friction, forwards minus backwards",
            0.0,
        ),
    ),
    law=law,
    depends_on=("direction",),
    promises=frozenset({"memoryless"}),
    sentence=(
        "Dry friction of {coulomb_friction} in the mean depends on the direction: half the difference, forwards minus "
        "backwards, is {friction_asymmetry}."
    ),
    reference="Janot, Gautier, Brunot, Data set and reference models of EMPS, 2019",
    confused_with={
        "constant_offset": "rest on either side: an offset acts at rest and pushes one way, friction only resists",
        "coulomb_friction": "coasting both ways: while the drive pushes, a dead-band wider on one side does the same",
    },
    screen=Screen("friction_asymmetry"),
    includes=("coulomb_friction",),
)
