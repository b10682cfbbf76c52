"""The link rings against the motor through something elastic."""

from __future__ import annotations

import math

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.parameter import Parameter

#: Between what the frequency may lie, Hz.
LOWEST, HIGHEST = 0.3, 40.0


def frequencies(step: float, end: float) -> list[float]:
    """Frequencies, Hz, from three periods in a recording to a tenth of the sample rate. Each is 1.4 times the one
    before it, since a fit finds ringing from no further off.
    """
    lowest, highest = max(1.05 * LOWEST, 3.0 / end), min(0.75 * HIGHEST, 0.1 / step)
    count = max(math.ceil(math.log(max(highest / lowest, 1.0)) / math.log(1.4)), 1)
    return [lowest * (highest / lowest) ** (i / count) for i in range(count + 1)]


def trials(seen: Seen) -> list[dict[str, float]]:
    """Frequencies, and with each other values of gap and inertias. Ringing is told by its frequency, which no slope
    finds from afar, and changes what the gap looked like.
    """
    return [
        {
            "joint_frequency": frequency,
            "joint_damping": 0.15,
            "motor_share": share,
            "backlash_gap": gap * seen.lever,
            "friction_share": 0.7,
        }
        for frequency in frequencies(seen.step, seen.end)
        for share in (0.15, 0.3, 0.45)
        for gap in (0.015, 0.04)
    ]


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
            LOWEST,
            HIGHEST,
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
    screen=Screen("joint_frequency", trials=trials),
    includes=("backlash",),
)
