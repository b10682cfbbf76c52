"""The gain falls under electrical load: the supply gives way."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.quantities import Parameter
from twin.words import absolute, maximum


def law(q: Any, p: Any) -> Any:
    # The current goes with what is left of the command after the back-EMF.
    current = absolute(q.command - q.emf)
    return q.command * maximum(1.0 - p.supply_sag * current, 0.1)


EFFECT = Effect(
    id="supply_sag",
    title="supply that sags under load",
    station="drive",
    slot="drive",
    parameters=(
        Parameter(
            "supply_sag", "1/{u}", "loss of gain per unit of command that drives current", 0.0, 0.0, 0.02
        ),
    ),
    law=law,
    depends_on=("input", "velocity"),
    promises=frozenset({"odd", "memoryless"}),
    sentence="The supply gives way under load: the gain falls by {supply_sag} of the command that drives current.",
    reference="Leonhard, Control of Electrical Drives, 2001",
    confused_with={
        "drive_saturation": "steps at four or more duties: saturation has a corner",
        "quadratic_drag": "coast-downs from high speed",
        "coulomb_friction": "coast-downs",
    },
    screen=Screen("supply_sag"),
)
