"""Gravity on a load of known mass and lever."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.math_ops import sin
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return -9.80665 * q.moment / p.own_inertia * sin(q.position - p.payload_angle)


EFFECT = Effect(
    id="payload_gravity",
    title="gravity on a payload of known mass",
    station="load",
    slot="load",
    parameters=(Parameter("payload_angle", "rad", "angle at which the payload hangs", None),),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence="Gravity pulls the known payload towards {payload_angle}.",
    reference="Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, 2006",
    confused_with={"gravity": "recordings with two or more payloads"},
    includes=("payload",),
)
