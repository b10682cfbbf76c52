"""The tests that a name of the last model must pass, at the longest filter memory that the model supports."""

from __future__ import annotations

import numpy as np

from twin.diagnosis import (
    acceptance,
    cross_validation,
    forward_selection,
    thresholds,
)
from twin.diagnosis.result import NotBorneOut
from twin.diagnosis.search_result import SearchResult
from twin.effects.catalogue import EFFECTS
from twin.estimation import likelihood, local_optima, multistart
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model.stepper import Structure


def fit_with_longest_memory(found: SearchResult) -> tuple[FitProblem, Fit]:
    """The last model with the longest filter memory that it supports, and the problem with its predicted contacts as
    the mask. The memory is not shortened: a shorter one would not see the slow torques that the model was chosen by.
    """
    sharp = local_optima.with_longer_memory(found.problem, found.last)
    return multistart.refit_with_contact_mask(found.problem, sharp, most=sharp.process_noise)


def _idle_names(problem: FitProblem, sharp: Fit, first: Structure) -> list[str]:
    """The names beyond the first model that do nothing: with a size of zero and nothing else changed, `sharp` is as
    likely.
    """
    out = []
    for page in (EFFECTS[i] for i in sharp.structure.named if i not in first):
        size = next((p for p in page.parameters if page.screen and p.name == page.screen.gain), None)
        if size is None or size.neutral is None:
            continue
        values = {**sharp.values, size.name: size.neutral}
        without = likelihood.evaluate(problem.at(sharp.process_noise), sharp.structure, values)
        if without.deviance - sharp.deviance < thresholds.PENALTY_PER_PARAMETER:
            out.append(page.id)
    return out


def name_p_values(found: SearchResult, first: Structure) -> dict[str, float]:
    """The p-value of each name beyond the first model: the chance that it predicts as well without being real. Bounces
    that happened to fit it may have won it its round. A name with too little data for a decision has none.
    """
    out = {}
    for effect in (i for i in found.last.structure.named if i not in first):
        without = [q for q in found.smaller_models if effect not in q.structure]
        if without:
            gains = cross_validation.block_gains(found.problem, min(without, key=lambda q: q.deviance), found.last)
            # A few seconds tell nothing either way.
            if np.count_nonzero(gains) >= thresholds.MIN_BLOCKS:
                out[effect] = cross_validation.p_value_of_gains(gains)
    return out


def _unearned(found: SearchResult, foreseen: tuple[FitProblem, Fit], first: Structure) -> list[NotBorneOut]:
    """The names beyond the first model that fail a test. These are all that do nothing, or else the one that fails most
    clearly.

    Of two that do the same, neither predicts anything beside the other. So one is removed and the other tested again.
    """
    idle = _idle_names(*foreseen, first)
    if idle:
        reason = "with the longest filter memory that fits the model it is as likely without this effect"
        return [NotBorneOut(i, reason, 0.0) for i in idle]
    lesser = {i: [q for q in found.smaller_models if i not in q.structure] for i in found.last.structure.named}
    best = {i: min(fits, key=lambda q: q.deviance) for i, fits in lesser.items() if fits and i not in first}
    if failed := acceptance.not_borne_out(*foreseen, first, best):
        return [failed]
    chances = name_p_values(found, first)
    worst = max(chances, key=lambda e: chances[e], default="")
    if worst and chances[worst] > thresholds.NAME_MAX_P_VALUE:
        reason = f"it predicts parts that were left out no better than chance may (p = {chances[worst]:.2g})"
        return [NotBorneOut(worst, reason, chances[worst])]
    return []


def drop_unearned_names(
    found: SearchResult, first: Structure
) -> tuple[SearchResult, tuple[FitProblem, Fit], list[NotBorneOut]]:
    """The search without the names of its last model that fail a test. The last model with the longest memory that it
    supports. And the names that failed.
    """
    failed: list[NotBorneOut] = []
    while True:
        foreseen = fit_with_longest_memory(found)
        unearned = _unearned(found, foreseen, first)
        if not unearned:
            return found, foreseen, failed
        failed += unearned
        found = forward_selection.drop_effects(found, [n.id for n in unearned], foreseen[1].values)
