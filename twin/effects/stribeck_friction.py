"""Dry friction that is larger at rest and falls as speed rises."""

from __future__ import annotations

from typing import Any

from twin.effects.effect import Effect, Screen, Seen
from twin.effects.math_ops import exp
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    return p.stribeck_friction * exp(-((q.velocity / p.stribeck_velocity) ** 2))


def trials(seen: Seen) -> list[dict[str, float]]:
    """Small speeds, as shares of a fast one."""
    return [{"stribeck_velocity": share * seen.fast} for share in (0.02, 0.06, 0.15)]


EFFECT = Effect(
    id="stribeck_friction",
    title="dry friction that falls with speed (Stribeck)",
    station="friction",
    slot="grip",
    parameters=(
        Parameter("stribeck_friction", "{x}/s^2", "excess of the dry friction at rest, over inertia", 0.0, 0.0),
        Parameter("stribeck_velocity", "{x}/s", "speed at which the excess has fallen to 1/e", None, 1e-4, start=0.3),
    ),
    law=law,
    depends_on=("velocity", "direction"),
    promises=frozenset({"dissipative", "odd", "memoryless"}),
    sentence="Dry friction is larger at rest by {stribeck_friction} and falls with speed on a scale of "
    "{stribeck_velocity}.",
    reference="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30, 1994",
    confused_with={
        "coulomb_friction": "slow ramps: dwell at low speed",
        "backlash": "reversals at several amplitudes",
    },
    screen=Screen("stribeck_friction", trials=trials),
    includes=("coulomb_friction",),
)
