"""Dead time between command and torque."""

from __future__ import annotations

from twin.effects.effect import Effect, Screen
from twin.effects.parameter import Parameter

EFFECT = Effect(
    id="input_delay",
    title="dead time between command and torque",
    station="motor",
    slot="structure",
    parameters=(Parameter("delay", "s", "dead time between command and torque", 0.0, 0.0, 0.2, 0.004),),
    law=None,
    depends_on=("input", "time"),
    promises=frozenset({"odd", "state"}),
    sentence="The command acts {delay} late.",
    reference="Franklin, Powell, Workman, Digital Control of Dynamic Systems, 1998",
    confused_with={
        "motor_lag": "steps: a lag starts at once with a slope, a delay starts late with a full step",
        "backlash": "reversals at two or more amplitudes: a delay is the same at each",
    },
    equation=r"u(t - t_d)",
    screen=Screen("delay", grid={"delay": (0.002, 0.006, 0.015)}),
)
