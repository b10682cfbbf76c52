"""Torque over time, of no known origin."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.knots import held, parameters


def law(q: Any, p: Any) -> Any:
    return held(q.time, "unknown_time", p)


EFFECT = Effect(
    id="unknown_time",
    title="torque of unknown origin over time",
    station="disturbance",
    slot="load",
    parameters=parameters("unknown_time", "{x}/s^2", "time", "s", 0.0, 60.0),
    law=law,
    depends_on=("time",),
    promises=frozenset({"memoryless"}),
    sentence="A torque without visible cause wanders with time, drawn from {unknown_time_from} on.",
    reference="de Boor, A Practical Guide to Splines, 1978",
    confused_with={
        "constant_offset": "record again: a constant comes back the same",
        "load_change": "rest: a changed load shows only while accelerating",
    },
)
