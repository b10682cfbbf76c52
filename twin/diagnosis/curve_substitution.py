"""Named torques that a nameless curve replaces: it fits better, or as well where the names cancel each other.

A spring that stiffens has no page. Over a short travel a linear spring describes most of it. Near the unstable
equilibrium of gravity, a spring of the same strength leaves k (x - sin x), nearly k x^3 / 6. So the two together
describe it there. So what a model names over position or speed is compared with a curve over it. Where a motor's gain
varies with its angle, the axis oscillates about its path, which looks like an eccentric encoder.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import (
    cross_validation,
    law_tolerance,
    model_comparison,
    nonparametric,
    residual_torque,
    selection_round,
    thresholds,
)
from twin.diagnosis.plausibility import is_plausible
from twin.effects.catalogue import CANDIDATES, EFFECTS
from twin.effects.knots import spots, through
from twin.estimation import optimizer, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model import equations
from twin.model.stepper import Structure
from twin.parallel import each

FloatArray = NDArray[np.float64]

#: Where the torques act that a curve over a variable may stand for.
CURVE_SLOTS: Mapping[str, tuple[str, ...]] = {"position": ("load", "shaft"), "velocity": ("drag",)}
_SPOKEN = {"position": "position", "velocity": "speed"}
#: Curves of waves over the angle, each with the number of directions of the command that it tells apart.
WAVE_DIRECTIONS: Mapping[str, int] = {"unknown_angle": 1, "unknown_push": 2}


@dataclass(frozen=True, eq=False)
class Substitution:
    """Effects of the last model, the model with a nameless term in their place, and the reason."""

    ids: tuple[str, ...]
    curve: Fit
    says: str


def _named_over(first: Structure, last: Structure, variable: str) -> tuple[str, ...]:
    """The names of the last model beyond the first that depend on the variable alone. A stop's damping does not."""
    mine = (i for i in last.named if i in CANDIDATES and i not in first and EFFECTS[i].slot in CURVE_SLOTS[variable])
    return tuple(i for i in mine if equations.reads(i) <= {variable})


def _titles(ids: Sequence[str]) -> str:
    titles = " and ".join(EFFECTS[i].title for i in ids)
    return titles[:1].upper() + titles[1:]


def _without_effects(last: Fit, ids: Sequence[str]) -> Fit:
    """The last model without these effects; all else as it is."""
    structure = last.structure.without(*ids)
    values = preparation.complete_values(structure, last.values)
    return replace(last, structure=structure, values=values, free=tuple(n for n in last.free if n in values))


def _torques_as_curve(sketched: Fit, last: Fit, ids: Sequence[str], variable: str) -> Fit:
    """The sketch of a curve over the variable, through what these effects of the last model do at its knots."""
    prefix = f"unknown_{variable}"
    at = spots(prefix, sketched.values)
    unit = through(prefix, at, np.ones(len(at)).tolist())
    sense = _effect_torques([prefix], replace(sketched, values=unit), np.zeros(1), variable)[0]
    same = through(prefix, at, (sense * _effect_torques(ids, last, np.array(at), variable).sum(axis=0)).tolist())
    return replace(sketched, values={**preparation.complete_values(sketched.structure, last.values), **same})


def _fit_curve_instead(problem: FitProblem, last: Fit, ids: Sequence[str], variable: str) -> Fit:
    """The last model with a curve over the variable in the place of these effects. The curve starts from the torque
    that is missing without them, or, where rattle hides that, from their own torque.
    """
    sketched = nonparametric.sketch_curve(problem, _without_effects(last, ids), nonparametric.CurveTerm(variable))
    begun = (sketched, _torques_as_curve(sketched, last, ids, variable))
    return min(each(lambda p: nonparametric.fit_curve(problem, p), begun), key=lambda p: p.deviance)


