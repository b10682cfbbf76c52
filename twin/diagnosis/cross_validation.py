"""Does an addition predict data that it was not fitted to?

Twelve knots follow slow noise and gain more than their penalty by it. Where errors are correlated, every gain looks
more certain than it is. So the values of an addition are fitted without one stretch of half a second in five. On the
left-out stretches the larger model is compared with the smaller one (Stone, Cross-validatory choice, J. R. Stat. Soc. B
36, 1974). The test is the signed-rank test (Wilcoxon, Individual comparisons by ranking methods, Biometrics Bulletin 1,
1945). It counts the stretches with a gain, weighted by the rank of the gain, so that no stretch outvotes the rest. For
what acts in a few places only, none of the largest changes may be a loss.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from twin.diagnosis import thresholds
from twin.estimation import likelihood, optimizer
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.parallel import each

FloatArray = NDArray[np.float64]


def _reading_losses(problem: FitProblem, point: Fit, scale: float) -> list[FloatArray]:
    """What each reading (N,) of each case takes from the likelihood at a scale; nothing where none is judged."""
    out = []
    for case in problem.stepped(point.structure):
        run = likelihood.innovations(case, point.structure, point.values, point.process_noise)
        loss = likelihood.huber_loss(run.error / np.sqrt(run.variance * scale))
        out.append(np.where(case.masked | ~np.isfinite(loss), 0.0, loss))
    return out


def block_gains(problem: FitProblem, smaller: Fit, larger: Fit) -> FloatArray:
    """By how much the larger model does better on each stretch (M,) that its own values were not fitted to."""
    own = tuple(n for n in larger.free if n not in smaller.free)
    stretches = [(c.drive.time / likelihood.BLOCK_LENGTH).astype(np.intp) for c in problem.recordings]
    plain = _reading_losses(problem, smaller, smaller.scale)

    def left_out(fold: int) -> list[FloatArray]:
        hidden = [
            ~c.masked & (s % thresholds.CROSS_VALIDATION_FOLDS == fold)
            for c, s in zip(problem.recordings, stretches, strict=True)
        ]
        masked = [replace(c, contact_mask=c.masked | h) for c, h in zip(problem.recordings, hidden, strict=True)]
        fitted = problem.on(masked)
        # Where names gave way to fewer there may be nothing of its own.
        found = (
            optimizer.levenberg_marquardt(fitted.at(larger.process_noise), larger.structure, larger.values, own)
            if own
            else larger
        )
        better = [a - b for a, b in zip(plain, _reading_losses(problem, found, smaller.scale), strict=True)]
        return [np.bincount(s[h], d[h])[np.unique(s[h])] for s, h, d in zip(stretches, hidden, better, strict=True)]

    return np.concatenate([g for fold in each(left_out, range(thresholds.CROSS_VALIDATION_FOLDS)) for g in fold])


def recording_gains(problem: FitProblem, smaller: Fit, larger: Fit) -> FloatArray:
    """By how much the larger model does better on each recording (M,), both through the smaller one's filter.

    A filter of its own, which trusts the better model for longer, would take its smaller errors for larger ones.
    """
    points = (smaller, replace(larger, process_noise=smaller.process_noise))
    pairs = zip(*(_reading_losses(problem, p, smaller.scale) for p in points), strict=True)
    return np.array([float(np.sum(one) - np.sum(other)) for one, other in pairs])


def gain_p_value(problem: FitProblem, smaller: Fit, larger: Fit) -> float:
    """The chance that the larger model does better on as many stretches although its addition is not real. Or the
    chance that all of the largest changes are gains, for what acts in one place only.
    """
    return p_value_of_gains(block_gains(problem, smaller, larger))


def p_value_of_gains(found: FloatArray) -> float:
    """The same of the gains (M,) themselves: twice the lesser of two chances, since there are two."""
    told = found[found != 0.0]
    if len(told) < thresholds.MIN_BLOCKS:
        return 1.0
    largest_first = told[np.argsort(-np.abs(told))]
    in_a_row = int(np.argmin([*(largest_first > 0.0), False]))
    return min(1.0, 2.0 * min(float(wilcoxon(told, alternative="greater").pvalue), 0.5**in_a_row))
