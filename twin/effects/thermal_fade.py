"""The gain falls as the motor heats."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    # A warm winding passes less current, whether the drive or the back-EMF drives it.
    lost = p.fade * q.heat
    return q.command * (1.0 - lost) + lost * p.fade_emf * q.emf


#: Between what the thermal time constant may lie, s.
SHORTEST, LONGEST = 1.0, 3600.0


def trials(seen: Seen) -> list[dict[str, float]]:
    """Time constants, as shares of the recording's length.

    A motor that turns draws far less current than one that is held. In units of the largest command on a held motor, a
    fade of a sixth would be larger than any fade may be: the reference is the command that heats as the recording does.
    """
    times = dict.fromkeys(min(max(share * seen.end, SHORTEST), LONGEST) for share in (0.15, 0.5, 1.5))
    return [{"fade_time": time, "fade_reference": seen.heating} for time in times]


EFFECT = Effect(
    id="thermal_fade",
    title="gain that fades as the motor heats",
    station="drive",
    slot="drive",
    parameters=(
        Parameter("fade", "1", "loss of gain when warmed through by the reference current", 0.0, -0.5, 0.9),
        Parameter("fade_emf", "1", "how much of the viscous friction is the motor's back-EMF", None, 0.0, 1.0, 0.8),
        Parameter("fade_time", "s", "thermal time constant", None, SHORTEST, LONGEST, 30.0),
        Parameter("fade_reference", "{u}", "command that heats a held motor by one", None, start=50.0, estimated=False),
    ),
    law=law,
    depends_on=("time", "input"),
    promises=frozenset({"odd", "state"}),
    sentence="The gain falls by {fade} as the motor heats, with a time constant of {fade_time}.",
    reference="Hughes, Drury, Electric Motors and Drives, 2013",
    confused_with={
        "load_change": "repeat the first block at the end: heat comes slowly, a load at once",
        "quadratic_drag": "repeat the first block at the end",
    },
    screen=Screen("fade", trials=trials),
)
