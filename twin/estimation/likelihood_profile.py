"""Intervals from the profile of the likelihood, for parameters whose likelihood is no parabola."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twin.estimation import numerics, optimizer, parameter_bounds
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem

FloatArray = NDArray[np.float64]

#: Deviance at the ends of a 95 % interval of one parameter.
_CHI2_95 = 3.841
#: Most moves of an end of such an interval, and most steps in which all other parameters follow it there. Where gap and
#: motor's share make up for each other, fewer steps end beside the ridge, and the interval is too short.
PROFILE_PASSES, PROFILE_STEPS = 4, 8
#: A ridge of powers is followed by so large a factor at most: beyond, the others are at their bounds.
MAX_RATIO = 1e3


def _shifted_along_slope(point: Fit, name: str, value: float) -> dict[str, float]:
    """The values with a free parameter at this one, and the others where the information says that they follow it."""
    i = point.free.index(name)
    rest = [k for k in range(len(point.free)) if k != i]
    slope = -numerics.least_squares_solution(point.information[np.ix_(rest, rest)], point.information[rest, i])
    change = {point.free[k]: (value - point.values[name]) * f for k, f in zip(rest, slope.tolist(), strict=True)}
    return {
        **point.values,
        **parameter_bounds.clipped_to_bounds({n: point.values[n] + c for n, c in change.items()}),
        name: value,
    }


def _shifted_by_powers(point: Fit, name: str, value: float, powers: Mapping[str, float]) -> dict[str, float]:
    """The same where others go with powers of it, which is above 0 at the point."""
    ratio = min(max(value / point.values[name], 1.0 / MAX_RATIO), MAX_RATIO)
    moved = {n: point.values[n] * ratio**power for n, power in powers.items() if n in point.free}
    return {**point.values, **parameter_bounds.clipped_to_bounds(moved), name: value}


def profile_interval(
    problem: FitProblem, point: Fit, name: str, std: float, powers: Mapping[str, float]
) -> tuple[float, float]:
    """95 % interval of a free parameter from the profile of the likelihood, all others refitted.

    This is for bounded and kinked parameters, whose likelihood is no parabola. On either side the profile is evaluated
    where the parabola of the standard error `std` would end. The end is then moved to where the profile says. Where a
    unit of deviance is worth so little that a profile would only show how the model errs, the parabola has to do.

    `powers` says how others go with the parameter along a ridge of the likelihood. Bounces of a light motor make local
    optima across it. Beyond the end that a profile finds, others may be as likely: the interval holds these, too.
    """
    if not math.isfinite(std):
        return parameter_bounds.BOUNDS[name]  # it leaves no trace, and may be anything
    here = point.values[name]
    others = tuple(n for n in point.free if n != name)
    i = point.free.index(name)
    plain = math.sqrt(max(float(point.covariance[i, i]), 1e-300))
    wanted = _CHI2_95 * (std / plain) ** 2
    passes = PROFILE_PASSES if point.overdispersion < optimizer.OVERDISPERSION_OF_WRONG_MODEL else 0

    def likeliest(near: Fit, value: float, free: tuple[str, ...]) -> Fit:
        begun = [_shifted_along_slope(near, name, value)] + (
            [_shifted_by_powers(near, name, value, powers)] if powers and near.values[name] > 0.0 else []
        )
        reached = [
            optimizer.levenberg_marquardt(problem.at(point.process_noise), point.structure, begin, free, PROFILE_STEPS)
            for begin in begun
        ]
        return min(reached, key=lambda p: p.deviance)

    ends = []
    for bound, sign in zip(parameter_bounds.BOUNDS[name], (-1.0, 1.0), strict=True):
        room = sign * (bound - here)
        reach = min(1.96 * std, room)
        for _ in range(passes):
            if reach <= 0.0:
                break
            rise = likeliest(point, here + sign * reach, others).deviance - point.deviance
            factor = math.sqrt(wanted / rise) if rise > 0.0 else 2.0
            reach = min(reach * min(max(factor, 0.4), 2.0), room)
            if 0.7 < factor < 1.4:
                break
        valley, held = point, reach
        for _ in range(passes if powers else 0):
            valley = likeliest(valley, here + sign * min(held + 0.5 * reach, room), point.free)
            found = sign * (valley.values[name] - here)
            if valley.deviance - point.deviance > wanted or found <= held:
                break
            held = found
        ends.append(here + sign * max(held, 0.0))
    return ends[0], ends[1]
