"""Viscous friction that differs between the two directions of motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twin.effects.effect import Effect, Recorded, Screen
from twin.effects.math_ops import absolute
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return -p.viscous_asymmetry * absolute(q.velocity)


def plausible(values: Mapping[str, float], recorded: Recorded) -> bool:
    """Viscous friction resists in both directions."""
    return abs(values["viscous_asymmetry"]) <= values.get("viscous_friction", 0.0)


EFFECT = Effect(
    id="viscous_asymmetry",
    title="viscous friction that differs between the directions",
    station="friction",
    slot="drag",
    parameters=(
        Parameter("viscous_asymmetry", "1/s", "half the difference of viscous friction, forwards minus backwards", 0.0),
    ),
    law=law,
    depends_on=("velocity", "direction"),
    promises=frozenset({"memoryless"}),
    sentence=(
        "Viscous friction depends on the direction of motion: half the difference, forwards minus backwards, is "
        "{viscous_asymmetry}."
    ),
    reference="Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models ... with friction, Automatica 30, 1994, "
    "sec. 2 (friction of a drive train that depends on the direction)",
    confused_with={
        "friction_asymmetry": "steady runs at two speeds each way: the difference of dry friction is the same at both",
        "quadratic_drag": "runs both ways: drag is the same in both",
        "constant_offset": "rest: an offset acts there, too",
    },
    screen=Screen("viscous_asymmetry"),
    plausible=plausible,
)
