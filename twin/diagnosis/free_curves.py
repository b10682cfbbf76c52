"""Curves of no known shape against the names: which serves best, and whether it takes their place."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

from twin.diagnosis import (
    block_validation,
    cross_validation,
    curve_substitution,
    forward_selection,
    law_tolerance,
    model_comparison,
    nonparametric,
    probabilities,
    selection_round,
    thresholds,
)
from twin.diagnosis.nonparametric import TERM_KINDS, CurveTerm
from twin.diagnosis.plausibility import is_plausible
from twin.diagnosis.search_result import SearchResult
from twin.effects.catalogue import EFFECTS, UNKNOWN
from twin.estimation import local_optima, optimizer, preparation
from twin.estimation.fit import Fit
from twin.model.stepper import Structure
from twin.parallel import each

#: Shapes that are tried whatever the missing torque shows: the likelihood sees more of them than its averages do.
ALWAYS_TRIED = ("position", "velocity", "input", "time", "drag")


def best_curve(
    found: SearchResult,
    before: nonparametric.RemainingDependence,
    after: nonparametric.RemainingDependence,
    chances: Mapping[str, float],
) -> Fit:
    """The first model with the term of no known shape that serves it best; by itself where the names leave it nothing.

    `before` and `after` are what the first model and the last one lack, `chances` the p-values of the names. The names
    may have led to better values of the first model's own parameters.
    """
    first, last = found.first, found.last
    if not nonparametric.is_torque_known(found.problem, first):
        return first
    bases, left = [first], [before]
    if last.structure != first.structure:
        named, _ = probabilities.probabilities(found)
        likely = all(named[e] > thresholds.LIKELY_NAME for e in last.structure.named if e not in first.structure)
        plain = all(chance < thresholds.NAME_CLEAR_P_VALUE for chance in chances.values())
        if (
            likely
            and plain
            and after.share < thresholds.FAINT_SHARE
            and nonparametric.share_removed(before, after) >= before.share
        ):
            return first
        bases.append(replace(first, values={n: last.values.get(n, v) for n, v in first.values.items()}))
        left.append(after)
    speed = found.problem.recordings[0].drive.speed
    # Several recordings of speed begin at unknown angles.
    several = speed and len(found.problem.recordings) > 1
    strange = [k for k in TERM_KINDS if several and "position" in EFFECTS[f"unknown_{k}"].depends_on]
    strange += [] if nonparametric.fixes_drive_curve(found.problem.recordings) else ["input"]
    shown = [t for one in left for t in nonparametric.candidate_terms(one) if t.kind not in strange]
    always = [CurveTerm(k) for k in ALWAYS_TRIED if not (k in strange or (k == "position" and speed))]
    terms = dict.fromkeys((*shown, *always))
    tried = each(lambda pair: nonparametric.sketch_curve(found.problem, *pair), itertools.product(bases, terms))
    fits = each(
        lambda p: nonparametric.fit_curve(found.problem, p),
        sorted(tried, key=lambda p: p.deviance)[: thresholds.MAX_CURVES],
    )
    # Missing physics may have led gap and teeth of the first model to a wrong optimum. A fit far behind the names stays
    # there.
    near = [
        p
        for p in fits
        if model_comparison.gain(first, p) > 0.0
        and model_comparison.criterion_difference(last, p) < thresholds.MIN_GAIN
    ]
    promising = [p for p in near if is_plausible(found.problem, p, first)]
    if not promising:
        return first
    # A curve over time follows whatever happened once: of several, what comes again is the better one.
    chosen = promising[0]
    if len(promising) > 1:
        chosen = min(promising, key=lambda p: cross_validation.gain_p_value(found.problem, first, p))
    return nonparametric.restart_curve_gap(found.problem, chosen)


def restart_from_curve(found: SearchResult, nameless: Fit) -> SearchResult:
    """The search, its last model refitted from the values beside a better curve, in all that both share. Gap and teeth
    were searched again beside the curve, and the gain of that is not the curve's. Rivals start there, too.
    """
    last = found.last
    if not model_comparison.is_significant(last, nameless):
        return found
    begun = {**last.values, **{n: nameless.values[n] for n in last.free if n in nameless.free}}
    # Which side of the gap a torque acts on decides how it is crossed: from the wrong one no slope leads to the other.
    sides = [begun, *({**begun, "shaft_share": side} for side in (0.0, 1.0) if "shaft_share" in last.free)]
    other = local_optima.best_refit(
        found.problem.holding(local_optima.held_values(last)).at(last.process_noise), last.structure, sides
    )
    best = min(last, other, key=lambda p: p.deviance)
    return found if best is last else forward_selection.with_last_model(found, best)


def replaces_names(found: SearchResult, nameless: Fit, left: Sequence[nonparametric.RemainingDependence]) -> bool:
    """Whether a nameless curve replaces the names: it improves the fit more than they do, and beside it they gain
    nothing.

    If the missing torque of neither model, `left`, depends on anything, the curve has to predict data that it was not
    fitted to. The missing torque of the first model may clearly depend on something while nothing is named. A curve
    that predicts left-out data then need only pay its own penalty. Every real friction departs a little from its law,
    and a curve of any shape follows it. But the curve lacks the rest of the law: for example, that this friction
    changes sign with the motion. So names stay where they are found again beside the curve and each still improves the
    fit significantly. Dry friction that leaves little also stays, alone or with a constant torque, where the curve is
    one over the speed. A motor that varies over its turn acts like friction that varies, but is none. A ripple keeps
    its name from a curve that is the same ripple with its overtones.
    """
    if curve_substitution.is_ripple(found.last, nameless):
        return False
    new = [EFFECTS[i] for i in found.last.structure.named if i not in found.first.structure]
    certain = (
        not new
        and left[0].p_value < thresholds.CERTAIN_DEPENDENCE_P_VALUE
        and model_comparison.gain(found.last, nameless) > 0.0
    )
    doubt = law_tolerance.doubt_since(found.problem, found.first.structure, found.last)
    earns = model_comparison.is_significant(found.last, nameless, doubt)
    if not (earns or certain):
        return False
    follows = "unknown_velocity" in nameless.structure and all(
        e.slot == "grip" or e.id == "constant_offset" for e in new
    )
    if new and follows and nonparametric.share_removed(*left) > 1.0 - thresholds.DRY_FRICTION_SHARE**2:
        return False
    goes = any(one.p_value < thresholds.DEPENDENCE_MAX_P_VALUE for one in left) and selection_round.is_confirmed(
        found.problem, found.last, nameless
    )
    if (
        not (goes and earns)
        and cross_validation.gain_p_value(found.problem, found.last, nameless) > thresholds.CURVE_MAX_P_VALUE
    ):
        return False
    return (
        model_comparison.criterion_difference(_fit_names_beside_curve(found, nameless), nameless)
        <= len(new) * thresholds.MIN_GAIN
    )


def with_curve(found: SearchResult, nameless: Fit) -> SearchResult:
    """The search, ended with what has no name in the place of all names."""
    return replace(found, last=nameless, rounds=found.rounds[:1], smaller_models=(), alternatives=())


def keep_or_replace(found: SearchResult, nameless: Fit) -> SearchResult:
    """What becomes of a model whose names leave most of the missing torque where it was.

    They are replaced by a curve that predicts better. A curve that does not improve the fit significantly, or does less
    than the names, would only mislead a free run. Then the model stays as it is.
    """
    if (
        model_comparison.is_significant(found.first, nameless)
        and model_comparison.criterion_difference(nameless, found.last) >= 0.0
    ):
        return with_curve(found, nameless)
    return found


def _fit_names_beside_curve(found: SearchResult, nameless: Fit) -> Fit:
    """The nameless curve with the names fitted from zero beside it. The curve alone where nothing was named."""
    last, first = found.last, found.first
    both = nameless.structure.with_(*last.structure.ids)
    if both == nameless.structure:
        return nameless
    new = [p for e in last.structure.effects if e not in first.structure.effects for p in e.parameters]
    nothing = {p.name: p.neutral for p in new if p.neutral is not None}
    kept = [n for n in last.free if n not in first.free]
    begun = preparation.complete_values(both, {**last.values, **nameless.values, **nothing})
    return optimizer.levenberg_marquardt(
        found.problem.at(nameless.process_noise), both, begun, tuple(dict.fromkeys((*nameless.free, *kept)))
    )


def without_worse_curve(found: SearchResult, first: Structure) -> tuple[SearchResult, list[str]]:
    """The search. Its first model replaces a last one whose curve does not help on data that it was not fitted to."""
    curves = [i for i in found.last.structure.ids if i in UNKNOWN and i not in first]
    if not curves or block_validation.improves(found.problem, found.first, found.last):
        return found, []
    titles = " and ".join(EFFECTS[i].title for i in curves)
    says = (
        f"{titles[:1].upper()}{titles[1:]} would fit better one step ahead, but makes the free run no better through "
        "blocks that it was not fitted to: the model stays as it was."
    )
    return back_to_first(found), [says]


def back_to_first(found: SearchResult) -> SearchResult:
    """The search, ended with the first model."""
    return replace(found, last=found.first, smaller_models=(), alternatives=())
