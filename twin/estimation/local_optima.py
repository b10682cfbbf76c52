"""To the maximum of the likelihood near given values, and out of the valleys that what was missing has led into.

Structures compete at one noise density: that of a filter which remembers a tenth of a second, or for longer where the
model is right for longer. Where it lacks much the likeliest density believes little but the last readings, and so
forgets the slow part of the misfit, in which physics shows: half as long a memory knows a sixteenth of a constant
torque, and would drop it again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from twin.estimation import likelihood, multistart, preparation
from twin.estimation.likelihood import Case, Point
from twin.model.stepper import Structure
from twin.parallel import each

#: The least memory of a filter that judges, s.
MEMORY = 0.1
#: Noise densities within this factor judge alike.
ALIKE = 1.5


def judged(cases: Sequence[Case], point: Point) -> float:
    """The noise density at which the first round is judged."""
    return min(likelihood.density_of(cases[0], MEMORY), point.density)


def settle(
    cases: Sequence[Case], structure: Structure, values: Mapping[str, float], held: Mapping[str, float], density: float
) -> Point:
    """The maximum near these values at a noise density, with everything free that is not held."""
    structure = preparation.with_teeth(structure)
    mine = preparation.with_steps(cases, structure)
    free = tuple(n for n in preparation.free_parameters(structure) if n not in held)
    full = preparation.completed(structure, values) | dict(held)
    return likelihood.climb(mine, structure, full, density, free, tolerance=0.2)


def highest(
    cases: Sequence[Case], structure: Structure, starts: Sequence[Mapping[str, float]], held: Mapping[str, float],
    density: float,
) -> Point:  # fmt: skip
    """The likeliest of the maxima near several values."""
    return min(each(lambda v: settle(cases, structure, v, held, density), starts), key=lambda p: p.deviance)


def kept(point: Point) -> dict[str, float]:
    """What could be estimated and was not free: it stays as it is."""
    return {n: point.values[n] for n in preparation.free_parameters(point.structure) if n not in point.free}


def rejudged(cases: Sequence[Case], point: Point, held: Mapping[str, float]) -> Point:
    """The maximum at the noise density that the model asks for, now that it lacks less."""
    mine = preparation.with_steps(cases, point.structure)
    likeliest = likelihood.best_density(mine, point.structure, point.values, around=point.density)
    density = min(likelihood.density_of(cases[0], MEMORY), likeliest, point.density)
    if 1.0 / ALIKE < density / point.density < ALIKE:
        return point
    return settle(cases, point.structure, point.values, held, density)


def retoothed(
    cases: Sequence[Case], structure: Structure, values: Mapping[str, float], held: Mapping[str, float], density: float
) -> Point:
    """The maximum near these values with teeth that are looked for anew."""
    structure = preparation.with_teeth(structure)
    mine = preparation.with_steps(cases, structure)
    seen = multistart.glimpses(mine, structure)
    begun = multistart.likeliest_teeth(seen, structure, preparation.completed(structure, values), density)
    return settle(cases, structure, begun, held, density)


def relocated(cases: Sequence[Case], point: Point, held: Mapping[str, float]) -> Point:
    """The point, or a better one where gap, shares and teeth are looked for anew.

    What was missing until now may have led them astray, and no slope leads back.
    """
    if not point.structure.toothed:
        return point
    rigid = point.structure.without("tooth_compliance")
    seen = multistart.glimpses(preparation.with_steps(cases, rigid), rigid)

    def looked(memory: float) -> Point:
        rough = multistart.coarse(seen, rigid, preparation.completed(rigid, point.values), held, memory)
        return retoothed(cases, point.structure, {**point.values, **rough.values}, held, point.density)

    return min([point, *each(looked, multistart.MEMORIES)], key=lambda p: p.deviance)


def deepen(cases: Sequence[Case], point: Point, held: Mapping[str, float]) -> Point:
    """The point, or a better one by way of the noise density that the recording asks for, where valleys are wider."""
    mine = preparation.with_steps(cases, point.structure)
    likeliest = likelihood.fit(mine, point.structure, point.values, point.free, point.density, rounds=12)
    other = settle(cases, point.structure, likeliest.values, held, point.density)
    return min(point, other, key=lambda p: p.deviance)


def sharpened(cases: Sequence[Case], point: Point) -> Point:
    """The point, with a longer memory where the recording asks for one: the model then is right for longer."""
    mine = preparation.with_steps(cases, point.structure)
    density = likelihood.best_density(mine, point.structure, point.values, around=point.density)
    if density > 0.8 * point.density:
        return point
    found = likelihood.fit(mine, point.structure, point.values, point.free, density)
    return found if found.density < point.density else point
