"""Named torques that something without a name stands for better, or one curve as well where they cancel each other.

A spring that stiffens has no page. Over a short travel a spring describes most of it; about the place where gravity
stands on its head a spring of its strength leaves k (x - sin x), nearly k x^3 / 6, and describes it with gravity. So
what a model names over the position, and over the speed, is held against a curve over it. Friction whose bristles
bend before they slide goes with the way since the last reversal, which no curve over a state of motion follows; most
of it is dry friction, which is held against it. And where a motor's gain goes with its turn the axis swings about its
way as an encoder off centre shows it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import cross_validation, model_comparison, nonparametric, residual_torque, selection_round
from twin.diagnosis.plausibility import plausible
from twin.effects.catalogue import CANDIDATES, EFFECTS
from twin.effects.knots import spots, through
from twin.estimation import likelihood, preparation
from twin.estimation.likelihood import Case, Point
from twin.model import equations
from twin.model.stepper import Structure
from twin.parallel import each

FloatArray = NDArray[np.float64]

#: Torques may be pieces of one curve where together they are at some place less stiff than this share of what each of
#: the two stiffest is: two whose strengths differ by up to ten times either way happen to do so once in six times.
CANCELLED = 0.5
#: Where the torques act that a curve over a variable may stand for.
SLOTS: Mapping[str, tuple[str, ...]] = {"position": ("load", "shaft"), "velocity": ("drag",)}
_SPOKEN = {"position": "position", "velocity": "speed"}
#: Curves of waves over the angle, each with the number of directions of the command that it tells apart.
WAYS: Mapping[str, int] = {"unknown_angle": 1, "unknown_push": 2}
#: What is periodic in the angle has overtones, in every motor and gear; where they are less than this share of its
#: first wave, and it is the same whichever way the drive pushes, it is a ripple still.
OVERTONES = 1.0 / 3.0


@dataclass(frozen=True, eq=False)
class Redrawn:
    """Effects of the last model, the model with something without a name instead, and why they are named no more."""

    ids: tuple[str, ...]
    curve: Point
    says: str


def _ids(first: Structure, last: Structure, variable: str) -> tuple[str, ...]:
    """What the last model names beyond the first that follows from the variable alone; a stop's damping does not."""
    mine = (i for i in last.named if i in CANDIDATES and i not in first and EFFECTS[i].slot in SLOTS[variable])
    return tuple(i for i in mine if equations.reads(i) <= {variable})


def _titles(ids: Sequence[str]) -> str:
    titles = " and ".join(EFFECTS[i].title for i in ids)
    return titles[:1].upper() + titles[1:]


def _bare(last: Point, ids: Sequence[str]) -> Point:
    """The last model without these effects; all else as it is."""
    structure = last.structure.without(*ids)
    values = preparation.completed(structure, last.values)
    return replace(last, structure=structure, values=values, free=tuple(n for n in last.free if n in values))


def _drawn(cases: Sequence[Case], last: Point, ids: Sequence[str], variable: str) -> Point:
    """The last model with a curve over the variable in the place of these effects: from what it lacks without them, or
    from what they do, where rattle hides that.
    """
    sketched = nonparametric.sketch(cases, _bare(last, ids), nonparametric.Term(variable))
    prefix = f"unknown_{variable}"
    at = spots(prefix, sketched.values)
    unit = through(prefix, at, np.ones(len(at)).tolist())
    sense = _torques([prefix], replace(sketched, values=unit), np.zeros(1), variable)[0]
    same = through(prefix, at, (sense * _torques(ids, last, np.array(at), variable).sum(axis=0)).tolist())
    begun = replace(sketched, values={**preparation.completed(sketched.structure, last.values), **same})
    return min(each(lambda p: nonparametric.finish(cases, p), (sketched, begun)), key=lambda p: p.deviance)


def _needed(cases: Sequence[Case], first: Structure, curve: Point, names: Sequence[str]) -> Point:
    """The model with a curve, less the names that do nothing beside it; what the first model has stays."""
    for effect in names:
        structure = curve.structure.without(effect, *curve.structure.brought_by(effect, first))
        values = preparation.completed(structure, curve.values)
        free = tuple(n for n in curve.free if n in values)
        mine = preparation.with_steps(cases, structure)
        less = likelihood.climb(mine, structure, values, curve.density, free)
        if not model_comparison.earns(less, curve):
            curve = less
    return curve


