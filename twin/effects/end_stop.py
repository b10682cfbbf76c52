"""Stiff contact beyond an angle on either side."""

from __future__ import annotations

import itertools
import math
from typing import Any

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.math_ops import maximum, where
from twin.effects.parameter import Parameter

#: Where stops stand that nothing met, in the axis' unit.
NOWHERE = {"stop_upper": 1e3, "stop_lower": -1e3}


def law(q: Any, p: Any) -> Any:
    # A bumper damps from the first touch, a hard body the more the deeper it is pressed; a stop pushes, never pulls.
    below, above = p.stop_lower - q.position, q.position - p.stop_upper
    up = p.stop_stiffness * below * (1.0 - p.stop_hysteresis * q.velocity) - p.stop_damping * q.velocity
    down = p.stop_stiffness * above * (1.0 + p.stop_hysteresis * q.velocity) + p.stop_damping * q.velocity
    return where(below > 0.0, maximum(up, 0.0), where(above > 0.0, -maximum(down, 0.0), 0.0))


def trials(seen: Seen) -> list[dict[str, float]]:
    """Stops on one side or both, soft and hard, near the furthest readings.

    The link runs on until the stop has turned it around, so that a stop lies inside the furthest reading.
    """
    rows = []
    for upper, lower in ((1, 0), (0, 1), (1, 1)):
        for stiffness, share in itertools.product((8e3, 6e4), (0.15, 0.8)):
            depth = share * seen.fast / math.sqrt(stiffness)
            highest = seen.lowest + seen.travel
            rows.append(
                {
                    "stop_upper": highest - depth if upper else highest + seen.travel,
                    "stop_lower": seen.lowest + depth if lower else seen.lowest - seen.travel,
                    "stop_stiffness": stiffness,
                    "stop_damping": 0.4 * math.sqrt(stiffness),
                }
            )
    return rows


EFFECT = Effect(
    id="end_stop",
    title="end stop",
    station="load",
    slot="load",
    parameters=(
        Parameter("stop_stiffness", "1/s^2", "contact stiffness over inertia", 0.0, 0.0, 2e5, 5e3),
        Parameter("stop_damping", "1/s", "contact damping over inertia", 0.0, 0.0, 5e3, 50.0),
        Parameter("stop_hysteresis", "s/{x}", "growth of the stiffness with approach speed", 0.0, 0.0, 20.0, 0.0),
        Parameter("stop_upper", "{x}", "position of the upper stop", None, start=NOWHERE["stop_upper"]),
        Parameter("stop_lower", "{x}", "position of the lower stop", None, start=NOWHERE["stop_lower"]),
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence="The link meets stops (upper: {stop_upper}, lower: {stop_lower}).",
    reference="Goldsmith, Impact, 1960 (damped from the first touch); Hunt, Crossley, Coefficient of restitution "
    "interpreted as damping in vibroimpact, J. Appl. Mech. 42, 1975 (damped by depth)",
    confused_with={"spring": "rest in mid-travel: a stop acts only beyond its angle"},
    screen=Screen("stop_stiffness", trials=trials),
)
