"""A parameter over many axes of one kind: how far the axes differ, and which of them stands apart.

Each axis gives an estimate with a standard error s_i; the axes themselves scatter by tau around a centre mu. So the
estimates have the variances tau^2 + s_i^2 (random-effects model). The condition for tau is that the weighted squares
sum to their number less one (Paule and Mandel, Consensus values and weighting factors, J. Res. NBS 87, 1982).

Axes that stand apart are found with the generalised ESD test (Rosner, Percentage points for a generalized ESD
many-outlier procedure, Technometrics 25, 1983). The farthest is taken out until a quarter is gone. The last one whose
distance passes its limit is an outlier, with all those before it. So two alike do not hide one another. tau is then
that of the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import stdtrit

FloatArray = NDArray[np.float64]

#: Axes from which on one of them can be said to stand apart.
FEWEST = 5
#: Share of the axes that may stand apart.
MOST_APART = 0.25
#: Parameters are compared by their ratios where every axis' value is this many standard errors from zero.
SURELY_NOT_ZERO = 3.0


@dataclass(frozen=True)
class Population:
    """One parameter over the axes of a fleet.

    Attributes
    ----------
    axes : tuple of str
        Those whose recordings fix the parameter.
    values, stds : ndarray (n,)
        Estimates and standard errors, in the parameter's unit.
    centre : float
        Of the axes that do not stand apart, in the parameter's unit.
    spread : float
        Standard deviation between those axes, their own errors taken off: in the parameter's unit, or of its natural
        logarithm where `by_ratio`.
    by_ratio : bool
    outliers : tuple of str
        Axes that stand apart, the farthest first.
    """

    axes: tuple[str, ...]
    values: FloatArray
    stds: FloatArray
    centre: float
    spread: float
    by_ratio: bool
    outliers: tuple[str, ...] = ()

    def quantile(self, deviations: float) -> float:
        """The value so many standard deviations of the axes from the centre."""
        step = deviations * self.spread
        return self.centre * math.exp(step) if self.by_ratio else self.centre + step


def centre_and_spread(values: FloatArray, variances: FloatArray) -> tuple[float, float]:
    """Weighted mean, and variance between the axes, of estimates with these variances (n,) of their own."""

    def mean(between: float) -> float:
        return float(np.average(values, weights=1.0 / (variances + between)))

    def excess(between: float) -> float:
        return float(np.sum((values - mean(between)) ** 2 / (variances + between))) - (len(values) - 1)

    # Exact estimates have no weights without a spread.
    least = 1e-12 * max(float(np.ptp(values)) ** 2, 1e-300)
    if len(values) < 2 or excess(least) <= 0.0:
        return mean(least), 0.0
    most = float(np.sum((values - values.mean()) ** 2)) + least
    between = float(brentq(excess, least, most)) if excess(most) < 0.0 else most
    return mean(between), between


def apart(values: FloatArray, variances: FloatArray, false_alarms: float) -> list[int]:
    """Indices of the axes that stand apart, the farthest first.

    Parameters
    ----------
    values, variances : ndarray (n,)
        Estimates and their own variances.
    false_alarms : float
        Probability that any is named where none stands apart.
    """
    total = len(values)
    rest, taken, certain = list(range(total)), [], 0
    if total < FEWEST:
        return []
    for step in range(1, int(MOST_APART * total) + 1):
        mean, between = centre_and_spread(values[rest], variances[rest])
        scale = np.sqrt(np.maximum(variances[rest] + between, 1e-300))
        distance = np.abs(values[rest] - mean) / scale
        farthest = int(np.argmax(distance))
        n = len(rest)
        quantile = float(stdtrit(n - 2, 1.0 - false_alarms / (2.0 * n)))
        limit = (n - 1) * quantile / math.sqrt((n - 2 + quantile**2) * n)
        taken.append(rest.pop(farthest))
        if distance[farthest] > limit:
            certain = step
    return taken[:certain]


def population_of(
    values: Mapping[str, float], stds: Mapping[str, float], false_alarms: float, angle: bool = False
) -> Population:
    """What a fleet's estimates of one parameter say.

    Parameters
    ----------
    values, stds : mapping
        By axis: estimate and standard error, in the parameter's unit.
    false_alarms : float
        Probability that any axis is named an outlier where none stands apart.
    angle : bool
        The values are angles: never compared by their ratios.
    """
    axes = tuple(values)
    x, s = np.array([values[a] for a in axes]), np.array([stds[a] for a in axes])
    by_ratio = not angle and bool(np.all(np.abs(x) > SURELY_NOT_ZERO * s) and (np.all(x > 0.0) or np.all(x < 0.0)))
    y, variances = (np.log(np.abs(x)), (s / x) ** 2) if by_ratio else (x, s**2)
    out = apart(y, variances, false_alarms)
    kept = [i for i in range(len(axes)) if i not in out]
    mean, between = centre_and_spread(y[kept], variances[kept])
    centre = math.copysign(math.exp(mean), x[0]) if by_ratio else mean
    return Population(axes, x, s, centre, math.sqrt(between), by_ratio, tuple(axes[i] for i in out))
