"""Which values the first and the last model are judged and handed out with.

The likeliest values of a model that lacks physics make a poor free run: gap and motor's share make up for what is
missing within milliseconds. An improvement over that run would be overstated. So the first model is shown at its best
free run through the fitted data. So is the last one, where its likeliest values run worse than that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from twin.diagnosis import adequacy, coverage, screening
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


def _best_free_run(
    problem: FitProblem, fit: Fit, train: Sequence[Recording], others: Sequence[Mapping[str, float]] = ()
) -> Judged:
    best = horizon.free_run_fits(problem, fit, others)[0]
    return Judged(horizon.as_judged(problem, best), horizon.to_model(problem, best, train))


def _values_of_first(first: Fit, last: Fit) -> list[dict[str, float]]:
    """The first model's values for the last one: with what was added as it is there, and as nothing.

    The last model holds the first: from there its best free run is no worse. From its own values that run may end in
    another local optimum.
    """
    shared = {n: v for n, v in first.values.items() if n in last.values}
    added = [i for i in last.structure.ids if i not in first.structure]
    nothing = {n: v for i in added for n, v in screening.neutral_values(i).items() if n in last.values}
    return [shared, {**shared, **nothing}]


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
        other = _best_free_run(problems[1], fits[1], train, _values_of_first(first.fit, fits[1]))
        found = adequacy.measure(problems[0], held_out, first.fit, other.fit, beyond)
        # Two lengths of a free run may disagree where it may take one of several paths.
        if found.free_run["train"].after.rmse < figures.free_run["train"].after.rmse:
            last, figures = other, found
    return Pair(first, last, figures)
