"""Joint maximum likelihood: all parameters from whole recordings, gap crossings included, and how well they are known.

Steady driving shows only the sum of dead-band and dry friction, and nothing of the gap; the samples after each
reversal, the coast-downs and the plugging separate them (effects.md). So nothing is cut away. `multistart` finds the
maximum; here are the standard errors, the intervals of what is bounded or kinked, and what a recording cannot fix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.errors import BadInput
from twin.estimation import (
    filter_memory,
    likelihood,
    likelihood_profile,
    multistart,
    optimizer,
    parameter_bounds,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording, known_quantities, to_fit, told_of
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.parallel import each

#: Bounded and kinked parameters, whose likelihood is no parabola.
PROFILED = ("dead_band_forward", "dead_band_reverse", "backlash_gap")
#: Changes of teeth and gap that matter to nothing but the order of bounces, as shares of their values.
_PERTURBATIONS = {"tooth_frequency": 0.01, "tooth_damping": 0.01, "backlash_gap": 0.001}


def _notes(point: Fit, covariance: NDArray[np.float64]) -> dict[str, str]:
    """What the recording cannot fix, and what would."""
    size = np.sqrt(np.diag(covariance))
    notes = {}
    for i, name in enumerate(point.free):
        value = abs(point.values[name])
        if size[i] <= 0.5 * max(value, 1e-12):
            continue
        with np.errstate(invalid="ignore"):
            correlation = np.nan_to_num(np.abs(covariance[i] / (size[i] * np.maximum(size, 1e-300))))
        correlation[i] = 0.0
        partner = point.free[int(np.argmax(correlation))]
        if correlation.max() > 0.95:
            notes[name] = f"the recording cannot fix it: it and {partner} show only together; {_remedy(name, partner)}"
        else:
            notes[name] = f"the recording cannot fix it; {_remedy(name, '')}"
    for name in point.free:
        bounds = parameter_bounds.bounds_of(name)
        if name in multistart.MULTIMODAL and point.values[name] in bounds and point.values[name] != 0.0:
            told = (
                f"it ends at its bound of {point.values[name]:.3g}: a sign that it makes up for physics that is missing"
            )
            notes[name] = "; ".join([told, *filter(None, [notes.get(name)])])
    if not point.converged and point.free:
        # Every model has an input gain, and it comes first: what is said of it is read.
        told = f"the fit did not converge, no value is final: {point.message}"
        notes[point.free[0]] = "; ".join([told, *filter(None, [notes.get(point.free[0])])])
    return notes


def _remedy(name: str, partner: str) -> str:
    both = {name, partner}
    if any(n.startswith("dead_band") for n in both) and "coulomb_friction" in both:
        return "add a slow triangle through zero and coast-downs: dead-band and dry friction are one in steady state"
    if both & {"backlash_gap", "motor_share", "friction_share", "dry_share", "tooth_frequency", "tooth_damping"}:
        return "add reversals at two or more amplitudes"
    return "add steps at more duties, coast-downs and slow ramps"


def roughness(problem: FitProblem, point: Fit) -> float:
    """How much the deviance changes, in the median, where teeth and gap change by next to nothing.

    Where a motor rattles on and on, every bounce depends on all those before: each value has a likelihood of its own,
    and what is gained by another may be luck. What the information promises of such a change is not counted; slopes
    that have run away promise more than comes.
    """
    shaken = {n: share * point.values[n] for n, share in _PERTURBATIONS.items() if n in point.free}
    changes = [(n, sign * size) for n, size in shaken.items() for sign in (-1.0, 1.0)]
    if not changes:
        return 0.0
    trembled = [{**point.values, n: point.values[n] + change} for n, change in changes]
    found = likelihood.deviances(problem.at(point.process_noise), point.structure, trembled)
    rise = np.array(found) - point.deviance
    own = [point.free.index(n) for n, _ in changes]
    promised = np.diag(point.information)[own] * np.array([change for _, change in changes]) ** 2
    return float(np.median(np.minimum(np.abs(rise), np.abs(rise - promised))))


def covariance_of(problem: FitProblem, point: Fit) -> NDArray[np.float64]:
    """Covariance (n, n) of the free parameters: by the jackknife, and wider where the likelihood is rough.

    There the highest of its peaks lies anywhere within the roughness of the parabola's top.
    """
    covariance = likelihood.jackknife_covariance(problem, point)
    seen = np.isfinite(covariance)
    covariance[seen] += roughness(problem, point) / 3.0 * point.covariance[seen]
    return covariance


def to_model(problem: FitProblem, point: Fit, recordings: Sequence[Recording]) -> Model:
    """The point as a model, with standard errors and where it comes from."""
    covariance = covariance_of(problem, point)
    first = recordings[0]
    variance = problem.recordings[0].reading_variance * point.scale
    known = {k: v for k, v in known_quantities(first).items() if v}
    return Model(
        structure=point.structure,
        values={p.name: float(point.values[p.name]) for p in point.structure.parameters},
        fitted=point.free,
        covariance=covariance,
        notes=_notes(point, covariance),
        axis_unit=first.output_unit.removesuffix("/s"),
        input_unit=first.input_unit,
        sample_time=float(np.round(np.median(np.diff(first.time)), 9)),
        resolution=first.resolution,
        reads_speed=first.is_speed,
        reading_std=math.sqrt(variance),
        torque_density=point.process_noise * variance,
        known={**known, **told_of(first)},
        provenance={
            "method": "joint",
            "recordings": ", ".join(r.name for r in recordings),
            **({"held": ", ".join(problem.held)} if problem.held else {}),
        },
    )


def for_horizon(model: Model, recordings: Sequence[Recording], horizon: float, closed: bool = False) -> Model:
    """The model with the values that predict best up to `horizon` seconds ahead, found from its own, the likeliest.

    Where the structure is complete both are the same but for noise, and the likeliest are the sharper. Where it is
    not, the likeliest serve the next reading, and a long free run is served by others: those that make up for what is
    missing on the way. From window to longer window the model runs freely, because the error of a long run has many
    valleys; of all values that were passed the best over the horizon itself are kept. `closed` predicts from the
    reference under the rig's own loop, not from the recorded input. Raises BadInput.
    """
    if not horizon > 0.0:
        raise BadInput(f"the horizon is {horizon:g} s: give a time above 0")
    if not model.fitted or model.reading_std <= 0.0:
        raise BadInput("the model holds no estimate to start from: make it with twin identify")
    train = to_fit(recordings)
    structure = model.structure
    process_noise = model.torque_density / model.reading_std**2
    problem = preparation.prepare_recordings(train, structure).at(process_noise)
    problem = multistart.choose_initial_contacts(problem, structure, model.values)
    if closed:
        under = preparation.prepare_recordings(train, structure, closed=True).recordings
        contacts = [c.contact for c in problem.recordings]
        problem = problem.on([replace(c, contact=at) for c, at in zip(under, contacts, strict=True)])
    longest = min(horizon, max(float(c.drive.time[-1]) for c in problem.recordings))

    def deviance(point: Fit) -> float:
        return point.deviance

    def windows(span: float) -> FitProblem:
        return problem.on([likelihood.with_free_runs(c, process_noise, span) for c in problem.recordings])

    goal = windows(longest)
    best = likelihood.evaluate(goal, structure, model.values, model.fitted)
    values: Mapping[str, float] = model.values
    span = 2.0 * max(filter_memory.memory_of(c, process_noise) for c in problem.recordings)
    while span < longest:
        values = optimizer.levenberg_marquardt(windows(span), structure, values, model.fitted, rounds=15).values
        trial = likelihood.evaluate(goal, structure, values, model.fitted)
        best = min(best, trial, key=deviance)
        span *= 2.0
    for begin in (values, best.values):
        trial = optimizer.levenberg_marquardt(goal, structure, begin, model.fitted)
        best = min(best, trial, key=deviance)
    # Errors of one run hang together: stretches as long as the run, but several for every parameter.
    whole = sum(float(c.drive.time[-1]) for c in problem.recordings)
    stretch = min(longest, whole / (4.0 * len(model.fitted)))
    covariance = likelihood.jackknife_covariance(goal, best, stretch)
    return replace(
        model,
        values={n: float(v) for n, v in best.values.items()},
        covariance=covariance,
        intervals={},
        notes=_notes(best, covariance),
        provenance={**model.provenance, "horizon": f"{horizon:g} s{', under the own loop' if closed else ''}"},
    )


def _profile_intervals(problem: FitProblem, point: Fit, model: Model) -> dict[str, tuple[float, float]]:
    """95 % intervals of the parameters for which a standard error is not enough."""
    powers = {"backlash_gap": multistart.RIDGE_POWERS}
    names = [n for n in PROFILED if n in point.free]
    ends = each(
        lambda n: likelihood_profile.profile_interval(problem, point, n, model.std(n), powers.get(n, {})), names
    )
    found = dict(zip(names, ends, strict=True))
    if {"backlash_gap", "motor_share"} <= set(point.free) and math.isfinite(model.std("motor_share")):
        # Along the ridge the motor's share goes with the gap, and so it is no better known.
        share, wide = point.values["motor_share"], 1.96 * model.std("motor_share")
        lighter, heavier = (share * point.values["backlash_gap"] / max(g, 1e-9) for g in found["backlash_gap"][::-1])
        low, high = parameter_bounds.bounds_of("motor_share")
        found["motor_share"] = (max(min(share - wide, lighter), low), min(max(share + wide, heavier), high))
    return found


def identify(
    recordings: Sequence[Recording],
    structure: Structure,
    held: Mapping[str, float] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Model:
    """The joint estimate of a structure from its training recordings. Raises BadInput."""
    tell = progress or (lambda sentence, share: None)
    train = to_fit(recordings)
    tell("a coarse fit", 0.0)
    held = dict(held or {})
    problem, begun = multistart.coarse_starts(train, structure, held)
    tell("the full likelihood", 0.3)
    point = multistart.fit_from_starts(problem.holding(held), preparation.with_tooth_compliance(structure), begun)
    tell("leaving local valleys", 0.75)
    problem, point = multistart.leave_local_optima(problem, point)
    model = to_model(problem.holding(held), point, train)
    tell("profiles of the likelihood", 0.85)
    return replace(model, intervals=_profile_intervals(problem, point, model))
