"""Which values the first and the last model are judged and handed out with.

The likeliest values of a model that lacks physics make a poor free run: gap and motor's share make up for what is
missing within milliseconds. An improvement over that run would be overstated. So the first model is shown at its best
free run through the fitted data. So is the last one, where its likeliest values run worse than that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from twin.diagnosis import adequacy, coverage
from twin.diagnosis import verdict as claims
from twin.diagnosis.adequacy import Adequacy
from twin.diagnosis.data_split import RecordingPart
from twin.estimation import horizon, maximum_likelihood
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.fitted_model import Model


@dataclass(frozen=True, eq=False)
class Judged:
    """A fit as the likelihood judges it, and the model that comes of it."""

    fit: Fit
    model: Model


@dataclass(frozen=True, eq=False)
class Pair:
    """The first and the last model, the same where nothing was added, with their figures."""

    first: Judged
    last: Judged
    figures: Adequacy


def _best_free_run(problem: FitProblem, fit: Fit, train: Sequence[Recording]) -> Judged:
    best = horizon.best_with_known_gap(horizon.free_run_fits(problem, fit))
    return Judged(horizon.as_judged(problem, best), horizon.to_model(problem, best, train))


def pair(
    problems: tuple[FitProblem, FitProblem],
    fits: tuple[Fit, Fit],
    train: Sequence[Recording],
    held_out: Sequence[RecordingPart],
) -> Pair:
    """The models with the values that they are handed out with.

    Parameters
    ----------
    problems
        As the first and the last model are judged.
    fits
        Their likeliest values; the same fit twice where nothing was added.
    train
        What was fitted.
    held_out
        What no fit has seen; it has no say in the values.
    """
    first, last = (Judged(f, maximum_likelihood.to_model(p, f, train)) for p, f in zip(problems, fits, strict=True))
    added = fits[0] is not fits[1]
    if added or horizon.lacks_physics(problems[0], fits[0]):
        first = _best_free_run(problems[0], fits[0], train)
    if not added:
        last = first
    fitted = [r.recording for r in problems[0].recordings]
    beyond = coverage.beyond(fitted, held_out)
    figures = adequacy.measure(problems[0], held_out, first.fit, last.fit, beyond)
    if added and claims.is_worse(figures.free_run["train"]):
        last = _best_free_run(problems[1], fits[1], train)
        figures = adequacy.measure(problems[0], held_out, first.fit, last.fit, beyond)
    return Pair(first, last, figures)
