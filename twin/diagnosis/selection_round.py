"""Which physics was left out.

Structures compete at one noise density (`valleys`). Innovations hang together over the filter's memory, so that a unit
of deviance is worth less; what it is worth is measured (`compare.worth`). Where a light motor rattles in its gap, a
filter that trusts the model for longer than a bounce is led astray by bounces that no model foresees, and rewards
whatever moves them: so what is added must show to shorter memories, too (`shows`).

Candidates are looked at from two places. Near: beside the model as it stands, where the score test sees the smallest
effect. Far: where they follow the torque that is missing along the way (`following`), so that an effect is found also
where its lack has led the model astray. The best few are fitted with everything else, and the smaller model is refitted
from their optimum before they are compared, so that a badly converged model makes no discovery.

Where a model is right for a moment only, a lost round is looked at once more, for slow torques, with a filter that
remembers for longer (`slower`).
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

from twin.diagnosis import model_comparison, screening, torque_regression
from twin.diagnosis.plausibility import plausible
from twin.diagnosis.screening import Entry
from twin.effects.catalogue import EFFECTS
from twin.estimation import contact_masking, likelihood, local_optima, maximum_likelihood, multistart, preparation
from twin.estimation.likelihood import Case, Point
from twin.model.stepper import Structure
from twin.parallel import each

FloatArray = NDArray[np.float64]

#: Candidates per round that climb a little, how many of them go on to the end, and how many of those that follow the
#: missing torque best are fitted from where they do.
SURVIVORS, NEAR, FOLLOWING = 8, 4, 2
#: Share of the best one's gain, and of what an effect must earn, from which on others are looked at more deeply.
CLOSE, HOPE = 0.4, 0.25
#: So many of the best take each other's place where the likelihood is rough.
EACH = 3
#: Behind so many of the best of a lost round another effect is looked for.
LOOKED_BEHIND = 2
#: So often at most does a round begin again from a smaller model that its rivals have shown a better place.
AGAIN = 3
#: Where a unit of deviance is worth less than so many, innovations are white and what they say needs no second filter.
WHITE = 2.0
#: What is there shows to filters that forget so many times as fast, too, each twice as fast as the one before, down to
#: this memory, s; of what it does to the likelihood a slow torque keeps this share when the memory is halved.
FASTER, BRIEFEST, KEPT = (2.0, 4.0), 0.02, 1.0 / 16.0
#: Torques that change no faster than the axis moves; the memory of a filter that looks for them once no other finds
#: anything, s; and the units that what shows to no usual memory has to earn: bounces that a longer one does not forget
#: have earned 34, and what a rig departs from every law by has earned a name 57 with one of a few hundredths of a s.
SLOW = ("constant_offset", "gravity", "spring", "quadratic_drag", "thermal_fade", "supply_sag")
LONG, PLAIN = 0.4, 5.0 * model_comparison.LEAST
#: Units that make a filter sure of what the next one, which forgets faster, can know too little of.
SURE = 0.5 * model_comparison.LEAST


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A structure, fitted; `added` is what it has beyond the one it competes with."""

    added: tuple[str, ...]
    point: Point

    @property
    def deviance(self) -> float:
        return self.point.deviance


def _climb(cases: Sequence[Case], base: Point, entry: Entry) -> Hypothesis:
    mine = preparation.with_steps(cases, entry.structure)
    begun = screening.likeliest(mine, entry.structure, entry.places, base.density)
    found = likelihood.climb(mine, entry.structure, begun, base.density, entry.free, rounds=6, tolerance=1.0)
    return Hypothesis((entry.effect,), found)


def contest(cases: Sequence[Case], base: Point, candidates: Sequence[str]) -> list[Hypothesis]:
    """The candidates that promise most beside the base, after a few steps; the best first."""
    mine = preparation.with_steps(cases, base.structure)
    trials = screening.grids(mine, base.structure, base.values)
    entered = screening.entries(mine, base, {e: trials[e] for e in candidates})
    entries = sorted(entered, key=lambda e: -e.promise)
    fits = each(lambda e: _climb(mine, base, e), entries[:SURVIVORS])
    return sorted(fits, key=lambda h: h.deviance)


@dataclass(frozen=True, eq=False)
class Round:
    """One addition: the model before, the rivals (the best first), and what a unit of deviance is worth among them.

    `won` says whether the first of the rivals has earned its place, or does so as soon as the next is beside it;
    `refused` are those that looked better and had not. Where every candidate was bent into something else there are
    no rivals.
    """

    before: Point
    rivals: tuple[Hypothesis, ...]
    unit: float
    won: bool = True
    refused: frozenset[str] = frozenset()


