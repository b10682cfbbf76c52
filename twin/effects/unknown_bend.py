"""Friction that gives by degrees before it slides: more than its size, but no name of the list."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return -p.unknown_bend_level * q.bend


EFFECT = Effect(
    id="unknown_bend",
    title="friction that gives before it slides",
    station="friction",
    slot="bristle",
    parameters=(
        Parameter("unknown_bend_level", "{x}/s^2", "friction once it slides, over inertia", 0.0, 0.0),
        Parameter("unknown_bend_give", "{x}", "travel by which it gives before it slides", None, 1e-5, 1.0, 0.03),
    ),
    law=law,
    depends_on=("position", "direction"),
    promises=frozenset({"odd", "state"}),
    sentence=(
        "Friction of {unknown_bend_level} at the motor gives like a spring for about {unknown_bend_give} of travel "
        "after every reversal, before it slides."
    ),
    reference="Dahl, A Solid Friction Model, Aerospace Corp. TOR-158, 1968",
    confused_with={
        "coulomb_friction": "small steps back and forth: dry friction holds still, this swings on its bristles",
        "unknown_velocity": "reversals at several speeds: this goes with the way since them, not with the speed",
    },
)
