"""Joint maximum likelihood: all parameters from whole recordings, gap crossings included.

Steady driving shows only the sum of dead-band and dry friction, and nothing of the gap; the samples after each
reversal, the coast-downs and the plugging separate them (effects.md). So nothing is cut away. The way to the
maximum: (1) gain, friction and dead-band with a filter that remembers a tenth of a second, where the likelihood
is nearly quadratic in them; (2) gap, motor's share and friction's share from a grid, because every gap crossing
is a kink of the likelihood in these; (3) compliant teeth, likewise; (4) everything together with the noise
density that the recording asks for.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace


from twin import likelihood
from twin.axis import BASE, Structure
from twin.likelihood import Case, Point
from twin.recording import Recording
from twin.startup import start_values

#: Memory of the filter while the coarse values are looked for, s.
MEMORY = 0.1

_CORE = ("input_gain", "viscous_friction", "dead_band_forward", "dead_band_reverse")
_GRID = {
    "backlash_gap": (0.003, 0.006, 0.009, 0.013, 0.018, 0.025, 0.035, 0.05, 0.07, 0.09),
    "motor_share": (0.12, 0.22, 0.36, 0.55),
    "friction_share": (0.4, 0.8),
}
_TEETH = {"tooth_frequency": (60.0, 90.0, 130.0, 190.0), "tooth_damping": (0.15, 0.4)}


def free_parameters(structure: Structure) -> tuple[str, ...]:
    """Everything that is estimated unless the user holds it."""
    return tuple(p.name for p in structure.parameters if p.estimated)


def _scan(
    cases: Sequence[Case], structure: Structure, values: Mapping[str, float], density: float,
    grid: Mapping[str, Iterable[float]], keep: int,
) -> list[dict[str, float]]:  # fmt: skip
    """The best few points of a grid, by deviance."""
    tried = []
    for combination in itertools.product(*grid.values()):
        trial = {**values, **dict(zip(grid, combination, strict=True))}
        tried.append((likelihood.evaluate(cases, structure, trial, density).deviance, trial))
    tried.sort(key=lambda pair: pair[0])
    return [trial for _, trial in tried[:keep]]


def coarse(cases: Sequence[Case], structure: Structure, values: Mapping[str, float]) -> Point:
    """A point in the right valley, by steps (1) and (2), for contact without compliance."""
    density = likelihood.density_of(cases[0], MEMORY)
    rigid = structure.without("tooth_compliance")
    core = tuple(n for n in free_parameters(rigid) if n not in _GRID)
    point = likelihood.climb(cases, rigid, values, density, core, rounds=12, tolerance=1.0)
    if "backlash" not in rigid:
        return point
    best = point
    for start in _scan(cases, rigid, point.values, density, _GRID, keep=2):
        trial = likelihood.climb(cases, rigid, start, density, core, rounds=4, tolerance=1.0)
        trial = likelihood.climb(cases, rigid, trial.values, density, free_parameters(rigid), rounds=15, tolerance=1.0)
        if trial.deviance < best.deviance:
            best = trial
    return best


def prepare(recordings: Sequence[Recording], structure: Structure) -> list[Case]:
    return [likelihood.prepare(r, structure) for r in recordings]


def _choose_contacts(cases: Sequence[Case], structure: Structure, values: Mapping[str, float]) -> list[Case]:
    """Where in the gap each motor starts, by the likelihood of its first seconds."""
    if "backlash" not in structure:
        return list(cases)
    chosen = []
    for case in cases:
        head = case.recording.part(0.0, min(3.0, float(case.recording.time[-1])))
        trial = likelihood.prepare(head, structure)
        density = likelihood.density_of(trial, MEMORY)
        scored = [
            (likelihood.evaluate([replace(trial, contact=s)], structure, values, density).deviance, s)
            for s in (0.0, -1.0, 1.0)
        ]
        chosen.append(replace(case, contact=min(scored)[1]))
    return chosen


def joint(recordings: Sequence[Recording], structure: Structure, held: Mapping[str, float] | None = None) -> Point:
    """Maximum-likelihood estimate of a structure from recordings; `held` parameters keep their value."""
    held = dict(held or {})
    rigid = structure.without("tooth_compliance")
    cases = prepare(recordings, rigid)
    values = {**start_values(cases, rigid), **held}
    point = coarse(cases, rigid, values)
    cases = _choose_contacts(cases, rigid, point.values)
    if "tooth_compliance" in structure:
        cases = [replace(c, drive=replace(c.drive, longest=0.002 / structure.substeps * (1 + 1e-9))) for c in cases]
        start = _scan(cases, structure, point.values, point.density, _TEETH, keep=1)[0]
        point = likelihood.climb(
            cases, structure, start, point.density, free_parameters(structure), rounds=15, tolerance=1.0
        )
    free = tuple(n for n in free_parameters(structure) if n not in held)
    return likelihood.fit(cases, structure, point.values, free, point.density)


def base_structure() -> Structure:
    """The base effects with teeth that give, which is what a real gap is made of."""
    return Structure.of([*BASE, "tooth_compliance"])
