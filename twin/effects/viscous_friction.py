"""Resistance in proportion to speed, back-EMF included (the paper's b)."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return -p.viscous_friction * q.velocity


EFFECT = Effect(
    id="viscous_friction",
    title="viscous friction",
    station="friction",
    slot="drag",
    parameters=(
        Parameter("viscous_friction", "1/s", "viscous friction and back-EMF over inertia (b)", 0.0, 0.0, start=1.0),
    ),
    law=law,
    depends_on=("velocity",),
    promises=frozenset({"dissipative", "odd", "memoryless"}),
    sentence="Speed decays with a time constant of 1/({viscous_friction}).",
    reference="Malik et al., eq. (2)",
    confused_with={"quadratic_drag": "steady states at three or more speeds"},
)
