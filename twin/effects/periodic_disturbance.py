"""An outside torque at a fixed frequency."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.math_ops import sin
from twin.effects.parameter import Parameter
from twin.effects.phases import polar


def law(q: Any, p: Any) -> Any:
    return p.disturbance * sin(6.283185307179586 * p.disturbance_frequency * q.time - p.disturbance_phase)


EFFECT = Effect(
    id="periodic_disturbance",
    title="outside torque at a fixed frequency",
    station="disturbance",
    slot="load",
    parameters=(
        Parameter("disturbance", "{x}/s^2", "amplitude of the outside torque over inertia", 0.0, 0.0),
        Parameter("disturbance_frequency", "Hz", "its frequency", None, 0.01, 200.0, 1.0),
        Parameter("disturbance_phase", "rad", "its phase at time zero", None),
    ),
    law=law,
    depends_on=("time",),
    promises=frozenset({"memoryless"}),
    sentence="Something outside pushes with {disturbance} at {disturbance_frequency}.",
    reference="Den Hartog, Mechanical Vibrations, 1956",
    confused_with={"torque_ripple": "run at two speeds: a ripple's frequency follows the speed"},
    substeps=2,
    screen=Screen("disturbance", "disturbance_phase", polar, rate="disturbance_frequency"),
)
