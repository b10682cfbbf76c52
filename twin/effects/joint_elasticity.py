"""The link rings against the motor through something elastic."""

from __future__ import annotations

from twin.effects.effect import Effect, Screen
from twin.effects.parameter import Parameter

EFFECT = Effect(
    id="joint_elasticity",
    title="elasticity between motor and link",
    station="transmission",
    slot="structure",
    parameters=(
        Parameter(
            "joint_frequency",
            "Hz",
            "frequency at which motor and link ring against each other",
            None,
            0.3,
            40.0,
            10.0,
        ),
        Parameter("joint_damping", "1", "damping ratio of that ringing", None, 0.0, 2.0, 0.1),
    ),
    law=None,
    depends_on=("acceleration", "input"),
    promises=frozenset({"state"}),
    sentence="Between motor and link something elastic lets the link ring at {joint_frequency} (damping "
    "ratio {joint_damping}).",
    reference="Spong, Modeling and control of elastic joint robots, J. Dyn. Syst. 109, 1987",
    confused_with={
        "motor_lag": "steps: look for ringing after the edge",
        "input_delay": "steps: look for ringing after the edge",
    },
    equation=r"\lambda = k\,\mathrm{dz}_{g}(\theta_m - \theta) + d\,(\dot\theta_m - \dot\theta)",
    screen=Screen("joint_frequency", grid={"joint_frequency": (0.5, 1.5, 4.0, 10.0, 25.0)}),
    includes=("backlash",),
)
