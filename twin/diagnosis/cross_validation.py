"""Does an addition foretell what it was not fitted to?

Twelve knots follow slow noise and earn their price by it, and where errors hang together every gain looks surer than it
is. So the values of an addition are fitted without one stretch of half a second in five, and on what was left out the
larger model is held against the smaller one (Stone, Cross-validatory choice, J. R. Stat. Soc. B 36, 1974). What counts
is on how many stretches it does better, the more the better it does there, but no stretch outvotes the rest (Wilcoxon,
Individual comparisons by ranking methods, Biometrics Bulletin 1, 1945); or, of what acts in a few places only, whether
none of the largest changes is a loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from twin.estimation import likelihood, preparation
from twin.estimation.likelihood import Case, Point
from twin.parallel import each

FloatArray = NDArray[np.float64]

#: Of so many stretches one is left out: all states of motion remain in the others.
FOLDS = 5
#: What happens less often by chance is no chance.
SURE = 0.005
#: What would happen more often than this by chance speaks for nothing: six largest changes in a row are gains more
#: often. In scripts/blind_trial.py names that were there came to as much once in 72 (seeds 93 and 9407; 69061 from 790,
#: 71069 from 961), 27 of the last 29 to a thousandth of it. Loads, ripples and encoders off centre that were not
#: came to 0.03, 0.09, 0.15, 0.25 and 0.4.
IDLE = 0.03
#: By less chance a name foretells plainly. An encoder off centre that stood for a gain which varies over a turn, and
#: left nearly nothing of the missing torque (MuJoCo, 69061:813), came to 0.0007.
PLAIN = 1e-4
#: On fewer stretches nothing can be told.
LEAST = 10


def _losses(cases: Sequence[Case], point: Point, scale: float) -> list[FloatArray]:
    """What each reading (N,) of each case takes from the likelihood at a scale; nothing where none is judged."""
    out = []
    for case in preparation.with_steps(cases, point.structure):
        run = likelihood.innovations(case, point.structure, point.values, point.density)
        loss = likelihood.robust_loss(run.error / np.sqrt(run.variance * scale))
        out.append(np.where(case.passed_over | ~np.isfinite(loss), 0.0, loss))
    return out


def gains(cases: Sequence[Case], smaller: Point, larger: Point) -> FloatArray:
    """By how much the larger model does better on each stretch (M,) that its own values were not fitted to."""
    own = tuple(n for n in larger.free if n not in smaller.free)
    stretches = [(c.drive.time / likelihood.STRETCH).astype(np.intp) for c in cases]
    plain = _losses(cases, smaller, smaller.scale)

    def left_out(fold: int) -> list[FloatArray]:
        hidden = [~c.passed_over & (s % FOLDS == fold) for c, s in zip(cases, stretches, strict=True)]
        fitted = [replace(c, unforeseen=c.passed_over | h) for c, h in zip(cases, hidden, strict=True)]
        mine = preparation.with_steps(fitted, larger.structure)
        # Where names gave way to fewer there may be nothing of its own.
        found = likelihood.climb(mine, larger.structure, larger.values, larger.density, own) if own else larger
        better = [a - b for a, b in zip(plain, _losses(cases, found, smaller.scale), strict=True)]
        return [np.bincount(s[h], d[h])[np.unique(s[h])] for s, h, d in zip(stretches, hidden, better, strict=True)]

    return np.concatenate([g for fold in each(left_out, range(FOLDS)) for g in fold])


def chance(cases: Sequence[Case], smaller: Point, larger: Point) -> float:
    """The chance that the larger model would do better on as many stretches, were there nothing to what it adds; or
    that all of the largest changes would be gains, as where it acts in one place only.
    """
    return by_chance(gains(cases, smaller, larger))


def by_chance(found: FloatArray) -> float:
    """The same of the gains (M,) themselves: twice the lesser of two chances, since there are two."""
    told = found[found != 0.0]
    if len(told) < LEAST:
        return 1.0
    largest_first = told[np.argsort(-np.abs(told))]
    in_a_row = int(np.argmin([*(largest_first > 0.0), False]))
    return min(1.0, 2.0 * min(float(wilcoxon(told, alternative="greater").pvalue), 0.5**in_a_row))
