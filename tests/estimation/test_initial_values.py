"""Where the search starts: slopes of local polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import savgol_filter

from twin.estimation.initial_values import local_slope


@pytest.mark.parametrize("rank", range(3))
@pytest.mark.parametrize("count, width, order", [(500, 51, 3), (51, 51, 3), (7, 5, 3), (5, 3, 2), (3, 3, 2)])
def test_slopes_are_those_of_another_hand_up_to_the_ends(count: int, width: int, order: int, rank: int) -> None:
    values = np.cumsum(np.random.default_rng(count).standard_normal(count))
    expected = savgol_filter(values, width, order, deriv=rank, delta=0.002)
    assert local_slope(values, width, order, rank, 0.002) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_a_cubic_is_its_own_polynomial() -> None:
    t = 0.01 * np.arange(80)
    assert local_slope(1.0 - t**2 + 2.0 * t**3, 11, 3, 1, 0.01) == pytest.approx(-2.0 * t + 6.0 * t**2, abs=1e-9)
