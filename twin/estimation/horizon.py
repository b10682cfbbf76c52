"""The values with which a model predicts best over a horizon, or over whole recordings.

Where a structure is complete they are the likeliest ones but for noise, and the likeliest are the sharper. Where it
lacks physics there are no true values. The likeliest values then predict the next reading well: gap and motor's share
make up for what is missing within milliseconds. A free run with them is worse. From window to longer window the model
runs freely, because the error of a long run has many local optima.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.errors import BadInput
from twin.estimation import (
    filter_memory,
    likelihood,
    maximum_likelihood,
    multistart,
    optimizer,
    parameter_bounds,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording, to_fit
from twin.model.fitted_model import Model
from twin.parallel import each

#: What a model without a gap does not have: all but the gap itself may be anything then.
_GAP_PARAMETERS = ("backlash_gap", "motor_share", "friction_share", "dry_share", "shaft_share")
#: Factor from one length of the windows to the next, and steps of the fit at each.
_LENGTHENING, _ROUNDS = 2.0, 15
#: Overdispersion below which the errors one step ahead count as white.
_WHITE = 2.0
#: Key of a model's provenance where its likeliest values only make up for missing physics, and what it says there.
LACKING = "lacking"
_LACKS = "the likeliest values make up for missing physics"
FOLLOWS = "the likeliest values follow each reading from the last one"
#: What a model's provenance calls this horizon.
WHOLE = "whole recordings"
_NO_GAP = (
    "with the physics that this model has, the recording is followed better without a gap; find what else is missing, "
    "with twin diagnose"
)


@dataclass(frozen=True, eq=False)
class HorizonFit:
    """Values that predict best over a horizon.

    Attributes
    ----------
    goal
        The recordings, judged by free runs over the horizon.
    fit
        The best values there.
    horizon
        s.
    """

    goal: FitProblem
    fit: Fit
    horizon: float

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Of the free parameters (n, n).

        Errors of one run are correlated. The jackknife leaves out stretches as long as the run, but several for every
        parameter.
        """
        whole = sum(float(c.drive.time[-1]) for c in self.goal.recordings)
        stretch = min(self.horizon, whole / (4.0 * max(len(self.fit.free), 1)))
        return likelihood.jackknife_covariance(self.goal, self.fit, stretch)


def longest_of(problem: FitProblem) -> float:
    """Duration (s) of the longest recording."""
    return max(float(c.drive.time[-1]) for c in problem.recordings)


def _windows(problem: FitProblem, span: float) -> FitProblem:
    """The problem, judged by free runs of so many seconds."""
    judged = [replace(c, contact_mask=None) for c in problem.recordings]
    return problem.on([likelihood.with_free_runs(c, problem.process_noise, span) for c in judged])


def _rank(fit: Fit) -> tuple[bool, float]:
    """The less the better: of fits whose gap and motor's share are estimates the likeliest, then of the others."""
    return not _is_gap_known(fit), fit.deviance


def fit_over(problem: FitProblem, start: Fit, horizon: float) -> HorizonFit:
    """The values that predict best up to a horizon, found from those of a fit: the best of all that were passed.

    Parameters
    ----------
    problem
        The recordings, at the process noise by which the filter finds the state ahead of each free run.
    start
        Where the search begins; its free parameters are fitted.
    horizon
        s.
    """
    goal = _windows(problem, horizon)
    passed = [likelihood.evaluate(goal, start.structure, start.values, start.free)]
    values: Mapping[str, float] = start.values
    span = _LENGTHENING * max(filter_memory.memory_of(c, problem.process_noise) for c in problem.recordings)
    while span < horizon:
        shorter = _windows(problem, span)
        values = optimizer.levenberg_marquardt(shorter, start.structure, values, start.free, rounds=_ROUNDS).values
        passed.append(likelihood.evaluate(goal, start.structure, values, start.free))
        span *= _LENGTHENING
    best = min(passed, key=_rank)
    ends = [optimizer.levenberg_marquardt(goal, start.structure, begin, start.free) for begin in (values, best.values)]
    return HorizonFit(goal, min([best, *ends], key=_rank), horizon)


def _without_gap(fit: Fit) -> Fit:
    """The fit with a gap of zero, which is held with all that a gap alone shows, at its usual values."""
    usual = {p.name: p.start for p in fit.structure.parameters if p.name in _GAP_PARAMETERS}
    values = {**fit.values, **usual, "backlash_gap": 0.0}
    free = tuple(n for n in fit.free if n not in (*_GAP_PARAMETERS, "tooth_frequency", "tooth_damping"))
    return replace(fit, structure=fit.structure.without("tooth_compliance"), values=values, free=free)


def _is_gap_known(fit: Fit) -> bool:
    """Whether gap and motor's share, where they are free, end within their bounds: else they are no estimates."""
    share = fit.values.get("motor_share") if "motor_share" in fit.free else None
    within = share not in parameter_bounds.bounds_of("motor_share")
    return "backlash_gap" not in fit.free or (
        within and fit.values["backlash_gap"] < parameter_bounds.bounds_of("backlash_gap")[1]
    )


def is_gap_at_bound(fit: Fit) -> bool:
    """Whether gap or motor's share end at a bound. Where there is no gap at all, the share may be anything."""
    return not _is_gap_known(fit) and fit.values["backlash_gap"] > 0.0


