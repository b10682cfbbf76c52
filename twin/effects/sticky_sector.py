"""More dry friction within a range of angles: a tight spot of a bearing, a scored shaft, a rail with a burr."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from twin.effects import places
from twin.effects.effect import Effect, Recorded, Screen, Seen
from twin.effects.math_ops import cos, exp
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    # Flat in the middle; at half the range from it 1/e is left.
    phase = p.sector_order * (q.position - p.sector_angle)
    edge = places.half_width(p.sector_order, p.sector_width)
    return p.sector_friction * exp(-(((1.0 - cos(phase)) / (1.0 - cos(edge))) ** 2))


def trials(seen: Seen) -> list[dict[str, float]]:
    """Sectors once a turn, or once in the travel, of four widths, at every half of their width."""
    order = places.orders(seen, 1)[0]
    return [
        {"sector_order": order, "sector_angle": angle, "sector_width": width}
        for width, angle in places.grid(seen, order, (0.06, 0.15, 0.3, 0.6))
    ]


def plausible(values: Mapping[str, float], recorded: Recorded) -> bool:
    """It ends within the period, and the link passes it."""
    return places.passed(recorded, values["sector_order"], values["sector_angle"], values["sector_width"])


EFFECT = Effect(
    id="sticky_sector",
    title="dry friction that is larger within a range of angles",
    station="friction",
    slot="grip",
    parameters=(
        Parameter("sector_friction", "{x}/s^2", "excess of the dry friction in the sector, over inertia", 0.0, 0.0),
        Parameter("sector_angle", "{x}", "middle of the sector", None),
        Parameter("sector_width", "{x}", "half of the sector's range", None, 0.005, math.pi, 0.3),
        places.order("sector_order"),
    ),
    law=law,
    depends_on=("position", "direction"),
    promises=frozenset({"dissipative", "memoryless"}),
    sentence="Dry friction is larger by {sector_friction} within {sector_width} on either side of {sector_angle}.",
    reference="Armstrong-Helouvry, Control of Machines with Friction, 1991, ch. 4 (friction that depends on position)",
    confused_with={
        "position_dependent_friction": "pass the whole turn slowly: a sector ends, a wave goes on",
        "detent": "pass the place in both directions: a detent pulls towards it, friction only resists",
        "disturbance_pulse": "pass the same angle at another time",
    },
    screen=Screen("sector_friction", trials=trials, local=True),
    includes=("coulomb_friction",),
    plausible=plausible,
)
