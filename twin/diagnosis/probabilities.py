"""The probability of each name, and the names that cannot be told from their rivals."""

from __future__ import annotations

from twin.diagnosis import (
    model_comparison,
    round_margin,
    thresholds,
)
from twin.diagnosis.result import Undecided
from twin.diagnosis.search_result import SearchResult
from twin.effects.catalogue import EFFECTS, UNKNOWN


def probabilities(found: SearchResult) -> tuple[dict[str, float], tuple[tuple[str, float], ...]]:
    """The probability of each named effect, or of one of the base that a rival could replace. And a ranking of these,
    of their rivals, and of the other candidates of the first round.

    An effect shares what is certain with each rival that could stand in its place, and with its absence.
    """
    named: dict[str, float] = {}
    ranking: dict[str, float] = {}
    for effect in dict.fromkeys((*found.last.structure.named, *(w.effect for w in found.alternatives))):
        if effect in UNKNOWN:
            continue
        named[effect], others = round_margin.probability_shares(found, effect)
        for rival, share in others.items():
            ranking[rival] = max(ranking.get(rival, 0.0), share)
    # What the first model has is not missing, whatever could stand in its place.
    new = {e: p for e, p in named.items() if e in found.last.structure.named and e not in found.first.structure}
    # What took the place of all names, or of one, took the chances of what else was tried.
    taken = bool(new) or any(i in UNKNOWN for i in found.last.structure.ids)
    for this in found.rounds[:1]:
        tried = (*(h.point for h in this.rivals), this.before)
        weight = model_comparison.model_probabilities(
            [model_comparison.criterion(p, this.overdispersion) for p in tried]
        )
        for h, w in zip(this.rivals, weight, strict=False):
            ranking.setdefault(h.added[0], 0.0 if taken else float(w))
    ranking |= new
    return named, tuple(sorted(ranking.items(), key=lambda pair: -pair[1]))


def undecided(found: SearchResult) -> tuple[Undecided, ...]:
    """Effects and the rivals that could as well stand in their place, with what each is given."""
    named, ranking = probabilities(found)
    out = []
    for swap in found.alternatives:
        one, two = swap.effect, swap.rival
        if model_comparison.criterion_difference(found.last, swap.point) < thresholds.UNDECIDED_MARGIN:
            text = EFFECTS[one].confused_with.get(two) or EFFECTS[two].confused_with.get(one)
            text = text or "a richer recording: several amplitudes, coast-downs, slow ramps"
            out.append(Undecided((one, two), (named[one], dict(ranking)[two]), text))
    return tuple(sorted(out, key=lambda u: -u.probabilities[1]))
