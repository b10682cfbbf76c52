"""Which effects a first model lacks. They are added one at a time, pruned, and compared with those that they are easily
confused with. Then more are looked for with a filter whose memory is as short as the recording asks
(`short_memory`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from twin.diagnosis import (
    alternatives,
    dead_band_rivals,
    events,
    gap_presence,
    growth,
    model_comparison,
    screening,
    selection_round,
    short_memory,
    thresholds,
)
from twin.diagnosis.growth import Progress
from twin.diagnosis.search_result import Alternative, SearchResult
from twin.diagnosis.selection_round import Round
from twin.effects.catalogue import CANDIDATES, EFFECTS
from twin.estimation import (
    contact_masking,
    local_optima,
    multistart,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.stepper import Structure


def _first_fit(
    recordings: Sequence[Recording], first: Structure, held: Mapping[str, float]
) -> tuple[FitProblem, Fit, Fit]:
    """The problem, the first model as a search judges it, and its likeliest values."""
    problem, rough = multistart.coarse_starts(recordings, first, held)
    polished, fine = multistart.leave_local_optima(
        problem, multistart.fit_from_starts(problem, preparation.with_tooth_compliance(first), rough)
    )
    # What a model without the right physics cannot predict may be what is looked for.
    problem = contact_masking.without_contact_mask(polished)
    noise = local_optima.judging_process_noise(problem, fine)
    return problem, local_optima.refit(problem.at(noise), first, fine.values), fine


def search(
    recordings: Sequence[Recording],
    first: Structure,
    held: Mapping[str, float],
    candidates: Sequence[str] = CANDIDATES,
    progress: Progress | None = None,
) -> SearchResult:
    """Add effects one at a time as long as each improves the fit significantly, then refine the result."""
    tell = progress or (lambda sentence, share: None)
    tell("fitting the first model", 0.0)
    problem, best, fine = _first_fit(recordings, first, held)
    if gap_presence.is_gap_a_makeshift(problem, best):
        first, candidates = first.without(*gap_presence.GAP), (*candidates, "backlash")
        problem, best, fine = _first_fit(recordings, first, held)
    candidates = screening.testable_candidates(problem, candidates, first)
    ground = first
    if friction := dead_band_rivals.friction_for_dead_band(problem, best, candidates):
        best, ground = friction, ground.without("dead_band").with_("coulomb_friction")
    events.announce(events.Reached(problem, best))
    found = _search_from(problem, best, (), ground, candidates, tell)
    for this in _narrow_rounds(problem, found, best.process_noise):
        start = growth.plain_winner(problem, this)
        if not _leads_elsewhere(problem, found, start, candidates):
            continue
        tell(f"beginning anew with {EFFECTS[this.rivals[0].added[0]].title}", 0.7)
        with events.observing(None):
            other = _search_from(
                problem, start, (growth.with_better_fit(this, start),), ground, candidates, lambda said, share: None
            )
        found = _better_search(problem, found, other)
        if found.last is other.last:
            break
    rigid = gap_presence.without_idle_gap(found)
    if rigid is not None:
        problem, ground = rigid[0], ground.without(*gap_presence.GAP)
        found = _search_from(*rigid, found.rounds, ground, candidates, tell)
    best, rounds = growth.without_unmet_stops(problem, found.last), found.rounds
    wider = alternatives.containing(problem, best, ground, candidates, rounds)
    best, swaps = alternatives.prefer_containing(problem, best, found.alternatives, wider)
    swaps = [*swaps, *dead_band_rivals.offset_for_dead_bands(problem, best, candidates)]
    if ground != first:
        begun = local_optima.refit(problem.at(best.process_noise), first, fine.values)
        found = replace(found, first=begun, smaller_models=(*found.smaller_models, begun))
    if friction:
        swaps += dead_band_rivals.dead_band_for_friction(problem, best, begun)
    tell("looking closer", 0.8)
    events.announce(events.Reached(problem, best))
    closer = short_memory.refine_with_short_memory(replace(found, last=best, alternatives=tuple(swaps)), candidates)
    return replace(closer, last=dead_band_rivals.with_level_dead_bands(closer.problem, closer.last))


def _search_from(
    problem: FitProblem, best: Fit, rounds: Sequence[Round], first: Structure, candidates: Sequence[str], tell: Progress
) -> SearchResult:
    """The search that grows from a model which these rounds led to."""
    rounds, room = list(rounds), thresholds.MAX_EFFECTS - len(rounds)
    for _ in range(thresholds.MAX_REPLACEMENTS):
        grown, more = growth.add_effects(problem, best, first, candidates, tell, room)
        rounds += more
        # What the last model is compared with is judged at the same noise.
        start = rounds[0].before if rounds else grown
        begun = local_optima.refit(problem.at(grown.process_noise), first, start.values)
        best, lesser, swaps = growth.prune_and_exchange(problem, grown, begun, rounds)
        begun = growth.best_of_structure(lesser, begun)
        # An effect that was replaced or pruned may have hidden another one. This is not so where it did more than all
        # others.
        if best.structure in (grown.structure, *(this.before.structure for this in rounds)):
            break
    return SearchResult(begun, best, tuple(rounds), problem, tuple(lesser), tuple(swaps))


def _narrow_rounds(problem: FitProblem, found: SearchResult, process_noise: float) -> list[Round]:
    """The first round, won by a rival instead, once for each rival of these. It is confirmed. Its gain, in units of its
    own, was about as large as the winner's, or larger. It neither contains the winner nor is contained in it.

    A misleading effect may reduce the deviance most, since correlated innovations count the same evidence many times
    over. None where the round was not won with the first noise density of the search, or only with a second effect.
    """
    this = found.rounds[0] if found.rounds else None
    if this is None or not this.won or this.before.process_noise < process_noise:
        return []
    winner, *others = this.rivals
    gain = model_comparison.gain(this.before, winner.point)
    if gain <= thresholds.MIN_GAIN:
        return []
    least = max(thresholds.MIN_GAIN, (1.0 - thresholds.NARROW_SHARE) * gain)
    apart = [
        h
        for h in others
        if winner.added[0] not in h.point.structure and h.added[0] not in {*winner.point.structure.ids, *this.refused}
    ]
    gains = {h.added[0]: model_comparison.gain(this.before, h.point) for h in apart}
    close = sorted((h for h in apart if gains[h.added[0]] > least), key=lambda h: -gains[h.added[0]])
    shown = [h for h in close[: thresholds.MAX_RESTARTS] if selection_round.is_confirmed(problem, this.before, h.point)]
    return [replace(this, rivals=(h, *(o for o in this.rivals if o is not h))) for h in shown]


def _leads_elsewhere(problem: FitProblem, found: SearchResult, start: Fit, candidates: Sequence[str]) -> bool:
    """Whether a second effect beside this start, after a few steps, makes a better model than the winner of the first
    round. The winner itself is no second effect: a rival that needs it has not misled the search.
    """
    winner = found.rounds[0].rivals[0]
    open_ = [c for c in growth.open_candidates(candidates, start) if c not in winner.added]
    seconds = selection_round.screen_candidates(problem, start, screening.trial_grids(problem, start, open_))
    return any(model_comparison.criterion_difference(h.point, winner.point) > 0.0 for h in seconds)


def _better_search(problem: FitProblem, one: SearchResult, other: SearchResult) -> SearchResult:
    """The search with the better last model, both judged at one noise density. Where both ends are the same but for one
    effect each, the other's effect is its alternative.
    """
    process_noise = min(one.last.process_noise, other.last.process_noise)

    def judged(end: Fit) -> Fit:
        same = end.process_noise == process_noise
        return end if same else local_optima.refit(problem.at(process_noise), end.structure, end.values)

    ends = [(one, judged(one.last)), (other, judged(other.last))]
    if model_comparison.criterion_difference_penalised(ends[1][1], ends[0][1]) < 0.0:
        ends.reverse()
    (kept, best), (_, lost) = ends
    if one.last.structure == other.last.structure:
        return replace(one, last=best) if one.last.process_noise == process_noise else one
    own, rival = ([i for i in a.structure.named if i not in b.structure] for a, b in ((best, lost), (lost, best)))
    told = {(w.effect, w.rival) for w in kept.alternatives}
    if len(own) == len(rival) == 1 and (own[0], rival[0]) not in told and kept.last is best:
        return replace(kept, alternatives=(*kept.alternatives, Alternative(own[0], rival[0], lost)))
    return kept


def with_last_model(found: SearchResult, last: Fit) -> SearchResult:
    """The search with another last model of the same structure. The models that it is compared with are fitted
    again."""
    kept = local_optima.held_values(last)
    fits = growth.refits(
        found.problem.holding(kept), last, growth.smaller_structures(last.structure, found.first.structure)
    )
    swaps = alternatives.refitted(found.problem.holding(kept), last, found.alternatives)
    return replace(found, last=last, smaller_models=(*fits, found.first) if fits else (), alternatives=tuple(swaps))


def drop_effects(found: SearchResult, effects: Sequence[str], values: Mapping[str, float]) -> SearchResult:
    """The search, its last model without some of its effects, from these values. A removed effect may replace one that
    stays: of two that do the same, the removed one may fit better alone.
    """
    kept, structure = local_optima.held_values(found.last), found.last.structure.without(*effects)
    alone = local_optima.refit(found.problem.holding(kept).at(found.last.process_noise), structure, values)
    last, lesser, swaps = growth.prune_and_exchange(found.problem.holding(kept), alone, found.first, found.rounds)
    told = {(w.effect, w.rival) for w in swaps}
    others = [w for w in found.alternatives if (w.effect, w.rival) not in told]
    swaps += alternatives.refitted(found.problem.holding(kept), last, others, fewer=effects)
    return replace(found, last=last, smaller_models=tuple(lesser), alternatives=tuple(swaps))