def _drop_idle_names(problem: FitProblem, first: Structure, curve: Fit, names: Sequence[str]) -> Fit:
    """The model with a curve, without the names that do nothing beside it. The first model's effects stay."""
    for effect in names:
        structure = curve.structure.without(effect, *curve.structure.brought_by(effect, first))
        values = preparation.complete_values(structure, curve.values)
        free = tuple(n for n in curve.free if n in values)
        less = optimizer.levenberg_marquardt(problem.at(curve.process_noise), structure, values, free)
        if not model_comparison.is_significant(less, curve):
            curve = less
    return curve


def _passed_values(problem: FitProblem, last: Fit, variable: str) -> FloatArray:
    """Where the axis was, or how fast: values (200,) of the variable that are equally often passed."""
    moves = [residual_torque.missing_torque(c, last.structure, last.values).state(variable) for c in problem.recordings]
    x = np.concatenate(moves)
    return np.asarray(np.quantile(x[np.isfinite(x)], np.linspace(0.005, 0.995, 200)))


def _departure(problem: FitProblem, last: Fit, curve: Fit, ids: Sequence[str], variable: str) -> float:
    """Deviation of a curve over the variable from the names' torque along the recordings, as a share of that torque.

    A constant is left out, since it may be the dead-bands'. So is a straight line over speed, which is viscous
    friction.
    """
    x = _passed_values(problem, last, variable)
    named = _effect_torques(ids, last, x, variable).sum(axis=0)
    rest = _effect_torques([f"unknown_{variable}"], curve, x, variable)[0] - named
    shared = np.vander(x, 1 if variable == "position" else 2)
    rest -= shared @ np.linalg.lstsq(shared, rest, rcond=None)[0]
    return float(rest.std()) / max(float(named.std()), 1e-300)


def substitute_curve(problem: FitProblem, first: Structure, last: Fit, variable: str) -> Substitution | None:
    """A curve over the variable that improves the fit beside what the last model names over it, by more than errors of
    the named laws may. None where it does not, or nothing is named."""
    ids = _named_over(first, last.structure, variable)
    if not ids:
        return None
    curve = _fit_curve_instead(problem, last, ids, variable)
    departs = _departure(problem, last, curve, ids, variable) >= thresholds.LAW_TOLERANCE
    if not (
        departs
        and model_comparison.is_significant(last, curve, law_tolerance.doubt_since(problem, first, last))
        and selection_round.is_confirmed(problem, last, curve)
        and cross_validation.gain_p_value(problem, last, curve) < thresholds.CURVE_MAX_P_VALUE
    ):
        return None
    says = (
        f"{_titles(ids)} would fit in part, but a curve over the {_SPOKEN[variable]} that no known effect describes "
        f"fits better by {model_comparison.gain(last, curve):.0f} units of deviance. "
        f"{thresholds.MIN_GAIN:.0f} are enough."
    )
    return Substitution(ids, curve, says)


def overtone_share(curve: Fit) -> float:
    """The part of a curve of waves over the angle beyond a first wave that is the same in both drive directions. It is
    a share of that wave, both in the root mean square, and infinite for any other curve.
    """
    for term in WAVE_DIRECTIONS:
        if term in curve.structure:
            parts = np.array([curve.values[n] for n in nonparametric.wave_parameters(term)]).reshape(
                WAVE_DIRECTIONS[term], -1
            )
            first = parts[:, :2].mean(axis=0)
            parts[:, :2] -= first
            return float(np.sqrt(np.square(parts).sum(axis=1).mean()) / max(float(np.hypot(*first)), 1e-300))
    return math.inf


def is_ripple(last: Fit, curve: Fit) -> bool:
    """Whether a curve of waves over the angle is the torque ripple that the last model names. It has the same waves per
    turn, and little beyond the first of them. It fits better, since no cogging is one sine, but it is the same effect.
    """
    if "torque_ripple" not in last.structure or overtone_share(curve) >= thresholds.MAX_OVERTONE_SHARE:
        return False
    order = next(curve.values[f"{term}_order"] for term in WAVE_DIRECTIONS if term in curve.structure)
    return abs(order / last.values["ripple_order"] - 1.0) < thresholds.LAW_TOLERANCE


