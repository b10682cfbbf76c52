"""Torque with the sine of the link's angle: the axis is not vertical."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.math_ops import sin
from twin.effects.parameter import Parameter
from twin.effects.phases import polar


def law(q: Any, p: Any) -> Any:
    return -p.gravity_gain * sin(q.position - p.gravity_angle)


EFFECT = Effect(
    id="gravity",
    title="gravity on the link",
    station="load",
    slot="load",
    parameters=(
        Parameter("gravity_gain", "{x}/s^2", "largest torque of gravity over inertia", 0.0, 0.0),
        Parameter("gravity_angle", "rad", "angle at which the link hangs", None),
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence="Gravity pulls the link towards {gravity_angle} with up to {gravity_gain}: the axis is not vertical.",
    reference="Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, 2006",
    confused_with={
        "position_dependent_friction": "pass each angle in both directions: gravity keeps its sign",
        "encoder_eccentricity": "constant speed at two speeds: the sensor's error scales with speed squared",
        "spring": "travel over more than half a turn",
    },
    screen=Screen("gravity_gain", "gravity_angle", polar),
)
