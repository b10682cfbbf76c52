"""A constant torque: drive offset, tilt of a linear axis."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return p.offset


EFFECT = Effect(
    id="constant_offset",
    title="constant torque",
    station="load",
    slot="shaft",
    parameters=(Parameter("offset", "{x}/s^2", "constant torque over inertia", 0.0),),
    law=law,
    depends_on=(),
    promises=frozenset({"memoryless"}),
    sentence="A constant torque of {offset} acts on the axis.",
    reference="Janot, Gautier, Brunot, Data set and reference models of EMPS, 2019",
    confused_with={
        "friction_asymmetry": "rest on either side: friction vanishes when nothing pushes",
        "gravity": "travel over more than half a turn",
    },
    screen=Screen("offset"),
)