def _still(smaller: Point, larger: Point) -> bool:
    """Whether the larger model is preferred at the price of one parameter: whether something is there is asked, what
    it is like has been paid for. A curve has twelve knots, and a shorter memory knows a sixteenth of a slow torque.
    """
    gain = (smaller.deviance - larger.deviance) / model_comparison.worth([smaller, larger])
    return gain > model_comparison.PRICE * min(len(larger.free) - len(smaller.free), 1)


def shows(cases: Sequence[Case], before: Point, after: Point) -> bool:
    """Whether the gain rises above the roughness of the likelihood, and the larger model is preferred, too, where only
    meetings of motor and link that it foresees are judged, and by filters that forget faster, both adapted to them,
    down to the first to which innovations are white and the effect does what it must if it is there.

    A light motor that rattles in its gap bounces as no model foresees, and a filter that trusts the model longer than
    a bounce rewards whatever moves the bounces to where they happened to be. A shorter memory asks for the same
    physics and is not led astray so far; but it forgets a weak and slow torque: half as long, it knows a sixteenth of
    it. So none is asked that is shorter than it need be, and none for more than such a torque could do there: where
    that is too little to be preferred, what chance makes of it says nothing against a filter that was sure.
    """
    if not model_comparison.earns(
        before, after, max(each(partial(maximum_likelihood.roughness, cases), (before, after)))
    ):
        return False
    tests = (partial(test, cases, before, after) for test in (_shows_foreseen, _shows_faster))
    return all(each(call, tests))


def _shows_foreseen(cases: Sequence[Case], before: Point, after: Point) -> bool:
    """Whether the larger model is preferred where only meetings of motor and link that it foresees are judged."""
    foreseen = contact_masking.foreseeable(preparation.with_steps(cases, after.structure), after)
    if all(c.unforeseen is None for c in foreseen):
        return True
    return _still(*_adapted(foreseen, before, after, before.density))


def _shows_faster(cases: Sequence[Case], before: Point, after: Point) -> bool:
    """Whether the larger model is preferred by filters that forget faster, as far as they can know."""
    memory = likelihood.memory_of(cases[0], before.density)
    smaller, larger, least = before, after, 0.0
    for shorter in (memory / times for times in FASTER):
        gain, unit = smaller.deviance - larger.deviance, model_comparison.worth([smaller, larger])
        if shorter < BRIEFEST or (unit < WHITE and gain >= least):
            break
        least, sure = KEPT * gain, gain > SURE * unit
        smaller, larger = _adapted(cases, before, after, likelihood.density_of(cases[0], shorter))
        if not _still(smaller, larger):
            too_little = least < model_comparison.PRICE * model_comparison.worth([smaller, larger])
            return sure and too_little and larger.deviance <= smaller.deviance
    return True


def _adapted(cases: Sequence[Case], before: Point, after: Point, density: float) -> tuple[Point, Point]:
    """Both models at another noise density, each from its own place and the other's: valleys are others there, and the
    one that the larger model happens to be in says nothing about its effect. Where the smaller one can be the larger
    can be, too, with what it adds as it was or as nothing.
    """
    added = (i for i in after.structure.ids if i not in before.structure)
    nothing = {n: v for i in added for n, v in screening.neutral(i).items()}

    def adapted(point: Point, values: Mapping[str, float]) -> Point:
        mine = preparation.with_steps(cases, point.structure)
        begun = {n: values.get(n, v) for n, v in point.values.items()}
        return likelihood.climb(mine, point.structure, begun, density, point.free, rounds=20, tolerance=0.2)

    both = (before, after)
    reached = each(lambda p: adapted(p, p.values), both)
    learned = each(lambda pair: adapted(pair[0], pair[1].values), zip(both, reached[::-1], strict=True))
    smaller, larger = (min(pair, key=lambda p: p.deviance) for pair in zip(reached, learned, strict=True))
    nested = each(lambda values: adapted(after, values), (smaller.values, {**nothing, **smaller.values}))
    return smaller, min(larger, *nested, key=lambda p: p.deviance)


