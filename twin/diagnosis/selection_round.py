"""One round of the search: which candidate is added to a model.

All candidates are compared at one process noise (`local_optima`). Innovations of a wrong model are correlated over the
filter's memory, and differences of deviance are divided by their overdispersion (`model_comparison.overdispersion`). A
light motor that rattles in its gap bounces in ways that no model predicts, and a long memory rewards whatever moves the
bounces. So an effect must show to shorter memories, too (`is_confirmed`).

Candidates start from two places. One is beside the fitted model, where the score test sees the smallest effect
(`screening`). The other follows the missing torque (`torque_regression`), which works also where the model is misled.
The best few are fitted with everything else. The smaller model is refitted from their optimum before they are compared,
so that a badly converged model makes no discovery.

A lost round is repeated for slow torques with a longer memory (`retry_with_long_memory`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import call

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import events, model_comparison, residual_torque, screening, thresholds, torque_regression
from twin.diagnosis.plausibility import is_plausible
from twin.diagnosis.residual_torque import MissingTorque
from twin.diagnosis.screening import Candidate
from twin.effects.catalogue import EFFECTS
from twin.estimation import (
    contact_masking,
    filter_memory,
    local_optima,
    maximum_likelihood,
    multistart,
    optimizer,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model.stepper import Structure
from twin.parallel import each

FloatArray = NDArray[np.float64]
#: Rows of values that each candidate tries.
Trials = Mapping[str, Sequence[dict[str, float]]]

#: Torques that change no faster than the axis moves.
SLOW_EFFECTS = ("constant_offset", "gravity", "spring", "quadratic_drag", "thermal_fade", "supply_sag")


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A structure, fitted; `added` is what it has beyond the one it competes with."""

    added: tuple[str, ...]
    point: Fit

    @property
    def deviance(self) -> float:
        return self.point.deviance


def _short_fit(problem: FitProblem, base: Fit, entry: Candidate) -> Hypothesis:
    begun = screening.most_likely_values(problem.at(base.process_noise), entry.structure, entry.places)
    found = optimizer.levenberg_marquardt(
        problem.at(base.process_noise), entry.structure, begun, entry.free, rounds=6, tolerance=1.0
    )
    return Hypothesis((entry.effect,), found)


def screen_candidates(problem: FitProblem, base: Fit, trials: Trials) -> list[Hypothesis]:
    """The candidates that promise most beside the base, after a few steps; the best first.

    `trials` holds the rows of values that each of them tries.
    """
    entered = screening.score_candidates(problem, base, trials)
    entries = sorted(entered, key=lambda e: -e.promised_gain)
    fits = each(lambda e: _short_fit(problem, base, e), entries[: thresholds.MAX_SCREENED])
    return sorted(fits, key=lambda h: h.deviance)


@dataclass(frozen=True, eq=False)
class Round:
    """One addition: the model before, the rivals (the best first), and what a unit of deviance is worth among them.

    `won` says whether the first of the rivals improves the fit significantly, or does so once the next is beside it.
    `refused` are those that looked better and did not. Where every candidate was fitted to something else there are no
    rivals.
    """

    before: Fit
    rivals: tuple[Hypothesis, ...]
    overdispersion: float
    won: bool = True
    refused: frozenset[str] = frozenset()


def _is_preferred(smaller: Fit, larger: Fit) -> bool:
    """Whether the larger model is preferred with the penalty of one parameter. The question is only whether an effect
    exists: its other parameters have already been penalised. A curve has twelve knots, and a shorter memory sees a
    sixteenth of a slow torque.
    """
    gain = (smaller.deviance - larger.deviance) / model_comparison.overdispersion([smaller, larger])
    return gain > thresholds.PENALTY_PER_PARAMETER * min(len(larger.free) - len(smaller.free), 1)


