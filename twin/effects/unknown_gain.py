"""Gain of the motor over the angle, of no known shape."""

from __future__ import annotations

from typing import Any

from twin.effects import waves
from twin.effects.effect import Effect

HARMONICS = 6


def law(q: Any, p: Any) -> Any:
    return q.command * (1.0 + waves.line(p.unknown_gain_order * q.position, "unknown_gain", HARMONICS, p))


EFFECT = Effect(
    id="unknown_gain",
    title="motor constant of unknown shape over the angle",
    station="motor",
    slot="drive",
    parameters=(
        *waves.parameters("unknown_gain", HARMONICS, "1"),
        waves.order("unknown_gain_order"),
    ),
    law=law,
    depends_on=("position", "input"),
    promises=frozenset({"memoryless"}),
    sentence=(
        "What the motor makes of a command changes with the angle, by no known law: {unknown_gain_sin_1} and "
        "{unknown_gain_cos_1} of it are the first wave, which repeats {unknown_gain_order} times a turn."
    ),
    reference="Holtz, Springob, Identification and compensation of torque ripple, IEEE TIE 43, 1996",
    confused_with={
        "unknown_angle": "the same angles at several commands: a gain's part grows with the command",
        "torque_ripple": "the same angles at several commands: cogging is there without any",
        "gravity": "rest at several angles: a gain does nothing without a command",
    },
    substeps=2,
)
