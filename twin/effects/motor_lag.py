"""First-order delay between command and torque."""

from __future__ import annotations

from twin.effects.effect import Effect, Screen
from twin.effects.parameter import Parameter

EFFECT = Effect(
    id="motor_lag",
    title="lag between command and torque",
    station="motor",
    slot="structure",
    parameters=(
        Parameter("lag_time", "s", "time constant between command and torque", None, 1e-5, 2.0, 0.01),
        Parameter(
            "lag_dead_band",
            "1",
            "share of the dead-band that lies behind the lag",
            None,
            0.0,
            1.0,
            estimated=False,
            acts_on="dead_band",
        ),
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
    equation=r"T_{e}\,\dot\ell = u + \lambda_{e}\,\max\left(-\delta_{r}, \min\left(\delta_{f}, u_0\right)\right)"
    r" - \ell,\quad u_{e} = \max\left(\ell - \lambda_{e}\,\delta_{f}, 0\right)"
    r" + \min\left(\ell + \lambda_{e}\,\delta_{r}, 0\right)",
    substeps=2,
    # Behind the dead-band or ahead of it: what lies between is no choice of a recording.
    screen=Screen("lag_time", grid={"lag_time": (0.003, 0.01, 0.03), "lag_dead_band": (0.0, 1.0)}),
)
