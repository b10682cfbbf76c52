"""The gain falls under electrical load: the supply gives way."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen
from twin.quantities import Parameter
from twin.words import absolute, maximum


def law(q: Any, p: Any) -> Any:
    # The motor's current goes with what is left of the command after the back-EMF. A switched bridge draws it from the
    # supply only while it is on, a linear amplifier always.
    current = absolute(q.command - q.emf)
    drawn = current * (1.0 - p.sag_switched * (1.0 - absolute(q.command) / p.sag_reference))
    return q.command * maximum(1.0 - p.supply_sag * drawn, 0.1)


EFFECT = Effect(
    id="supply_sag",
    title="supply that sags under load",
    station="drive",
    slot="drive",
    parameters=(
        Parameter("supply_sag", "1/{u}", "loss of gain per unit of command that drives current", 0.0, 0.0, 0.02),
        Parameter(
            "sag_switched", "1", "how much of the current flows only while the bridge is on", None, 0.0, 1.0, 0.5
        ),
        Parameter(
            "sag_reference", "{u}", "command at which the bridge is always on", None, 1e-6, start=100.0, estimated=False
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
    screen=Screen("supply_sag", grid={"sag_switched": (0.0, 1.0)}),
)
