"""Dry friction that gives elastically before it slides: bristles, seals, tyres, preloaded bearings."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return -p.presliding_friction * q.bend


def trials(seen: Seen) -> list[dict[str, float]]:
    """Travels, each three times the one before it, as angles at the lever.

    Beside dry friction no slope leads to friction that gives: it is tried in its place, as large.
    """
    dry = (0.03 * seen.push, 0.15 * seen.push) if seen.dry_friction is None else (seen.dry_friction,)
    return [
        {"presliding_travel": way * seen.lever, "presliding_friction": size}
        for way in (0.003, 0.01, 0.03, 0.1)
        for size in dry
    ]


EFFECT = Effect(
    id="presliding_friction",
    title="dry friction that gives before it slides",
    station="friction",
    slot="bristle",
    parameters=(
        Parameter("presliding_friction", "{x}/s^2", "friction once it slides, over inertia", 0.0, 0.0),
        Parameter("presliding_travel", "{x}", "travel by which it gives before it slides", None, 1e-5, 1.0, 0.03),
    ),
    law=law,
    depends_on=("position", "direction"),
    promises=frozenset({"odd", "state"}),
    sentence=(
        "Dry friction of {presliding_friction} at the motor gives like a spring for about {presliding_travel} of "
        "travel after every reversal, before it slides."
    ),
    reference="Dahl, A Solid Friction Model, Aerospace Corp. TOR-158, 1968",
    confused_with={
        "coulomb_friction": "small steps back and forth: Coulomb friction holds still, this gives and springs back",
        "stribeck_friction": "reversals at two speeds: this goes with the travel since them, not with the speed",
        "backlash": "small steps back and forth: this resists from the first count on, a gap does not",
    },
    screen=Screen("presliding_friction", trials=trials),
)