def is_confirmed(problem: FitProblem, before: Fit, after: Fit) -> bool:
    """Whether the larger model passes three tests. Its gain exceeds the roughness of the likelihood. It is preferred
    where only contacts that it predicts are judged. It is preferred by filters with shorter memories, down to the first
    one with white innovations at which the effect has the gain it must have. Both models are refitted in the last two
    tests.

    A light motor that rattles in its gap bounces as no model predicts. A filter with a memory longer than a bounce
    rewards whatever moves the predicted bounces to the real ones. A shorter memory needs the same physics and is misled
    less. But it loses a weak and slow torque: half as long, it sees a sixteenth of it. So no memory is shorter than it
    needs to be, and the gain asked there is that of such a torque. Where that is too small to be preferred, a loss by
    chance says nothing against a filter that was sure.
    """
    if not model_comparison.is_significant(
        before, after, max(each(partial(maximum_likelihood.roughness, problem), (before, after)))
    ):
        return False
    tests = (
        partial(test, problem, before, after)
        for test in (_confirmed_at_foreseeable_contacts, _confirmed_by_short_memories)
    )
    return all(each(call, tests))


def _confirmed_at_foreseeable_contacts(problem: FitProblem, before: Fit, after: Fit) -> bool:
    """Whether the larger model is preferred where only contacts that it predicts are judged."""
    foreseen = contact_masking.with_contact_mask(problem, after)
    if all(c.contact_mask is None for c in foreseen.recordings):
        return True
    return _is_preferred(*_refit_both(foreseen, before, after, before.process_noise))


def _confirmed_by_short_memories(problem: FitProblem, before: Fit, after: Fit) -> bool:
    """Whether the larger model is preferred by filters with shorter memories, as far as they can see the effect."""
    memory = filter_memory.memory_of(problem.recordings[0], before.process_noise)
    smaller, larger, least = before, after, 0.0
    for shorter in (memory / times for times in thresholds.MEMORY_DIVISORS):
        gain, unit = smaller.deviance - larger.deviance, model_comparison.overdispersion([smaller, larger])
        if shorter < thresholds.SHORTEST_MEMORY or (unit < thresholds.WHITE_OVERDISPERSION and gain >= least):
            break
        least, sure = thresholds.GAIN_KEPT_AT_HALF_MEMORY * gain, gain > thresholds.CLEAR_GAIN * unit
        smaller, larger = _refit_both(
            problem, before, after, filter_memory.process_noise_of(problem.recordings[0], shorter)
        )
        if not _is_preferred(smaller, larger):
            too_little = least < thresholds.PENALTY_PER_PARAMETER * model_comparison.overdispersion([smaller, larger])
            return sure and too_little and larger.deviance <= smaller.deviance
    return True


def _refit_both(problem: FitProblem, before: Fit, after: Fit, process_noise: float) -> tuple[Fit, Fit]:
    """Both models at another noise density, each started from its own values and from the other's. The local optima
    differ there, and which of them the larger model is in says nothing about its effect. The larger one is also started
    from the smaller one's values, with its addition as it was and as nothing.
    """
    added = (i for i in after.structure.ids if i not in before.structure)
    nothing = {n: v for i in added for n, v in screening.neutral_values(i).items()}

    def adapted(point: Fit, values: Mapping[str, float]) -> Fit:
        begun = {n: values.get(n, v) for n, v in point.values.items()}
        return optimizer.levenberg_marquardt(
            problem.at(process_noise), point.structure, begun, point.free, rounds=20, tolerance=0.2
        )

    both = (before, after)
    reached = each(lambda p: adapted(p, p.values), both)
    learned = each(lambda pair: adapted(pair[0], pair[1].values), zip(both, reached[::-1], strict=True))
    smaller, larger = (min(pair, key=lambda p: p.deviance) for pair in zip(reached, learned, strict=True))
    nested = each(lambda values: adapted(after, values), (smaller.values, {**nothing, **smaller.values}))
    return smaller, min(larger, *nested, key=lambda p: p.deviance)


def _refit_hypotheses(
    problem: FitProblem, found: Sequence[Hypothesis]
) -> list[Hypothesis]:  # fmt: skip
    """What was found, each at the maximum near it."""
    return each(
        lambda h: Hypothesis(h.added, local_optima.refit(problem, h.point.structure, h.point.values)),
        found,
    )


