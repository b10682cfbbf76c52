"""Which effects a first model lacks. They are added one at a time, pruned, and compared with those that they are easily
confused with. Then more are looked for with a filter whose memory is as short as the recording asks
(`refine_with_short_memory`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from twin.diagnosis import (
    events,
    law_tolerance,
    model_comparison,
    screening,
    selection_round,
    thresholds,
    torque_regression,
)
from twin.diagnosis.plausibility import is_plausible
from twin.diagnosis.selection_round import Hypothesis, Round
from twin.effects.catalogue import CANDIDATES, EFFECTS
from twin.effects.end_stop import NOWHERE
from twin.estimation import (
    contact_masking,
    likelihood,
    local_optima,
    multistart,
    optimizer,
    parameter_bounds,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.stepper import Structure
from twin.parallel import each

Progress = Callable[[str, float], None]
#: Units of inputs that no pulse-width stage cuts: an amplifier that is linear loses no command.
LINEAR_INPUTS = ("V", "A", "N*m", "N")
DEAD_BANDS = ("dead_band_forward", "dead_band_reverse")
GAP = ("backlash", "tooth_compliance")


@dataclass(frozen=True, eq=False)
class Alternative:
    """The last model with a rival in the place of one of its effects, fitted."""

    effect: str
    rival: str
    point: Fit


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The path to a structure: the first model, the last, and the rounds between. Also the last less one effect, and
    the last with one effect exchanged for a close rival, or for one that contains it.
    """

    first: Fit
    last: Fit
    rounds: tuple[Round, ...]
    problem: FitProblem
    smaller_models: tuple[Fit, ...] = ()
    alternatives: tuple[Alternative, ...] = ()


def _smaller_structures(structure: Structure, keep: Structure) -> list[Structure]:
    """The structure less one effect each, with and without what that effect brought along."""
    out = []
    for effect in structure.named:
        if effect not in keep:
            brought = structure.brought_by(effect, keep)
            out += [structure.without(effect)] if brought else []
            out += [structure.without(effect, *brought)]
    return out


def _refits(problem: FitProblem, point: Fit, structures: Sequence[Structure]) -> list[Fit]:
    return each(lambda s: local_optima.refit(problem.at(point.process_noise), s, point.values), structures)


def _best_smaller(problem: FitProblem, point: Fit, lesser: Sequence[Fit], plain: Fit) -> Fit:
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


def _restart(problem: FitProblem, point: Fit) -> Fit:
    """The point at its most likely noise density, with gap and teeth searched again. It stays as it was where that
    would turn an effect into something else.
    """
    moved = local_optima.restart_gap(problem, local_optima.refit_at_own_noise(problem, point))
    return moved if is_plausible(problem, moved, point) else point


def _add_effects(
    problem: FitProblem, best: Fit, first: Structure, candidates: Sequence[str], tell: Progress,
    most: int = thresholds.MAX_EFFECTS,
) -> tuple[Fit, list[Round]]:  # fmt: skip
    """The model with up to this many effects that improve the fit significantly, added one at a time. And the rounds,
    of which the last may have added none.

    What laws of the model before may leave, since `first`, is no other effect.
    """
    rounds: list[Round] = []
    known: list[Hypothesis] = []
    while len(rounds) < most and (open_ := _open_candidates(candidates, best)):
        tell(f"round {len(rounds) + 1}: trying {len(open_)} effects", 0.05 + 0.2 * len(rounds))
        best = _restart(problem, best) if rounds else best
        usual = selection_round.run_round(problem, best, known, open_)
        this = selection_round.retry_with_long_memory(problem, usual, open_)
        if not this.won or _is_left_by_laws(problem, first, this):
            best = this.before
            rounds.append(replace(this, won=False))
            events.announce(events.Reached(problem, best))
            break
        winner, best = this.rivals[0].point, _with_gap_again(problem, _plain_winner(problem, this), candidates)
        known = [] if best is winner else [this.rivals[0]]
        rounds.append(_with_better_fit(this, best))
        events.announce(events.Reached(problem, best))
        if this is not usual:
            # Over such a long memory other effects would gain enough by the chance of a bounce.
            break
    return best, rounds


