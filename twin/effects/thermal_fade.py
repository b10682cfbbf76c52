"""The gain falls as the motor heats."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    # A warm winding passes less current, whether the drive or the back-EMF drives it.
    lost = p.fade * q.heat
    return q.command * (1.0 - lost) + lost * p.fade_emf * q.emf


EFFECT = Effect(
    id="thermal_fade",
    title="gain that fades as the motor heats",
    station="drive",
    slot="drive",
    parameters=(
        Parameter("fade", "1", "loss of gain when warmed through by the reference current", 0.0, -0.5, 0.9),
        Parameter("fade_emf", "1", "how much of the viscous friction is the motor's back-EMF", None, 0.0, 1.0, 0.8),
        Parameter("fade_time", "s", "thermal time constant", None, 1.0, 3600.0, 30.0),
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
    screen=Screen("fade", grid={"fade_time": (5.0, 15.0, 40.0, 120.0)}),
)
