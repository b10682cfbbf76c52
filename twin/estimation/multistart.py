"""The way to the maximum of the likelihood.

(1) Gain, friction and dead-band, with a filter of a memory of a tenth of a second. The likelihood is then nearly
quadratic in them. (2) Gap, motor's share and friction's share from a grid, because every gap crossing is a kink of the
likelihood in these. (3) Everything together, compliant teeth included. The filter's memory begins short and is
lengthened for as long as the recording supports it. Where that ends in a rough place, the same from gaps, shares and
teeth of a differential evolution. (4) The noise density that the recording asks for, and the known ridges of the
likelihood.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from twin.estimation import (
    contact_masking,
    filter_memory,
    likelihood,
    numerics,
    optimizer,
    parameter_bounds,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.initial_values import start_values
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model import equations
from twin.model.stepper import Structure
from twin.parallel import each

#: Memories of the filter while coarse values are looked for, s. A long one sees more where nothing rattles. Where a
#: light motor does, a short one is not misled by its bounces.
COARSE_MEMORIES = (0.1, 0.025)
_COARSE_GRID = {
    "backlash_gap": (0.003, 0.006, 0.009, 0.013, 0.018, 0.025, 0.035, 0.05, 0.07, 0.09),
    "motor_share": (0.12, 0.22, 0.36, 0.55),
    "friction_share": (0.4, 0.8),
}
_TOOTH_GRID = {"tooth_frequency": (60.0, 90.0, 130.0, 190.0), "tooth_damping": (0.12, 0.2, 0.35, 0.5)}
#: Differential evolution where nothing else leads to gap, shares and teeth: its bounds, the population and the
#: generations. Least ratio between the best that are fitted further, and their number.
_EVOLUTION_RANGES = {
    "backlash_gap": (0.003, 0.15), "motor_share": (0.08, 0.7), "friction_share": (0.2, 1.0),
    "tooth_frequency": (50.0, 250.0), "tooth_damping": (0.08, 0.7),
}  # fmt: skip
_POPULATION, _GENERATIONS, _MIN_RATIO_APART, _MAX_STARTS = 32, 9, 1.1, 3
#: What is looked for from afar: no slope leads to it.
MULTIMODAL = tuple(_EVOLUTION_RANGES)
#: A unit of deviance is worth so little where the motor rattles, or physics is missing.
_ROUGH_OVERDISPERSION = 1.3
#: The shortest memory of the filter from which on it is lengthened, s, and most lengthenings. Up to the last time, s,
#: it is lengthened in any case: teeth ring that long, and with a shorter memory any tooth may do well.
_SHORTEST_MEMORY, _MAX_LENGTHENINGS, _RINGING_TIME = 0.007, 12, 0.05
#: Values are looked for in this number of parts of a recording, each of this length, s. Where in its gap the motor is
#: at the start of a part is not known, so many short parts lead astray where it seldom crosses.
_EXCERPTS, _EXCERPT_LENGTH = 3, 12.0
#: Where in the gap a motor may start, and how many s of a recording at least, after motor and link have met, show it.
_CONTACT_GRID, _CONTACT_DURATION, _CONTACT_MARGIN = tuple(np.linspace(-1.0, 1.0, 9).tolist()), 3.0, 1.0
#: s, of the filter that a fit is begun anew with: it follows the model, and readings hardly lead it.
_LONG_MEMORY = 1.0
_DEAD_BANDS = ("dead_band_forward", "dead_band_reverse")
_RIDGE_FOLLOWERS = ("input_gain", "viscous_friction")
#: By which powers of the gap the shares go with it, so that the motor crosses it in the same time.
RIDGE_POWERS = {"motor_share": -1.0, "friction_share": -1.0}


def _in_axis_units(
    grid: Mapping[str, tuple[float, ...]], cases: Sequence[PreparedRecording]
) -> dict[str, tuple[float, ...]]:
    """A grid whose gaps are in the unit of these recordings, not in rad."""
    lever = cases[0].recording.lever
    return {n: tuple(lever * x for x in v) if n == "backlash_gap" else v for n, v in grid.items()}


def _grid_search(
    problem: FitProblem, structure: Structure, values: Mapping[str, float],
    grid: Mapping[str, Iterable[float]], keep: int,
) -> list[dict[str, float]]:  # fmt: skip
    """The best few points of a grid, by deviance."""
    trials = [{**values, **dict(zip(grid, point, strict=True))} for point in itertools.product(*grid.values())]
    found = likelihood.deviances(problem, structure, trials)
    return [trials[i] for i in np.argsort(found, kind="stable")[:keep]]


def coarse_fit(
    problem: FitProblem,
    structure: Structure,
    values: Mapping[str, float],
    memory: float,
) -> Fit:
    """A point near the global optimum, by steps (1) and (2), for rigid contact and a filter's memory (s)."""
    problem = problem.at(filter_memory.process_noise_of(problem.recordings[0], memory))
    rigid = structure.without("tooth_compliance")
    free = problem.free(rigid)
    core = tuple(n for n in free if n not in _COARSE_GRID)
    point = optimizer.levenberg_marquardt(problem, rigid, values, core, rounds=12, tolerance=1.0)
    grid = {n: v for n, v in _in_axis_units(_COARSE_GRID, problem.recordings).items() if n in free}
    if not grid:
        return point
    best = point
    for begin in _grid_search(problem, rigid, point.values, grid, keep=2):
        trial = optimizer.levenberg_marquardt(problem, rigid, begin, core, rounds=4, tolerance=1.0)
        trial = optimizer.levenberg_marquardt(problem, rigid, trial.values, free, rounds=15, tolerance=1.0)
        if trial.deviance < best.deviance:
            best = trial
    return best


