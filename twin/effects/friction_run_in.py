"""Dry friction that is larger at the start and falls with time: cold grease, a seal that was at rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twin.effects.effect import Effect, Recorded, Screen, Seen
from twin.effects.math_ops import exp
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return p.run_in_friction * exp(-q.time / p.run_in_time)


def trials(seen: Seen) -> list[dict[str, float]]:
    """Time constants between a twentieth and the whole of the recording."""
    return [{"run_in_time": min(max(share * seen.end, 0.2), 3600.0)} for share in (0.05, 0.12, 0.3, 0.8)]


def plausible(values: Mapping[str, float], recorded: Recorded) -> bool:
    """It takes longer than a start and has fallen by a good part within the recording; it falls, and is no step."""
    return 0.01 * recorded.end < values["run_in_time"] < 1.5 * recorded.end


EFFECT = Effect(
    id="friction_run_in",
    title="dry friction that falls as the machine runs in",
    station="friction",
    slot="grip",
    parameters=(
        Parameter("run_in_friction", "{x}/s^2", "excess of the dry friction at time zero, over inertia", 0.0, 0.0),
        Parameter("run_in_time", "s", "time in which the excess falls to 1/e", None, 0.1, 3600.0, 10.0),
    ),
    law=law,
    depends_on=("time", "direction"),
    promises=frozenset({"dissipative", "odd", "memoryless"}),
    sentence="Dry friction is larger by {run_in_friction} at the start and the excess falls to 1/e in {run_in_time}.",
    reference="Armstrong-Helouvry, Control of Machines with Friction, 1991, ch. 4 (friction as a drive warms up); "
    "Blau, Friction Science and Technology, 2008, ch. 7 (running-in)",
    confused_with={
        "load_change": "rest and start again: friction that ran in is back after a rest, a load is not",
        "thermal_fade": "repeat the first block at the end: friction has fallen, a warm motor is weaker",
    },
    screen=Screen("run_in_friction", trials=trials),
    includes=("coulomb_friction",),
    plausible=plausible,
)
