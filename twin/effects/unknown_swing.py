"""Something rides on the link and is left behind: more than inertia, but no name of the list."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return p.unknown_swing_share * q.tug


EFFECT = Effect(
    id="unknown_swing",
    title="something that swings along with the link",
    station="load",
    slot="rider",
    parameters=(
        Parameter("unknown_swing_share", "1", "inertia of what swings, as a share of the axis'", 0.0, 0.0, 20.0),
        Parameter("unknown_swing_stiffness", "1/s^2", "spring that holds it, over its inertia", None, 0.0, 1e4, 100.0),
        Parameter("unknown_swing_damping", "1/s", "damper that holds it, over its inertia", None, 0.01, 100.0, 1.0),
    ),
    law=law,
    depends_on=("acceleration",),
    promises=frozenset({"odd", "state"}),
    sentence=(
        "Something with {unknown_swing_share} of the axis' inertia rides on the link, as a liquid or a hanging load "
        "does: a spring of {unknown_swing_stiffness} and a damper of {unknown_swing_damping} hold it, both over its "
        "own inertia."
    ),
    reference="Den Hartog, Mechanical Vibrations, 1956, ch. 3",
    confused_with={
        "joint_elasticity": "stop sharply: what swings along pulls a link that stands, a joint lets that ring",
        "load_change": "one quick move and a rest: what swings pulls on afterwards",
        "motor_lag": "stop sharply: look for ringing after the edge",
    },
)