def excerpts(problem: FitProblem, structure: Structure) -> FitProblem:
    """Parts of the recordings, spread evenly. A short one is one part. So is one whose physics depends on the time
    since its start."""
    if equations.timed(structure):
        return problem
    parts = []
    for case in problem.stepped(structure):
        end, length = float(case.recording.time[-1]), _EXCERPT_LENGTH + 0.5 * case.step
        if end <= _EXCERPTS * _EXCERPT_LENGTH:
            parts.append(case)
            continue
        # Each begins with a reading and holds at least half as many as any: some would lie in a long silence.
        read = case.drive.time[np.isfinite(case.drive.measured)]
        held = np.searchsorted(read, read + length, "right") - np.arange(len(read))
        full = read[2 * held >= held.max()]
        full = full[full <= max(end - length + case.step, full[0])]
        begins = full[np.linspace(0, len(full) - 1, _EXCERPTS).astype(int)].tolist()
        parts += [preparation.excerpt(case, structure, begin, begin + length) for begin in begins]
    return problem.on(parts)


def choose_initial_contacts(problem: FitProblem, structure: Structure, values: Mapping[str, float]) -> FitProblem:
    """Where in the gap each motor starts, by the likelihood of its first seconds."""
    if "backlash" not in structure:
        return problem
    chosen = []
    for case in problem.recordings:
        shown = 0.0 if case.start_mask is None else float(case.drive.time[case.start_mask][-1]) + _CONTACT_MARGIN
        first = preparation.excerpt(
            case, structure, 0.0, min(max(_CONTACT_DURATION, shown), float(case.recording.time[-1]))
        )
        first = replace(first, start_mask=None)
        process_noise = filter_memory.process_noise_of(first, COARSE_MEMORIES[0])
        scored = [
            (
                likelihood.evaluate(
                    FitProblem([replace(first, contact=s)], {}, process_noise), structure, values
                ).deviance,
                s,
            )
            for s in (case.contact, *_CONTACT_GRID)
        ]
        chosen.append(replace(case, contact=min(scored, key=lambda pair: pair[0])[1]))
    return problem.on(chosen)


def coarse_starts(
    recordings: Sequence[Recording], structure: Structure, held: Mapping[str, float]
) -> tuple[FitProblem, list[Fit]]:
    """The problem, and coarse points of the structure without compliant teeth; `held` parameters keep their value."""
    rigid = structure.without("tooth_compliance")
    problem = preparation.prepare_recordings(recordings, rigid, held)
    values = {**start_values(problem.recordings, rigid), **held}
    seen = excerpts(problem, rigid)
    points = each(lambda m: coarse_fit(seen, rigid, values, m), COARSE_MEMORIES)
    return choose_initial_contacts(problem, rigid, points[0].values), points


def _shortest_memory(problem: FitProblem) -> float:
    """The memory of the filter from which on it is lengthened, s."""
    shortest = (filter_memory.memory_of(c, filter_memory.largest_process_noise([c])) for c in problem.recordings)
    return max(_SHORTEST_MEMORY, *shortest)


