"""The closer look: what a filter sees that remembers for no longer than a recording asks for."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import circuit_rig
from blind_trial import KINDS, draw
from concealed import Concealed

from twin.diagnosis import selection_round, short_memory
from twin.diagnosis.search_result import SearchResult
from twin.effects.catalogue import BASE
from twin.estimation import contact_masking, local_optima, multistart, preparation
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
    found = short_memory.refine_with_short_memory(as_it_was, candidates)
    if there:
        assert found.last.structure.named == ("constant_offset",)
        assert found.last.values["offset"] == pytest.approx(planted.parameters["offset_link"], rel=0.2)
        assert found.first.structure.named == () and found.rounds[-1].won
        assert any(q.structure.named == () for q in found.smaller_models)
    else:
        assert found is as_it_was
