"""From a first model and recordings to the diagnosis: search, judge, refit, and test on held-out data."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.codegen import latex
from twin.diagnosis import (
    adequacy,
    coverage,
    curve_substitution,
    data_split,
    dead_band_rivals,
    events,
    experiment_design,
    forward_selection,
    free_curves,
    handed_out,
    held_sensor,
    holdout,
    localization,
    model_comparison,
    name_tests,
    nonparametric,
    probabilities,
    residual_torque,
    suspect,
    thresholds,
)
from twin.diagnosis import verdict as claims
from twin.diagnosis.data_split import Intervals, RecordingPart
from twin.diagnosis.growth import Progress
from twin.diagnosis.localization import Regime
from twin.diagnosis.residual_torque import MissingTorque
from twin.diagnosis.result import Diagnosis, Estimate, Experiment, Finding, Fitness, NotBorneOut, Trace
from twin.diagnosis.search_result import SearchResult
from twin.display.numbers import capital, measure, number
from twin.effects.catalogue import BASE, CANDIDATES, EFFECTS, UNKNOWN, pages
from twin.errors import BadInput
from twin.estimation import likelihood, local_optima, long_recording, maximum_likelihood
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.io.position_loop import own_loop
from twin.io.recording import Recording, to_fit
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

#: So many recordings are named in one sentence; more are counted.
_MOST_NAMED = 3


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


def _findings(found: SearchResult, model: Model, first: Structure) -> tuple[Finding, ...]:
    named, _ = probabilities.probabilities(found)
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


def _unequal_dead_bands(last: Fit, unit: str) -> list[str]:
    """A sentence on dead-bands that differ by more than three standard errors; none where they are about equal."""
    if not set(dead_band_rivals.DEAD_BANDS) <= set(last.free) or not dead_band_rivals.are_dead_bands_unequal(last):
        return []
    forward, reverse = (last.values[n] for n in dead_band_rivals.DEAD_BANDS)
    return [
        f"The dead-bands are unequal: {forward:.3g} {unit} forwards and {reverse:.3g} {unit} backwards, as a drive or "
        "friction that differs between the directions makes them, or a constant torque."
    ]


def _closest_rival(found: SearchResult) -> list[Fit]:
    """The likeliest of the alternatives that the recordings do not tell from the last model; none where they do."""
    close = [
        w.point
        for w in found.alternatives
        if model_comparison.criterion_difference(found.last, w.point) < thresholds.UNDECIDED_MARGIN
    ]
    return sorted(close, key=lambda p: model_comparison.criterion_difference_penalised(p, found.last))[:1]


def _next_experiment(found: SearchResult) -> Experiment:
    """The input that would tell the closest rivals apart, or fix what is known worst."""
    problem = found.problem.stepped(found.last.structure)
    try:
        return experiment_design.design_for_discrimination([found.last, *_closest_rival(found)], problem)
    except (BadInput, np.linalg.LinAlgError) as error:
        return Experiment(why=f"no experiment was designed: {error}")


def _worst_recording(found: SearchResult) -> tuple[PreparedRecording, nonparametric.RemainingDependence]:
    """The recording in which the first model lacks most, and what it lacks there. It is the longest if nothing is
    missing.
    """
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


@dataclass(frozen=True, eq=False)
class _Searched:
    """What was fitted and held out, by the names that the user knows, what the search found, and sentences on it."""

    train: list[Recording]
    held_out: list[RecordingPart]
    names: list[str]
    found: SearchResult
    said: tuple[str, ...]


def _split_and_search(
    recordings: Sequence[Recording], first: Structure, held: Mapping[str, float], candidates: Sequence[str],
    progress: Progress | None,
) -> _Searched:  # fmt: skip
    """The search, with sentences on physics that held-out data alone show.

    Where the end of a lone recording shows physics that does not act before, the middle is held out instead. Where a
    moment lies in what is held out, blocks are. Of recordings that are too long, stretches are fitted and held out.
    """

    def looked(where: Intervals) -> tuple[_Searched, list[str]]:
        train, held_out = data_split.split(recordings, where)
        searched = long_recording.stretches(train, thresholds.MANY_STAMPS)
        names, said = [r.name for r in to_fit(recordings)], []
        if searched != train:
            names, held_out = [r.name for r in searched], data_split.short_parts(held_out)
            said = [_stretches_sentence(train, searched)]
        found = forward_selection.search(searched, first, held, candidates, progress)
        shown = holdout.physics_only_in_holdout(found.problem, found.last, held_out)
        return _Searched(searched, held_out, names, found, tuple(said)), shown

    choice = coverage.choose(recordings)
    said = coverage.sentences(choice)
    searched, shown = looked(choice.where)
    if shown and choice.where == data_split.END_PART and not searched.held_out[0].whole:
        said += [f"{s} So the middle was held out instead, and the search begun anew." for s in shown]
        searched, shown = looked(data_split.MIDDLE_PART)
    if lost := _moment_held_out(searched):
        again, shown_again = looked(data_split.BLOCKS)
        if not _moment_held_out(again):
            searched, shown, said = again, shown_again, [*said, lost]
    acting = [f"{s} Fit a recording in which it acts." for s in shown]
    return replace(searched, said=(*said, *searched.said, *acting))


def _moment_held_out(searched: _Searched) -> str:
    """A sentence on a moment, at which something changes, that lies in a held-out part; "" where none does.

    When in that part it was no fit can know, and a free run through it errs until then or from then on.
    """
    last = searched.found.last
    for effect in last.structure.effects:
        moment = effect.screen and effect.screen.moment
        if moment not in last.free:
            continue
        for part in searched.held_out:
            if not part.whole and part.begin <= last.values[moment] <= part.end:
                lies = f"between {number(part.begin)} and {number(part.end)} s"
                return (
                    f"{capital(effect.title)}: its moment lies {lies}, which was held out, so that no fit could see "
                    "it. So blocks all over the recording were held out instead, and the search begun anew."
                )
    return ""


def _stretches_sentence(whole: Sequence[Recording], searched: Sequence[Recording]) -> str:
    there, seen = (sum(float(r.time[-1]) for r in some) for some in (whole, searched))
    return (
        f"Of {number(there)} s that may be fitted, {len(searched)} stretches were searched, {number(seen)} s together: "
        "what happens at a moment, or changes from one stretch to the next, is not among what was tried. To look for "
        "that, diagnose a part of the recording."
    )


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
    if long_recording.is_long(to_fit(recordings), thresholds.MANY_STAMPS):
        return found  # stretches of the recordings were judged, not each of them
    odd = suspect.odd_one_out(found.adequacy)
    if odd is None:
        return found
    if progress:
        progress("asking again without the recording that carries most of the misfit", 0.97)
    with events.observing(None):
        other = _diagnosed(suspect.without(recordings, odd), first, held, candidates, None, closed)
    return replace(found, remarks=(*found.remarks, suspect.sentence(found, odd, other)))


class _Laps:
    """Seconds that each stage took, in their order."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._clock = time.perf_counter()

    def end(self, stage: str) -> None:
        """A stage ends now, and the next begins."""
        now = time.perf_counter()
        self.seconds[stage] = now - self._clock
        self._clock = now


