"""Dry friction whose size varies over a turn."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.math_ops import sin
from twin.effects.parameter import Parameter
from twin.effects.phases import polar


def law(q: Any, p: Any) -> Any:
    return p.friction_variation * sin(q.position - p.friction_angle)


EFFECT = Effect(
    id="position_dependent_friction",
    title="dry friction that varies over a turn",
    station="friction",
    slot="grip",
    parameters=(
        Parameter("friction_variation", "{x}/s^2", "amplitude of the variation over a turn", 0.0, 0.0),
        Parameter("friction_angle", "rad", "angle at which the variation passes through zero, rising", None),
    ),
    law=law,
    depends_on=("position", "direction"),
    promises=frozenset({"memoryless"}),
    sentence="Dry friction varies over a turn by {friction_variation} either way (rising through {friction_angle}).",
    reference="Al-Bender, De Moerloose, Characterization and modeling of friction, 2010",
    confused_with={"gravity": "pass each angle in both directions: gravity keeps its sign, friction turns it"},
    screen=Screen("friction_variation", "friction_angle", polar),
    includes=("coulomb_friction",),
)
