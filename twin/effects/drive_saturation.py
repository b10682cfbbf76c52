"""The drive clips below the commanded range."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.math_ops import maximum, minimum
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return maximum(-p.saturation_limit, minimum(p.saturation_limit, q.command))


def trials(seen: Seen) -> list[dict[str, float]]:
    """Limits, as shares of the largest command."""
    return [{"saturation_limit": share * seen.span} for share in (0.4, 0.55, 0.7, 0.85, 0.95)]


EFFECT = Effect(
    id="drive_saturation",
    title="saturation of the drive",
    station="drive",
    slot="drive",
    parameters=(
        Parameter("saturation_limit", "{u}", "largest command that the drive passes on", None, 0.0, start=100.0),
    ),
    law=law,
    depends_on=("input",),
    promises=frozenset({"odd", "memoryless"}),
    sentence="The drive passes on no more than {saturation_limit}.",
    reference="Hippe, Windup in Control, 2006",
    confused_with={
        "quadratic_drag": "coast-downs from high speed: saturation acts only with duty",
        "supply_sag": "steps at four or more duties: saturation has a corner",
    },
    screen=Screen("saturation_limit", trials=trials),
)
