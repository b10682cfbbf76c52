"""A torque that pulls into one angle, once or several times a turn: a magnet, a latch, a spring-loaded ball."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from twin.effects import places
from twin.effects.effect import Effect, Recorded, Screen, Seen
from twin.effects.math_ops import cos, exp, sin
from twin.effects.parameter import Parameter


def law(q: Any, p: Any) -> Any:
    # The slope of a well exp(k cos(phase)), largest at `edge` from its middle; at a quarter of its period it is a sine.
    phase = p.detent_order * (q.position - p.detent_angle)
    edge = places.half_width(p.detent_order, p.detent_width)
    depth = (cos(phase) - cos(edge)) * cos(edge) / sin(edge) ** 2
    return -p.detent_torque * sin(phase) / sin(edge) * exp(depth)


def trials(seen: Seen) -> list[dict[str, float]]:
    """Detents from once to six times a turn, or once in the travel, of four widths, at every half of their width."""
    return [
        {"detent_order": order, "detent_angle": angle, "detent_width": width}
        for order in places.orders(seen, 6)
        for width, angle in places.grid(seen, order, (0.05, 0.1, 0.2, 0.4))
    ]


def plausible(values: Mapping[str, float], recorded: Recorded) -> bool:
    """The link comes near it, and it is narrower than a wave."""
    return places.passed(recorded, values["detent_order"], values["detent_angle"], values["detent_width"])


EFFECT = Effect(
    id="detent",
    title="detent",
    station="load",
    slot="load",
    parameters=(
        Parameter("detent_torque", "{x}/s^2", "largest torque towards the detent, over inertia", 0.0, 0.0),
        Parameter("detent_angle", "{x}", "position that it pulls towards", None),
        Parameter("detent_width", "{x}", "distance at which it pulls hardest", None, 0.005, math.pi, 0.2),
        places.order("detent_order"),
    ),
    law=law,
    depends_on=("position",),
    promises=frozenset({"memoryless"}),
    sentence=(
        "A detent pulls the link towards {detent_angle} with up to {detent_torque}, hardest at {detent_width} from it, "
        "{detent_order} times a turn."
    ),
    reference="Hanselman, Brushless Permanent Magnet Motor Design, 2003, ch. 8 (detent torque); Lechner, Naunheimer, "
    "Automotive Transmissions, 1999, ch. 9 (detent of a ball and a spring)",
    confused_with={
        "torque_ripple": "pass a whole turn slowly: a ripple acts everywhere, a detent near its place",
        "sticky_sector": "pass the place in both directions: a detent pulls towards it, friction only resists",
        "gravity": "travel over the whole turn: gravity is one sine",
    },
    screen=Screen("detent_torque", trials=trials, local=True),
    plausible=plausible,
)
