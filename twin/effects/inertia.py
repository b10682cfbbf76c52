"""How much the drive accelerates the axis: input gain over inertia (the paper's c)."""

from __future__ import annotations

from twin.effects.effect import Effect
from twin.effects.parameter import Parameter

# The stepper itself multiplies the command that acts by the input gain: it is the unit of everything else.
EFFECT = Effect(
    id="inertia",
    title="input gain over inertia",
    station="inertia",
    slot="structure",
    parameters=(
        Parameter(
            "input_gain",
            "{x}/s^2/{u}",
            "acceleration per unit of the command that acts (c)",
            None,
            0.0,
            start=0.1,
        ),
    ),
    law=None,
    depends_on=("input",),
    promises=frozenset({"odd", "memoryless"}),
    sentence="One unit of input accelerates the axis by {input_gain}.",
    reference="Malik et al., eq. (2)",
    confused_with={},
    equation=r"c\,u",
)