def substitute_gain_wave(problem: FitProblem, first: Structure, last: Fit) -> Substitution | None:
    """A motor whose gain varies with the angle, in the place of an eccentric encoder that the last model names. Each is
    one wave per turn, so the likelier one is taken. None where there is none, or the gain is not likelier.
    """
    ids = tuple(i for i in ("encoder_eccentricity",) if i in last.structure and i not in first)
    if not ids:
        return None
    sketched = nonparametric.sketch_curve(problem, _without_effects(last, ids), nonparametric.CurveTerm("gain"))
    wave = nonparametric.fit_curve(problem, nonparametric.first_wave_only(sketched))
    better = model_comparison.criterion_difference(wave, last)
    if better < thresholds.MIN_GAIN or not is_plausible(problem, wave, last):
        return None
    says = (
        f"{_titles(ids)} would fit in part, but a motor whose gain varies with the angle, which no known effect "
        f"describes, fits better by {better:.0f} units of deviance with as many parameters. "
        f"{thresholds.MIN_GAIN:.0f} are enough."
    )
    return Substitution(ids, wave, says)


def _effect_torques(ids: Sequence[str], point: Fit, at: FloatArray, variable: str = "position") -> FloatArray:
    """The torque (effects, values) of each at each value of the variable that they follow from."""
    return np.array([equations.along(i, {variable: at}, point.values) for i in ids])


def _remaining_stiffness(positions: FloatArray, last: Fit, ids: Sequence[str]) -> float:
    """The common stiffness of these torques where they cancel most on the way between these positions (N,), as a share
    of the second largest one's.
    """
    at = np.linspace(positions.min(), positions.max(), len(positions))
    stiff = np.diff(_effect_torques(ids, last, at), axis=1)
    both = stiff.sum(axis=0)
    least = float(np.min(both * np.sign(np.median(both))))
    return abs(least) / max(float(np.sort(np.abs(stiff).max(axis=1))[-2]), 1e-300)


def substitute_cancelling(problem: FitProblem, first: Structure, last: Fit) -> Substitution | None:
    """What the last model has beyond the first that is one curve in pieces; None where there is no such thing, or the
    names do more than a curve over the position."""
    ids = _named_over(first, last.structure, "position")
    if len(ids) < 2:
        return None
    left = _remaining_stiffness(_passed_values(problem, last, "position"), last, ids)
    if left > thresholds.MAX_CANCELLED_STIFFNESS:
        return None
    curve = _fit_curve_instead(problem, last, ids, "position")
    # The penalty of the knots favours names, whatever they are. What counts is whether these fit better.
    more = (curve.deviance - last.deviance) / model_comparison.overdispersion([curve, last])
    says = (
        f"{_titles(ids)} would fit, but cancel each other: about one place they are together no more than "
        f"{100.0 * left:.0f} % as stiff as either is, and one curve over the position does as well. It may be all of "
        "them, or one thing of another shape, as a spring that stiffens: a wider travel would tell."
    )
    return None if more > thresholds.MIN_GAIN else Substitution(ids, curve, says)


def best_substitution(problem: FitProblem, first: Structure, last: Fit) -> Substitution | None:
    """The last model with a nameless curve in the place of names, where the recording supports it."""
    variables = [v for v in CURVE_SLOTS if not (problem.recordings[0].drive.speed and v == "position")]
    pieces = substitute_cancelling(problem, first, last) if "position" in variables else None
    curves = [substitute_curve(problem, first, last, v) for v in variables] if pieces is None else [pieces]
    found = [r for r in (*curves, substitute_gain_wave(problem, first, last)) if r is not None]
    best: Substitution | None = min(found, key=lambda r: r.curve.deviance, default=None)
    if best is None:
        return None
    others = [i for i in best.curve.structure.named if i in CANDIDATES and i not in first]
    return replace(best, curve=_drop_idle_names(problem, first, best.curve, others))