def _along(cases: Sequence[Case], last: Point, variable: str) -> FloatArray:
    """Where the axis was, or how fast: values (200,) of the variable that are equally often passed."""
    mine = preparation.with_steps(cases, last.structure)
    moves = [residual_torque.missing_torque(c, last.structure, last.values).state(variable) for c in mine]
    x = np.concatenate(moves)
    return np.asarray(np.quantile(x[np.isfinite(x)], np.linspace(0.005, 0.995, 200)))


def _departs(cases: Sequence[Case], last: Point, curve: Point, ids: Sequence[str], variable: str) -> float:
    """By what share of what the names do, along the recordings, a curve over the variable departs from them.

    A constant may be the dead-bands' as well, and a straight line over speed is viscous friction.
    """
    x = _along(cases, last, variable)
    named = _torques(ids, last, x, variable).sum(axis=0)
    rest = _torques([f"unknown_{variable}"], curve, x, variable)[0] - named
    shared = np.vander(x, 1 if variable == "position" else 2)
    rest -= shared @ np.linalg.lstsq(shared, rest, rcond=None)[0]
    return float(rest.std()) / max(float(named.std()), 1e-300)


def outdone(cases: Sequence[Case], first: Structure, last: Point, variable: str) -> Redrawn | None:
    """A curve over the variable that earns its place in spite of what the last model names over it; None where it does
    not, or nothing is named."""
    ids = _ids(first, last.structure, variable)
    if not ids:
        return None
    curve = _drawn(cases, last, ids, variable)
    departs = _departs(cases, last, curve, ids, variable) >= model_comparison.LAX
    if not (
        departs
        and selection_round.shows(cases, last, curve)
        and cross_validation.chance(cases, last, curve) < cross_validation.SURE
    ):
        return None
    says = (
        f"{_titles(ids)} would fit in part, but a curve over the {_SPOKEN[variable]} that no known effect describes "
        f"fits better by {model_comparison.earned(last, curve):.0f} units of deviance, "
        f"where {model_comparison.LEAST:.0f} would do."
    )
    return Redrawn(ids, curve, says)


def overtones(curve: Point) -> float:
    """What a curve of waves over the angle has beyond a first wave that is the same whichever way the drive pushes, as
    a share of that, both in the root mean square; infinite for any other curve.
    """
    for term in WAYS:
        if term in curve.structure:
            parts = np.array([curve.values[n] for n in nonparametric.wave_parts(term)]).reshape(WAYS[term], -1)
            first = parts[:, :2].mean(axis=0)
            parts[:, :2] -= first
            return float(np.sqrt(np.square(parts).sum(axis=1).mean()) / max(float(np.hypot(*first)), 1e-300))
    return math.inf


def is_ripple(last: Point, curve: Point) -> bool:
    """Whether a curve of waves over the angle is the torque ripple that the last model names: as many a turn, and
    hardly more than the first of them. It does more, since no cogging is one sine; but it is nothing else.
    """
    if "torque_ripple" not in last.structure or overtones(curve) >= OVERTONES:
        return False
    order = next(curve.values[f"{term}_order"] for term in WAYS if term in curve.structure)
    return abs(order / last.values["ripple_order"] - 1.0) < model_comparison.LAX


def giving(cases: Sequence[Case], first: Structure, last: Point) -> Redrawn | None:
    """Friction that gives before it slides, in the place of all dry friction that the last model names; None where
    there is none, or the recording does not speak for it.
    """
    ids = tuple(e.id for e in last.structure.effects if e.slot == "grip" and e.id not in first)
    if not ids:
        return None
    sketched = nonparametric.sketch(cases, _bare(last, ids), nonparametric.Term("bend"))
    bent = nonparametric.relocated(cases, nonparametric.finish(cases, sketched))
    # What one thing does about as well as two kinds of friction do is more likely to be that one.
    briefer = len(bent.structure.named) < len(last.structure.named)
    speaks = (
        model_comparison.behind(bent, last) < -model_comparison.LEAST
        if briefer
        else selection_round.shows(cases, last, bent)
    )
    if not (speaks and plausible(cases, bent, last)):
        return None
    better = model_comparison.earned(last, bent)
    much = f"better by {better:.0f} units of deviance, where {model_comparison.LEAST:.0f} would do"
    says = (
        f"{_titles(ids)} would fit in part, but friction that gives before it slides, which is more than a name of "
        f"the list says, fits {'as well by itself' if briefer and better < model_comparison.LEAST else much}."
    )
    return Redrawn(ids, bent, says)