def _open_candidates(candidates: Sequence[str], best: Fit) -> list[str]:
    """The candidates that the model lacks and that a score test can see. A gap has none: see `_with_gap_again`."""
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
    while fewer := _smaller_structures(best.structure, begun.structure):
        lesser = [*_refits(problem, best, fewer), begun]
        less = _best_smaller(problem, best, lesser, plain)
        if less is best:
            break
        best = less
    return best, lesser


def _without_unmet_stops(problem: FitProblem, last: Fit) -> Fit:
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
    problem, rough = multistart.coarse_starts(recordings, first, held)
    polished, fine = multistart.leave_local_optima(
        problem, multistart.fit_from_starts(problem, preparation.with_tooth_compliance(first), rough)
    )
    # What a model without the right physics cannot predict may be what is looked for.
    problem = contact_masking.without_contact_mask(polished)
    best = local_optima.refit(problem.at(local_optima.judging_process_noise(problem, fine)), first, fine.values)
    if _is_gap_a_makeshift(problem, best):
        best = local_optima.refit(problem.at(best.process_noise), first.without(*GAP), best.values)
        first, fine, candidates = best.structure, best, (*candidates, "backlash")
    candidates = screening.testable_candidates(problem, candidates, first)
    ground = first
    if friction := _friction_for_dead_band(problem, best, candidates):
        best, ground = friction, ground.without("dead_band").with_("coulomb_friction")
    events.announce(events.Reached(problem, best))
    found = _search_from(problem, best, (), ground, candidates, tell)
    for this in _narrow_rounds(problem, found, best.process_noise):
        start = _plain_winner(problem, this)
        if not _leads_elsewhere(problem, found, start, candidates):
            continue
        tell(f"beginning anew with {EFFECTS[this.rivals[0].added[0]].title}", 0.7)
        with events.observing(None):
            other = _search_from(
                problem, start, (_with_better_fit(this, start),), ground, candidates, lambda said, share: None
            )
        found = _better_search(problem, found, other)
        if found.last is other.last:
            break
    rigid = _without_idle_gap(found)
    if rigid is not None:
        problem, ground = rigid[0], ground.without(*GAP)
        found = _search_from(*rigid, found.rounds, ground, candidates, tell)
    best, rounds = _without_unmet_stops(problem, found.last), found.rounds
    wider = _containing_alternatives(problem, best, ground, candidates, rounds)
    best, swaps = _prefer_containing(problem, best, found.alternatives, wider)
    swaps = [*swaps, *_offset_for_dead_bands(problem, best, candidates)]
    if ground != first:
        begun = local_optima.refit(problem.at(best.process_noise), first, fine.values)
        found = replace(found, first=begun, smaller_models=(*found.smaller_models, begun))
    if friction:
        swaps += _dead_band_for_friction(problem, best, begun)
    tell("looking closer", 0.8)
    events.announce(events.Reached(problem, best))
    closer = refine_with_short_memory(replace(found, last=best, alternatives=tuple(swaps)), candidates)
    return replace(closer, last=_with_level_dead_bands(closer.problem, closer.last))


def _with_level_dead_bands(problem: FitProblem, last: Fit) -> Fit:
    """The model with its constant torque held where the dead-bands are about equal, if its size is not known.

    As long as the drive pushes, the torque may be any that leaves no dead-band negative. Machines have equal dead-bands
    more often than others.
    """
    if not {"offset", *DEAD_BANDS} <= set(last.free):
        return last
    place = last.free.index("offset")
    error = math.sqrt(max(float(last.robust_covariance[place, place]), 0.0))
    if abs(last.values["offset"]) >= thresholds.MIN_SIZE_IN_ERRORS * error:
        return last
    begun = last.values | torque_regression.equal_dead_bands(last.values)
    free = tuple(n for n in last.free if n != "offset")
    level = optimizer.levenberg_marquardt(problem.at(last.process_noise), last.structure, begun, free)
    return level if model_comparison.criterion_difference(last, level) < thresholds.UNDECIDED_MARGIN else last