@dataclass(frozen=True, eq=False)
class _Chosen:
    """The search with the names or the curve that stand, and how well they are known.

    `foreseen` is the last model with its longest filter memory, and the problem that it is judged by there.
    `left` is what the first and the last model lack in the recording `case`. The first lacks most there.
    """

    found: SearchResult
    foreseen: tuple[FitProblem, Fit]
    failed: tuple[NotBorneOut, ...]
    case: PreparedRecording
    left: tuple[nonparametric.RemainingDependence, nonparametric.RemainingDependence]
    others_left: bool
    said: tuple[str, ...]


def _ground(first: Structure, last: Structure) -> Structure:
    """What is no new name: dry friction in the place of the dead-band has proved itself against that."""
    replaced = "dead_band" in first and "dead_band" not in last
    return first.without("dead_band").with_("coulomb_friction") if replaced else first


def _test_names(found: SearchResult, first: Structure) -> _Chosen:
    """The search without the names that fail a test."""
    found, foreseen, failed = name_tests.drop_unearned_names(found, _ground(first, found.last.structure))
    case, lacking = _worst_recording(found)
    after = nonparametric.remaining_dependence(case, found.last.structure, found.last.values)
    return _Chosen(found, foreseen, tuple(failed), case, (lacking, after), False, ())


def _try_curves(tested: _Chosen, first: Structure) -> _Chosen:
    """The search, its names replaced by a curve where that serves better."""
    found, case, left, said = tested.found, tested.case, tested.left, []
    seen = found.last
    chances = name_tests.name_p_values(found, _ground(first, found.last.structure))
    nameless = free_curves.best_curve(found, *left, chances)
    learned = free_curves.restart_from_curve(found, nameless)
    if learned is not found:
        found = learned
        left = (left[0], nonparametric.remaining_dependence(case, found.last.structure, found.last.values))
    named = bool(set(found.last.structure.named) - set(first.named))
    if free_curves.replaces_names(found, nameless, left):
        found = free_curves.with_curve(found, nameless)
    elif drawn := curve_substitution.best_substitution(found.problem, first, found.last):
        said.append(drawn.says)
        found = replace(found, last=drawn.curve, smaller_models=(), alternatives=())
    elif not nonparametric.is_described(named, *left):
        found = free_curves.keep_or_replace(found, nameless)
    found, kept_as_it_was = free_curves.without_worse_curve(found, first)
    said += kept_as_it_was
    if found.last is found.first:
        left = (left[0], left[0])
    others = _other_recordings_left(found, case)
    if others:
        several = len(others) > _MOST_NAMED
        where = f"{len(others)} other recordings, as {others[0]}," if several else ", ".join(others)
        said.append(f"What is left of the missing torque in {where} goes with something still.")
    foreseen = tested.foreseen if found.last is seen else name_tests.fit_with_longest_memory(found)
    # What was dropped may have come back in another's place.
    failed = tuple(n for n in tested.failed if n.id not in found.last.structure)
    return _Chosen(found, foreseen, failed, case, left, bool(others), tuple(said))