def turning(cases: Sequence[Case], first: Structure, last: Point) -> Redrawn | None:
    """A motor whose gain goes with the angle in the place of an encoder off centre that the last model names: each by
    one wave a turn, so that the likelier is the better; None where there is none, or the gain is not likelier.
    """
    ids = tuple(i for i in ("encoder_eccentricity",) if i in last.structure and i not in first)
    if not ids:
        return None
    sketched = nonparametric.sketch(cases, _bare(last, ids), nonparametric.Term("gain"))
    wave = nonparametric.finish(cases, nonparametric.one_wave(sketched))
    better = model_comparison.ahead(wave, last)
    if better < model_comparison.LEAST or not plausible(cases, wave, last):
        return None
    says = (
        f"{_titles(ids)} would fit in part, but a motor whose gain goes with the angle, which is more than a name of "
        f"the list says, fits better by {better:.0f} units of deviance with as many numbers, where "
        f"{model_comparison.LEAST:.0f} would do."
    )
    return Redrawn(ids, wave, says)


def _torques(ids: Sequence[str], point: Point, at: FloatArray, variable: str = "position") -> FloatArray:
    """The torque (effects, values) of each at each value of the variable that they follow from."""
    return np.array([equations.along(i, {variable: at}, point.values) for i in ids])


def _left_over(cases: Sequence[Case], last: Point, ids: Sequence[str]) -> float:
    """What these torques leave of their stiffness where they cancel most, as a share of what the second largest has."""
    moved = _along(cases, last, "position")
    at = np.linspace(moved.min(), moved.max(), len(moved))
    stiff = np.diff(_torques(ids, last, at), axis=1)
    both = stiff.sum(axis=0)
    least = float(np.min(both * np.sign(np.median(both))))
    return abs(least) / max(float(np.sort(np.abs(stiff).max(axis=1))[-2]), 1e-300)


def one_curve(cases: Sequence[Case], first: Structure, last: Point) -> Redrawn | None:
    """What the last model has beyond the first that is one curve in pieces; None where there is no such thing, or the
    names do more than a curve over the position."""
    ids = _ids(first, last.structure, "position")
    if len(ids) < 2:
        return None
    left = _left_over(cases, last, ids)
    if left > CANCELLED:
        return None
    curve = _drawn(cases, last, ids, "position")
    # The knots' price speaks for names, whatever they are: what counts is whether these fit better.
    more = (curve.deviance - last.deviance) / model_comparison.worth([curve, last])
    says = (
        f"{_titles(ids)} would fit, but cancel each other: about one place they are together no more than "
        f"{100.0 * left:.0f} % as stiff as either is, and one curve over the position does as well. It may be all of "
        "them, or one thing of another shape, as a spring that stiffens: a wider travel would tell."
    )
    return None if more > model_comparison.LEAST else Redrawn(ids, curve, says)


def redrawn(cases: Sequence[Case], first: Structure, last: Point) -> Redrawn | None:
    """The last model with what has no name in the place of what it names, where the recording speaks for that."""
    variables = [v for v in SLOTS if not (cases[0].drive.speed and v == "position")]
    pieces = one_curve(cases, first, last) if "position" in variables else None
    curves = [outdone(cases, first, last, v) for v in variables] if pieces is None else [pieces]
    tried = each(lambda way: way(cases, first, last), (giving, turning))
    found = [r for r in (*curves, *tried) if r is not None]
    best: Redrawn | None = min(found, key=lambda r: r.curve.deviance, default=None)
    if best is None:
        return None
    others = [i for i in best.curve.structure.named if i in CANDIDATES and i not in first]
    return replace(best, curve=_needed(cases, first, best.curve, others))