def _without_idle_gap(found: SearchResult) -> tuple[FitProblem, Fit] | None:
    """The problem and the last model of a search, both without a gap, where a rigid drive is more likely; else None.

    A model with a gap has two inertias and teeth, and no gap of nothing makes it rigid. Where there is none, these
    follow what else is missing. It is asked at the end only: a model that lacks much may be likelier without a gap that
    is there. A gap that is known stays, and so does one that another effect needs.
    """
    last, problem = found.last, found.problem
    structure = last.structure.without(*GAP)
    known = any(n in problem.held for n in ("backlash_gap", "motor_share"))
    if known or "backlash" in structure or "backlash" not in last.structure:
        return None
    rigid = local_optima.refit(problem.at(last.process_noise), structure, last.values)
    return _without_gap(problem, rigid) if model_comparison.criterion_difference(rigid, last) > 0.0 else None


def _is_gap_a_makeshift(problem: FitProblem, point: Fit) -> bool:
    """Whether the widest gap that is looked for, with all else the same, is about as likely as the one that was found.

    A recording that shows a gap bounds it from above: a wider one would let the axis stand where it was seen to move.
    Where nothing bounds it, the gap stands for other physics.
    """
    if "backlash_gap" not in point.free:
        return False
    widest = {**point.values, "backlash_gap": parameter_bounds.bounds_of("backlash_gap")[1]}
    wide = likelihood.evaluate(problem.at(point.process_noise), point.structure, widest, point.free)
    lost = (wide.deviance - point.deviance) / model_comparison.overdispersion([point])
    return lost < thresholds.PENALTY_PER_PARAMETER


def _with_gap_again(problem: FitProblem, point: Fit, candidates: Sequence[str]) -> Fit:
    """The point, or one with a gap where that shows beside the effects that are known now.

    The first model's gap stood for them, and hid the one that is there.
    """
    if "backlash" not in candidates or "backlash" in point.structure:
        return point
    geared = local_optima.search_gap(problem, point)
    shows = model_comparison.is_significant(point, geared) and not _is_gap_a_makeshift(problem, geared)
    return geared if shows else point


def _without_gap(problem: FitProblem, point: Fit) -> tuple[FitProblem, Fit]:
    """The problem and the model with motor and link as one. They do not rattle, so nothing is left out for that."""
    unmasked = problem.on([replace(c, rattle_mask=None, start_mask=None) for c in problem.recordings])
    structure = point.structure.without(*GAP)
    return unmasked, local_optima.refit(unmasked.at(point.process_noise), structure, point.values)


def _search_from(
    problem: FitProblem, best: Fit, rounds: Sequence[Round], first: Structure, candidates: Sequence[str], tell: Progress
) -> SearchResult:
    """The search that grows from a model which these rounds led to."""
    rounds, room = list(rounds), thresholds.MAX_EFFECTS - len(rounds)
    for _ in range(thresholds.MAX_REPLACEMENTS):
        grown, more = _add_effects(problem, best, first, candidates, tell, room)
        rounds += more
        # What the last model is compared with is judged at the same noise.
        start = rounds[0].before if rounds else grown
        begun = local_optima.refit(problem.at(grown.process_noise), first, start.values)
        best, lesser, swaps = _prune_and_exchange(problem, grown, begun, rounds)
        begun = _best_of_structure(lesser, begun)
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
    open_ = [c for c in _open_candidates(candidates, start) if c not in winner.added]
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


