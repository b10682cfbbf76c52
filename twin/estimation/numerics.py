"""Linear algebra where parameters may leave no trace."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Information along a direction, over that of its parameters each by itself, below which nothing determines it. Slopes
#: are rounded to seven digits, which leaves 1e-13 where there is none.
EIGENVALUE_FLOOR = 1e-10


@contextmanager
def ignore_overflow() -> Iterator[None]:
    """For values so wild that the model overflows, and parameters that leave no trace and so have no end of variance.

    Both are looked for in what comes out, and no news. Every thread has to be told anew.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        yield


def without_what_is_lost(covariance: FloatArray) -> FloatArray:
    """The covariance (n, n) in which a variance that is not finite is infinite, and none with others."""
    found = covariance.copy()
    lost = ~np.isfinite(np.diag(found))
    found[lost, :] = found[:, lost] = 0.0
    found[lost, lost] = np.inf
    return found


def least_squares_solution(a: FloatArray, b: FloatArray) -> FloatArray:
    """The smallest solution of a x = b, which is there also where a parameter leaves no trace and a is singular.

    Infinite where a or b is not finite: nothing is known of it.
    """
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
        return np.full(a.shape[1:] + b.shape[1:], np.inf)
    return np.asarray(np.linalg.lstsq(a, b, rcond=EIGENVALUE_FLOOR)[0])


def bounded_solution(a: FloatArray, b: FloatArray, bounds: FloatArray) -> FloatArray:
    """The solution (n,) of a x = b that keeps to bounds (2, n): what would leave them is held there, for the others.

    Infinite where a or b is not finite.
    """
    held = np.zeros(b.size, dtype=bool)
    found = least_squares_solution(a, b)
    while np.all(np.isfinite(found)):
        beyond = ~held & ((found < bounds[0]) | (found > bounds[1]))
        if not beyond.any():
            break
        held |= beyond
        at_bound = np.where(held, np.clip(found, *bounds), 0.0)
        rest = b - a @ at_bound
        found = at_bound
        found[~held] = least_squares_solution(a[np.ix_(~held, ~held)], rest[~held])
    return found