def _refit_deeper(problem: FitProblem, h: Hypothesis) -> list[Hypothesis]:
    return [Hypothesis(h.added, local_optima.refit_through_best_noise(problem, h.point))]


def _fit_followers(
    problem: FitProblem, base: Fit, missing: MissingTorque, trials: Trials
) -> list[Hypothesis]:  # fmt: skip
    """The candidates that follow the missing torque best, fitted from those values, on either side of the gap."""
    best = torque_regression.ranked_by_torque(missing, base, trials)[: thresholds.MAX_FOLLOWERS]
    begun = [(f.effect, f.structure, place) for f in best for place in f.places]
    longer = base.structure.with_("constant_offset")
    begun += [("constant_offset", longer, place) for place in torque_regression.offset_starts(base, list(trials))]

    def fitted(start: tuple[str, Structure, dict[str, float]]) -> Hypothesis:
        effect, structure, place = start
        return Hypothesis(
            (effect,), local_optima.refit(problem.at(base.process_noise), structure, {**place, **problem.held})
        )

    # Where a regression sends the drive to sleep no model runs.
    return [h for h in each(fitted, begun) if math.isfinite(h.deviance)]


def _fit_beside_free_motion(
    problem: FitProblem, base: Fit, missing: MissingTorque, candidates: Sequence[str]
) -> list[Hypothesis]:  # fmt: skip
    """The candidates that promise most beside the base fitted to free motion of the axis, if that is far from the base.
    Gap, shares and teeth are searched again.
    """
    free = torque_regression.fit_to_free_motion(problem, missing, base)
    if free is None:
        return []

    def fitted(h: Hypothesis) -> Hypothesis:
        point = local_optima.refit(problem.at(base.process_noise), h.point.structure, h.point.values)
        return Hypothesis(h.added, local_optima.restart_gap(problem, point))

    trials = screening.trial_grids(problem, free, candidates)
    return each(fitted, screen_candidates(problem, free, trials)[: thresholds.MAX_FITTED])


def _is_confusable(effect: str, winner: Hypothesis) -> bool:
    """Whether the effect is one that the winner is confused with."""
    other = winner.added[0]
    return effect in EFFECTS[other].confused_with or other in EFFECTS[effect].confused_with


def _fit_in_place_of_winner(problem: FitProblem, winner: Hypothesis, structure: Structure, effect: str) -> Hypothesis:
    """The structure with the effect, from where the winner stands."""
    longer, point = preparation.with_tooth_compliance(structure.with_(effect)), winner.point
    trials = screening.trial_grids(problem, point, [effect])[effect]
    places = [screening.values_with(point, longer, effect, t) for t in trials]
    begun = screening.most_likely_values(problem.at(point.process_noise), longer, places)
    return Hypothesis((effect,), local_optima.refit(problem.at(point.process_noise), longer, begun))


def _fit_from_other(
    problem: FitProblem,
    one: Hypothesis,
    other: Hypothesis,
    smaller: Structure,
) -> Hypothesis:
    """The one with its own effect from where the other stands in everything that both share."""
    shared = {p.name: other.point.values[p.name] for p in smaller.parameters if p.name in other.point.values}
    own = one.point
    return Hypothesis(
        one.added, local_optima.refit(problem.at(own.process_noise), own.structure, {**own.values, **shared})
    )


def _fit_on_other_gap_side(
    problem: FitProblem, before: Fit, h: Hypothesis
) -> list[Hypothesis]:  # fmt: skip
    """The addition refitted on the other side of the gap or, for a lag, of the dead-band. A few steps chose the side,
    and no slope leads to the other.
    """
    own = h.point
    shares = [p.name for p in own.structure.parameters if p.acts_on and p.name not in before.values]
    begun = (
        {**own.values, name: 0.0 if own.values[name] > 0.5 else 1.0} for name in shares if name not in problem.held
    )
    return [Hypothesis(h.added, local_optima.refit(problem.at(own.process_noise), own.structure, b)) for b in begun]


