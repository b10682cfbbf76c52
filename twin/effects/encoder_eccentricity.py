"""Once-per-turn error of the sensor."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.math_ops import sin
from twin.effects.parameter import Parameter
from twin.effects.phases import polar


def law(q: Any, p: Any) -> Any:
    return p.eccentricity * sin(q.position - p.eccentricity_angle)


EFFECT = Effect(
    id="encoder_eccentricity",
    title="eccentric encoder",
    station="sensor",
    slot="sensor",
    parameters=(
        Parameter("eccentricity", "{x}", "amplitude of the sensor's error over a turn", 0.0, 0.0, 0.5),
        Parameter("eccentricity_angle", "rad", "angle at which the error passes through zero, rising", None),
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence="The encoder sits off centre: its reading errs by {eccentricity} over a turn.",
    reference="Lopez, Artes, Eccentricity error of rotary encoders, 2012",
    confused_with={
        "gravity": "constant speed at two speeds: the sensor's error scales with speed squared",
        "torque_ripple": "two constant speeds",
    },
    screen=Screen("eccentricity", "eccentricity_angle", polar),
)
