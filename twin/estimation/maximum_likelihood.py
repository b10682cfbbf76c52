"""Joint maximum likelihood: all parameters from whole recordings, gap crossings included, and how well they are known.

Steady driving shows only the sum of dead-band and dry friction, and nothing of the gap. The samples after each
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
    contact_masking,
    likelihood,
    likelihood_profile,
    long_recording,
    multistart,
    optimizer,
    parameter_bounds,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording, known_quantities, to_fit, told_of
from twin.model import equations
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.parallel import each

#: Bounded and kinked parameters, whose likelihood is no parabola.
PROFILED = ("dead_band_forward", "dead_band_reverse", "backlash_gap")
#: So many standard errors from 0, the likelihood of many readings is a parabola over the width of an interval.
_WELL_KNOWN = 10.0
#: Changes of teeth and gap that matter to nothing but the order of bounces, as shares of their values.
_PERTURBATIONS = {"tooth_frequency": 0.01, "tooth_damping": 0.01, "backlash_gap": 0.001}


def notes(point: Fit, covariance: NDArray[np.float64]) -> dict[str, str]:
    """What the recording cannot fix, and what would."""
    size = np.sqrt(np.diag(covariance))
    said: dict[str, str] = {}
    for i, name in enumerate(point.free):
        value = abs(point.values[name])
        if size[i] <= 0.5 * max(value, 1e-12):
            continue
        with np.errstate(invalid="ignore"):
            correlation = np.nan_to_num(np.abs(covariance[i] / (size[i] * np.maximum(size, 1e-300))))
        correlation[i] = 0.0
        partner = point.free[int(np.argmax(correlation))]
        if correlation.max() > 0.95:
            said[name] = f"the recording cannot fix it: it and {partner} show only together; {_remedy(name, partner)}"
        else:
            said[name] = f"the recording cannot fix it; {_remedy(name, '')}"
    for name in point.free:
        bounds = parameter_bounds.bounds_of(name)
        if name in multistart.MULTIMODAL and point.values[name] in bounds and point.values[name] != 0.0:
            stiff = name == "tooth_frequency" and point.values[name] == bounds[1]
            why = "the teeth are too stiff to show" if stiff else "a sign that it makes up for physics that is missing"
            told = f"it ends at its bound of {point.values[name]:.3g}: {why}"
            said[name] = "; ".join([told, *filter(None, [said.get(name)])])
    if not point.converged and point.free:
        # Every model has an input gain, and it comes first: what is said of it is read.
        told = f"the fit did not converge, no value is final: {point.message}"
        said[point.free[0]] = "; ".join([told, *filter(None, [said.get(point.free[0])])])
    return said


def _remedy(name: str, partner: str) -> str:
    both = {name, partner}
    if any(n.startswith("dead_band") for n in both) and "coulomb_friction" in both:
        return "add a slow triangle through zero and coast-downs: dead-band and dry friction are one in steady state"
    if both & {"backlash_gap", "motor_share", "friction_share", "dry_share", "tooth_frequency", "tooth_damping"}:
        return "add reversals at two or more amplitudes"
    return "add steps at more duties, coast-downs and slow ramps"


def roughness(problem: FitProblem, point: Fit) -> float:
    """How much the deviance changes, in the median, where teeth and gap change by next to nothing.

    Where a motor rattles without end, every bounce depends on all those before. Each value then has a likelihood of its
    own, and a gain by another value may be chance. What the information promises of such a change is not counted;
    slopes that have run away promise more than comes.
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
        notes=notes(point, covariance),
        axis_unit=first.output_unit.removesuffix("/s"),
        input_unit=first.input_unit,
        sample_time=float(np.round(np.median(np.diff(first.time)), 9)),
        resolution=first.resolution,
        reads_speed=first.is_speed,
        reading_std=math.sqrt(variance),
        torque_density=point.process_noise * variance,
        recorded_time=max(float(r.time[-1]) for r in recordings),
        known={**known, **told_of(first)},
        provenance={
            "method": "joint",
            "recordings": ", ".join(r.name for r in recordings),
            **({"held": ", ".join(problem.held)} if problem.held else {}),
        },
    )


def _profile_intervals(problem: FitProblem, point: Fit, model: Model) -> dict[str, tuple[float, float]]:
    """95 % intervals of the parameters for which a standard error is not enough."""
    powers = {"backlash_gap": multistart.RIDGE_POWERS}
    names = [n for n in PROFILED if n in point.free]
    if long_recording.is_long([c.recording for c in problem.recordings]):
        ends = _intervals_by_stretches(problem, point, model, names, powers)
    else:
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


