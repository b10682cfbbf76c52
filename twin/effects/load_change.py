"""Inertia that changes at a moment of the recording: something was picked up or dropped."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.math_ops import where
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    # The stepper ends a piece at this moment, so that it is met exactly and can be estimated.
    return p.load_added * where(q.time > p.load_time, 1.0, 0.0)


def trials(seen: Seen) -> list[dict[str, float]]:
    """Nine moments, evenly spread."""
    return [{"load_time": 0.1 * i * seen.end} for i in range(1, 10)]


EFFECT = Effect(
    id="load_change",
    title="load that changes at a moment",
    station="inertia",
    slot="mass",
    parameters=(
        Parameter("load_added", "1", "inertia added, in units of the inertia before", 0.0, -0.7, 20.0),
        Parameter("load_time", "s", "moment of the change", None),
    ),
    law=law,
    depends_on=("time", "acceleration"),
    promises=frozenset({"memoryless"}),
    sentence="At {load_time} the inertia changes by {load_added} of what it was.",
    reference="Basseville, Nikiforov, Detection of Abrupt Changes, 1993",
    confused_with={"thermal_fade": "repeat the first block at the end: heat comes slowly, a load at once"},
    screen=Screen("load_added", trials=trials, moment="load_time"),
)
