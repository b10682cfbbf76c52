"""The kernel's text: written once."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from axis_runs import drive

from twin import kernel
from twin.axis import STATES, Structure
from twin.effects.catalogue import BASE


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
        none = np.zeros((len(STATES), 2))
        kernel.predict_with_slopes(recording, vector, start, none, ("input_gain", "sag_reference"))
