"""Which of several fitted structures a recording speaks for, and how well each fits."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from twin.likelihood import Point

FloatArray = NDArray[np.float64]

#: Deviance that a parameter must earn. More than BIC's log(N): real rigs differ from every model a little, and the
#: best of twenty candidates is not one candidate (calibrated on rigs with nothing missing, scripts/blind_trial.py).
PRICE = 15.0
#: Gain in the criterion, in units of what deviance is worth, below which nothing is said to be missing.
LEAST = 60.0
#: Deviance of a model that errs is worth this little at the least: beyond it is not the unit that grows but the mess.
LARGEST_UNIT = 20.0
#: Share of the deviance explained so far that a further effect must earn beside its price.
FRACTION = 0.04
#: Deviance that counts as one unit of log-odds times two: a model that errs a little makes likelihoods too sure.
TEMPER = 20.0


def criterion(point: Point) -> float:
    """Deviance plus the price of the parameters."""
    return point.deviance + PRICE * len(point.free)


def needed(point: Point) -> float:
    """Gain in the criterion from which on an addition that ends in this point is more than the model's own errors.

    Where innovations stay correlated, because the model errs or nobody sees the motor in its gap, each says again
    what the one before it said, and deviance counts them all (`Point.unit`).
    """
    unit = point.unit
    return LEAST * (min(max(unit, 1.0), LARGEST_UNIT) if math.isfinite(unit) else LARGEST_UNIT)


def weights(criteria: Sequence[float]) -> FloatArray:
    """Probabilities of rival structures from their criteria."""
    c = np.asarray(criteria, dtype=float)
    c = np.where(np.isfinite(c), c, np.inf)
    odds = np.exp(-(c - c.min()) / (2.0 * TEMPER))
    return np.asarray(odds / odds.sum())


def whiteness(normalised: FloatArray, lags: int = 25) -> float:
    """p-value of the Ljung-Box test that normalised innovations are white; NaN for fewer than 100 of them.

    They are averaged over blocks of a few samples first: rounding to whole counts leaves an error from stamp to
    stamp that is not noise and not physics.
    """
    z = normalised[np.isfinite(normalised)]
    if len(z) < 100:
        return math.nan
    block = max(len(z) // 3000, 1)
    z = z[: len(z) // block * block].reshape(-1, block).mean(axis=1)
    z = np.clip(z, *np.quantile(z, [0.005, 0.995]))
    z = z - z.mean()
    n = len(z)
    power = float(np.dot(z, z))
    if power <= 0.0:
        return math.nan
    correlation = np.array([np.dot(z[k:], z[:-k]) / power for k in range(1, lags + 1)])
    statistic = n * (n + 2.0) * float(np.sum(correlation**2 / (n - np.arange(1, lags + 1))))
    return float(stats.chi2.sf(statistic, lags))


def rmse(recorded: FloatArray, simulated: FloatArray) -> tuple[float, float]:
    """Root-mean-square error over what was read, and the same in percent of the recorded range."""
    error = recorded - simulated
    ok = np.isfinite(error)
    if not ok.any():
        return math.nan, math.nan
    value = float(np.sqrt(np.mean(error[ok] ** 2)))
    spread = float(np.ptp(recorded[np.isfinite(recorded)]))
    return value, 100.0 * value / spread if spread > 0.0 else math.nan
