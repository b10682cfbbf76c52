"""One recording that is unlike all others is named, and what the others say without it; none where all are alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import steps

from twin.diagnosis import suspect
from twin.diagnosis.adequacy import Adequacy, Comparison, FreeRun, TorqueFigures
from twin.diagnosis.diagnose import diagnose
from twin.estimation import prepared_recording
from twin.io.recording import Recording
from twin.model.stepper import Structure
from twin.simulation import kernel

RIGID = Structure.of(["inertia", "viscous_friction"])
COUNT = 1e-3


def figures(*errors: float) -> Adequacy:
    """Recordings whose own noise makes 0.01 rad, over a range of 2 rad."""
    runs = [FreeRun(e, 0.01, 0.5 if e < 0.02 else 0.0, 0.02) for e in errors]
    rows = tuple(("train", f"run {i}", Comparison(r, r, 2.0)) for i, r in enumerate(runs))
    return Adequacy({}, rows, TorqueFigures())


@pytest.mark.parametrize("at", [0, 2])
def test_the_recording_that_carries_most_of_the_misfit_is_named(at: int) -> None:
    errors = [0.01, 0.012, 0.009]
    errors[at] = 0.5
    assert suspect.odd_one_out(figures(*errors)) == at


@pytest.mark.parametrize("errors", [(0.01, 0.012, 0.009), (0.5, 0.5, 0.01), (0.4, 0.5, 0.6), (0.01, 0.5), ()])
def test_no_recording_is_named_where_none_or_several_are_unlike(errors: tuple[float, ...]) -> None:
    assert suspect.odd_one_out(figures(*errors)) is None


def recorded(name: str, seed: int) -> Recording:
    """What an encoder reads of a rigid axis with viscous friction over 4 s."""
    duty = steps(np.random.default_rng(seed), 2000)
    blank = Recording(name, 0.002 * np.arange(2000), duty, np.zeros(2000), "%", "rad", COUNT)
    drive = prepared_recording.prepare_recording(blank, RIGID).drive
    values = kernel.vector(RIGID, {"input_gain": 0.4, "viscous_friction": 3.0})
    read = kernel.predict(drive, values, kernel.start_state(0.0, 0.0, 0.0)).reading
    return replace(blank, output=COUNT * np.round(read / COUNT))


def test_the_answer_without_the_odd_one_is_given() -> None:
    """An encoder that slips on its shaft in one run of four is no property of the axis."""
    made = [recorded(f"run {i}", i) for i in range(4)]
    slips = np.cumsum(np.random.default_rng(9).uniform(0.0, 0.2, 2000) * (np.arange(2000) % 400 == 399))
    slipping = replace(made[2], output=made[2].output + slips)
    found = diagnose([*made[:2], slipping, made[3]], RIGID, {}, ())
    assert suspect.odd_one_out(found.adequacy) == 2
    assert found.remarks[-1].startswith("run 2 carries most of the misfit")
    assert "Without it the verdict is nothing missing, with no effect" in found.remarks[-1]