def lacks_physics(problem: FitProblem, likeliest: Fit) -> bool:
    """Whether the likeliest values make up for missing physics. It is so where the filter's memory is the shortest
    allowed. It is also so where gap or share end at a bound and the errors are correlated.
    """
    bent = is_gap_at_bound(likeliest) and likeliest.overdispersion > _WHITE
    return bent or optimizer.is_misspecified(problem, likeliest)


def follows_readings(problem: FitProblem, likeliest: Fit) -> bool:
    """Whether the filter's memory is the shortest allowed: each reading is then told by the last ones, whatever the
    parameters are. So it is where readings are coarse and rounded alike, and where the input does not drive the output.
    """
    return likeliest.process_noise > 0.5 * filter_memory.largest_process_noise(problem.recordings)


def free_run_fits(problem: FitProblem, likeliest: Fit, others: Sequence[Mapping[str, float]] = ()) -> list[HorizonFit]:
    """Fits over the whole recordings, the best first; last those whose gap or motor's share is no estimate.

    Parameters
    ----------
    problem
        The recordings, at any process noise.
    likeliest
        The fit from which one search begins, and one without a gap.
    others
        Values of its parameters from which other searches begin: long runs have many local optima.
    """
    problem, horizon = problem.at(likeliest.process_noise), longest_of(problem)
    starts = [likeliest, *([_without_gap(likeliest)] if "backlash_gap" in likeliest.free else [])]
    starts += [replace(likeliest, values={**likeliest.values, **values}) for values in others]
    return sorted(each(lambda start: fit_over(problem, start, horizon), starts), key=lambda end: _rank(end.fit))


def as_judged(problem: FitProblem, found: HorizonFit) -> Fit:
    """The values as the likelihood of each reading given all before judges them."""
    fit = found.fit
    return likelihood.evaluate(problem.at(found.goal.process_noise), fit.structure, fit.values, fit.free)


def to_model(problem: FitProblem, found: HorizonFit, recordings: Sequence[Recording]) -> Model:
    """The model with the values of the best free run, and their standard errors.

    Parameters
    ----------
    problem
        The recordings as they were judged before.
    found
        Over the whole recordings.
    recordings
        What was fitted.
    """
    model = maximum_likelihood.to_model(problem, as_judged(problem, found), recordings)
    return _over(model, found, WHOLE)


def in_place_of_likeliest(
    problem: FitProblem, likeliest: Fit, recordings: Sequence[Recording], others: Sequence[Mapping[str, float]] = ()
) -> Model:
    """The model with the values of the best free run, marked by why the likeliest are not taken.

    `others` are values from which other searches begin.
    """
    best = free_run_fits(problem, likeliest, others)[0]
    found = to_model(problem, best, recordings)
    why = _LACKS if lacks_physics(problem, likeliest) else FOLLOWS
    return replace(found, provenance={**found.provenance, LACKING: why})


def _over(model: Model, found: HorizonFit, says: str) -> Model:
    """The model with values that were fitted over a horizon."""
    fit, covariance = found.fit, found.covariance
    notes = maximum_likelihood.notes(fit, covariance)
    if "backlash_gap" not in fit.free and fit.values.get("backlash_gap") == 0.0:
        notes |= {n: _NO_GAP for n in _GAP_PARAMETERS if n in model.values}
    return replace(
        model,
        values={n: float(fit.values[n]) for n in model.values},
        covariance=covariance,
        intervals={},
        notes=notes,
        provenance={**model.provenance, "horizon": says},
    )


def for_horizon(model: Model, recordings: Sequence[Recording], horizon: float, closed: bool = False) -> Model:
    """The model with the values that predict best up to `horizon` seconds ahead, found from its own.

    Parameters
    ----------
    model
        With an estimate.
    recordings
        Those with the role "train" are fitted.
    horizon
        s.
    closed
        Whether to predict from the reference under the rig's own loop, not from the recorded input.

    Raises
    ------
    BadInput
        The horizon is no time, or the model holds no estimate.
    """
    if not horizon > 0.0:
        raise BadInput(f"the horizon is {horizon:g} s: give a time above 0")
    if not model.fitted or model.reading_std <= 0.0:
        raise BadInput("the model holds no estimate to start from: make it with twin identify")
    train, structure = to_fit(recordings), model.structure
    problem = preparation.prepare_recordings(train, structure).at(model.torque_density / model.reading_std**2)
    problem = multistart.choose_initial_contacts(problem, structure, model.values)
    if closed:
        under = preparation.prepare_recordings(train, structure, closed=True).recordings
        contacts = [c.contact for c in problem.recordings]
        problem = problem.on([replace(c, contact=at) for c, at in zip(under, contacts, strict=True)])
    longest = min(horizon, longest_of(problem))
    start = likelihood.evaluate(problem, structure, model.values, model.fitted)
    # These values are no longer those of the best free run, whatever was said of the likeliest.
    model = replace(model, provenance={k: v for k, v in model.provenance.items() if k != LACKING})
    return _over(model, fit_over(problem, start, longest), f"{horizon:g} s{', under the own loop' if closed else ''}")