def _finished(
    cases: Sequence[Case], found: Sequence[Hypothesis], held: Mapping[str, float], density: float
) -> list[Hypothesis]:  # fmt: skip
    """What was found, each at the maximum near it."""
    return each(
        lambda h: Hypothesis(h.added, local_optima.settle(cases, h.point.structure, h.point.values, held, density)),
        found,
    )


def _deepened(cases: Sequence[Case], h: Hypothesis, held: Mapping[str, float]) -> list[Hypothesis]:
    return [Hypothesis(h.added, local_optima.deepen(cases, h.point, held))]


def _following(
    cases: Sequence[Case], base: Point, candidates: Sequence[str], held: Mapping[str, float]
) -> list[Hypothesis]:  # fmt: skip
    """The candidates that follow the missing torque best, fitted from where they do, on either side of the gap."""
    best = torque_regression.followers(cases, base, candidates)[:FOLLOWING]
    begun = [(f.effect, f.structure, place) for f in best for place in f.places]
    longer = base.structure.with_("constant_offset")
    begun += [("constant_offset", longer, place) for place in torque_regression.levelled(base, candidates)]

    def fitted(start: tuple[str, Structure, dict[str, float]]) -> Hypothesis:
        effect, structure, place = start
        return Hypothesis((effect,), local_optima.settle(cases, structure, {**place, **held}, held, base.density))

    # Where a regression sends the drive to sleep no model runs.
    return [h for h in each(fitted, begun) if math.isfinite(h.deviance)]


def _freed(
    cases: Sequence[Case], base: Point, candidates: Sequence[str], held: Mapping[str, float]
) -> list[Hypothesis]:  # fmt: skip
    """The candidates that promise most beside the base as it is where the axis moves freely, if that is far from it;
    gap, shares and teeth are looked for anew.
    """
    free = torque_regression.freed(cases, base)
    if free is None:
        return []

    def fitted(h: Hypothesis) -> Hypothesis:
        point = local_optima.settle(cases, h.point.structure, h.point.values, held, base.density)
        return Hypothesis(h.added, local_optima.relocated(cases, point, held))

    return each(fitted, contest(cases, free, candidates)[:NEAR])


def _alike(effect: str, winner: Hypothesis) -> bool:
    """Whether the effect is one that the winner is confused with."""
    other = winner.added[0]
    return effect in EFFECTS[other].confused_with or other in EFFECTS[effect].confused_with


def _instead(
    cases: Sequence[Case], winner: Hypothesis, structure: Structure, effect: str, held: Mapping[str, float]
) -> Hypothesis:
    """The structure with the effect, from where the winner stands."""
    longer, point = preparation.with_teeth(structure.with_(effect)), winner.point
    mine = preparation.with_steps(cases, longer)
    trials = screening.grids(mine, point.structure, point.values)[effect]
    places = [screening.placed(point, longer, effect, t) for t in trials]
    begun = screening.likeliest(mine, longer, places, point.density)
    return Hypothesis((effect,), local_optima.settle(cases, longer, begun, held, point.density))


def _in_place_of(
    cases: Sequence[Case], one: Hypothesis, other: Hypothesis, smaller: Structure, held: Mapping[str, float]
) -> Hypothesis:
    """The one with its own effect from where the other stands in everything that both share."""
    shared = {p.name: other.point.values[p.name] for p in smaller.parameters if p.name in other.point.values}
    own = one.point
    return Hypothesis(one.added, local_optima.settle(cases, own.structure, {**own.values, **shared}, held, own.density))


def _on_the_other_side(
    cases: Sequence[Case], before: Point, h: Hypothesis, held: Mapping[str, float]
) -> list[Hypothesis]:  # fmt: skip
    """What was added, on the other side of the gap or, for a lag, of the dead-band, from where it stands: a few steps
    chose the side, and no slope leads to the other.
    """
    own = h.point
    shares = [p.name for p in own.structure.parameters if p.acts_on and p.name not in before.values]
    begun = ({**own.values, name: 0.0 if own.values[name] > 0.5 else 1.0} for name in shares if name not in held)
    return [Hypothesis(h.added, local_optima.settle(cases, own.structure, b, held, own.density)) for b in begun]


def _better(cases: Sequence[Case], point: Point, others: Sequence[Point]) -> Point:
    """The point, or the likeliest of others of its structure that are still what their names say."""
    return min([point, *(p for p in others if plausible(cases, p, point))], key=lambda p: p.deviance)