def _models_of(chosen: _Chosen, searched: _Searched, first: Structure) -> tuple[_Chosen, handed_out.Pair]:
    """Both models as they are handed out, with their figures. A last model that is worse on held-out data than the
    first is not handed out.
    """
    found, (judged, last_point) = chosen.found, chosen.foreseen
    # Which contacts a model without the right physics should predict is not known.
    first_point = local_optima.with_longer_memory(found.problem, found.first)
    same = first_point.structure == last_point.structure
    pair = handed_out.pair(
        (judged if same else found.problem, judged),
        (last_point if same else first_point, last_point),
        searched.train,
        searched.held_out,
    )
    if not claims.vetoed(pair.figures) or pair.last.fit is pair.first.fit:
        return chosen, pair
    said = claims.veto_sentence(pair.figures, pair.last.fit.structure, first)
    failed = claims.vetoed_names(pair.figures, pair.last.fit.structure, first)
    chosen = replace(
        chosen,
        found=free_curves.back_to_first(found),
        failed=(*chosen.failed, *failed),
        left=(chosen.left[0], chosen.left[0]),
        said=(*chosen.said, said),
    )
    return chosen, handed_out.Pair(pair.first, pair.first, adequacy.unchanged(pair.figures))


def _emptied_names(chosen: _Chosen, pair: handed_out.Pair, first: Structure) -> list[NotBorneOut]:
    """The names of which the best free run leaves nothing, where the likeliest values run too far off to be handed out.

    Such a name follows what the model lacks for a moment, and does not describe it.
    """
    if pair.last.fit in (pair.first.fit, chosen.foreseen[1]):
        return []
    out = []
    for finding in filter(claims.includes_nothing, _findings(chosen.found, pair.last.model, first)):
        size = claims.size_of(finding)
        assert size is not None
        reason = f"in the free run that fits best its size, {measure(size.value, size.std, size.unit)}, may be nothing"
        out.append(NotBorneOut(finding.id, reason, abs(size.value) / size.std))
    return out


def _choose(tested: _Chosen, searched: _Searched, first: Structure, tell: Progress) -> tuple[_Chosen, handed_out.Pair]:
    """What stands of the names or a curve in their place, and both models as they are handed out."""
    unit = searched.train[0].input_unit
    for _ in range(thresholds.MAX_EFFECTS):
        tell("trying shapes without a name", 0.85)
        chosen = _try_curves(tested, first)
        tell("fitting both models to the end", 0.87)
        chosen = replace(chosen, said=(*chosen.said, *_choice_sentences(chosen, first, unit)))
        settled, pair = _models_of(chosen, searched, first)
        emptied = _emptied_names(chosen, pair, first)
        if not emptied:
            break
        left = forward_selection.drop_effects(tested.found, [n.id for n in emptied], tested.foreseen[1].values)
        again = _test_names(left, first)
        tested = replace(again, failed=(*tested.failed, *emptied, *again.failed))
    return settled, pair


def _fit_by_role(shown: Sequence[Trace], problem: FitProblem, pair: handed_out.Pair) -> dict[str, dict[str, Fitness]]:
    """How well both models follow what was fitted and what was held out."""
    white = [_whiteness_p_value(problem, judged.fit) for judged in (pair.first, pair.last)]
    return {
        role: {
            when: _fitness([t for t in shown if t.role == role], when, white[i] if role == "train" else math.nan)
            for i, when in enumerate(("before", "after"))
        }
        for role in ("train", "holdout")
    }


def _choice_sentences(chosen: _Chosen, first: Structure, unit: str) -> list[str]:
    """What was tried and not confirmed, and what the last model says of dead-bands and gap."""
    last = chosen.found.last
    said = [f"Tried, not confirmed: {EFFECTS[n.id].title}; {n.reason}." for n in chosen.failed]
    said += _unequal_dead_bands(last, unit)
    if "constant_offset" in last.structure and "offset" not in (*last.free, *chosen.found.problem.held):
        told = EFFECTS["dead_band"].confused_with["constant_offset"]
        said.append(
            "The constant torque is the one that leaves the dead-bands about equal: as long as the drive pushes, it "
            f"does what unequal ones do. This would tell: {told}."
        )
    if "backlash" in first and "backlash" not in last.structure:
        said.append("No gap shows: in this model motor and link are one.")
    return said


