"""The supply as it was, from a supply as it was read: readings that scatter would shake the command."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def without_reading_noise(supply: FloatArray) -> FloatArray:
    """The supply without the noise of its readings.

    A level that goes at random by a variance q from row to row is read with a variance r (local level model; Harvey,
    Forecasting, Structural Time Series Models and the Kalman Filter, 1989, ch. 4.1). Neighbouring steps of the readings
    then have a covariance of -r, and each step a variance of q + 2 r. The best estimate weighs a reading k rows away by
    decay^k, on both sides alike. A supply that sags with the load has a large q, and stays as it is; one that only
    scatters becomes its mean.

    Parameters
    ----------
    supply
        Readings (N,), V, NaN where there is none.

    Returns
    -------
    FloatArray
        The level (N,), V, NaN where nothing was read.
    """
    from scipy.signal import lfilter  # slow to import, and only a logged supply needs it

    read = np.isfinite(supply)
    step = np.diff(supply[read])
    if step.size < 2:
        return supply
    noise = -float(np.mean(step[1:] * step[:-1]))
    if noise <= 0.0:
        return supply
    ratio = max(float(np.mean(step**2)) / noise - 2.0, 0.0)  # q over r
    decay = 1.0 + 0.5 * ratio - math.sqrt(ratio + 0.25 * ratio**2)

    def gathered(values: FloatArray) -> FloatArray:
        before = lfilter([1.0], [1.0, -decay], values)
        after = lfilter([1.0], [1.0, -decay], values[::-1])[::-1]
        return np.asarray(before + after - values)

    level = gathered(np.where(read, supply, 0.0)) / gathered(read.astype(np.float64))
    return np.where(read, level, np.nan)
