"""Tests of a fitted name: its size against its standard error, possible physics, and a gain in most recordings.

A likelihood gains also from names that describe something else. Their own figures then show it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from twin.diagnosis import block_validation, cross_validation, thresholds
from twin.diagnosis.result import NotBorneOut
from twin.display.numbers import measure
from twin.effects.catalogue import EFFECTS, pages
from twin.effects.parameter import Parameter
from twin.estimation import maximum_likelihood, parameter_bounds
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model.stepper import Structure


def _names(fit: Fit, first: Structure) -> list[str]:
    """The names that the fit has beyond the first model."""
    return [i for i in fit.structure.named if i not in first and EFFECTS[i].screen is not None]


def _size_of(name: str) -> Parameter:
    """The parameter that says how large the effect is."""
    screen = EFFECTS[name].screen
    assert screen is not None
    return next(p for page in pages(name) for p in page.parameters if p.name == screen.gain)


def _too_small(problem: FitProblem, fit: Fit, first: Structure) -> Iterator[NotBorneOut]:
    """The names whose size is less than three of its standard errors."""
    covariance = maximum_likelihood.covariance_of(problem, fit)
    for name in _names(fit, first):
        size = _size_of(name)
        if size.name not in fit.free or (size.neutral is None and size.lower != 0.0):
            continue
        value, index = fit.values[size.name] - (size.neutral or 0.0), fit.free.index(size.name)
        error = math.sqrt(max(float(covariance[index, index]), 1e-300))
        if abs(value) < thresholds.MIN_SIZE_IN_ERRORS * error:
            known = measure(fit.values[size.name], error)
            reason = f"its size, {size.name} = {known}, is less than three errors"
            yield NotBorneOut(name, reason, abs(value) / error)


def _impossible(problem: FitProblem, fit: Fit, first: Structure) -> Iterator[NotBorneOut]:
    """The names with impossible values: a size or time constant at its bound, or dry friction that pushes."""
    for name in _names(fit, first):
        size = _size_of(name)
        at = fit.values[size.name]
        if size.name in fit.free and at in parameter_bounds.bounds_of(size.name) and at not in (0.0, size.neutral):
            yield NotBorneOut(name, f"its size {size.name} ends at its bound of {at:g}, and so is no estimate", at)
        for p in EFFECTS[name].parameters:
            at = fit.values[p.name]
            if p.unit == "s" and p.name in fit.free and at in parameter_bounds.bounds_of(p.name) and at != p.neutral:
                yield NotBorneOut(name, f"its time constant {p.name} ends at its bound of {at:g} s", at)
    if "position_dependent_friction" in _names(fit, first):
        angle = np.concatenate([r.positions for r in problem.recordings]) - fit.values["friction_angle"]
        least = fit.values["coulomb_friction"] + float(np.min(fit.values["friction_variation"] * np.sin(angle)))
        if least < -thresholds.LAW_TOLERANCE * abs(fit.values["friction_variation"]):
            reason = f"dry friction would push along a part of the turn, by as much as {-least:.3g}"
            yield NotBorneOut("position_dependent_friction", reason, least)


def _one_recording(problem: FitProblem, fit: Fit, lesser: dict[str, Fit]) -> Iterator[NotBorneOut]:
    """The names whose gain comes from one of several recordings alone; `lesser` are the fits without each.

    Not every recording need show an effect: a drive clips in those that ask much of it.
    """
    if len(problem.recordings) < thresholds.MIN_RECORDINGS:
        return
    for name, without in lesser.items():
        gains = cross_validation.recording_gains(problem, without, fit)
        best = int(np.argmax(gains))
        others = float(np.sum(np.delete(gains, best)))
        if others <= 0.0:
            alone = problem.recordings[best].recording.name
            reason = f"without {alone} the other {len(gains) - 1} recordings are predicted no better with it"
            yield NotBorneOut(name, reason, others)


def _no_help_ahead(problem: FitProblem, fit: Fit, lesser: dict[str, Fit]) -> Iterator[NotBorneOut]:
    """The names with worse predictions on left-out blocks, one second ahead or in the free run."""
    for name, without in lesser.items():
        for ahead in block_validation.errors_ahead(problem, without, fit):
            if ahead.is_worse:
                span = f"{ahead.horizon:g} s ahead" if math.isfinite(ahead.horizon) else "in the free run"
                reason = f"{span} the error on blocks that were left out is {ahead.ratio:.2f} times that without it"
                yield NotBorneOut(name, reason, ahead.ratio)


def _predicts_clearly(problem: FitProblem, fit: Fit, without: Fit | None) -> bool:
    """Whether errors on blocks that a name was not fitted to are far smaller with it, at every horizon.

    Then its size is accepted, whatever its standard error. A standard error from slopes at a rough place of the
    likelihood means nothing.
    """
    if without is None:
        return False
    ahead = block_validation.errors_ahead(problem, without, fit)
    return max(one.ratio for one in ahead) < thresholds.CLEAR_ERROR_RATIO


def not_borne_out(problem: FitProblem, fit: Fit, first: Structure, lesser: dict[str, Fit]) -> NotBorneOut | None:
    """The name that the figures contradict most clearly, or none.

    Parameters
    ----------
    problem
        The recordings as the fit was judged.
    fit
        The last model, at the memory that it bears.
    first
        The first model's structure, whose effects need no proof.
    lesser
        For each name the best fit without it.
    """
    impossible = next(_impossible(problem, fit, first), None)
    if impossible is not None:
        return impossible
    unsure = (n for n in _too_small(problem, fit, first) if not _predicts_clearly(problem, fit, lesser.get(n.id)))
    small = min(unsure, key=lambda n: n.figure, default=None)
    few = small or next(_one_recording(problem, fit, lesser), None)
    return few or max(_no_help_ahead(problem, fit, lesser), key=lambda n: n.figure, default=None)
