"""A model grows by one effect after another, and is pruned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from twin.diagnosis import (
    alternatives,
    events,
    gap_presence,
    law_tolerance,
    model_comparison,
    selection_round,
    thresholds,
)
from twin.diagnosis.plausibility import is_plausible
from twin.diagnosis.search_result import Alternative
from twin.diagnosis.selection_round import Hypothesis, Round
from twin.effects.catalogue import EFFECTS
from twin.effects.end_stop import NOWHERE
from twin.estimation import (
    local_optima,
    optimizer,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model.stepper import Structure
from twin.parallel import each

Progress = Callable[[str, float], None]


def smaller_structures(structure: Structure, keep: Structure) -> list[Structure]:
    """The structure less one effect each, with and without what that effect brought along."""
    out = []
    for effect in structure.named:
        if effect not in keep:
            brought = structure.brought_by(effect, keep)
            out += [structure.without(effect)] if brought else []
            out += [structure.without(effect, *brought)]
    return out


def refits(problem: FitProblem, point: Fit, structures: Sequence[Structure]) -> list[Fit]:
    return each(lambda s: local_optima.refit(problem.at(point.process_noise), s, point.values), structures)


def best_smaller(problem: FitProblem, point: Fit, lesser: Sequence[Fit], plain: Fit) -> Fit:
    """The best of the lesser fits whose lack does not matter, or the point itself.

    What a law misses of what it stands for must not pass for another effect.
    """
    missed = law_tolerance.doubt(plain, point)
    fair = [
        q for q in lesser if is_plausible(problem, q, point) and not model_comparison.is_significant(q, point, missed)
    ]
    return min(
        fair, key=lambda q: model_comparison.criterion(q, model_comparison.overdispersion([point])), default=point
    )


def restart(problem: FitProblem, point: Fit) -> Fit:
    """The point at its most likely noise density, with gap and teeth searched again. It stays as it was where that
    would turn an effect into something else.
    """
    moved = local_optima.restart_gap(problem, local_optima.refit_at_own_noise(problem, point))
    return moved if is_plausible(problem, moved, point) else point


def add_effects(
    problem: FitProblem, best: Fit, first: Structure, candidates: Sequence[str], tell: Progress,
    most: int = thresholds.MAX_EFFECTS,
) -> tuple[Fit, list[Round]]:  # fmt: skip
    """The model with up to this many effects that improve the fit significantly, added one at a time. And the rounds,
    of which the last may have added none.

    What laws of the model before may leave, since `first`, is no other effect.
    """
    rounds: list[Round] = []
    known: list[Hypothesis] = []
    while len(rounds) < most and (open_ := open_candidates(candidates, best)):
        tell(f"round {len(rounds) + 1}: trying {len(open_)} effects", 0.05 + 0.2 * len(rounds))
        best = restart(problem, best) if rounds else best
        usual = selection_round.run_round(problem, best, known, open_)
        this = selection_round.retry_with_long_memory(problem, usual, open_)
        if not this.won or _is_left_by_laws(problem, first, this):
            best = this.before
            rounds.append(replace(this, won=False))
            events.announce(events.Reached(problem, best))
            break
        winner, best = (
            this.rivals[0].point,
            gap_presence.with_gap_again(problem, plain_winner(problem, this), candidates),
        )
        known = [] if best is winner else [this.rivals[0]]
        rounds.append(with_better_fit(this, best))
        events.announce(events.Reached(problem, best))
        if this is not usual:
            # Over such a long memory other effects would gain enough by the chance of a bounce.
            break
    return best, rounds


def open_candidates(candidates: Sequence[str], best: Fit) -> list[str]:
    """The candidates that the model lacks and that a score test can see. A gap has none: see `gap_presence`."""
    return [c for c in candidates if c not in best.structure and EFFECTS[c].screen]


def _is_left_by_laws(problem: FitProblem, first: Structure, this: Round) -> bool:
    """Whether the winner of the round gains no more than the laws of the model before it may leave."""
    gained = this.before.deviance - this.rivals[0].deviance
    return gained < law_tolerance.doubt_since(problem, first, this.before)


def _prune(
    problem: FitProblem, best: Fit, begun: Fit
) -> tuple[Fit, list[Fit]]:  # fmt: skip
    """The model without its superfluous effects, and the smaller ones that it is compared with."""
    lesser: list[Fit] = []
    plain = law_tolerance.plain_fit(problem, begun.structure, begun)
    while fewer := smaller_structures(best.structure, begun.structure):
        lesser = [*refits(problem, best, fewer), begun]
        less = best_smaller(problem, best, lesser, plain)
        if less is best:
            break
        best = less
    return best, lesser


def without_unmet_stops(problem: FitProblem, last: Fit) -> Fit:
    """The model with a stop only on the side where one is met.

    A stop that nothing shows may stand at the furthest reading or anywhere beyond. Were it kept there, the next
    recording that goes further would hit it.
    """
    fits = [last]
    for stop, far in NOWHERE.items():
        if stop in last.free:
            free = tuple(n for n in last.free if n != stop)
            fits.append(
                optimizer.levenberg_marquardt(
                    problem.at(last.process_noise), last.structure, {**last.values, stop: far}, free
                )
            )
    return min(fits, key=lambda p: model_comparison.criterion(p, model_comparison.overdispersion([last])))


def best_of_structure(lesser: Sequence[Fit], begun: Fit) -> Fit:
    """The likeliest of these with the structure of one of them."""
    return min((q for q in lesser if q.structure == begun.structure), key=lambda p: p.deviance, default=begun)


def prune_and_exchange(
    problem: FitProblem, grown: Fit, begun: Fit, rounds: Sequence[Round]
) -> tuple[Fit, list[Fit], list[Alternative]]:  # fmt: skip
    """The grown model, pruned and with one effect exchanged for a rival where that now fits better. Also the smaller
    models that it is compared with, and the alternatives to its effects.
    """
    best, lesser = _prune(problem, grown, begun)
    swaps = alternatives.exchanged(problem, best, begun.structure, lesser, rounds)
    better = min(swaps, key=lambda w: model_comparison.criterion_difference_penalised(w.point, best), default=None)
    if better is None or model_comparison.criterion_difference_penalised(better.point, best) >= 0.0:
        return best, lesser, swaps
    # The rival had lost beside what was still missing then; now it is the one that fits, and more may show.
    last, lesser = _prune(problem, better.point, best_of_structure(lesser, begun))
    return last, lesser, [Alternative(better.rival, better.effect, best)] if better.rival in last.structure else []


def with_better_fit(this: Round, found: Fit) -> Round:
    """The round, with a better fit of the rival that has this structure. A rival in a worse local optimum would make an
    effect that contains it look better.
    """
    better = [h.point.structure == found.structure and found.deviance < h.deviance for h in this.rivals]
    rivals = (Hypothesis(h.added, found) if b else h for h, b in zip(this.rivals, better, strict=True))
    return replace(this, rivals=tuple(rivals))


def plain_winner(problem: FitProblem, this: Round) -> Fit:
    """The winner, or only what it brought along where that improves the fit significantly by itself.

    The extra part of a specialised friction then competes with all other candidates.
    """
    winner = this.rivals[0]
    kept = this.before.structure.with_(*EFFECTS[winner.added[0]].includes)
    if kept.named == this.before.structure.named:
        return winner.point
    plain = refits(problem, winner.point, [kept])[0]
    return plain if model_comparison.is_significant(this.before, plain) else winner.point
