"""A load of known mass and lever, which differs from recording to recording."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return q.payload / p.own_inertia


EFFECT = Effect(
    id="payload",
    title="payload of known inertia",
    station="inertia",
    slot="mass",
    parameters=(Parameter("own_inertia", "kg*m^2", "inertia of the drive without payload", None, 1e-9, start=0.01),),
    law=law,
    depends_on=("acceleration",),
    promises=frozenset({"memoryless"}),
    sentence="The drive's own inertia is {own_inertia}; the payload's comes on top.",
    reference="Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, 2006",
    confused_with={"inertia": "recordings with two or more payloads"},
)
