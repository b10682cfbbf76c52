"""Where the search starts: slopes of local polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import savgol_filter

from twin.effects.catalogue import BASE
from twin.estimation import prepared_recording
from twin.estimation.initial_values import local_slope
from twin.io.recording import Recording
from twin.model.stepper import Structure


@pytest.mark.parametrize("rank", range(3))
@pytest.mark.parametrize("count, width, order", [(500, 51, 3), (51, 51, 3), (7, 5, 3), (5, 3, 2), (3, 3, 2)])
def test_slopes_are_those_of_another_hand_up_to_the_ends(count: int, width: int, order: int, rank: int) -> None:
    values = np.cumsum(np.random.default_rng(count).standard_normal(count))
    expected = savgol_filter(values, width, order, deriv=rank, delta=0.002)
    assert local_slope(values, width, order, rank, 0.002) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_a_cubic_is_its_own_polynomial() -> None:
    t = 0.01 * np.arange(80)
    assert local_slope(1.0 - t**2 + 2.0 * t**3, 11, 3, 1, 0.01) == pytest.approx(-2.0 * t + 6.0 * t**2, abs=1e-9)


def test_a_column_of_a_table_runs_the_kernel_that_is_there() -> None:
    """For numbers that lie apart in memory the kernel would be compiled a second time, for a minute."""
    table = np.column_stack([0.002 * np.arange(500), np.sign(np.sin(np.arange(500) / 40.0)), np.arange(500) / 500.0])
    columns = Recording("table", table[:, 0], 30.0 * table[:, 1], table[:, 2], "%", "rad", 1e-4)
    drive = prepared_recording.prepare_recording(columns, Structure.of(BASE)).drive
    assert not columns.output.flags.c_contiguous
    assert all(a.flags.c_contiguous for a in (drive.time, drive.command, drive.measured))
