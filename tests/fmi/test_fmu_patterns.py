"""Whatever steps an importer takes: any FMU follows the kernel's finest grid, also after a detour and back."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from native_axis import EVERYTHING, NAMES, PERIOD, RIGID, by_kernel, command, model_of

from twin.fmi import python_fmu
from twin.fmi.fmu_archive import open_fmu
from twin.fmi.fmu_instance import Running, running
from twin.model.stepper import Structure

#: The FMI version of the native ones.
KINDS = {"python": None, "native 2": 2, "native 3": 3}
#: All effects are on in one of the two.
AXES = {"rigid": RIGID, "elastic": EVERYTHING}
SECONDS = 4.0
#: Between two internal steps, and exact in binary as they are: the motion amplifies rounding.
CHANGE = 1.25 + 2.0**-13


@pytest.fixture(scope="module", params=list(itertools.product(AXES, KINDS)), ids=" ".join)
def started(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    native_fmu_of: Callable[[Structure, int], Path],
) -> Iterator[tuple[str, Running]]:
    axis, kind = request.param
    out = tmp_path_factory.mktemp("patterns") / "axis.fmu"
    model, fmi = model_of(AXES[axis], load_time=CHANGE), KINDS[kind]
    if fmi is None:
        python_fmu.export(model, out)
    else:
        python_fmu.update(native_fmu_of(AXES[axis], fmi), model, out)
    with running(open_fmu(out), ["duty"], NAMES) as instance:
        yield axis, instance


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=30), st.integers(0, 100), st.integers(1, 9))
@example([1], 50, 3)
@example([40], 10, 9)
def test_any_steps_and_any_detour(started: tuple[str, Running], lengths: list[int], leave: int, astray: int) -> None:
    """Steps of `lengths` internal ones, over and over; `astray` of them are taken from step `leave` and taken back."""
    axis, instance = started
    structure = AXES[axis]
    finer = structure.substeps
    inner = PERIOD / finer
    count = int(SECONDS / inner)
    starts = [0, *itertools.takewhile(lambda n: n < count - 40, itertools.accumulate(itertools.cycle(lengths)))]
    finest = np.repeat(command(count // finer + 1), finer)
    u = np.repeat(finest[starts[:-1]], np.diff(starts))
    expected = by_kernel(model_of(structure, load_time=CHANGE), np.append(u, 0.0), 0.4, -0.2, inner)[starts]
    instance._slave.reset()
    instance.start({"position_start": 0.4, "velocity_start": -0.2})
    rows = [list(instance.read())]
    for i, (at, until) in enumerate(itertools.pairwise(starts)):
        if i == leave:
            state = instance._slave.getFMUState()
            for j in range(astray):
                instance.step((at + 7 * j) * inner, 7 * inner, [-90.0])
            instance._slave.setFMUState(state)
            instance._slave.freeFMUState(state)
        rows.append(list(instance.step(at * inner, (until - at) * inner, [u[at]])))
    span = np.maximum(np.ptp(expected, axis=0), 1e-3)
    assert np.max(np.abs(np.array(rows) - expected) / span) < 1e-10
