"""Dry friction and the dead-band, where an input has no pulse-width stage."""

from __future__ import annotations

import numpy as np
import pytest
from axis_runs import run

from twin.diagnosis import forward_selection, probabilities, search_result
from twin.io.recording import Recording
from twin.model.stepper import Structure

RIGID = Structure.of(["inertia", "viscous_friction"])
FIRST = RIGID.with_("dead_band")
COUNT = 2.0 * np.pi / 20000.0


def made(structure: Structure, unit: str, coasts: bool, **values: float) -> Recording:
    """Pushes in both directions, with coast-downs between them or one after the other."""
    rng = np.random.default_rng(4)
    time = 0.004 * np.arange(3000)
    size = rng.uniform(3.0, 8.0, 12)[(time // 1.0).astype(int)]
    sign = np.where((time // (2.0 if coasts else 12.0)) % 2 > 0, -1.0, 1.0)
    volts = np.where(coasts & (time % 1.0 > 0.6), 0.0, sign * size)
    truth = {"input_gain": 4.0, "viscous_friction": 2.0, **values}
    read, _ = run(structure, truth, time, volts + 0.02 * rng.standard_normal(3000) * (volts != 0.0))
    return Recording("made", time, volts, COUNT * np.round(read / COUNT), unit, "rad", COUNT)


def searched(recording: Recording) -> search_result.SearchResult:
    return forward_selection.search([recording], FIRST, {}, ("coulomb_friction",))


def test_dry_friction_takes_the_place_of_the_dead_band() -> None:
    found = searched(made(RIGID.with_("coulomb_friction"), "V", True, coulomb_friction=3.0))
    assert found.last.structure.named == ("coulomb_friction",) and "dead_band" not in found.last.structure
    assert found.last.values["coulomb_friction"] == pytest.approx(3.0, rel=0.02)
    assert "dead_band" in found.first.structure and found.first.deviance > found.last.deviance
    assert probabilities.undecided(found) == ()


def test_a_dead_band_that_coast_downs_show_stays() -> None:
    found = searched(made(FIRST, "V", True, dead_band_forward=0.8, dead_band_reverse=0.8))
    assert found.last.structure.named == () and "dead_band" in found.last.structure


def test_where_nothing_rubs_and_nothing_is_lost_the_first_model_stays() -> None:
    found = searched(made(RIGID, "V", True))
    assert found.last.structure.named == () and "dead_band" in found.last.structure


def test_where_the_drive_always_pushes_one_could_be_the_other() -> None:
    """Said once, with the experiment that tells them apart."""
    found = searched(made(RIGID.with_("coulomb_friction"), "V", False, coulomb_friction=3.0))
    assert found.last.structure.named == ("coulomb_friction",)
    (pair,) = probabilities.undecided(found)
    assert set(pair.ids) == {"coulomb_friction", "dead_band"} and "coast-downs" in pair.experiment


def test_a_drive_with_a_pulse_width_stage_keeps_its_dead_band() -> None:
    found = searched(made(FIRST, "%", False, dead_band_forward=0.8, dead_band_reverse=0.8))
    assert found.last.structure.named == () and "dead_band" in found.last.structure