def _tested(
    cases: Sequence[Case], before: Point, h: Hypothesis, held: Mapping[str, float]
) -> tuple[Point, bool]:  # fmt: skip
    """The smaller model, or a better one from where the larger stands: what that found may have been another valley.
    And whether the larger one earns its place beside it, and shows.
    """
    if not model_comparison.earns(before, h.point):
        return before, False
    before = _better(
        cases, before, [local_optima.settle(cases, before.structure, h.point.values, held, before.density)]
    )
    return before, model_comparison.earns(before, h.point) and shows(cases, before, h.point)


def compete(
    cases: Sequence[Case],
    before: Point,
    known: Sequence[Hypothesis],
    candidates: Sequence[str],
    held: Mapping[str, float],
) -> Round:
    """One round: fit the candidates that promise most, and let the smaller model learn from the best of them.

    `known` are rivals that have been fitted already.
    """
    density, structure, promising = before.density, before.structure, candidates
    best: dict[tuple[str, ...], Hypothesis] = {}

    def keep(found: Sequence[Hypothesis]) -> None:
        best.update(_best(cases, before, [*best.values(), *found]))

    def leading(most: int) -> list[Hypothesis]:
        return sorted(best.values(), key=lambda h: (not plausible(cases, h.point, before), h.deviance))[:most]

    begun = list(known)
    for _ in range(AGAIN):
        # Regressions on the missing torque leave a core idle: the contest runs beside them.
        ways = [partial(way, cases, before, promising, held) for way in (_following, _freed)]
        follow, free, near = each(call, [*ways, partial(contest, cases, before, promising)])
        keep([*follow, *free, *_finished(cases, (*begun, *near[:NEAR]), held, density)])
        leaders, begun = leading(2), []
        places = each(lambda h: local_optima.settle(cases, structure, h.point.values, held, density), leaders)
        smaller = _better(cases, before, places)
        unit = model_comparison.worth([before, leaders[0].point])
        learned = (before.deviance - smaller.deviance) / unit
        if learned < model_comparison.PRICE:
            break
        if learned < model_comparison.LEAST:
            promising = [h.added[0] for h in near]
        before = smaller
    least = HOPE * model_comparison.LEAST * unit

    def far() -> float:
        """The deviance above which a rival is far behind the best."""
        gain = before.deviance - leading(1)[0].deviance
        return before.deviance - max(CLOSE * gain, least)

    if before.deviance - leaders[0].deviance > least:
        # What is easily mistaken for the best, and is not near it, is tried in its place: the model without either may
        # have gone astray.
        near_it = [h.added for h in best.values() if h.deviance < far()]
        masks = [e for e in candidates if (e,) not in near_it and _alike(e, leaders[0])]
        keep(each(lambda e: _instead(cases, leaders[0], structure, e, held), masks))
    # Those that are not far behind the best may only have ended in a lesser valley.
    bar = far()
    close = [h for h in leading(NEAR) if h.deviance < bar]
    ways = [partial(_deepened, cases, h, held) for h in close]
    ways += [partial(_on_the_other_side, cases, before, h, held) for h in close]
    keep([h for found in each(call, ways) for h in found])
    if unit >= WHITE:
        # Where the likelihood is rough the one that ended in a better valley would win, whatever its effect.
        rough = [h for h in leading(1) if h.deviance < bar]
        keep([Hypothesis(h.added, local_optima.relocated(cases, h.point, held)) for h in rough])
        pairs = itertools.permutations([h for h in leading(EACH) if h.deviance < bar], 2)
        keep(each(lambda pair: _in_place_of(cases, pair[0], pair[1], structure, held), pairs))
    this = _judged(cases, before, list(best.values()), held)
    return this if this.won else _on_credit(cases, this, candidates, held)


def _on_credit(cases: Sequence[Case], this: Round, candidates: Sequence[str], held: Mapping[str, float]) -> Round:
    """A lost round, won by a rival that earns its place as soon as there is another one beside it, if that is so: of
    two effects each may hide the other, so that neither by itself comes near. If the next round does not bear it out
    it is dropped again.
    """
    for h in this.rivals[:LOOKED_BEHIND]:
        if this.before.deviance - h.deviance < model_comparison.LEAST * this.unit:
            continue
        open_ = [c for c in candidates if c not in h.point.structure]
        ways = (partial(_following, cases, h.point, open_, held), partial(contest, cases, h.point, open_))
        follow, near = each(call, ways)
        ended = _finished(cases, near[:NEAR], held, h.point.density)
        both = [x.point for x in (*follow, *ended) if plausible(cases, x.point, h.point)]
        earning = max(both, key=partial(model_comparison.earned, this.before), default=h.point)
        enough = model_comparison.earned(this.before, earning) > 2.0 * model_comparison.LEAST
        if enough and model_comparison.earns(h.point, earning) and shows(cases, this.before, earning):
            others = [o for o in this.rivals if o is not h]
            return Round(this.before, (h, *others), this.unit, refused=_before(this.rivals, h))
    return this


