"""The maximum of the likelihood: over the parameters by Levenberg-Marquardt, and over the process noise by a search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.effects.catalogue import EFFECTS
from twin.effects.phases import polar
from twin.estimation import filter_memory, likelihood, numerics, parameter_bounds
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model.stepper import Structure
from twin.parallel import each

FloatArray = NDArray[np.float64]

#: A unit of deviance worth so little says that the model errs.
OVERDISPERSION_OF_WRONG_MODEL = 5.0
#: Far from the maximum that worth says nothing: a climb ends at so many times its tolerance at most.
MAX_OVERDISPERSION = 10.0
#: So many steps in a row that bring nothing, each much shorter than the one before, end a climb.
MAX_REFUSED_STEPS = 4
#: Share of a bound within which a value is at it.
_AT_BOUND = 1e-6
#: Sizes of what goes with the sine of an angle, and the angle's parameter. None of these laws differs between a size
#: below zero and the same above it, half a turn on.
_ANGLE_OF = {
    screen.gain: screen.phase
    for screen in (effect.screen for effect in EFFECTS.values())
    if screen is not None and screen.combine is polar and screen.phase is not None
}


def _with_resisting_friction(values: dict[str, float], free: Sequence[str]) -> dict[str, float]:
    """The values where dry friction resists both ways. Friction that would push is none, so that beyond there values
    differ which say the same, and none of them is known.
    """
    lean, dry = values.get("friction_asymmetry", 0.0), values.get("coulomb_friction", 0.0)
    beyond = abs(lean) - dry
    if beyond <= 0.0 or "friction_asymmetry" not in free:
        return values
    size = dry + 0.5 * beyond if "coulomb_friction" in free else dry
    return {**values, "coulomb_friction": size, "friction_asymmetry": math.copysign(size, lean)}


def _half_a_turn_on(values: dict[str, float]) -> dict[str, float]:
    """The same values where no size that has an angle is below zero."""
    turned = {
        name: change
        for gain, angle in _ANGLE_OF.items()
        if values.get(gain, 0.0) < 0.0
        for name, change in ((gain, -values[gain]), (angle, math.remainder(values[angle] + math.pi, 2.0 * math.pi)))
    }
    return {**values, **turned}


def _damped_step(point: Fit, damping: float) -> dict[str, float]:
    """The values after one damped Gauss-Newton step, the best one within the bounds; a size with an angle may be below
    zero.
    """
    here = np.array([point.values[n] for n in point.free])
    low, high = np.array([parameter_bounds.BOUNDS[n] for n in point.free]).T
    # At zero such a size has no edge: on the other side the angle is another.
    low = np.array([-h if _ANGLE_OF.get(n) in point.free else b for n, b, h in zip(point.free, low, high, strict=True)])
    least, most = low - here, high - here
    size = np.sqrt(np.maximum(np.diag(point.information), 1e-300))
    scaled = point.information / np.outer(size, size)
    scaled[np.diag_indices_from(scaled)] += damping + numerics.EIGENVALUE_FLOOR
    step, inside = np.zeros(len(here)), point.visible.copy()
    while inside.any():
        pull = point.gradient / size - scaled @ np.where(inside, 0.0, step * size)
        step[inside] = numerics.least_squares_solution(scaled[np.ix_(inside, inside)], pull[inside]) / size[inside]
        beyond = np.where(inside, np.maximum(least - step, step - most) * size, 0.0)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 0.0:
            break
        # What would leave its bounds farthest ends there, and the others make the best of it.
        step[worst] = least[worst] if step[worst] < least[worst] else most[worst]
        inside[worst] = False
    moved = np.clip(here + step, low, high)
    for bound in (low, high):
        # What is nearer than this is at its bound, and is called so: a climb gets ever closer without reaching it.
        moved = np.where(np.isclose(moved, bound, rtol=_AT_BOUND, atol=0.0), bound, moved)
    return _with_resisting_friction({**point.values, **dict(zip(point.free, moved.tolist(), strict=True))}, point.free)


def levenberg_marquardt(
    problem: FitProblem,
    structure: Structure,
    values: Mapping[str, float],
    free: tuple[str, ...],
    rounds: int = 30,
    tolerance: float = 0.05,
) -> Fit:
    """Maximise the likelihood over the free parameters at a fixed noise density (Levenberg-Marquardt).

    Stops when a step promises, or has brought, less than `tolerance` of what a unit of deviance is worth there.
    """
    return levenberg_marquardt_from(problem, likelihood.evaluate(problem, structure, values, free), rounds, tolerance)


def levenberg_marquardt_from(problem: FitProblem, best: Fit, rounds: int, tolerance: float) -> Fit:
    """From a point that is known already."""
    damping, refused, wary = 1e-3, 0, False
    for _ in range(rounds):
        if not math.isfinite(best.deviance):
            return replace(best, converged=False, message="the start lies where the model cannot run")
        enough = tolerance * min(best.overdispersion, MAX_OVERDISPERSION)
        trial_values = _damped_step(best, damping)
        change = np.array([trial_values[n] - best.values[n] for n in best.free])
        promised = float(2.0 * best.gradient @ change - change @ best.information @ change)
        if promised < enough:
            return best
        trial_values = _half_a_turn_on(trial_values)
        # Where one step was refused half of the others are, too: these are looked at without their slopes first.
        trial = likelihood.evaluate(
            problem.at(best.process_noise), best.structure, trial_values, () if wary else best.free
        )
        gained = best.deviance - trial.deviance
        if gained > 0.0:
            best = (
                likelihood.evaluate(problem.at(best.process_noise), best.structure, trial_values, best.free)
                if wary
                else trial
            )
            refused = 0
            damping = max(damping * (0.1 if gained > 0.5 * promised else 0.5), 1e-9)
            if gained < enough:
                return best
        else:
            refused, wary = refused + 1, True
            if refused == MAX_REFUSED_STEPS:
                return replace(best, message="steps along the slope lead no higher: the likelihood is rough here")
            damping = max(damping * 10.0, 0.03)
    return replace(best, converged=False, message="the search ran out of rounds")


def is_misspecified(problem: FitProblem, point: Fit) -> bool:
    """Whether the model misses so much that the filter's memory is the shortest allowed and errors are still
    correlated.

    Such a likelihood is rough, and which of its many local optima is the best says little about the axis.
    """
    return (
        point.overdispersion > OVERDISPERSION_OF_WRONG_MODEL
        and point.process_noise > 0.5 * filter_memory.largest_process_noise(problem.recordings)
    )


def most_likely_process_noise(
    problem: FitProblem, structure: Structure, values: Mapping[str, float], around: float | None = None
) -> float:
    """The noise density that makes the recordings likeliest at fixed parameters, up to that of the shortest memory.

    `around` a density that is known already it is looked for within a factor of three hundred.
    """
    top = math.log10(filter_memory.largest_process_noise(problem.recordings))

    def looked(exponents: Sequence[float]) -> list[float]:
        return each(lambda d: likelihood.evaluate(problem.at(10.0**d), structure, values).deviance, exponents)

    if around is None:
        # Readings that are rounded and held have a second local optimum, where the filter follows the last reading
        # alone.
        grid = [top - d for d in range(0, 9)]
        begin = grid[int(np.argmin(looked(grid)))]
    else:
        begin = math.log10(around)
    middle, low, high = min(begin, top), min(begin, top) - 2.5, min(begin + 2.5, top)
    for _ in range(5):
        below, here, above = looked([middle - 0.4, middle, middle + 0.4])
        bend = below - 2.0 * here + above
        step = 0.2 * (below - above) / bend if bend > 0.0 else math.copysign(1.0, below - above)
        found = min(max(middle + min(max(step, -1.0), 1.0), low), high)
        if abs(found - middle) < 0.3:
            return float(10.0**found)
        middle = found
    return float(10.0**middle)


def fit_with_process_noise(
    problem: FitProblem,
    structure: Structure,
    values: Mapping[str, float],
    free: tuple[str, ...],
    rounds: int = 15,
    most: float = math.inf,
) -> Fit:
    """Maximum likelihood over the free parameters and the noise density, alternating until neither moves; the density
    stays at most so much. It begins with that of the problem, or is searched where that is zero.

    Until the density is settled the parameters only have to be about right.
    """
    current = problem.process_noise or most_likely_process_noise(problem, structure, values)
    point = levenberg_marquardt(problem.at(current), structure, values, free, min(rounds, 5), tolerance=1.0)
    for _ in range(6):
        found = min(most_likely_process_noise(problem, structure, point.values, around=current), most)
        if abs(math.log10(found / current)) < 0.1:
            break
        current = found
        point = levenberg_marquardt(problem.at(current), structure, point.values, free, min(rounds, 5), tolerance=1.0)
    return levenberg_marquardt_from(problem, point, rounds, 0.05)
