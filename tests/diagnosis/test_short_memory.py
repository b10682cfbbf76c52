"""The closer look: what a filter sees that remembers for no longer than a recording asks for."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.diagnosis import thresholds

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import circuit_rig
from blind_trial import KINDS, draw
from concealed import Concealed

from twin.diagnosis import forward_selection, model_comparison, selection_round
from twin.diagnosis.forward_selection import Alternative, SearchResult
from twin.diagnosis.selection_round import Hypothesis, Round
from twin.effects.catalogue import BASE, CANDIDATES
from twin.estimation import contact_masking, local_optima, multistart, preparation, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.stepper import Structure

FIRST = Structure.of(BASE)


@pytest.mark.parametrize("there", [True, False])
def test_a_faint_torque_is_seen_where_a_motor_rattles(there: bool) -> None:
    """A tenth of a second ahead nothing earns a place beside the errors of the bounces."""
    candidates = ("constant_offset", "gravity", "motor_lag")
    drawn = draw(71069, 1037, tuple(KINDS), 20.0, "circuit")
    (planted,) = drawn.label.effects
    effects = [Concealed(planted.id, planted.parameters)] if there else []
    run = circuit_rig.simulate(drawn.rig, effects, drawn.time, drawn.duty, drawn.noise_seed)
    count = 2.0 * np.pi / run.counts_per_revolution
    recording = Recording("rig", run.time, run.duty, run.counts * count, "%", "rad", count)
    problem, rough = multistart.coarse_starts([recording], FIRST, {})
    polished, fine = multistart.leave_local_optima(
        problem,
        multistart.fit_from_starts(problem, preparation.with_tooth_compliance(FIRST), rough),
    )
    problem = contact_masking.without_contact_mask(polished)
    before = local_optima.refit(problem.at(local_optima.judging_process_noise(problem, fine)), FIRST, fine.values)
    lost = selection_round.run_round(problem, before, (), candidates)
    assert not lost.won
    as_it_was = SearchResult(lost.before, lost.before, (lost,), problem)
    found = forward_selection.refine_with_short_memory(as_it_was, candidates)
    if there:
        assert found.last.structure.named == ("constant_offset",)
        assert found.last.values["offset"] == pytest.approx(planted.parameters["offset_link"], rel=0.2)
        assert found.first.structure.named == () and found.rounds[-1].won
        assert any(q.structure.named == () for q in found.smaller_models)
    else:
        assert found is as_it_was


def fitted(deviance: float, *effects: str, process_noise: float = 1.0) -> Fit:
    """A point that nothing was fitted for."""
    none = np.zeros(1)
    return Fit(
        Structure.of([*BASE, *effects]), {}, process_noise, ("input_gain",), deviance, 1.0, np.eye(1), none, np.eye(1)
    )


def looked_at(
    monkeypatch, found: SearchResult, sharp: Fit, grown: Fit, swaps: list[Alternative], settle=None
) -> SearchResult:  # fmt: skip
    """The closer look where the filter that the recording asks for ends here, and finds these."""
    case = prepared_recording.prepare_recording(
        Recording("still", 0.002 * np.arange(50), np.full(50, 30.0), np.zeros(50), "%", "rad", 1e-4), FIRST
    )
    rounds = [Round(sharp, (Hypothesis(grown.structure.named[-1:], grown),), 1.0)] if grown is not sharp else []
    monkeypatch.setattr(forward_selection, "_fit_at_best_noise", lambda cases, point: (FitProblem([case]), sharp))
    monkeypatch.setattr(forward_selection, "_add_with_short_memory", lambda *rest: (FitProblem([case]), grown, rounds))
    monkeypatch.setattr(
        forward_selection, "_add_with_usual_memory", lambda found, cases, best, *rest: (cases, best, [])
    )
    monkeypatch.setattr(forward_selection, "_prune_and_exchange", lambda *rest: (grown, [], list(swaps)))
    monkeypatch.setattr(
        forward_selection,
        "_offset_for_dead_bands",
        lambda cases, last, rivals: [Alternative("dead_band", rivals[0], grown)],
    )
    monkeypatch.setattr(
        local_optima, "refit", settle or (lambda cases, structure, *rest: fitted(0.0, *structure.named))
    )
    return forward_selection.refine_with_short_memory(found, CANDIDATES)


def test_as_it_was_where_there_is_no_other_filter_or_it_sees_nothing(monkeypatch) -> None:
    found = SearchResult(fitted(0.0), fitted(-100.0, "gravity"), (), FitProblem(()))
    alike, other = (
        replace(found.last, process_noise=share * local_optima.PROCESS_NOISE_TOLERANCE) for share in (0.9, 2.0)
    )
    grown = fitted(-300.0, "gravity", "motor_lag")
    assert looked_at(monkeypatch, found, alike, grown, []) is found
    assert looked_at(monkeypatch, found, other, other, []) is found


def test_what_stood_for_what_had_been_found_does_so_beside_what_is_new(monkeypatch) -> None:
    """But a constant torque that is named is no other reading of the dead-bands."""
    pairs = (("gravity", "spring"), ("dead_band", "constant_offset"))
    old = [Alternative(effect, rival, fitted(-99.0, rival)) for effect, rival in pairs]
    found = SearchResult(fitted(0.0), fitted(-100.0, "gravity"), (), FitProblem(()), (), tuple(old))
    sharp = fitted(-2000.0, "gravity", process_noise=2.0 * local_optima.PROCESS_NOISE_TOLERANCE)
    mine = Alternative("motor_lag", "input_delay", fitted(-2080.0, "gravity", "input_delay"))
    for new, kept in (("motor_lag", 2), ("constant_offset", 1)):
        grown = fitted(-2100.0, "gravity", new)
        seen = looked_at(monkeypatch, found, sharp, grown, [mine])
        assert seen.last is grown and seen.first.structure == FIRST
        # What had been found is held against the model that lacks it alone, as is what is new.
        assert {q.structure.named for q in seen.smaller_models} == {("gravity",), (new,), ()}
        assert seen.alternatives[0] is mine and [(w.effect, w.rival) for w in seen.alternatives[1:]] == [*pairs[:kept]]
        assert all(new in w.point.structure for w in seen.alternatives[1:])


@pytest.mark.parametrize(("asymmetric", "named"), [(-2099.0, "coulomb_friction"), (-2300.0, "friction_asymmetry")])
def test_what_contains_a_new_effect_is_held_against_it(monkeypatch, asymmetric: float, named: str) -> None:
    """Plain friction that only the closer look finds may be one-sided; what was found before is not asked again."""
    old = Alternative("gravity", "spring", fitted(-99.0, "spring"))
    found = SearchResult(fitted(0.0), fitted(-100.0, "gravity"), (), FitProblem(()), (), (old,))
    sharp = fitted(-2000.0, "gravity", process_noise=2.0 * local_optima.PROCESS_NOISE_TOLERANCE)
    grown = fitted(-2100.0, "gravity", "coulomb_friction")
    wider = [
        Alternative("coulomb_friction", "friction_asymmetry", fitted(asymmetric, "gravity", "friction_asymmetry")),
        Alternative("gravity", "spring", fitted(-9000.0, "spring", "coulomb_friction")),
    ]
    monkeypatch.setattr(forward_selection, "_containing_alternatives", lambda *rest: wider)
    monkeypatch.setattr(model_comparison, "overdispersion", lambda points: 1.0)

    def settle(cases, structure, *rest):
        return next((w.point for w in wider if w.point.structure == structure), fitted(0.0, *structure.named))

    seen = looked_at(monkeypatch, found, sharp, grown, [], settle)
    assert named in seen.last.structure.named
    other = {"coulomb_friction", "friction_asymmetry"} - {named}
    assert [(w.effect, w.rival) for w in seen.alternatives] == [(named, *other), ("gravity", "spring")]
    # What stood for what had been found does so beside what is named now.
    assert seen.alternatives[1].point.structure.named == fitted(0.0, "spring", named).structure.named


def test_looked_for_are_as_many_effects_as_there_is_room_for(monkeypatch) -> None:
    """Each beside the one before, judged as that asks for; none where nothing does a little."""
    names = ("spring", "motor_lag", "gravity", "input_delay")
    points = [fitted(-1000.0 * n, *names[:n]) for n in range(len(names) + 1)]

    def seen(cases, before, candidates):
        n = len(before.structure.named)
        return [Hypothesis((names[n],), points[n + 1])]

    monkeypatch.setattr(selection_round, "screen_candidates", seen)
    monkeypatch.setattr(
        selection_round, "run_round", lambda cases, before, known, *rest: Round(before, tuple(known), 1.0)
    )
    monkeypatch.setattr(forward_selection, "_plain_winner", lambda cases, this: this.rivals[0].point)
    monkeypatch.setattr(forward_selection, "_fit_at_best_noise", lambda cases, point: (cases, point))
    for room in (0, 1, 3):
        _, best, rounds = forward_selection._add_with_short_memory(FitProblem([]), points[0], room, names)
        assert best is points[room] and len(rounds) == room
    # What a rig has of its own shows there, too: too little is no discovery, and next to nothing is not looked at.
    for earned in (
        0.9 * thresholds.MIN_GAIN_AT_OTHER_MEMORY,
        0.9 * thresholds.PROMISING_SHARE * thresholds.MIN_GAIN_AT_OTHER_MEMORY,
    ):
        little = Hypothesis(("spring",), fitted(-earned, "spring"))
        monkeypatch.setattr(selection_round, "screen_candidates", lambda *rest, little=little: [little])
        if earned < thresholds.PROMISING_SHARE * thresholds.MIN_GAIN_AT_OTHER_MEMORY:
            monkeypatch.setattr(selection_round, "run_round", None)
        assert forward_selection._add_with_short_memory(FitProblem([]), points[0], 3, names)[1:] == (points[0], [])


def test_what_a_faint_effect_had_hidden_from_the_usual_filter_is_looked_for_beside_it(monkeypatch) -> None:
    """From where the usual filter would have the model, and judged as the sharper one asks for; all that was found is
    left as it was where nothing more shows.
    """
    known, usual = fitted(-2000.0, "spring", process_noise=5.0), fitted(-900.0, "spring")
    more = fitted(-1500.0, "spring", "motor_lag")
    lost = Round(usual, (), 1.0, False)
    won = Round(usual, (Hypothesis(("motor_lag",), more),), 1.0)
    found, sharper, asked = (
        SearchResult(fitted(0.0), fitted(0.0), (), FitProblem(())),
        replace(more, process_noise=5.0),
        [],
    )

    def settle(problem, structure, values):
        assert structure == known.structure and problem.process_noise == found.last.process_noise
        return usual

    def grow(problem, best, candidates, tell, most):
        asked.append((best, most))
        return more, [won, lost]

    monkeypatch.setattr(local_optima, "refit", settle)
    monkeypatch.setattr(forward_selection, "_restart", lambda cases, point: point)
    monkeypatch.setattr(
        forward_selection, "_fit_at_best_noise", lambda cases, point: (cases, replace(point, process_noise=5.0))
    )
    monkeypatch.setattr(forward_selection, "_add_effects", grow)
    _, best, rounds = forward_selection._add_with_usual_memory(found, FitProblem([]), known, 2, CANDIDATES)
    assert asked == [(usual, 2)] and rounds == [won]
    assert best.structure == sharper.structure and best.process_noise == sharper.process_noise
    monkeypatch.setattr(forward_selection, "_add_effects", lambda *rest: (usual, [lost]))
    assert forward_selection._add_with_usual_memory(found, FitProblem([]), known, 2, CANDIDATES)[1:] == (known, [])