def slower(cases: Sequence[Case], this: Round, candidates: Sequence[str], held: Mapping[str, float]) -> Round:
    """A lost round once more, for slow torques, with a filter that remembers for longer than the model is right: what
    they do in a tenth of a second drowns in what the model has wrong there, and grows with the square of the time.

    The round as it is where the filter remembers for as long as the recording asks for, and where nothing does so much
    more that the errors of a long memory cannot have done it.
    """
    before, longer = this.before, likelihood.density_of(cases[0], LONG)
    slow = [c for c in candidates if c in SLOW]
    if this.won or not slow or before.density <= longer:
        return this
    mine = preparation.with_steps(cases, before.structure)
    if likelihood.best_density(mine, before.structure, before.values, around=before.density) <= before.density:
        return this
    before = local_optima.settle(cases, before.structure, before.values, held, longer)
    seen = contest(cases, before, slow)
    if not any(model_comparison.earned(before, h.point) > PLAIN for h in seen):
        return this
    found = compete(cases, before, seen, slow, held)
    return found if found.won and model_comparison.earned(found.before, found.rivals[0].point) > PLAIN else this


def _best(
    cases: Sequence[Case], before: Point, found: Sequence[Hypothesis]
) -> dict[tuple[str, ...], Hypothesis]:  # fmt: skip
    """Of each effect its best fit; what is bent into something else must not oust what is still itself."""
    best: dict[tuple[str, ...], Hypothesis] = {}
    for h in found:
        best[h.added] = min(best.get(h.added, h), h, key=lambda o: (not plausible(cases, o.point, before), o.deviance))
    return best


def _sounder(cases: Sequence[Case], before: Point, point: Point, held: Mapping[str, float]) -> Point:
    """The point, or where it earns more with gap, shares and teeth as the smaller model has them or looked for anew:
    a motor as light as may be rattles on and on, and of what it likes nobody can be sure.
    """
    own = {n: v for n, v in before.values.items() if n in multistart.SOUGHT}
    places = (
        lambda: local_optima.relocated(cases, point, held),
        lambda: local_optima.settle(cases, point.structure, {**point.values, **own}, held, point.density),
    )
    return max([point, *each(call, places)], key=partial(model_comparison.earned, before))


def _judged(
    cases: Sequence[Case], before: Point, found: Sequence[Hypothesis], held: Mapping[str, float]
) -> Round:  # fmt: skip
    """The round of these rivals, and its winner: the best that earns its place and shows."""
    # What is bent into something else, as a spring into a constant, is no rival to anything.
    sound = sorted((h for h in found if plausible(cases, h.point, before)), key=lambda h: h.deviance)
    unit = model_comparison.worth([before, *(h.point for h in sound[:1])])
    rivals = sorted(sound, key=lambda h: model_comparison.criterion(h.point, unit))
    winner = None
    for h in rivals:
        promises = (
            model_comparison.criterion(before, unit) - model_comparison.criterion(h.point, unit)
            > model_comparison.LEAST
        )
        promises = promises or model_comparison.earns(before, h.point)
        before, stands = _tested(cases, before, h, held)
        if not stands and promises:
            moved = _sounder(cases, before, h.point, held)
            if moved is not h.point and plausible(cases, moved, before):
                h = Hypothesis(h.added, moved)
                before, stands = _tested(cases, before, h, held)
        if stands:
            winner = h
            break
    refused = frozenset[str]()
    if winner is not None:
        refused = _before(rivals, winner)
        rivals = [winner, *(h for h in rivals if h.added != winner.added)]
    unit = model_comparison.worth([before, *(h.point for h in rivals[:1])])
    return Round(before, tuple(rivals), unit, winner is not None, refused)


def _before(rivals: Sequence[Hypothesis], winner: Hypothesis) -> frozenset[str]:
    """The effects of the rivals that stand before the winner."""
    return frozenset(h.added[0] for h in itertools.takewhile(lambda h: h.added != winner.added, rivals))
