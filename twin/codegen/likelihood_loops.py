"""The loops over the predictions of a run: errors, their scale under Huber's loss, and what each says of the
parameters.

Written as those of `kalman_loops`, and compiled with them. In numpy each line is an array of its own, and all of them
took a twelfth of the time of an evaluation.
"""

# mypy: ignore-errors
# ruff: noqa: F821

from __future__ import annotations

import numpy as np


def judging(measured, left_out, rounding, unit, reading, spread):
    """Make of what a run foresaw its errors, in place.

    `reading` (N,) becomes what was `measured` less it, and less what `rounding` may have taken; NaN where `left_out`.
    `spread` (N,), in units of a reading's variance, becomes a variance.
    """
    for i in range(len(reading)):
        error = measured[i] - reading[i]
        if left_out[i]:
            error = np.nan
        if error > rounding[i]:
            error = error - rounding[i]
        elif error < -rounding[i]:
            error = error + rounding[i]
        else:
            error = 0.0 * error
        reading[i] = error
        spread[i] = unit * spread[i]


def normalising(error, variance, squares):
    """Put the squares of what was read, over their variances, into `squares`; how many, and the sum of the logarithms
    of their variances.
    """
    count = 0
    logs = 0.0
    for i in range(len(error)):
        if np.isfinite(error[i]):
            squares[count] = error[i] * error[i] / variance[i]
            logs += log(variance[i])
            count += 1
    return count, logs


def scaling(squares, limit):
    """The scale of squared normalised innovations under Huber's loss, and that loss; infinite where one is not finite.

    The scale solves scale = mean of min(z^2, limit sqrt(scale) z), whose right side is concave. From the mean, which
    lies above, Newton's steps go down to it and never beyond.
    """
    mean = 0.0
    for z2 in squares:
        mean += z2
    mean = mean / len(squares)
    if not np.isfinite(mean):
        return np.inf, np.inf
    scale = max(mean, 1e-30)
    for _ in range(100):
        near = 0.0
        far = 0.0
        for z2 in squares:
            if z2 > limit * limit * scale:
                far += sqrt(z2)
            else:
                near += z2
        far = limit * far * sqrt(scale)
        step = (scale - (near + far) / len(squares)) / (1.0 - 0.5 * far / scale / len(squares))
        scale = max(scale - step, 1e-30)
        if not step > 1e-12 * scale:
            break
    loss = 0.0
    for z2 in squares:
        z2 = z2 / scale
        if z2 > limit * limit:
            loss += limit * (2.0 * sqrt(z2) - limit)
        else:
            loss += z2
    return scale, loss


def gathering(error, variance, limit, stretch, slopes, pulls, weights, read):
    """Add the contribution of each reading to that of its stretch. The slope of the log-likelihood goes to `pulls` (M,
    n), the lower triangle of the information to `weights` (M, n, n), and one to `read` (M,).

    `error`, its `variance` and its `stretch` are (N,), `slopes` (N, n); what is not finite is no reading. Beyond
    `limit` standard deviations a reading has the weight of Huber's loss.
    """
    n = slopes.shape[1]
    slope = np.empty(n)
    for i in range(len(error)):
        if error[i] != error[i]:
            continue
        weight = 1.0 / variance[i]
        far = abs(error[i]) * sqrt(weight)
        if far > limit:
            weight = weight * limit / far
        at = stretch[i]
        read[at] += 1
        for a in range(n):
            slope[a] = slopes[i, a]
        for a in range(n):
            weighted = weight * slope[a]
            pulls[at, a] += weighted * error[i]
            for b in range(a + 1):
                weights[at, a, b] += weighted * slope[b]
