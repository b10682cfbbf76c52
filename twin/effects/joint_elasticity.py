"""The link rings against the motor through something elastic."""

from __future__ import annotations

from twin.effects.effect import Effect, Screen
from twin.quantities import Parameter

EFFECT = Effect(
    id="joint_elasticity",
    title="elasticity between motor and link",
    station="transmission",
    slot="structure",
    parameters=(
        Parameter("joint_stiffness", "1/s^2", "torque over inertia per unit of twist", None, 1.0, 1e6, 2e3),
        Parameter(
            "joint_damping", "1/s", "torque over inertia per unit of twist speed", None, 0.0, 500.0, 2.0
        ),
    ),
    law=None,
    depends_on=("acceleration", "input"),
    promises=frozenset({"state"}),
    sentence="Between motor and link something elastic ({joint_stiffness}, damping {joint_damping}) lets the link ring.",
    reference="Spong, Modeling and control of elastic joint robots, J. Dyn. Syst. 109, 1987",
    confused_with={
        "motor_lag": "steps: look for ringing after the edge",
        "input_delay": "steps: look for ringing after the edge",
    },
    equation=r"\lambda = k\,\mathrm{dz}_{g}(\theta_m - \theta) + d\,(\dot\theta_m - \dot\theta)",
    screen=Screen("joint_stiffness"),
    includes=("backlash",),
    substeps=4,
)
