"""Which of several fitted structures a recording speaks for, and how well each fits."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from twin.estimation.likelihood import Point

FloatArray = NDArray[np.float64]

#: What a parameter must earn, in units of what deviance is worth (`Point.unit`): a parameter too many earns one.
PRICE = 3.0
#: Gain in the criterion, in units of what is added, below which nothing is said to be missing: real rigs differ from
#: every model a little, and the best of twenty candidates is not one candidate. Where nothing is missing in
#: scripts/blind_trial.py the best candidate earned 18.5, 15.7 and 15.3 (seeds 33053 and 61091), the others less; beside
#: a true name (circuit, seed 59083) what was not there earned up to 21.6, and as many earned 10 to 22 that were there.
LEAST = 22.0
#: Chance that what passes for one of the candidates is something that none of them describes, and units that count as
#: one of log-odds times two: a model that errs a little makes likelihoods too sure. To 393 names that
#: scripts/blind_trial.py gave (61091 and 69061 from 31, on the circuit 59083 and 71069 from 156) 6, 7 and 8 are about
#: equally likely, and 10 is less so; to 250 more (69061 from 1244 and 1330, 71069 from 1459 and 1550) 5 is 20 times
#: less likely than 7. The first 90 of these alone would have it the other way round.
OTHER = 0.03
TEMPER = 7.0
#: Criteria that differ by less leave two explanations undecided: 82 % to 18 %.
UNSURE = 3.0 * TEMPER
#: By this share of what it does a law may miss what a machine does; deviance goes with the square.
LAX = 0.05
#: What a unit is worth where the slopes of all rivals have run away: as little as where a motor rattles without end.
WORST = 100.0


def worth(points: Sequence[Point]) -> float:
    """What a unit of deviance is worth among rivals: to the likeliest whose slopes say something.

    Where innovations stay correlated each says again what the one before it said, and deviance counts them all. A
    difference of deviance over this unit is then what it would be for independent ones (composite likelihood; Varin
    and Vidoni, Biometrika 92, 2005). What is missing from a model correlates its innovations, too, and must not speak
    against itself: the likeliest shows best what noise alone does; by the parameters that all have, since a curve's
    twelve knots, each of which is seen for a while only, would outvote the rest.
    """
    shared = set(points[0].free).intersection(*(p.free for p in points))
    units = [(p.deviance, p.unit_by(shared)) for p in points if not p.chaotic]
    certain = [(deviance, unit) for deviance, unit in units if math.isfinite(deviance) and math.isfinite(unit)]
    return max(1.0, min(certain)[1]) if certain else WORST


def criterion(point: Point, unit: float) -> float:
    """Deviance in units of what it is worth, plus the price of the parameters."""
    return point.deviance / unit + PRICE * len(point.free)


def ahead(one: Point, other: Point) -> float:
    """By how many units the criterion of the first is better than that of the second."""
    unit = worth([one, other])
    return criterion(other, unit) - criterion(one, unit)


def behind(rival: Point, last: Point) -> float:
    """By how many units a rival is behind the last model, in criterion and brevity.

    What one effect explains about as well as two do is more likely to be that one: each name costs what leaves two
    explanations undecided.
    """
    return ahead(last, rival) + UNSURE * (len(rival.structure.named) - len(last.structure.named))


def earned(before: Point, after: Point, doubt: float = 0.0) -> float:
    """By how many units an addition makes the criterion better, were its deviance larger by `doubt`.

    A unit is worth no more than it is to the size of what was added, by whichever is known best: the slope of a slow
    effect is led by slow errors, which most other parameters hardly feel.
    """
    added = [e.screen.gain for e in after.structure.effects if e.screen and e not in before.structure.effects]
    sizes = [after.unit_by([gain]) for gain in added if gain in after.free]
    unit = max(worth([before, after]), min((u for u in sizes if math.isfinite(u)), default=1.0))
    return criterion(before, unit) - criterion(after, unit) - doubt / unit


def earns(before: Point, after: Point, doubt: float = 0.0) -> bool:
    """Whether an addition earns its place, even were its deviance larger by `doubt`."""
    return earned(before, after, doubt) > LEAST


def weights(criteria: Sequence[float]) -> FloatArray:
    """Probabilities of rival structures from their criteria; what is short of one is left to what is none of them."""
    c = np.asarray(criteria, dtype=float)
    c = np.where(np.isfinite(c), c, np.inf)
    odds = np.exp(-(c - c.min()) / (2.0 * TEMPER))
    return np.asarray((1.0 - OTHER) * odds / odds.sum())


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
