"""Which of several fitted structures a recording supports, and how well each fits."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from twin.diagnosis import thresholds
from twin.estimation.fit import Fit

FloatArray = NDArray[np.float64]


def overdispersion(points: Sequence[Fit]) -> float:
    """What a unit of deviance is worth among rivals: to the likeliest whose slopes say something.

    Correlated innovations repeat each other, and deviance counts them all. A difference of deviance over this unit is
    then what it would be for independent ones (composite likelihood; Varin and Vidoni, Biometrika 92, 2005). Physics
    that a model lacks correlates its innovations, too, and must not count against finding it. So the unit is that of
    the likeliest model, which shows best what noise alone does. Only parameters that all models share count: a curve's
    twelve knots, each of which is seen for a while only, would outvote the rest.
    """
    shared = set(points[0].free).intersection(*(p.free for p in points))
    units = [(p.deviance, p.overdispersion_by(shared)) for p in points if not p.is_chaotic]
    certain = [(deviance, unit) for deviance, unit in units if math.isfinite(deviance) and math.isfinite(unit)]
    return max(1.0, min(certain)[1]) if certain else thresholds.WORST_OVERDISPERSION


def criterion(point: Fit, unit: float) -> float:
    """Deviance in units of what it is worth, plus the price of the parameters."""
    return point.deviance / unit + thresholds.PENALTY_PER_PARAMETER * len(point.free)


def criterion_difference(one: Fit, other: Fit) -> float:
    """By how many units the criterion of the first is better than that of the second."""
    unit = overdispersion([one, other])
    return criterion(other, unit) - criterion(one, unit)


def criterion_difference_penalised(rival: Fit, last: Fit) -> float:
    """By how many units a rival is behind the last model, in criterion and brevity.

    What one effect explains about as well as two do is more likely to be that one: each name costs what leaves two
    explanations undecided.
    """
    return criterion_difference(last, rival) + thresholds.UNDECIDED_MARGIN * (
        len(rival.structure.named) - len(last.structure.named)
    )


def gain(before: Fit, after: Fit, doubt: float = 0.0) -> float:
    """By how many units an addition makes the criterion better, were its deviance larger by `doubt`.

    A unit is worth no more than it is for the size of what was added, by the best-known of these sizes. Slow errors
    drive the slope of a slow effect, and most other parameters hardly feel them.
    """
    added = [e.screen.gain for e in after.structure.effects if e.screen and e not in before.structure.effects]
    sizes = [after.overdispersion_by([gain]) for gain in added if gain in after.free]
    unit = max(overdispersion([before, after]), min((u for u in sizes if math.isfinite(u)), default=1.0))
    return criterion(before, unit) - criterion(after, unit) - doubt / unit


def is_significant(before: Fit, after: Fit, doubt: float = 0.0) -> bool:
    """Whether an addition improves the fit significantly, even were its deviance larger by `doubt`."""
    return gain(before, after, doubt) > thresholds.MIN_GAIN


def model_probabilities(criteria: Sequence[float]) -> FloatArray:
    """Probabilities of rival structures from their criteria. The rest to one is that of none of them."""
    c = np.asarray(criteria, dtype=float)
    c = np.where(np.isfinite(c), c, np.inf)
    odds = np.exp(-(c - c.min()) / (2.0 * thresholds.TEMPERATURE))
    return np.asarray((1.0 - thresholds.PROB_NONE_OF_THESE) * odds / odds.sum())


def whiteness_p_value(normalised: FloatArray, lags: int = 25) -> float:
    """p-value of the Ljung-Box test that normalised innovations are white; NaN for fewer than 100 of them.

    They are averaged over blocks of a few samples first, because rounding to whole counts leaves an error that is
    neither noise nor physics.
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
    return float(chdtrc(lags, statistic))


def rmse(recorded: FloatArray, simulated: FloatArray) -> tuple[float, float]:
    """Root-mean-square error over what was read, and the same in percent of the recorded range."""
    error = recorded - simulated
    ok = np.isfinite(error)
    if not ok.any():
        return math.nan, math.nan
    value = float(np.sqrt(np.mean(error[ok] ** 2)))
    spread = float(np.ptp(recorded[np.isfinite(recorded)]))
    return value, 100.0 * value / spread if spread > 0.0 else math.nan
