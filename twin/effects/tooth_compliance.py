"""Gear teeth that give under load: contact across the gap is a spring, not a wall."""

from __future__ import annotations

from twin.effects.effect import Effect
from twin.effects.parameter import Parameter

EFFECT = Effect(
    id="tooth_compliance",
    title="compliance of the gear teeth",
    station="transmission",
    slot="structure",
    parameters=(
        Parameter(
            "tooth_frequency",
            "Hz",
            "frequency at which motor and link ring against each other",
            None,
            40.0,
            300.0,
            120.0,
        ),
        Parameter("tooth_damping", "1", "damping ratio of that ringing", None, 0.0, 2.0, 0.3),
    ),
    law=None,
    depends_on=("acceleration", "input"),
    promises=frozenset({"state"}),
    sentence="The teeth give under load: in mesh, motor and link ring at {tooth_frequency}.",
    reference="Spong, Modeling and control of elastic joint robots, J. Dyn. Syst. 109, 1987",
    confused_with={"joint_elasticity": "reversals: teeth ring above some 40 Hz, a joint below"},
    equation=r"\lambda = k\,\mathrm{dz}_{g}(\theta_m - \theta) + d\,(\dot\theta_m - \dot\theta)",
    includes=("backlash",),
)
