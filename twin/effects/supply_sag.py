"""The gain falls under electrical load: the supply gives way."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.math_ops import absolute, maximum, where
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    # The current goes with what the sagging supply gives less the back-EMF, so that both are solved for together; what
    # the motor returns raises nothing. A switched bridge draws current only while it is on, a linear one always.
    size = absolute(q.command)
    against = p.sag_emf * q.emf * (2.0 * where(q.command > 0.0, 1.0, 0.0) - 1.0)
    on = p.supply_sag * (1.0 - p.sag_switched * (1.0 - size / p.sag_reference))
    return q.command * maximum(1.0 - on * maximum(size - against, 0.0) / (1.0 + on * size), 0.1)


def trials(seen: Seen) -> list[dict[str, float]]:
    """A linear drive and a switched one that is always on at the largest command."""
    return [{"sag_switched": switched, "sag_reference": seen.span} for switched in (0.0, 1.0)]


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
        Parameter("sag_emf", "1", "how much of the viscous friction is the motor's back-EMF", None, 0.0, 1.0, 0.8),
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
    screen=Screen("supply_sag", trials=trials),
)
