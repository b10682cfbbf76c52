"""How an effect won its round, and how likely that makes it beside its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.diagnosis import (
    model_comparison,
)
from twin.diagnosis.search_result import SearchResult
from twin.diagnosis.selection_round import Hypothesis, Round
from twin.model.stepper import Structure


@dataclass(frozen=True, eq=False)
class RoundMargin:
    """How an effect won its round: its gain, and the rivals that lack it, each with the distance to it."""

    gain: float
    rivals: tuple[tuple[Hypothesis, float], ...]


def margin_of(rounds: Sequence[Round], last: Structure, effect: str) -> RoundMargin:
    """The last round that was won with an effect of the last model among its rivals, at whatever rank. An effect that
    lost to a rival may have replaced it since.

    Some rivals are left out. One that contains the effect does not contradict it, and one that is also in the last
    model took nothing from it. One that was not confirmed has no share.
    """
    for this in reversed(rounds):
        own = {
            h.added[0]: model_comparison.criterion(h.point, this.overdispersion)
            for h in this.rivals
            if effect in h.point.structure
        }
        if this.won and effect not in this.before.structure and own:
            # An effect that another one brought along stands for itself where it ran, too.
            best = own.get(effect, min(own.values()))
            others = [h for h in this.rivals if effect not in h.point.structure and h.added[0] not in last]
            rivals = tuple(
                (h, model_comparison.criterion(h.point, this.overdispersion) - best)
                for h in others
                if h.added[0] not in this.refused
            )
            return RoundMargin(model_comparison.criterion(this.before, this.overdispersion) - best, rivals)
    return RoundMargin(0.0, ())


def probability_shares(found: SearchResult, effect: str) -> tuple[float, dict[str, float]]:
    """The share of the certain probability for an effect of the last model, and for each rival that could replace it.
    Its absence has the rest.
    """
    contest = margin_of(found.rounds, found.last.structure, effect)
    against = {h.added[0]: max(short, 0.0) for h, short in contest.rivals}
    against |= {
        w.rival: model_comparison.criterion_difference_penalised(w.point, found.last)
        for w in found.alternatives
        if w.effect == effect
    }
    without = [model_comparison.gain(q, found.last) for q in found.smaller_models if effect not in q.structure]
    own, *others = model_comparison.model_probabilities([0.0, *against.values(), *([min(without)] if without else [])])
    return float(own), {rival: float(w) for rival, w in zip(against, others, strict=False)}