def _fit_by_lengthening_memory(
    problem: FitProblem, structure: Structure, values: Mapping[str, float], free: tuple[str, ...]
) -> Fit:
    """The likeliest point on the way from a short to a long memory of the filter.

    A light motor bounces in its gap, and whatever moves a bounce makes a local optimum. A filter with a short memory
    does not see the bounces: its likelihood has one wide optimum over the strength of the contacts. As the memory
    grows, this optimum divides, and the fit stays in the part that it is in. Where the model is wrong, a short memory
    is the best that there is.
    """
    shortest = _shortest_memory(problem)
    points: list[Fit] = []
    for rung in range(_MAX_LENGTHENINGS):
        memory = shortest * 2.0 ** (0.5 * rung)
        process_noise = filter_memory.process_noise_of(problem.recordings[0], memory)
        points.append(
            optimizer.levenberg_marquardt(problem.at(process_noise), structure, values, free, rounds=15, tolerance=1.0)
        )
        values = points[-1].values
        if memory > _RINGING_TIME and min(p.deviance for p in points) < min(p.deviance for p in points[-2:]):
            break
    return min(points, key=lambda p: p.deviance)


def _evolved_starts(problem: FitProblem, point: Fit) -> list[dict[str, float]]:
    """Values with likely gaps, shares and teeth, far from each other, by differential evolution (Storn and Price, J.
    Global Optimization 11, 1997).

    Where a motor rattles, the slopes lead to local optima nearby. The deviance still tells what is near the truth from
    what is not, if the filter remembers for as long as teeth ring. So many values are tried, and the better ones are
    combined with each other.
    """
    ranges = _in_axis_units(_EVOLUTION_RANGES, problem.recordings)
    names = [n for n in ranges if n in point.free]
    if len(names) < 2:
        return []
    seen = excerpts(problem, point.structure)
    first, largest = seen.recordings[0], filter_memory.largest_process_noise(seen.recordings)
    memory = max(_RINGING_TIME, filter_memory.memory_of(first, largest))
    seen = seen.at(filter_memory.process_noise_of(first, memory))

    def valued(x: NDArray[np.float64]) -> dict[str, float]:
        return {**point.values, **dict(zip(names, np.exp(x).tolist(), strict=True))}

    crowd = differential_evolution(
        lambda x: np.array(likelihood.deviances(seen, point.structure, [valued(v) for v in x.T])),
        np.log([ranges[n] for n in names]),
        maxiter=_GENERATIONS,
        popsize=_POPULATION // len(names),
        init="sobol",
        rng=0,
        polish=False,
        vectorized=True,
        updating="deferred",
        tol=0.0,
    )
    chosen: list[NDArray[np.float64]] = []
    for one in crowd.population[np.argsort(crowd.population_energies)]:
        if len(chosen) < _MAX_STARTS and all(
            np.abs(one - other).max() > math.log(_MIN_RATIO_APART) for other in chosen
        ):
            chosen.append(one)
    return [valued(x) for x in chosen]


def _at_bounds(point: Fit) -> bool:
    """Whether gap, shares or teeth lie at an end of what they may be."""
    bounds = {n: parameter_bounds.bounds_of(n) for n in _EVOLUTION_RANGES if n in point.free}
    return any(point.values[n] in pair for n, pair in bounds.items())


def best_tooth_start(problem: FitProblem, structure: Structure, values: Mapping[str, float]) -> dict[str, float]:
    """The values with the likeliest teeth that the structure allows."""
    if "tooth_compliance" not in structure:
        return dict(values)
    return _grid_search(problem, structure, values, _TOOTH_GRID, keep=1)[0]


def fit_from_starts(problem: FitProblem, structure: Structure, begun: Sequence[Fit]) -> Fit:
    """The maximum of the full likelihood from coarse points, teeth included where the structure has them."""
    seen, free = excerpts(problem, structure), problem.free(structure)

    def likeliest(starts: Iterable[dict[str, float]]) -> Fit:
        return min(
            each(lambda v: _fit_by_lengthening_memory(seen, structure, v, free), starts), key=lambda p: p.deviance
        )

    best = likeliest(preparation.complete_values(structure, p.values) for p in begun)
    # Where the shortest memory is the best, physics is missing, not the right optimum.
    remembers = filter_memory.memory_of(seen.recordings[0], best.process_noise) > 1.1 * _shortest_memory(seen)
    if (
        remembers
        and (best.overdispersion > _ROUGH_OVERDISPERSION or _at_bounds(best))
        and (bred := _evolved_starts(problem, best))
    ):
        best = min(best, likeliest(bred), key=lambda p: p.deviance)
    return optimizer.fit_with_process_noise(problem.at(best.process_noise), structure, best.values, free)


