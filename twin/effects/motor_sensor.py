"""The sensor sits on the motor: ahead of gear, gap and elasticity, which it reads the link through."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect


def law(q: Any, p: Any) -> Any:
    return q.gap


EFFECT = Effect(
    id="motor_sensor",
    title="sensor on the motor",
    station="sensor",
    slot="sensor",
    parameters=(),
    law=law,
    depends_on=("position",),
    promises=frozenset({"odd", "memoryless"}),
    sentence="The sensor reads the motor, ahead of the gap of {backlash_gap} and of what is elastic behind it.",
    reference="Spong, Modeling and control of elastic joint robots, J. Dyn. Syst. 109, 1987 (collocated measurement)",
    confused_with={
        "backlash": "hold the motor and move the link by hand: a sensor on the motor stands still within the gap"
    },
    includes=("backlash",),
)
