"""Stiff contact beyond an angle on either side."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.quantities import Parameter
from twin.words import maximum


def law(q: Any, p: Any) -> Any:
    # The damping grows with the depth, so that the torque sets in smoothly; a stop pushes, never pulls.
    below = maximum(p.stop_lower - q.position, 0.0) * maximum(1.0 - p.stop_damping * q.velocity, 0.0)
    above = maximum(q.position - p.stop_upper, 0.0) * maximum(1.0 + p.stop_damping * q.velocity, 0.0)
    return p.stop_stiffness * (below - above)


EFFECT = Effect(
    id="end_stop",
    title="end stop",
    station="load",
    slot="load",
    parameters=(
        Parameter("stop_stiffness", "1/s^2", "contact stiffness over inertia", 0.0, 0.0, 1e5, 5e3),
        Parameter("stop_damping", "s/{x}", "growth of the stiffness with approach speed", None, 0.0, 20.0, 0.5),
        Parameter("stop_upper", "{x}", "position of the upper stop", None, start=1e3),
        Parameter("stop_lower", "{x}", "position of the lower stop", None, start=-1e3),
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence="The link meets a stop at {stop_upper} or {stop_lower}.",
    reference="Hunt, Crossley, Coefficient of restitution interpreted as damping in vibroimpact, J. "
    "Appl. Mech. 42, 1975",
    confused_with={"spring": "rest in mid-travel: a stop acts only beyond its angle"},
    screen=Screen("stop_stiffness"),
    substeps=8,
)