def _free_runs(searched: _Searched, before: Model, after: Model, closed: bool) -> list[Trace]:
    """Both models beside what was fitted and what was held out, by the names that the user knows."""
    runs = [*(("train", RecordingPart(r)) for r in searched.train), *(("holdout", p) for p in searched.held_out)]
    names = [*searched.names, *(p.recording.name for p in searched.held_out)]
    return [replace(t, name=n) for t, n in zip(holdout.traces(before, after, runs, closed), names, strict=True)]


def _diagnosed(
    recordings: Sequence[Recording],
    first: Structure,
    held: Mapping[str, float] | None,
    candidates: Sequence[str],
    progress: Progress | None,
    closed: bool,
) -> Diagnosis:
    """The diagnosis of all these recordings, an odd one among them or not."""
    tell = progress or (lambda sentence, share: None)
    for recording in recordings if closed else ():
        own_loop(recording)  # or the user is told, before the search takes its minutes
    laps = _Laps()
    searched = _split_and_search(recordings, first, dict(held or {}), candidates, progress)
    tested = _test_names(searched.found, first)
    telling = searched.names[list(tested.found.problem.recordings).index(tested.case)]
    laps.end("search")
    chosen, pair = _choose(tested, searched, first, tell)
    before, after = pair.first.model, pair.last.model
    laps.end("curves and adequacy")
    fits = (pair.first.fit, pair.last.fit)
    missing = [residual_torque.missing_torque(chosen.case, p.structure, p.values) for p in fits]
    shapes = [tuple(residual_torque.torque_shapes(m)) for m in missing]
    local = localization.without_base(missing[0])
    laps.end("locate")
    tell("checking on held-out data through the FMU", 0.9)
    shown = _free_runs(searched, before, after, closed)
    fit = _fit_by_role(shown, chosen.found.problem, pair)
    laps.end("held-out check through FMPy")
    findings = (*_findings(chosen.found, after, first), *held_sensor.finding(recordings))
    tell("designing the next experiment", 0.95)
    designed = _next_experiment(chosen.found)
    roughness = maximum_likelihood.roughness(chosen.found.problem, chosen.found.last)
    laps.end("next experiment")
    added = [*(f.id for f in findings), *(i for i in after.structure.ids if i in UNKNOWN)]
    lacks, rest = map(nonparametric.is_dependence_left, chosen.left)
    still = rest or chosen.others_left
    claim = claims.decide(pair.figures, findings, still, any(i in UNKNOWN for i in added))
    depends = tuple(EFFECTS[added[0]].depends_on) if added else chosen.left[0].variables
    return Diagnosis(
        verdict=claim.verdict,
        findings=findings,
        ranking=probabilities.probabilities(chosen.found)[1],
        station=EFFECTS[added[0]].station if added else "",
        depends_on=depends if claim.verdict != "nothing_missing" else (),
        telling=telling,
        segments=tuple(localization.segments(local)),
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
        undecided=probabilities.undecided(chosen.found),
        remarks=(*_remarks(chosen.found, fit, roughness), *searched.said, *chosen.said),
        seconds=laps.seconds,
        not_borne_out=chosen.failed,
        adequacy=replace(pair.figures, says=claim.says),
        regimes=_regimes(chosen, local) if lacks else (),
        gain_bias=_gain_bias(missing[0], before.values["input_gain"]) if lacks else 0.0,
    )


def _gain_bias(missing: MissingTorque, fitted: float) -> float:
    """By what share the first model's input gain is too large because of what it lacks."""
    straight = fitted + localization.gain_error(missing)
    return fitted / straight - 1.0 if straight > 0.0 else 0.0


def _regimes(chosen: _Chosen, local: MissingTorque) -> tuple[Regime, ...]:
    """Where the first model lacks most, in the variable that this goes with. An angle counts from turn to turn."""
    lacking = chosen.left[0]
    if lacking.table.startswith("wave"):
        return ()
    turn = 2.0 * math.pi if lacking.table.startswith("angle") else 0.0
    return tuple(localization.regimes_of(local, lacking.variables, turn))


def _remarks(found: SearchResult, fit: Mapping[str, Mapping[str, Fitness]], roughness: float) -> list[str]:
    """Where the criteria disagree, and where none of them says much. The likelihood of the last model is so rough."""
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
    if roughness > thresholds.MIN_GAIN * model_comparison.overdispersion([found.last]):
        said.append(
            "The motor rattles in its gap: a change of only 1 % in the teeth's frequency moves the likelihood by more "
            "than an effect must gain. Effects may be hidden by that: record with fewer reversals, larger ones, or a "
            "load that keeps the teeth together."
        )
    return said
