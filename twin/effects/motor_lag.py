"""First-order delay between command and torque."""

from __future__ import annotations

from twin.effects.effect import Effect, Screen
from twin.quantities import Parameter

EFFECT = Effect(
    id="motor_lag",
    title="lag between command and torque",
    station="motor",
    slot="structure",
    parameters=(
        Parameter("lag_time", "s", "time constant between command and torque", None, 1e-5, 2.0, 0.01),
    ),
    law=None,
    depends_on=("input", "time"),
    promises=frozenset({"odd", "state"}),
    sentence="The torque follows the command with a first-order lag of {lag_time}.",
    reference="Leonhard, Control of Electrical Drives, 2001",
    confused_with={
        "input_delay": "steps: a lag starts at once with a slope, a delay starts late with a full step",
        "joint_elasticity": "steps: look for ringing after the edge",
    },
    equation=r"T_e\,\dot u_e = u - u_e",
    substeps=2,
    screen=Screen("lag_time"),
)
