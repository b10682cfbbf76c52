"""From a first model and recordings to the diagnosis: search, judge, refit, and test on held-out data."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from twin.codegen import latex
from twin.diagnosis import (
    acceptance,
    adequacy,
    block_validation,
    coverage,
    cross_validation,
    curve_substitution,
    data_split,
    events,
    experiment_design,
    forward_selection,
    handed_out,
    held_sensor,
    holdout,
    law_tolerance,
    model_comparison,
    nonparametric,
    residual_torque,
    selection_round,
    suspect,
    thresholds,
)
from twin.diagnosis import verdict as claims
from twin.diagnosis.data_split import Intervals, RecordingPart
from twin.diagnosis.forward_selection import Progress, SearchResult
from twin.diagnosis.nonparametric import TERM_KINDS, CurveTerm
from twin.diagnosis.plausibility import is_plausible
from twin.diagnosis.result import Diagnosis, Estimate, Experiment, Finding, Fitness, NotBorneOut, Trace, Undecided
from twin.effects.catalogue import BASE, CANDIDATES, EFFECTS, UNKNOWN, pages
from twin.errors import BadInput
from twin.estimation import likelihood, local_optima, maximum_likelihood, multistart, optimizer, preparation
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.io.position_loop import own_loop
from twin.io.recording import Recording, to_fit
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.parallel import each

#: Shapes that are tried whatever the missing torque shows: the likelihood sees more of them than its averages do.
ALWAYS_TRIED = ("position", "velocity", "input", "time", "drag")


def _fitness(chosen: Sequence[Trace], which: str, white: float) -> Fitness:
    recorded = np.concatenate([t.recorded for t in chosen]) if chosen else np.zeros(0)
    simulated = np.concatenate([getattr(t, which) for t in chosen]) if chosen else np.zeros(0)
    value, percent = model_comparison.rmse(recorded, simulated)
    return Fitness(value, percent, white)


def _whiteness_p_value(problem: FitProblem, point: Fit) -> float:
    parts = [
        likelihood.innovations(c, point.structure, point.values, point.process_noise)
        for c in problem.stepped(point.structure)
    ]
    return model_comparison.whiteness_p_value(
        np.concatenate([i.error / np.sqrt(i.variance * point.scale) for i in parts])
    )


def _probabilities(found: SearchResult) -> tuple[dict[str, float], tuple[tuple[str, float], ...]]:
    """The probability of each named effect, or of one of the base that a rival could replace. And a ranking of these,
    of their rivals, and of the other candidates of the first round.

    An effect shares what is certain with each rival that could stand in its place, and with its absence.
    """
    named: dict[str, float] = {}
    ranking: dict[str, float] = {}
    for effect in dict.fromkeys((*found.last.structure.named, *(w.effect for w in found.alternatives))):
        if effect in UNKNOWN:
            continue
        named[effect], others = forward_selection.probability_shares(found, effect)
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


def _findings(found: SearchResult, model: Model, first: Structure) -> tuple[Finding, ...]:
    named, _ = _probabilities(found)
    out = []
    for effect in model.structure.named:
        if effect in first or effect in UNKNOWN:
            continue
        page = EFFECTS[effect]
        parameters = {
            p.name: Estimate(model.values[p.name], model.std(p.name), model.unit(p.name))
            for one in pages(effect)
            if one.id not in BASE
            for p in one.parameters
        }
        out.append(
            Finding(
                effect,
                page.station,
                named[effect],
                model.says(effect),
                latex.equation(effect, model.axis_unit),
                parameters,
            )
        )
    return tuple(sorted(out, key=lambda f: -f.probability))


def _undecided(found: SearchResult) -> tuple[Undecided, ...]:
    """Effects and the rivals that could as well stand in their place, with what each is given."""
    named, ranking = _probabilities(found)
    out = []
    for swap in found.alternatives:
        one, two = swap.effect, swap.rival
        if model_comparison.criterion_difference(found.last, swap.point) < thresholds.UNDECIDED_MARGIN:
            text = EFFECTS[one].confused_with.get(two) or EFFECTS[two].confused_with.get(one)
            text = text or "a richer recording: several amplitudes, coast-downs, slow ramps"
            out.append(Undecided((one, two), (named[one], dict(ranking)[two]), text))
    return tuple(sorted(out, key=lambda u: -u.probabilities[1]))


def _best_curve(
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
        named, _ = _probabilities(found)
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


def _restart_from_curve(found: SearchResult, nameless: Fit) -> SearchResult:
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


def _curve_replaces_names(
    found: SearchResult, nameless: Fit, left: Sequence[nonparametric.RemainingDependence]
) -> bool:
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
    if new and follows and left[1].size < thresholds.DRY_FRICTION_SHARE * left[0].size:
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


def _with_curve(found: SearchResult, nameless: Fit) -> SearchResult:
    """The search, ended with what has no name in the place of all names."""
    return replace(found, last=nameless, rounds=found.rounds[:1], smaller_models=(), alternatives=())


def _keep_or_replace(found: SearchResult, nameless: Fit) -> SearchResult:
    """What becomes of a model whose names leave most of the missing torque where it was.

    They are replaced by a curve that predicts better. A curve that does not improve the fit significantly, or does less
    than the names, would only mislead a free run. Then the model stays as it is.
    """
    if (
        model_comparison.is_significant(found.first, nameless)
        and model_comparison.criterion_difference(nameless, found.last) >= 0.0
    ):
        return _with_curve(found, nameless)
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


def _fit_with_longest_memory(found: SearchResult) -> tuple[FitProblem, Fit]:
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


def _name_p_values(found: SearchResult, first: Structure) -> dict[str, float]:
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
    chances = _name_p_values(found, first)
    worst = max(chances, key=lambda e: chances[e], default="")
    if worst and chances[worst] > thresholds.NAME_MAX_P_VALUE:
        reason = f"it predicts parts that were left out no better than chance may (p = {chances[worst]:.2g})"
        return [NotBorneOut(worst, reason, chances[worst])]
    return []


def _drop_unearned_names(
    found: SearchResult, first: Structure
) -> tuple[SearchResult, tuple[FitProblem, Fit], list[NotBorneOut]]:
    """The search without the names of its last model that fail a test. The last model with the longest memory that it
    supports. And the names that failed.
    """
    failed: list[NotBorneOut] = []
    while True:
        foreseen = _fit_with_longest_memory(found)
        unearned = _unearned(found, foreseen, first)
        if not unearned:
            return found, foreseen, failed
        failed += unearned
        found = forward_selection.drop_effects(found, [n.id for n in unearned], foreseen[1].values)


def _unequal_dead_bands(last: Fit, unit: str) -> list[str]:
    """A sentence on dead-bands that differ by more than three standard errors; none where they are about equal."""
    if not set(forward_selection.DEAD_BANDS) <= set(last.free) or not forward_selection.are_dead_bands_unequal(last):
        return []
    forward, reverse = (last.values[n] for n in forward_selection.DEAD_BANDS)
    return [
        f"The dead-bands are unequal: {forward:.3g} {unit} forwards and {reverse:.3g} {unit} backwards, as a drive or "
        "friction that differs between the directions makes them, or a constant torque."
    ]


def _next_experiment(found: SearchResult) -> Experiment:
    """The input that would tell the closest rivals apart, or fix what is known worst."""
    problem = found.problem.stepped(found.last.structure)
    close = [
        w.point
        for w in found.alternatives
        if model_comparison.criterion_difference(found.last, w.point) < thresholds.UNDECIDED_MARGIN
    ]
    near = sorted(close, key=lambda p: model_comparison.criterion_difference_penalised(p, found.last))[:1]
    try:
        return experiment_design.design_for_discrimination([found.last, *near], problem)
    except (BadInput, np.linalg.LinAlgError) as error:
        return Experiment(why=f"no experiment was designed: {error}")


def _worst_recording(found: SearchResult) -> tuple[PreparedRecording, nonparametric.RemainingDependence]:
    """The recording in which the first model lacks most, and what it lacks there. It is the longest if nothing is
    missing."""
    judged = [
        (c, nonparametric.remaining_dependence(c, found.first.structure, found.first.values))
        for c in found.problem.recordings
    ]
    return max(
        judged, key=lambda j: (j[1].size if nonparametric.is_dependence_left(j[1]) else 0.0, float(j[0].drive.time[-1]))
    )


def _other_recordings_left(found: SearchResult, telling: PreparedRecording) -> list[str]:
    """The other recordings in which the missing torque of the last model depends on a state of motion."""
    last, others = found.last, [c for c in found.problem.recordings if c is not telling]
    left = [(c, nonparametric.remaining_dependence(c, last.structure, last.values)) for c in others]
    return [c.recording.name for c, one in left if nonparametric.is_dependence_left(one)]


def _split_and_search(
    recordings: Sequence[Recording], first: Structure, held: Mapping[str, float], candidates: Sequence[str],
    progress: Progress | None,
) -> tuple[list[Recording], list[RecordingPart], SearchResult, list[str]]:  # fmt: skip
    """The fitted recordings, the held-out parts, the search, and sentences on physics that held-out data alone show.

    Where the end of a lone recording shows physics that does not act before, the middle is held out instead.
    """

    def looked(where: Intervals) -> tuple[list[Recording], list[RecordingPart], SearchResult, list[str]]:
        train, held_out = data_split.split(recordings, where)
        found = forward_selection.search(train, first, held, candidates, progress)
        return train, held_out, found, holdout.physics_only_in_holdout(found.problem, found.last, held_out)

    choice = coverage.choose(recordings)
    said = coverage.sentences(choice)
    train, held_out, found, shown = looked(choice.where)
    if shown and choice.where == data_split.END_PART and not held_out[0].whole:
        said += [f"{s} So the middle was held out instead, and the search begun anew." for s in shown]
        train, held_out, found, shown = looked(data_split.MIDDLE_PART)
    return train, held_out, found, said + [f"{s} Fit a recording in which it acts." for s in shown]


def _without_worse_curve(found: SearchResult, first: Structure) -> tuple[SearchResult, list[str]]:
    """The search. Its first model replaces a last one whose curve does not help on data that it was not fitted to."""
    curves = [i for i in found.last.structure.ids if i in UNKNOWN and i not in first]
    if not curves or block_validation.improves(found.problem, found.first, found.last):
        return found, []
    titles = " and ".join(EFFECTS[i].title for i in curves)
    says = (
        f"{titles[:1].upper()}{titles[1:]} would fit better one step ahead, but makes the free run no better through "
        "blocks that it was not fitted to: the model stays as it was."
    )
    return _back_to_first(found), [says]


def _back_to_first(found: SearchResult) -> SearchResult:
    """The search, ended with the first model."""
    return replace(found, last=found.first, smaller_models=(), alternatives=())


def diagnose(
    recordings: Sequence[Recording],
    first: Structure,
    held: Mapping[str, float] | None = None,
    candidates: Sequence[str] = CANDIDATES,
    progress: Progress | None = None,
    closed: bool = False,
) -> Diagnosis:
    """Locate, name, model and show what a first model of these recordings leaves out. Raises BadInput.

    Fits and choices use the recorded input; `closed` shows the free runs under the rig's own loop. Where one of several
    recordings carries most of the misfit, the rest is diagnosed without it, too.
    """
    found = _diagnosed(recordings, first, held, candidates, progress, closed)
    odd = suspect.odd_one_out(found.adequacy)
    if odd is None:
        return found
    if progress:
        progress("asking again without the recording that carries most of the misfit", 0.97)
    with events.observing(None):
        other = _diagnosed(suspect.without(recordings, odd), first, held, candidates, None, closed)
    return replace(found, remarks=(*found.remarks, suspect.sentence(found, odd, other)))


def _diagnosed(
    recordings: Sequence[Recording],
    first: Structure,
    held: Mapping[str, float] | None,
    candidates: Sequence[str],
    progress: Progress | None,
    closed: bool,
) -> Diagnosis:
    """The diagnosis of all these recordings, an odd one among them or not."""
    held = dict(held or {})
    tell = progress or (lambda sentence, share: None)
    for recording in recordings if closed else ():
        own_loop(recording)  # or the user is told, before the search takes its minutes
    clock = time.perf_counter()
    seconds: dict[str, float] = {}

    def lap(stage: str) -> None:
        nonlocal clock
        now = time.perf_counter()
        seconds[stage] = seconds.get(stage, 0.0) + now - clock
        clock = now

    train, held_out, found, said = _split_and_search(recordings, first, held, candidates, progress)
    # Dry friction in the place of the dead-band has proved itself against that.
    replaced = "dead_band" in first and "dead_band" not in found.last.structure
    ground = first.without("dead_band").with_("coulomb_friction") if replaced else first
    found, foreseen, failed = _drop_unearned_names(found, ground)
    chances = _name_p_values(found, ground)
    seen = found.last
    lap("search")
    case, lacking = _worst_recording(found)
    # By the name that the user knows: what was fitted may have been cut where the rest is held out.
    telling = to_fit(recordings)[list(found.problem.recordings).index(case)].name
    left = [lacking, nonparametric.remaining_dependence(case, found.last.structure, found.last.values)]
    tell("trying shapes without a name", 0.85)
    nameless = _best_curve(found, left[0], left[1], chances)
    learned = _restart_from_curve(found, nameless)
    if learned is not found:
        found, left[1] = learned, nonparametric.remaining_dependence(case, learned.last.structure, learned.last.values)
    named = bool(set(found.last.structure.named) - set(first.named))
    if _curve_replaces_names(found, nameless, left):
        found = _with_curve(found, nameless)
    elif drawn := curve_substitution.best_substitution(found.problem, first, found.last):
        said.append(drawn.says)
        found = replace(found, last=drawn.curve, smaller_models=(), alternatives=())
    elif not nonparametric.is_described(named, *left):
        found = _keep_or_replace(found, nameless)
    found, kept_as_it_was = _without_worse_curve(found, first)
    said += kept_as_it_was
    left[1] = left[0] if found.last is found.first else left[1]
    others = _other_recordings_left(found, case)
    if others:
        said.append(f"What is left of the missing torque in {', '.join(others)} goes with something still.")
    lap("term without a name")
    # What was dropped may have come back in another's place.
    failed = [n for n in failed if n.id not in found.last.structure]
    said += [f"Tried, not confirmed: {EFFECTS[n.id].title}; {n.reason}." for n in failed]
    said += _unequal_dead_bands(found.last, recordings[0].input_unit)
    if "backlash" in first and "backlash" not in found.last.structure:
        said.append(
            "No gap shows: a model in which motor and link are one is more likely, so this one has no backlash."
        )
    tell("fitting both models to the end", 0.87)
    judged, last_point = foreseen if found.last is seen else _fit_with_longest_memory(found)
    # Which contacts a model without the right physics should predict is not known.
    first_point = local_optima.with_longer_memory(found.problem, found.first)
    same = first_point.structure == last_point.structure
    shown_pair = handed_out.pair(
        (judged if same else found.problem, judged), (last_point if same else first_point, last_point), train, held_out
    )
    figures, before, after = shown_pair.figures, shown_pair.first.model, shown_pair.last.model
    first_point, last_point = shown_pair.first.fit, shown_pair.last.fit
    if claims.vetoed(figures) and last_point is not first_point:
        said.append(claims.veto_sentence(figures, last_point.structure, first))
        failed = [*failed, *claims.vetoed_names(figures, last_point.structure, first)]
        found, after, last_point, left[1] = _back_to_first(found), before, first_point, left[0]
        figures = adequacy.unchanged(figures)
    lap("adequacy")
    missing = [residual_torque.missing_torque(case, p.structure, p.values) for p in (first_point, last_point)]
    shapes = [tuple(residual_torque.torque_shapes(m)) for m in missing]
    lap("locate")
    tell("checking on held-out data through the FMU", 0.9)
    runs = [*(("train", RecordingPart(r)) for r in train), *(("holdout", p) for p in held_out)]
    shown = holdout.traces(before, after, runs, closed)
    white = [_whiteness_p_value(found.problem, p) for p in (first_point, last_point)]
    fit = {
        role: {
            when: _fitness([t for t in shown if t.role == role], when, white[i] if role == "train" else math.nan)
            for i, when in enumerate(("before", "after"))
        }
        for role in ("train", "holdout")
    }
    lap("held-out check through FMPy")
    findings = (*_findings(found, after, first), *held_sensor.finding(recordings))
    tell("designing the next experiment", 0.95)
    designed = _next_experiment(found)
    lap("next experiment")
    added = [*(f.id for f in findings), *(i for i in after.structure.ids if i in UNKNOWN)]
    still = nonparametric.is_dependence_left(left[1]) or bool(others)
    claim = claims.decide(figures, findings, still, any(i in UNKNOWN for i in added))
    depends = tuple(EFFECTS[added[0]].depends_on) if added else left[0].variables
    _, ranking = _probabilities(found)
    return Diagnosis(
        verdict=claim.verdict,
        findings=findings,
        ranking=ranking,
        station=EFFECTS[added[0]].station if added else "",
        depends_on=depends if claim.verdict != "nothing_missing" else (),
        telling=telling,
        segments=tuple(residual_torque.segments(missing[0])),
        before=before,
        after=after,
        fit=fit,
        traces=tuple(shown),
        missing_before=missing[0],
        missing_after=missing[1],
        shapes_before=shapes[0],
        shapes_after=shapes[1],
        recordings=tuple(recordings),
        experiment=designed,
        undecided=_undecided(found),
        remarks=(*_remarks(found, fit), *said),
        seconds=seconds,
        not_borne_out=tuple(failed),
        adequacy=replace(figures, says=claim.says),
    )


def _remarks(found: SearchResult, fit: Mapping[str, Mapping[str, Fitness]]) -> list[str]:
    """Where the criteria disagree, and where none of them says much."""
    said = []
    held_out = fit["holdout"]
    if held_out["after"].rmse > held_out["before"].rmse:
        said.append(
            "The likelihood prefers the larger model but its free run on held-out data is worse "
            f"({held_out['after'].nrmse_percent:.2f} % against {held_out['before'].nrmse_percent:.2f} %): "
            "treat what was added with care."
        )
    said += [
        f"{c.recording.name}: in {100.0 * c.rattle_mask.mean():.0f} % of what was fitted the input turns so often that "
        "motor and link come to no rest against each other: that is followed, but nothing is concluded from it."
        for c in found.problem.recordings
        if c.rattle_mask is not None and c.rattle_mask.mean() >= 0.005
    ]
    if maximum_likelihood.roughness(found.problem, found.last) > thresholds.MIN_GAIN * model_comparison.overdispersion(
        [found.last]
    ):
        said.append(
            "The motor rattles in its gap: a change of only 1 % in the teeth's frequency moves the likelihood by more "
            "than an effect must gain. Effects may be hidden by that: record with fewer reversals, larger ones, or a "
            "load that keeps the teeth together."
        )
    return said