def _best_of_structure(lesser: Sequence[Fit], begun: Fit) -> Fit:
    """The likeliest of these with the structure of one of them."""
    return min((q for q in lesser if q.structure == begun.structure), key=lambda p: p.deviance, default=begun)


def _prune_and_exchange(
    problem: FitProblem, grown: Fit, begun: Fit, rounds: Sequence[Round]
) -> tuple[Fit, list[Fit], list[Alternative]]:  # fmt: skip
    """The grown model, pruned and with one effect exchanged for a rival where that now fits better. Also the smaller
    models that it is compared with, and the alternatives to its effects.
    """
    best, lesser = _prune(problem, grown, begun)
    swaps = _alternatives(problem, best, begun.structure, lesser, rounds)
    better = min(swaps, key=lambda w: model_comparison.criterion_difference_penalised(w.point, best), default=None)
    if better is None or model_comparison.criterion_difference_penalised(better.point, best) >= 0.0:
        return best, lesser, swaps
    # The rival had lost beside what was still missing then; now it is the one that fits, and more may show.
    last, lesser = _prune(problem, better.point, _best_of_structure(lesser, begun))
    return last, lesser, [Alternative(better.rival, better.effect, best)] if better.rival in last.structure else []


@dataclass(frozen=True, eq=False)
class RoundMargin:
    """How an effect won its round: its gain, and the rivals that lack it, each with the distance to it."""

    gain: float
    rivals: tuple[tuple[Hypothesis, float], ...]


def round_margin(rounds: Sequence[Round], last: Structure, effect: str) -> RoundMargin:
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
    contest = round_margin(found.rounds, found.last.structure, effect)
    against = {h.added[0]: max(short, 0.0) for h, short in contest.rivals}
    against |= {
        w.rival: model_comparison.criterion_difference_penalised(w.point, found.last)
        for w in found.alternatives
        if w.effect == effect
    }
    without = [model_comparison.gain(q, found.last) for q in found.smaller_models if effect not in q.structure]
    own, *others = model_comparison.model_probabilities([0.0, *against.values(), *([min(without)] if without else [])])
    return float(own), {rival: float(w) for rival, w in zip(against, others, strict=False)}


def _alternatives(
    problem: FitProblem, last: Fit, first: Structure, lesser: Sequence[Fit], rounds: Sequence[Round],
) -> list[Alternative]:  # fmt: skip
    """The last model with each effect exchanged for every close rival. A rival that would do better has to be confirmed
    in its place.

    `lesser` are smaller models that the last one is compared with, down to the first.
    """
    out = []
    for effect in last.structure.named:
        contest = round_margin(rounds, last.structure, effect)
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


def _overtaking_fits(rounds: Sequence[Round], effect: str, other: str) -> list[Fit]:
    """The fits with the other effect, where its gain over the effect in one round was significant by itself."""
    fits = [{h.added[0]: h.point for h in this.rivals} for this in rounds]
    if not any(effect in by and other in by and model_comparison.is_significant(by[effect], by[other]) for by in fits):
        return []
    return [by[other] for by in fits if other in by]


