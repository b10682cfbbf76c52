"""The kernel's text: written once."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from axis_runs import drive

from twin.effects.catalogue import BASE
from twin.model.stepper import Structure
from twin.simulation import kernel


def test_threads_that_need_a_kernel_at_once_wait_for_the_first(monkeypatch, tmp_path):
    at_once = threading.Barrier(4)
    writing = []

    def text(offered):
        writing.append(threading.get_ident())
        time.sleep(0.2)  # long enough for the others to come by
        return f"said = {len(writing)}\n"

    monkeypatch.setenv("TWIN_CACHE", str(tmp_path))
    monkeypatch.setattr(kernel, "kernel_text", text)

    def ask(_):
        at_once.wait()
        return kernel.compiled(Structure.of(("inertia", "gravity")))

    with ThreadPoolExecutor(4) as pool:
        loaded = list(pool.map(ask, range(4)))
    assert len(writing) == 1
    assert all(module is loaded[0] for module in loaded) and loaded[0].said == 1


def test_no_derivative_is_given_for_what_is_never_fitted():
    """A zero would look like a value that does not matter."""
    structure = Structure.of((*BASE, "supply_sag"))
    recording, values = drive(0.002 * np.arange(9), np.zeros(9)), {p.name: p.start for p in structure.parameters}
    vector, start = kernel.vector(structure, values), kernel.start_state(0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="sag_reference"):
        kernel.predict_with_slopes(recording, vector, start, kernel.fixed_start(["input_gain", "sag_reference"]))


def test_slopes_that_a_resting_axis_forgets_end_as_nothing_not_as_numbers_that_processors_are_slow_with():
    """They fall by a factor with each reading: below 1e-38 a single number takes many times as long."""
    structure = Structure.of((*BASE, "coulomb_friction"))
    names = ("input_gain", "viscous_friction", "dead_band_forward", "backlash_gap", "coulomb_friction")
    values = {p.name: p.start for p in structure.parameters}
    values |= {"input_gain": 0.5, "viscous_friction": 2.0, "coulomb_friction": 1.0, "dead_band_forward": 3.0}
    time = 0.002 * np.arange(15000)
    moved = drive(time, np.where(time < 1.0, 60.0, 0.0))
    vector, start = kernel.vector(structure, values), kernel.start_state(0.0, 0.0, 0.0)
    noise = kernel.Noise(1e5)
    read = replace(moved, measured=kernel.predict(moved, vector, start).reading)
    run = kernel.predict_with_slopes(read, vector, start, kernel.fixed_start(names), noise)
    moving, last = run.slopes[time < 1.0], run.slopes[time > 29.0]
    assert np.abs(moving).max() > 1e-3
    assert not last.any()
    assert not np.any((run.slopes != 0.0) & (np.abs(run.slopes) < 1e-37))
