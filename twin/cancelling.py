"""Named torques that cancel each other: one curve, told in pieces.

About the place where gravity stands on its head a spring of its strength leaves k (x - sin x), nearly k x^3 / 6: the
two together are a spring that stiffens, which has no page of its own, and the size of either says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from twin import compare, equations, likelihood, ready, unknown
from twin.axis import Structure
from twin.effects.catalogue import CANDIDATES, EFFECTS
from twin.effects.knots import KNOTS, names
from twin.likelihood import Case, Point

FloatArray = NDArray[np.float64]

#: Torques may be pieces of one curve where together they vary by less than this share of what each of the two largest
#: does: two that have nothing to do with each other happen to do so once in ten times.
CANCELLED = 0.5


def _torques(ids: Sequence[str], point: Point, places: FloatArray) -> FloatArray:
    """The torque (effects, places) of each at each place."""
    p = SimpleNamespace(**point.values)
    laws = [law for i in ids if (law := EFFECTS[i].law) is not None]
    return np.array([[law(SimpleNamespace(position=x), p) for x in places.tolist()] for law in laws], dtype=float)


def _places(cases: Sequence[Case]) -> FloatArray:
    """Where the axis was read."""
    read = np.concatenate([c.drive.measured for c in cases])
    return np.asarray(read[np.isfinite(read)])


@dataclass(frozen=True, eq=False)
class Pieces:
    """Effects of the last model that cancel each other, the share that is left, and the model with a curve instead."""

    ids: tuple[str, ...]
    left: float
    curve: Point

    @property
    def says(self) -> str:
        """Why they are named no more."""
        titles = " and ".join(EFFECTS[i].title for i in self.ids)
        return (
            f"{titles[:1].upper()}{titles[1:]} would fit, but cancel each other: together they vary by "
            f"{100.0 * self.left:.0f} % of what either does, and one curve over the position does as well. It may be "
            "all of them, or one thing of another shape, as a spring that stiffens: a wider travel would tell."
        )


def _left_over(cases: Sequence[Case], last: Point, ids: Sequence[str]) -> float:
    """By what share of what the second largest of these torques does all together vary where the axis was."""
    torques = _torques(ids, last, np.quantile(_places(cases), np.linspace(0.005, 0.995, 200)))
    return float(torques.sum(axis=0).std()) / max(float(np.sort(torques.std(axis=1))[-2]), 1e-300)


def _drawn(cases: Sequence[Case], last: Point, ids: Sequence[str]) -> Point:
    """The last model with a curve of no known shape in the place of these torques, from what they are together."""
    structure = last.structure.without(*ids).with_("unknown_position")
    low, span, seen = unknown.knots_over(_places(cases))
    heights = _torques(ids, last, np.linspace(low, low + span, KNOTS)).sum(axis=0)
    knots = names("unknown_position")
    curve = {**dict(zip(knots, heights.tolist(), strict=True)), "unknown_position_from": low}
    values = ready.completed(structure, {**last.values, **curve, "unknown_position_span": span})
    free = (*(n for n in last.free if n in values), *(n for n, s in zip(knots, seen, strict=True) if s))
    return likelihood.climb(ready.with_steps(cases, structure), structure, values, last.density, free)


def _is_curve(effect: str) -> bool:
    """Whether this is a torque that follows from the position alone; a stop's damping reads the velocity, too."""
    return EFFECTS[effect].slot == "load" and equations.reads(effect) <= {"position"}


def one_curve(cases: Sequence[Case], first: Structure, last: Point) -> Pieces | None:
    """What the last model has beyond the first that is one curve in pieces; None where there is no such thing, or the
    names do more than a curve over the position."""
    ids = tuple(i for i in last.structure.named if i in CANDIDATES and i not in first and _is_curve(i))
    if len(ids) < 2 or cases[0].drive.speed:
        return None
    left = _left_over(cases, last, ids)
    if left > CANCELLED:
        return None
    curve = _drawn(cases, last, ids)
    # The knots' price speaks for names, whatever they are: what counts is whether these fit better.
    more = (curve.deviance - last.deviance) / compare.worth([curve, last])
    return None if more > compare.LEAST else Pieces(ids, left, curve)