def _containing_alternatives(
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
        for h in _overtaking_fits(rounds, effect, other):
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


def _prefer_containing(
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


def are_dead_bands_unequal(fit: Fit) -> bool:
    """Whether the dead-bands of the two directions differ by three standard errors or more."""
    one, other = (fit.free.index(n) for n in DEAD_BANDS)
    known, differ = fit.robust_covariance, fit.values[DEAD_BANDS[1]] - fit.values[DEAD_BANDS[0]]
    variance = known[one, one] + known[other, other] - 2.0 * known[one, other]
    return bool(differ**2 >= thresholds.UNEQUAL_DEAD_BAND_DEVIATIONS**2 * variance)


def _offset_for_dead_bands(problem: FitProblem, last: Fit, candidates: Sequence[str]) -> list[Alternative]:
    """The last model with equal dead-bands and a constant torque in the place of their difference, where that fits
    about as well. As long as the drive pushes, the torque only shifts both.
    """
    offered = "constant_offset" in candidates and "constant_offset" not in last.structure
    if not offered or not set(DEAD_BANDS) <= set(last.free):
        return []
    if not are_dead_bands_unequal(last):
        return []
    differ = last.values[DEAD_BANDS[1]] - last.values[DEAD_BANDS[0]]
    longer, equal = last.structure.with_("constant_offset"), torque_regression.equal_dead_bands(last.values)
    begun = preparation.complete_values(longer, last.values | equal)
    rows = screening.with_gap_sides([equal], last.structure, last.values, "constant_offset")
    free = (*last.free, *(n for n in rows[0] if n not in equal))
    # The torque is held where it levels the dead-bands; they stay about equal unless something else makes up for it.
    fits = each(
        lambda row: optimizer.levenberg_marquardt(problem.at(last.process_noise), longer, begun | row, free), rows
    )
    found = min(fits, key=lambda p: p.deviance)
    level = abs(found.values[DEAD_BANDS[1]] - found.values[DEAD_BANDS[0]]) < 0.5 * abs(differ)
    stands = level and model_comparison.criterion_difference(last, found) < thresholds.UNDECIDED_MARGIN
    return [Alternative("dead_band", "constant_offset", found)] if stands else []


def _friction_for_dead_band(problem: FitProblem, first: Fit, candidates: Sequence[str]) -> Fit | None:
    """The first model with dry friction in the dead-band's place, for inputs that no pulse-width stage cuts: there the
    friction is the default.

    A torque is added where that is more likely: dead-bands differ by as much as it moves the axis. None where the
    friction is no gain over neither of the two, or the dead-band is clearly more likely.
    """
    unit = problem.recordings[0].recording.input_unit
    offered = "coulomb_friction" in candidates and "coulomb_friction" not in first.structure
    if unit not in LINEAR_INPUTS or not offered or not set(DEAD_BANDS) <= set(first.free):
        return None
    bare = first.structure.without("dead_band")
    level = torque_regression.equal_dead_bands(first.values)
    lost = first.values["input_gain"] * level["dead_band_forward"]
    begun = {**first.values, "coulomb_friction": lost, "offset": level["offset"]}
    structures = [bare, bare.with_("coulomb_friction")]
    if "constant_offset" in candidates and "constant_offset" not in first.structure:
        structures.append(structures[1].with_("constant_offset"))
    same = problem.at(first.process_noise)
    without, *fits = each(lambda s: local_optima.refit(same, s, begun), structures)
    unit_of_deviance = model_comparison.overdispersion([first, *fits])
    best = min(fits, key=lambda p: model_comparison.criterion(p, unit_of_deviance))
    stands = model_comparison.criterion_difference(first, best) < thresholds.UNDECIDED_MARGIN
    return best if stands and model_comparison.is_significant(without, fits[0]) else None


def _dead_band_for_friction(problem: FitProblem, last: Fit, first: Fit) -> list[Alternative]:
    """The last model with the first one's dead-band in the place of dry friction; none where another effect needs that
    friction.
    """
    dry = [i for i in ("coulomb_friction", "presliding_friction") if i in last.structure]
    needed = any("coulomb_friction" in e.includes for e in last.structure.effects)
    if len(dry) != 1 or needed or last.structure == first.structure:
        return []
    structure = last.structure.without(*dry).with_("dead_band")
    starts = [{**first.values, **last.values}, {**last.values, **first.values}]
    found = local_optima.best_refit(problem.at(last.process_noise), structure, starts)
    return [Alternative(dry[0], "dead_band", found)]


def _with_better_fit(this: Round, found: Fit) -> Round:
    """The round, with a better fit of the rival that has this structure. A rival in a worse local optimum would make an
    effect that contains it look better.
    """
    better = [h.point.structure == found.structure and found.deviance < h.deviance for h in this.rivals]
    rivals = (Hypothesis(h.added, found) if b else h for h, b in zip(this.rivals, better, strict=True))
    return replace(this, rivals=tuple(rivals))


def _plain_winner(problem: FitProblem, this: Round) -> Fit:
    """The winner, or only what it brought along where that improves the fit significantly by itself.

    The extra part of a specialised friction then competes with all other candidates.
    """
    winner = this.rivals[0]
    kept = this.before.structure.with_(*EFFECTS[winner.added[0]].includes)
    if kept.named == this.before.structure.named:
        return winner.point
    plain = _refits(problem, winner.point, [kept])[0]
    return plain if model_comparison.is_significant(this.before, plain) else winner.point


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
    while len(rounds) < most and (open_ := _open_candidates(candidates, best)):
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
        problem, best = _fit_at_best_noise(problem, _plain_winner(problem, this))
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
    usual = _restart(found.problem, settled)
    grown, rounds = _add_effects(
        found.problem, usual, found.first.structure, candidates, lambda sentence, share: None, most
    )
    won = [this for this in rounds if this.won]
    return (*_fit_at_best_noise(found.problem, grown), won) if won else (problem, best, [])


def _refit_alternatives(
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
            out += _offset_for_dead_bands(problem, last, [w.rival])
        else:
            structure = w.point.structure.with_(*more).without(*fewer)
            starts = ({**last.values, **w.point.values}, {**w.point.values, **last.values})
            out.append(
                Alternative(
                    w.effect, w.rival, local_optima.best_refit(problem.at(last.process_noise), structure, starts)
                )
            )
    return out


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
    best, _, swaps = _prune_and_exchange(problem, best, known, rounds)
    new = [e for e in best.structure.named if e not in known.structure]
    if not new:
        return found
    first = local_optima.refit(problem.at(best.process_noise), found.first.structure, found.first.values)
    # What had been found is judged beside what is new, each by itself.
    lesser = _refits(problem, best, _smaller_structures(best.structure, first.structure))
    best = _without_unmet_stops(problem, best)
    wider = [
        w for w in _containing_alternatives(problem, best, found.first.structure, candidates, rounds) if w.effect in new
    ]
    best, swaps = _prefer_containing(problem, best, swaps, wider)
    added = [e for e in best.structure.named if e not in known.structure]
    swaps += _refit_alternatives(problem, best, found.alternatives, more=added)
    return SearchResult(first, best, (*found.rounds, *rounds), problem, (*lesser, first), tuple(swaps))


def with_last_model(found: SearchResult, last: Fit) -> SearchResult:
    """The search with another last model of the same structure. The models that it is compared with are fitted
    again."""
    kept = local_optima.held_values(last)
    fits = _refits(found.problem.holding(kept), last, _smaller_structures(last.structure, found.first.structure))
    swaps = _refit_alternatives(found.problem.holding(kept), last, found.alternatives)
    return replace(found, last=last, smaller_models=(*fits, found.first) if fits else (), alternatives=tuple(swaps))


def drop_effects(found: SearchResult, effects: Sequence[str], values: Mapping[str, float]) -> SearchResult:
    """The search, its last model without some of its effects, from these values. A removed effect may replace one that
    stays: of two that do the same, the removed one may fit better alone.
    """
    kept, structure = local_optima.held_values(found.last), found.last.structure.without(*effects)
    alone = local_optima.refit(found.problem.holding(kept).at(found.last.process_noise), structure, values)
    last, lesser, swaps = _prune_and_exchange(found.problem.holding(kept), alone, found.first, found.rounds)
    told = {(w.effect, w.rival) for w in swaps}
    others = [w for w in found.alternatives if (w.effect, w.rival) not in told]
    swaps += _refit_alternatives(found.problem.holding(kept), last, others, fewer=effects)
    return replace(found, last=last, smaller_models=tuple(lesser), alternatives=tuple(swaps))