def _dead_band_ridge(problem: FitProblem, point: Fit) -> list[dict[str, float]]:
    """Both sides of the dead-band moved together, gain and friction following. Along this ridge of the likelihood,
    local optima are a tenth of a percent of the input apart. A gradient stays in the first.
    """
    if not all(n in point.free for n in (*_DEAD_BANDS, *_RIDGE_FOLLOWERS)):
        return []
    d, o = ([point.free.index(n) for n in names] for names in (_DEAD_BANDS, _RIDGE_FOLLOWERS))
    follow = -numerics.least_squares_solution(point.information[np.ix_(o, o)], point.information[np.ix_(o, d)]).sum(
        axis=1
    )
    reach = 0.01 * max(float(np.max(np.abs(c.recording.input))) for c in problem.recordings)
    trials = []
    for x in np.linspace(-reach, reach, 25).tolist():
        moved = {n: max(point.values[n] + x, 0.0) for n in _DEAD_BANDS}
        moved |= {n: max(point.values[n] + f * x, 1e-9) for n, f in zip(_RIDGE_FOLLOWERS, follow.tolist(), strict=True)}
        trials.append({**point.values, **moved})
    return trials


def _gap_ridge(problem: FitProblem, point: Fit) -> list[dict[str, float]]:
    """A wider gap and a lighter motor, which takes as long to cross it and hits the link as hard. So the likelihood has
    a ridge there, and every bounce makes a local optimum across it.
    """
    moving = {"backlash_gap": 1.0, **RIDGE_POWERS}
    if not set(moving) <= set(point.free):
        return []
    trials = [
        {**point.values, **{n: point.values[n] * float(g) ** power for n, power in moving.items()}}
        for g in np.geomspace(0.5, 2.0, 25)
    ]
    return [t for t in trials if parameter_bounds.within_bounds(t)]


def _best_on_ridges(problem: FitProblem, point: Fit) -> Fit:
    """The best point that is reached from the ridges of the likelihood, which may be the same."""
    best = point
    for ridge in (_dead_band_ridge, _gap_ridge):
        trials = ridge(problem, best)
        if not trials:
            continue
        found = likelihood.deviances(problem.at(best.process_noise), best.structure, trials)
        if min(found) < best.deviance + 10.0 * best.overdispersion:
            begin = trials[int(np.argmin(found))]
            other = optimizer.levenberg_marquardt(
                problem.at(best.process_noise), best.structure, begin, best.free, rounds=8
            )
            best = min(best, other, key=lambda p: p.deviance)
    return best


def refit_with_contact_mask(problem: FitProblem, point: Fit, most: float = math.inf) -> tuple[FitProblem, Fit]:
    """The problem, judged only at contacts that the point predicts. And the maximum near the point, with the noise
    density bounded by `most`.
    """
    judged = contact_masking.with_contact_mask(problem, point)
    if all(a.contact_mask is b.contact_mask for a, b in zip(judged.recordings, problem.recordings, strict=True)):
        return problem, point
    return judged, optimizer.fit_with_process_noise(
        judged.at(point.process_noise), point.structure, point.values, point.free, most=most
    )


def leave_local_optima(problem: FitProblem, point: Fit) -> tuple[FitProblem, Fit]:
    """Leave the local optima in which a fit from the coarse values ends. They come from contacts that no model
    predicts, from the contact at the start, and from the ridges.
    """
    if optimizer.is_misspecified(problem, point):
        return problem, point
    problem, point = refit_with_contact_mask(problem, point)
    chosen = choose_initial_contacts(problem, point.structure, point.values)
    if [c.contact for c in chosen.recordings] != [c.contact for c in problem.recordings]:
        problem = chosen
        point = optimizer.levenberg_marquardt(
            problem.at(point.process_noise), point.structure, point.values, point.free, rounds=15
        )
    for _ in range(2):
        other = _best_on_ridges(problem, point)
        if other.deviance > point.deviance - point.overdispersion:
            break
        point = optimizer.fit_with_process_noise(
            problem.at(point.process_noise), point.structure, other.values, point.free
        )
    return refit_with_contact_mask(problem, point)


def begin_anew(problem: FitProblem, point: Fit, values: Mapping[str, float]) -> tuple[FitProblem, Fit]:
    """The fit once more from the other end: from coarse values, with a filter whose memory is long.

    The way to a fit lengthens a short memory for as long as that pays. Where readings scatter widely, each step of it
    may pay nothing, although a long memory is by far the likeliest. Both ends are compared by the likelihood of the
    same readings. Where the model is wrong, its optima say little about the axis, and none is looked for.
    """
    if optimizer.is_misspecified(problem, point):
        return problem, point
    far = problem.at(filter_memory.process_noise_of(problem.recordings[0], _LONG_MEMORY))
    begin = preparation.complete_values(point.structure, values)
    other = optimizer.fit_with_process_noise(far, point.structure, begin, point.free)
    if other.deviance > point.deviance - point.overdispersion:
        return problem, point
    return leave_local_optima(problem, other)
