"""A drive that does nothing below a certain command, and loses it above."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.math_ops import where
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    u = q.command
    forward = u - p.dead_band_forward
    reverse = u + p.dead_band_reverse
    return where(forward > 0.0, forward, where(reverse < 0.0, reverse, 0.0))


EFFECT = Effect(
    id="dead_band",
    title="dead-band of the drive",
    station="drive",
    slot="drive",
    parameters=(
        Parameter("dead_band_forward", "{u}", "command lost when driving forwards", 0.0, 0.0),
        Parameter("dead_band_reverse", "{u}", "command lost when driving backwards", 0.0, 0.0),
    ),
    law=law,
    depends_on=("input",),
    promises=frozenset({"memoryless"}),
    sentence="The drive loses {dead_band_forward} forwards and {dead_band_reverse} backwards.",
    reference="Malik et al., eq. (12); Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor "
    "Nonlinearities, 1996",
    confused_with={
        "coulomb_friction": "coast-downs and plugging: let duty and speed have opposite signs",
        "constant_offset": "seconds without a command: a constant torque pulls then, too, and a dead-band does not",
    },
)
