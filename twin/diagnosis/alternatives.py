"""The last model with a rival, or an effect that contains it, in the place of one of its effects."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import partial

from twin.diagnosis import (
    dead_band_rivals,
    model_comparison,
    round_margin,
    selection_round,
    thresholds,
)
from twin.diagnosis.plausibility import is_plausible
from twin.diagnosis.search_result import Alternative
from twin.diagnosis.selection_round import Round
from twin.effects.catalogue import EFFECTS
from twin.estimation import (
    local_optima,
    optimizer,
    parameter_bounds,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model.stepper import Structure
from twin.parallel import each


def exchanged(
    problem: FitProblem, last: Fit, first: Structure, lesser: Sequence[Fit], rounds: Sequence[Round],
) -> list[Alternative]:  # fmt: skip
    """The last model with each effect exchanged for every close rival. A rival that would do better has to be confirmed
    in its place.

    `lesser` are smaller models that the last one is compared with, down to the first.
    """
    out = []
    for effect in last.structure.named:
        contest = round_margin.margin_of(rounds, last.structure, effect)
        margin = max(thresholds.UNDECIDED_MARGIN, thresholds.NARROW_SHARE * contest.gain)
        for h, short in contest.rivals:
            if short < margin:
                own, brought = h.point, last.structure.brought_by(effect, first)
                starts = ({**own.values, **last.values}, {**last.values, **own.values})
                # What the effect had brought along may be there without it.
                others = dict.fromkeys(last.structure.without(effect, *i).with_(*h.added) for i in ((), brought))
                begun = itertools.product(others, starts)
                tried = each(lambda b: local_optima.refit(problem.at(last.process_noise), b[0], b[1]), begun)
                point = local_optima.refit_through_best_noise(
                    problem, min(tried, key=lambda p: model_comparison.criterion_difference_penalised(p, last))
                )
                # What stays behind takes no place, and needs no test: that something is there is known from the effect.
                without = min((q for q in lesser if effect not in q.structure), key=lambda q: q.deviance)
                stays = model_comparison.criterion_difference_penalised(point, last) >= 0.0
                if is_plausible(problem, point, last) and (
                    stays or selection_round.is_confirmed(problem, without, point)
                ):
                    out.append(Alternative(effect, h.added[0], point))
    return out


def overtaking_fits(rounds: Sequence[Round], effect: str, other: str) -> list[Fit]:
    """The fits with the other effect, where its gain over the effect in one round was significant by itself."""
    fits = [{h.added[0]: h.point for h in this.rivals} for this in rounds]
    if not any(effect in by and other in by and model_comparison.is_significant(by[effect], by[other]) for by in fits):
        return []
    return [by[other] for by in fits if other in by]


def containing(
    problem: FitProblem,
    last: Fit,
    first: Structure,
    candidates: Sequence[str],
    rounds: Sequence[Round] = (),
) -> list[Alternative]:
    """The last model with a wider effect of the same size in the place of one of its effects, where that fits about as
    well.

    Dry friction that differs between the directions equals dry friction and a dead-band that is wider on one side,
    unless something moves without the drive. The simpler one is named, but the evidence for it is weak. Where the wider
    effect gained more in one of the rounds, it is tried at any size. A filter with a longer memory may have seen what
    the last one does not.
    """
    out = []
    for effect, other in itertools.product(last.structure.named, candidates):
        if effect not in EFFECTS[other].includes or effect in first or other in last.structure:
            continue
        own, more = EFFECTS[effect].screen, EFFECTS[other].screen
        assert own is not None and more is not None
        longer, size = last.structure.with_(other), last.values[own.gain]
        known = preparation.complete_values(longer, last.values) | dict(problem.held)
        starts = [known | {more.gain: s * size} for s in (1.0, -1.0) if more.gain not in problem.held]
        allowed = filter(parameter_bounds.within_bounds, starts)
        climb = partial(optimizer.levenberg_marquardt, problem.at(last.process_noise), longer, free=last.free)
        fits = each(climb, allowed)
        for h in overtaking_fits(rounds, effect, other):
            share = h.values[more.gain] / max(h.values[own.gain], 1e-300)
            begins = ({**last.values, more.gain: share * size}, {**last.values, **h.values})
            fits.append(local_optima.best_refit(problem.at(last.process_noise), longer, begins))
        found = min(fits, key=lambda p: p.deviance, default=None)
        if (
            found is not None
            and model_comparison.criterion_difference(last, found) < thresholds.UNDECIDED_MARGIN
            and is_plausible(problem, found, last)
        ):
            out.append(Alternative(effect, other, found))
    return out


def prefer_containing(
    problem: FitProblem,
    last: Fit,
    swaps: Sequence[Alternative],
    wider: Sequence[Alternative],
) -> tuple[Fit, list[Alternative]]:
    """The last model, or the likeliest one with a wider effect that is worth its parameters. And the alternatives to
    the effects that are named then.
    """
    likeliest = max(wider, key=lambda w: model_comparison.criterion_difference(w.point, last), default=None)
    if likeliest is not None:
        found = likeliest.point
        freed = local_optima.refit(problem.at(last.process_noise), found.structure, found.values)
        if model_comparison.criterion_difference(freed, last) > 0.0:
            others = [w for w in swaps if w.effect in freed.structure.named]
            return freed, [*others, Alternative(likeliest.rival, likeliest.effect, last)]
    return last, [*swaps, *wider]


def refitted(
    problem: FitProblem,
    last: Fit,
    swaps: Sequence[Alternative],
    more: Sequence[str] = (),
    fewer: Sequence[str] = (),
) -> list[Alternative]:
    """The alternatives, refitted to a last model that has gained some effects and lost others."""
    out = []
    for w in swaps:
        if w.rival in last.structure or w.effect not in last.structure:
            continue
        if w.effect == "dead_band":
            out += dead_band_rivals.offset_for_dead_bands(problem, last, [w.rival])
        else:
            structure = w.point.structure.with_(*more).without(*fewer)
            starts = ({**last.values, **w.point.values}, {**w.point.values, **last.values})
            out.append(
                Alternative(
                    w.effect, w.rival, local_optima.best_refit(problem.at(last.process_noise), structure, starts)
                )
            )
    return out
