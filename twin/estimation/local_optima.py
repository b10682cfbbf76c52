"""The maximum of the likelihood near given values, and the way out of local optima that missing physics has led into.

Structures are compared at one noise density. It is that of a filter with a memory of a tenth of a second, or longer
where the model is right for longer. Where the model lacks much, the likeliest density gives the filter a very short
memory. It then loses the slow part of the misfit, in which physics shows. Half as long a memory sees a sixteenth of a
constant torque, and would drop it again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from twin.estimation import filter_memory, multistart, optimizer, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem, free_parameters
from twin.model.stepper import Structure
from twin.parallel import each

#: The least memory of a filter that judges, s.
MIN_MEMORY = 0.1
#: Noise densities within this factor judge alike.
PROCESS_NOISE_TOLERANCE = 1.5


def judging_process_noise(problem: FitProblem, point: Fit) -> float:
    """The noise density at which the first round is judged."""
    return min(filter_memory.process_noise_of(problem.recordings[0], MIN_MEMORY), point.process_noise)


def refit(
    problem: FitProblem,
    structure: Structure,
    values: Mapping[str, float],
) -> Fit:
    """The maximum near these values at a noise density, with everything free that is not held."""
    structure = preparation.with_tooth_compliance(structure)
    full = preparation.complete_values(structure, values) | dict(problem.held)
    return optimizer.levenberg_marquardt(problem, structure, full, problem.free(structure), tolerance=0.2)


def best_refit(
    problem: FitProblem,
    structure: Structure,
    starts: Sequence[Mapping[str, float]],
) -> Fit:
    """The likeliest of the maxima near several values."""
    return min(each(lambda v: refit(problem, structure, v), starts), key=lambda p: p.deviance)


def held_values(point: Fit) -> dict[str, float]:
    """What could be estimated and was not free: it stays as it is."""
    return {n: point.values[n] for n in free_parameters(point.structure) if n not in point.free}


def refit_at_own_noise(problem: FitProblem, point: Fit) -> Fit:
    """The maximum at the noise density that the model asks for, now that it lacks less."""
    likeliest = optimizer.most_likely_process_noise(problem, point.structure, point.values, around=point.process_noise)
    process_noise = min(
        filter_memory.process_noise_of(problem.recordings[0], MIN_MEMORY), likeliest, point.process_noise
    )
    if 1.0 / PROCESS_NOISE_TOLERANCE < process_noise / point.process_noise < PROCESS_NOISE_TOLERANCE:
        return point
    return refit(problem.at(process_noise), point.structure, point.values)


def restart_tooth_stiffness(
    problem: FitProblem,
    structure: Structure,
    values: Mapping[str, float],
) -> Fit:
    """The maximum near these values after a new search of the teeth."""
    structure = preparation.with_tooth_compliance(structure)
    seen = multistart.excerpts(problem, structure)
    begun = multistart.best_tooth_start(seen, structure, preparation.complete_values(structure, values))
    return refit(problem, structure, begun)


def search_gap(problem: FitProblem, point: Fit) -> Fit:
    """The likeliest maximum with a gap, from a new search of gap, shares and teeth beside the other values."""
    rigid = point.structure.without("tooth_compliance").with_("backlash")
    seen = multistart.excerpts(problem, rigid)

    def looked(memory: float) -> Fit:
        rough = multistart.coarse_fit(seen, rigid, preparation.complete_values(rigid, point.values), memory)
        begin = {**point.values, **rough.values}
        return restart_tooth_stiffness(problem.at(point.process_noise), rigid, begin)

    return min(each(looked, multistart.COARSE_MEMORIES), key=lambda p: p.deviance)


def restart_gap(problem: FitProblem, point: Fit) -> Fit:
    """The point, or a better one after a new search of gap, shares and teeth.

    Physics that was missing until now may have led them to a wrong optimum, and no slope leads back.
    """
    if not point.structure.toothed:
        return point
    return min(point, search_gap(problem, point), key=lambda p: p.deviance)


def refit_through_best_noise(problem: FitProblem, point: Fit) -> Fit:
    """The point, or a better one by way of the most likely noise density, where local optima are wider."""
    likeliest = optimizer.fit_with_process_noise(
        problem.at(point.process_noise), point.structure, point.values, point.free, rounds=12
    )
    other = refit(problem.at(point.process_noise), point.structure, likeliest.values)
    return min(point, other, key=lambda p: p.deviance)


def with_longer_memory(problem: FitProblem, point: Fit) -> Fit:
    """The point, with a longer memory where the recording asks for one: the model then is right for longer."""
    process_noise = optimizer.most_likely_process_noise(
        problem, point.structure, point.values, around=point.process_noise
    )
    if process_noise > 0.8 * point.process_noise:
        return point
    found = optimizer.fit_with_process_noise(problem.at(process_noise), point.structure, point.values, point.free)
    return found if found.process_noise < point.process_noise else point
