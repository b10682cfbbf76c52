"""Dry friction of constant size, with true stick."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return p.coulomb_friction


EFFECT = Effect(
    id="coulomb_friction",
    title="dry (Coulomb) friction",
    station="friction",
    slot="grip",
    parameters=(Parameter("coulomb_friction", "{x}/s^2", "size of the dry friction, over inertia", 0.0, 0.0),),
    law=law,
    depends_on=("direction",),
    promises=frozenset({"dissipative", "odd", "memoryless"}),
    sentence="Dry friction of {coulomb_friction} opposes every motion and holds the axis at rest below that.",
    reference="Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models ... with friction, Automatica 30, 1994",
    confused_with={
        "dead_band": "coast-downs and plugging: friction goes by the sign of the speed, dead-band by that of the duty",
        "stribeck_friction": "slow ramps: dwell at low speed",
    },
    screen=Screen("coulomb_friction"),
)
