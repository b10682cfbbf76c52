"""What a filter with a memory as short as the recording asks for sees beside a model that was found."""

from __future__ import annotations

from collections.abc import Sequence

from twin.diagnosis import (
    alternatives,
    growth,
    model_comparison,
    screening,
    selection_round,
    thresholds,
)
from twin.diagnosis.search_result import SearchResult
from twin.diagnosis.selection_round import Round
from twin.estimation import (
    local_optima,
    multistart,
    optimizer,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem


def _fit_at_best_noise(problem: FitProblem, point: Fit) -> tuple[FitProblem, Fit]:
    """The problem, judged only at contacts that the model predicts. And the maximum near the point at the most likely
    process noise.
    """
    found = optimizer.fit_with_process_noise(problem.at(point.process_noise), point.structure, point.values, point.free)
    for _ in range(thresholds.MAX_MASK_UPDATES):
        problem, found = multistart.refit_with_contact_mask(problem, found)
    return problem, found


def _add_with_short_memory(
    problem: FitProblem, best: Fit, most: int, candidates: Sequence[str]
) -> tuple[FitProblem, Fit, list[Round]]:  # fmt: skip
    """The model with up to `most` more effects, each judged at the noise and the contact mask of the model before it.
    And the rounds won."""
    rounds: list[Round] = []
    while len(rounds) < most and (open_ := growth.open_candidates(candidates, best)):
        seen = selection_round.screen_candidates(problem, best, screening.trial_grids(problem, best, open_))
        if not any(
            model_comparison.gain(best, h.point) > thresholds.PROMISING_SHARE * thresholds.MIN_GAIN_AT_OTHER_MEMORY
            for h in seen
        ):
            break
        this = selection_round.run_round(problem, best, seen[: thresholds.MAX_FITTED], open_)
        if (
            not this.won
            or model_comparison.gain(this.before, this.rivals[0].point) < thresholds.MIN_GAIN_AT_OTHER_MEMORY
        ):
            break
        rounds.append(this)
        problem, best = _fit_at_best_noise(problem, growth.plain_winner(problem, this))
    return problem, best, rounds


def _add_with_usual_memory(
    found: SearchResult,
    problem: FitProblem,
    best: Fit,
    most: int,
    candidates: Sequence[str],
) -> tuple[FitProblem, Fit, list[Round]]:
    """The model with up to `most` more effects that the filter with the usual memory sees now. And the rounds won.

    An effect may look faint to that filter only because the model without it was misled, and then lacked more.
    """
    settled = local_optima.refit(found.problem.at(found.last.process_noise), best.structure, best.values)
    usual = growth.restart(found.problem, settled)
    grown, rounds = growth.add_effects(
        found.problem, usual, found.first.structure, candidates, lambda sentence, share: None, most
    )
    won = [this for this in rounds if this.won]
    return (*_fit_at_best_noise(found.problem, grown), won) if won else (problem, best, [])


def refine_with_short_memory(found: SearchResult, candidates: Sequence[str]) -> SearchResult:
    """The search, with the effects that a filter with a shorter memory shows beside its last model. The memory is no
    longer than the recording asks for, and contacts are judged only if the model predicts them. Where nothing shows,
    the search is as it was. Where a motor rattles, errors over a tenth of a second are correlated. A unit of deviance
    is then worth a fiftieth of what it is to a filter with a shorter memory. So the latter sees a faint effect beside
    those that were found. But such a filter does not see slow torques, and it weighs presliding at rest as much as what
    moves the axis. So it removes nothing, and leaves what had been found as it is. It also sees how the axis departs
    from every law. So what it alone shows has to gain as much more as what only a longer memory shows.
    """
    problem, known = _fit_at_best_noise(found.problem, found.last)
    if known.process_noise < local_optima.PROCESS_NOISE_TOLERANCE * found.last.process_noise and all(
        c.contact_mask is None for c in problem.recordings
    ):
        return found
    room = thresholds.MAX_EFFECTS - len(set(known.structure.named) - set(found.first.structure.named))
    problem, best, rounds = _add_with_short_memory(problem, known, room, candidates)
    if not rounds:
        return found
    problem, best, more = _add_with_usual_memory(found, problem, best, room - len(rounds), candidates)
    rounds += more
    known = local_optima.refit(problem.at(best.process_noise), known.structure, known.values)
    best, _, swaps = growth.prune_and_exchange(problem, best, known, rounds)
    new = [e for e in best.structure.named if e not in known.structure]
    if not new:
        return found
    first = local_optima.refit(problem.at(best.process_noise), found.first.structure, found.first.values)
    # What had been found is judged beside what is new, each by itself.
    lesser = growth.refits(problem, best, growth.smaller_structures(best.structure, first.structure))
    best = growth.without_unmet_stops(problem, best)
    wider = [
        w for w in alternatives.containing(problem, best, found.first.structure, candidates, rounds) if w.effect in new
    ]
    best, swaps = alternatives.prefer_containing(problem, best, swaps, wider)
    added = [e for e in best.structure.named if e not in known.structure]
    swaps += alternatives.refitted(problem, best, found.alternatives, more=added)
    return SearchResult(first, best, (*found.rounds, *rounds), problem, (*lesser, first), tuple(swaps))