def _intervals_by_stretches(
    problem: FitProblem, point: Fit, model: Model, names: Sequence[str], powers: Mapping[str, Mapping[str, float]]
) -> list[tuple[float, float]]:
    """The same of recordings that are long.

    So many readings make a parabola of the likelihood of what is well known. Of the rest, the profile over some
    stretches has the shape of that over all of them, and is wider as the standard error is.
    """
    plain = {n: (point.values[n] - 1.96 * model.std(n), point.values[n] + 1.96 * model.std(n)) for n in names}
    vague = [n for n in names if not abs(point.values[n]) > _WELL_KNOWN * model.std(n)]
    if not vague:
        return [plain[n] for n in names]
    seen = multistart.excerpts(problem, point.structure)
    near = optimizer.levenberg_marquardt(seen, point.structure, point.values, point.free)
    spread = dict(zip(point.free, np.sqrt(np.diag(covariance_of(seen, near))).tolist(), strict=True))

    def scaled(name: str) -> tuple[float, float]:
        low, high = likelihood_profile.profile_interval(seen, near, name, spread[name], powers.get(name, {}))
        ratio = model.std(name) / spread[name] if math.isfinite(spread[name]) and spread[name] > 0.0 else 1.0
        least, most = parameter_bounds.bounds_of(name)
        if not (math.isfinite(ratio) and math.isfinite(high)):
            return low, high
        value, middle = point.values[name], near.values[name]
        return max(value - ratio * (middle - low), least), min(value + ratio * (high - middle), most)

    return [scaled(n) if n in vague else plain[n] for n in names]


def likeliest(
    recordings: Sequence[Recording],
    structure: Structure,
    held: Mapping[str, float] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[FitProblem, Fit]:
    """The maximum of a structure's likelihood over its training recordings, and the problem that it is the maximum of.

    Raises BadInput.
    """
    tell = progress or (lambda sentence, share: None)
    tell("a coarse fit", 0.0)
    train, held = to_fit(recordings), dict(held or {})
    timed = equations.timed(structure)  # such a model cannot begin anywhere else
    searched = train if timed else long_recording.stretches(train)
    problem, begun = multistart.coarse_starts(searched, structure, held)
    tell("the full likelihood", 0.3)
    point = multistart.fit_from_starts(problem.holding(held), preparation.with_tooth_compliance(structure), begun)
    _check_judged(point, train)
    tell("leaving local optima", 0.75)
    problem, point = multistart.leave_local_optima(problem, point)
    problem, point = multistart.begin_anew(problem, point, begun[0].values)
    if searched == train:
        return problem.holding(held), _with_idle_limit(point, train)
    tell("all readings", 0.8)
    problem, point = _on_all(problem, point, train, held)
    return problem, _with_idle_limit(point, train)


def _with_idle_limit(point: Fit, recordings: Sequence[Recording]) -> Fit:
    """The same point, whose limit of the drive clips nothing else where no command of the recordings reaches it."""
    largest = max(float(np.max(np.abs(r.input))) for r in recordings)
    if "saturation_limit" not in point.free or point.values["saturation_limit"] < largest:
        return point
    usual = next(p.start for p in point.structure.parameters if p.name == "saturation_limit")
    return replace(point, values={**point.values, "saturation_limit": max(usual, largest)})


def _check_judged(point: Fit, recordings: Sequence[Recording]) -> None:
    """Raises BadInput where no reading can be judged: the model does not run, or motor and link never met for long."""
    if math.isfinite(point.deviance):
        return
    lasting = max(float(r.time[-1]) for r in recordings)
    raise BadInput(
        f"{recordings[0].name}: no reading of these {lasting:.3g} s can be compared with a model that has a gap: "
        "record for longer, with several reversals, or name backlash in `exclude`"
    )


def _on_all(
    problem: FitProblem, point: Fit, recordings: Sequence[Recording], held: Mapping[str, float]
) -> tuple[FitProblem, Fit]:
    """The maximum over whole recordings, near that of their stretches and at its noise."""
    whole = preparation.prepare_recordings(recordings, point.structure, held)
    noise = point.process_noise * problem.recordings[0].reading_variance / whole.recordings[0].reading_variance
    whole = multistart.choose_initial_contacts(whole.at(noise), point.structure, point.values)
    whole = contact_masking.with_contact_mask(whole, replace(point, process_noise=noise))
    return whole, optimizer.levenberg_marquardt(whole, point.structure, point.values, point.free)


def with_intervals(problem: FitProblem, point: Fit, recordings: Sequence[Recording]) -> Model:
    """The maximum as a model, with intervals where a standard error is not enough."""
    model = to_model(problem, point, to_fit(recordings))
    return replace(model, intervals=_profile_intervals(problem, point, model))


def identify(
    recordings: Sequence[Recording],
    structure: Structure,
    held: Mapping[str, float] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Model:
    """The joint estimate of a structure from its training recordings. Raises BadInput."""
    problem, point = likeliest(recordings, structure, held, progress)
    if progress is not None:
        progress("profiles of the likelihood", 0.85)
    return with_intervals(problem, point, recordings)
