"""Torque over the angle that depends on which way the drive pushes, of no known shape."""

from __future__ import annotations

from typing import Any

from twin.effects import waves
from twin.effects.effect import Effect
from twin.effects.math_ops import where

HARMONICS = 3


def law(q: Any, p: Any) -> Any:
    phase = p.unknown_push_order * q.position
    forward = waves.line(phase, "unknown_push_forward", HARMONICS, p)
    reverse = waves.line(phase, "unknown_push_reverse", HARMONICS, p)
    return q.command + where(q.command > 0.0, forward, 0.0) + where(q.command < 0.0, reverse, 0.0)


EFFECT = Effect(
    id="unknown_push",
    title="torque of unknown shape over the angle and the sign of the command",
    station="motor",
    slot="drive",
    parameters=(
        *waves.parameters("unknown_push_forward", HARMONICS, "{u}", ", while pushed forwards"),
        *waves.parameters("unknown_push_reverse", HARMONICS, "{u}", ", while pushed backwards"),
        waves.order("unknown_push_order"),
    ),
    law=law,
    depends_on=("position", "input"),
    promises=frozenset({"memoryless"}),
    sentence=(
        "A torque over the angle, of no known shape, depends on which way the drive pushes; its first wave repeats "
        "{unknown_push_order} times a turn."
    ),
    reference="Davis, Fourier Series and Orthogonal Functions, 1963",
    confused_with={
        "unknown_angle": "coast-downs: this acts only while the drive pushes",
        "unknown_gain": "the same angles at several commands: a gain's part grows with the command",
        "torque_ripple": "coast-downs: cogging acts there, too",
    },
    substeps=2,
)