def _better_plausible(problem: FitProblem, point: Fit, others: Sequence[Fit]) -> Fit:
    """The point, or the likeliest of others of its structure that are still what their names say."""
    return min([point, *(p for p in others if is_plausible(problem, p, point))], key=lambda p: p.deviance)


def _test_against_smaller(
    problem: FitProblem, before: Fit, h: Hypothesis
) -> tuple[Fit, bool]:  # fmt: skip
    """The smaller model, or a better optimum of it from the values of the larger one. And whether the larger one
    improves the fit significantly beside it, and is confirmed.
    """
    if not model_comparison.is_significant(before, h.point):
        return before, False
    before = _better_plausible(
        problem, before, [local_optima.refit(problem.at(before.process_noise), before.structure, h.point.values)]
    )
    return before, model_comparison.is_significant(before, h.point) and is_confirmed(problem, before, h.point)


class _Contest:
    """The best fit of each effect that was tried beside a model so far."""

    def __init__(self, problem: FitProblem, before: Fit) -> None:
        self.problem, self.before = problem, before
        self._best: dict[tuple[str, ...], Hypothesis] = {}

    @property
    def rivals(self) -> list[Hypothesis]:
        """All of them: the plausible ones first, the likeliest before the others."""
        return sorted(
            self._best.values(), key=lambda h: (not is_plausible(self.problem, h.point, self.before), h.deviance)
        )

    def keep(self, found: Sequence[Hypothesis]) -> None:
        """Take over what is better than the fits so far."""
        self._best.update(_best_per_effect(self.problem, self.before, [*self._best.values(), *found]))
        events.announce(events.Compared(self.before, tuple((h.added[0], h.point) for h in self._best.values())))

    def worth_more(self, found: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Those that gain enough for another fit, and are not far behind the first of the rivals.

        Parameters have their price in a gain: an effect with a place and a width follows chance better than one with a
        size alone.
        """
        leader = self.rivals[0]
        unit = model_comparison.overdispersion([self.before, leader.point])
        begun = model_comparison.criterion(self.before, unit)
        gained = begun - model_comparison.criterion(leader.point, unit)
        least = max(thresholds.CLOSE_SHARE * gained, thresholds.PROMISING_SHARE * thresholds.MIN_GAIN)
        return [h for h in found if begun - model_comparison.criterion(h.point, unit) > least]


def _fit_promising(contest: _Contest, known: Sequence[Hypothesis], candidates: Sequence[str]) -> list[str]:
    """Fit the candidates that promise most beside the model before. Returns those that a few steps were made of."""
    problem, before = contest.problem, contest.before
    missing = residual_torque.missing_torque(problem.longest, before.structure, before.values)
    trials = screening.trials_for_torque(problem, missing, before, candidates)
    ways = (
        partial(_fit_followers, problem, before, missing, trials),
        partial(_fit_beside_free_motion, problem, before, missing, candidates),
        # Regressions on the missing torque leave a core idle: the contest runs beside them.
        partial(screen_candidates, problem, before, trials),
    )
    follow, free, near = each(call, ways)
    few = [*known, *near[: thresholds.MAX_FITTED]]
    contest.keep([*follow, *free, *few])
    contest.keep(_refit_hypotheses(problem.at(before.process_noise), contest.worth_more(few)))
    return [h.added[0] for h in near]


def _examine_leaders(contest: _Contest, candidates: Sequence[str]) -> None:
    """Fit the rivals that are worth it from further places: each may only have ended in a worse local optimum."""
    problem, before = contest.problem, contest.before
    # Effects confused with the best and far behind it are tried in its place: the model without both may be misled.
    for best in contest.worth_more(contest.rivals[:1]):
        near_it = [h.added[0] for h in contest.worth_more(contest.rivals)]
        masks = [e for e in candidates if e not in near_it and _is_confusable(e, best)]
        contest.keep(each(partial(_fit_in_place_of_winner, problem, best, before.structure), masks))
    close = contest.worth_more(contest.rivals[: thresholds.MAX_FITTED])
    ways = [partial(_refit_deeper, problem, h) for h in close]
    ways += [partial(_fit_on_other_gap_side, problem, before, h) for h in close]
    contest.keep([h for found in each(call, ways) for h in found])
    if model_comparison.overdispersion([before, contest.rivals[0].point]) >= thresholds.WHITE_OVERDISPERSION:
        # Where the likelihood is rough, the one in the best local optimum would win, whatever its effect.
        rough = contest.worth_more(contest.rivals[:1])
        contest.keep([Hypothesis(h.added, local_optima.restart_gap(problem, h.point)) for h in rough])
        pairs = itertools.permutations(contest.worth_more(contest.rivals[: thresholds.MAX_EXCHANGED]), 2)
        contest.keep(each(lambda pair: _fit_from_other(problem, pair[0], pair[1], before.structure), pairs))


def run_round(
    problem: FitProblem,
    before: Fit,
    known: Sequence[Hypothesis],
    candidates: Sequence[str],
) -> Round:
    """One round: fit the candidates that promise most, and let the smaller model learn from the best of them.

    `known` are rivals that have been fitted already.
    """
    contest, promising, same = _Contest(problem, before), candidates, problem.at(before.process_noise)
    for _ in range(thresholds.MAX_ROUND_RESTARTS):
        near, known = _fit_promising(contest, known, promising), ()
        leaders = contest.rivals[:2]
        places = each(lambda h: local_optima.refit(same, before.structure, h.point.values), leaders)
        smaller = _better_plausible(problem, contest.before, places)
        unit = model_comparison.overdispersion([contest.before, leaders[0].point])
        learned = (contest.before.deviance - smaller.deviance) / unit
        gained = (smaller.deviance - leaders[0].deviance) / unit
        contest.before = smaller
        # Beside a leader that adds much more than the smaller model learned, another pass changes no order.
        if learned < max(thresholds.PENALTY_PER_PARAMETER, thresholds.CLOSE_SHARE * gained):
            break
        if learned < thresholds.MIN_GAIN:
            promising = near
    _examine_leaders(contest, candidates)
    this = _decide_round(problem, contest.before, contest.rivals)
    return this if this.won else _won_with_second(problem, this, candidates)


def _won_with_second(problem: FitProblem, this: Round, candidates: Sequence[str]) -> Round:
    """A lost round, won by a rival that improves the fit significantly once another one is beside it, if there is one.
    Two effects may hide each other, so that neither comes near by itself. If the next round does not confirm it, it is
    dropped again.
    """
    for h in this.rivals[: thresholds.MAX_HIDDEN]:
        if this.before.deviance - h.deviance < thresholds.MIN_GAIN * this.overdispersion:
            continue
        open_ = [c for c in candidates if c not in h.point.structure]
        missing = residual_torque.missing_torque(problem.longest, h.point.structure, h.point.values)
        trials = screening.trials_for_torque(problem, missing, h.point, open_)
        ways = (
            partial(_fit_followers, problem, h.point, missing, trials),
            partial(screen_candidates, problem, h.point, trials),
        )
        follow, near = each(call, ways)
        ended = _refit_hypotheses(problem.at(h.point.process_noise), near[: thresholds.MAX_FITTED])
        both = [x.point for x in (*follow, *ended) if is_plausible(problem, x.point, h.point)]
        earning = max(both, key=partial(model_comparison.gain, this.before), default=h.point)
        enough = model_comparison.gain(this.before, earning) > 2.0 * thresholds.MIN_GAIN
        if enough and model_comparison.is_significant(h.point, earning) and is_confirmed(problem, this.before, earning):
            others = [o for o in this.rivals if o is not h]
            return Round(this.before, (h, *others), this.overdispersion, refused=_effects_before(this.rivals, h))
    return this


def retry_with_long_memory(problem: FitProblem, this: Round, candidates: Sequence[str]) -> Round:
    """A lost round once more, for slow torques, with a filter whose memory is longer than the model is right. Over a
    tenth of a second, their effect is hidden by the model's other errors. It grows with the square of the time.

    The round stays as it is where the filter's memory already is as long as the recording asks for. It also stays where
    no gain is larger than the errors of a long memory can make.
    """
    before, longer = this.before, filter_memory.process_noise_of(problem.recordings[0], thresholds.LONG_MEMORY)
    slow = [c for c in candidates if c in SLOW_EFFECTS]
    if this.won or not slow or before.process_noise <= longer:
        return this
    if (
        optimizer.most_likely_process_noise(problem, before.structure, before.values, around=before.process_noise)
        <= before.process_noise
    ):
        return this
    before = local_optima.refit(problem.at(longer), before.structure, before.values)
    seen = screen_candidates(problem, before, screening.trial_grids(problem, before, slow))
    if not any(model_comparison.gain(before, h.point) > thresholds.MIN_GAIN_AT_OTHER_MEMORY for h in seen):
        return this
    found = run_round(problem, before, seen, slow)
    return (
        found
        if found.won
        and model_comparison.gain(found.before, found.rivals[0].point) > thresholds.MIN_GAIN_AT_OTHER_MEMORY
        else this
    )


def _best_per_effect(
    problem: FitProblem, before: Fit, found: Sequence[Hypothesis]
) -> dict[tuple[str, ...], Hypothesis]:  # fmt: skip
    """The best fit of each effect. An implausible fit must not replace a plausible one."""
    best: dict[tuple[str, ...], Hypothesis] = {}
    for h in found:
        best[h.added] = min(
            best.get(h.added, h), h, key=lambda o: (not is_plausible(problem, o.point, before), o.deviance)
        )
    return best


def _restart_for_gain(problem: FitProblem, before: Fit, point: Fit) -> Fit:
    """The point, or one with more gain. Gap, shares and teeth are taken from the smaller model or searched again. The
    lightest possible motor rattles without end, and its best values are never certain.
    """
    own = {n: v for n, v in before.values.items() if n in multistart.MULTIMODAL}
    places = (
        lambda: local_optima.restart_gap(problem, point),
        lambda: local_optima.refit(problem.at(point.process_noise), point.structure, {**point.values, **own}),
    )
    return max([point, *each(call, places)], key=partial(model_comparison.gain, before))


def _decide_round(
    problem: FitProblem, before: Fit, found: Sequence[Hypothesis]
) -> Round:  # fmt: skip
    """The round of these rivals, and its winner: the best that improves the fit significantly and is confirmed."""
    # What is bent into something else, as a spring into a constant, is no rival to anything.
    sound = sorted((h for h in found if is_plausible(problem, h.point, before)), key=lambda h: h.deviance)
    unit = model_comparison.overdispersion([before, *(h.point for h in sound[:1])])
    rivals = sorted(sound, key=lambda h: model_comparison.criterion(h.point, unit))
    winner = None
    for h in rivals:
        promises = (
            model_comparison.criterion(before, unit) - model_comparison.criterion(h.point, unit) > thresholds.MIN_GAIN
        )
        promises = promises or model_comparison.is_significant(before, h.point)
        before, stands = _test_against_smaller(problem, before, h)
        if not stands and promises:
            moved = _restart_for_gain(problem, before, h.point)
            if moved is not h.point and is_plausible(problem, moved, before):
                h = Hypothesis(h.added, moved)
                before, stands = _test_against_smaller(problem, before, h)
        if stands:
            winner = h
            break
    refused = frozenset[str]()
    if winner is not None:
        refused = _effects_before(rivals, winner)
        rivals = [winner, *(h for h in rivals if h.added != winner.added)]
    unit = model_comparison.overdispersion([before, *(h.point for h in rivals[:1])])
    return Round(before, tuple(rivals), unit, winner is not None, refused)


def _effects_before(rivals: Sequence[Hypothesis], winner: Hypothesis) -> frozenset[str]:
    """The effects of the rivals that stand before the winner."""
    return frozenset(h.added[0] for h in itertools.takewhile(lambda h: h.added != winner.added, rivals))
