"""A gap between motor and link: two bodies that push each other, never pull."""

from __future__ import annotations

from twin.effects.effect import Effect
from twin.effects.parameter import Parameter

EFFECT = Effect(
    id="backlash",
    title="backlash of the gears",
    station="transmission",
    slot="structure",
    parameters=(
        Parameter("backlash_gap", "{x}", "whole width of the gap, at the link", 0.0, 0.0, 0.5, 0.01),
        Parameter("motor_share", "1", "the motor's share of the inertia, seen at the link", None, 0.02, 0.98, 0.25),
        Parameter(
            "friction_share", "1", "the motor's share of the viscous friction, seen at the link", None, 0.0, 1.0, 0.7
        ),
        Parameter(
            "dry_share", "1", "the motor's share of the dry friction, seen there", None, 0.0, 1.0, 0.5, acts_on="grip"
        ),
        Parameter(
            "shaft_share", "1", "the motor's share of constant torque and ripple", None, 0.0, 1.0, 0.5, acts_on="shaft"
        ),
    ),
    law=None,
    depends_on=("direction", "input"),
    promises=frozenset({"dissipative"}),
    sentence="Between motor and link there is a gap of {backlash_gap}; the motor carries {motor_share} of the inertia.",
    reference="Nordin and Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38, 2002",
    confused_with={"input_delay": "reversals at two or more amplitudes: a delay is the same at each"},
    equation=r"\ddot\theta_m J_m = c u - \lambda,\quad \ddot\theta J_l = \lambda,\quad "
    r"|\theta_m - \theta| \le g/2",
)
