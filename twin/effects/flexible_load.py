"""Something that rides on the link by a spring and a damper: a ruler, a liquid, a hanging load."""

from __future__ import annotations

import math
from typing import Any

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.parameter import Parameter

#: Least frequency that is looked for, Hz, the step from one to the next, and the damping ratio of the trials: from rows
#: a factor of 2 apart with a ratio of 0.3, a hanging load and a liquid both ended in lesser optima.
_LOWEST, _STEP = 0.3, 1.5
_DAMPING_RATIO = 0.1
#: Dampers (1/s) of what no spring holds, as a liquid.
_LOOSE = (0.5, 4.0)
#: Stiffest spring, 1/s^2: it rings at 50 Hz.
_STIFFEST = 1e5


def law(q: Any, p: Any) -> Any:
    return p.flexible_load_share * q.tug


def trials(seen: Seen) -> list[dict[str, float]]:
    """What no spring holds, and frequencies from 0.3 Hz to a tenth of the sample rate."""
    rows = [{"flexible_load_stiffness": 0.0, "flexible_load_damping": damper} for damper in _LOOSE]
    highest = min(0.1 / seen.step, 0.9 * math.sqrt(_STIFFEST) / (2.0 * math.pi))
    for i in range(math.floor(math.log(max(highest / _LOWEST, 1.0), _STEP)) + 1):
        rate = 2.0 * math.pi * _LOWEST * _STEP**i
        rows.append({"flexible_load_stiffness": rate**2, "flexible_load_damping": 2.0 * _DAMPING_RATIO * rate})
    return rows


EFFECT = Effect(
    id="flexible_load",
    title="flexible load that rides on the link",
    station="load",
    slot="rider",
    parameters=(
        Parameter("flexible_load_share", "1", "inertia of what rides along, as a share of the axis'", 0.0, 0.0, 20.0),
        Parameter(
            "flexible_load_stiffness", "1/s^2", "spring that holds it, over its inertia", None, 0.0, _STIFFEST, 100.0
        ),
        Parameter("flexible_load_damping", "1/s", "damper that holds it, over its inertia", None, 0.01, 300.0, 1.0),
    ),
    law=law,
    depends_on=("acceleration",),
    promises=frozenset({"odd", "state"}),
    sentence=(
        "Something with {flexible_load_share} of the axis' inertia rides on the link, as a liquid or a hanging load "
        "does: a spring of {flexible_load_stiffness} and a damper of {flexible_load_damping} hold it, both over its "
        "own inertia."
    ),
    reference="Den Hartog, Mechanical Vibrations, 1956, ch. 3",
    confused_with={
        "joint_elasticity": "stop sharply: what rides along pulls a link that stands, a joint lets the link ring",
        "load_change": "one quick move and a rest: what rides along pulls on afterwards",
        "motor_lag": "stop sharply: look for ringing after the edge",
    },
    screen=Screen("flexible_load_share", trials=trials),
)
