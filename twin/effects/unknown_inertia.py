"""What an inertia of no known shape over the angle does to a link that turns: it slows where the inertia grows."""

from __future__ import annotations

from typing import Any

from twin.effects import varying_inertia, waves
from twin.effects.effect import Effect


def law(q: Any, p: Any) -> Any:
    # The energy of a free link, half its inertia times the square of its speed, stays: J a = -dJ/dx v^2 / 2.
    order = p.unknown_inertia_order
    slope = order * waves.slope(order * q.position, "unknown_inertia", varying_inertia.HARMONICS, p)
    return -0.5 * slope * q.velocity * q.velocity


EFFECT = Effect(
    id="unknown_inertia",
    title="inertia of unknown shape over the angle",
    station="inertia",
    slot="load",
    parameters=(),
    law=law,
    depends_on=("position", "acceleration"),
    promises=frozenset({"memoryless"}),
    sentence=(
        "The inertia at the link changes with the angle, by no known law: {unknown_inertia_sin_1} and "
        "{unknown_inertia_cos_1} of the axis' own are its first wave."
    ),
    reference="Wittenburg, Dynamics of Multibody Systems, 2008",
    confused_with={
        "load_change": "the same angles again and again: what the angle makes comes back with it",
        "unknown_gain": "a steady speed over the whole angle: a gain's part changes it, an inertia's hardly",
    },
    includes=("varying_inertia",),
    substeps=2,
)
