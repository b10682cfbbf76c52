"""Viscous friction that changes over time, by no known law."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.knots import held, parameters


def law(q: Any, p: Any) -> Any:
    return -q.velocity * held(q.time, "unknown_drag", p)


EFFECT = Effect(
    id="unknown_drag",
    title="viscous friction that wanders with time",
    station="friction",
    slot="load",
    parameters=parameters("unknown_drag", "1/s", "time", "s", 0.0, 60.0),
    law=law,
    depends_on=("velocity", "time"),
    promises=frozenset({"odd", "memoryless"}),
    sentence="Viscous friction changes over time, as it does when grease warms, drawn from {unknown_drag_from} on.",
    reference="de Boor, A Practical Guide to Splines, 1978",
    confused_with={
        "thermal_fade": "the same low speed at several commands, early and late: a gain fades with the command",
        "load_change": "constant speeds early and late: a load shows only while accelerating",
    },
)
