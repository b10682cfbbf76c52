"""A twin against recordings made since: when did which parameter change, and by how much?

Each recording gives a fit of the model's structure. A step after recording k means three things: the fits before it
(and the model itself) agree, the fits after it agree, and the two groups differ. Each group is pooled with the weights
of its errors, and `compare_models` names what differs. This is the generalised likelihood ratio test for a change at an
unknown time (Basseville and Nikiforov, Detection of Abrupt Changes, 1993, section 4.4.3).

The alarm rate is stated per recording. Each of the k possible times of a step gets its share of it (Bonferroni), so
that the rate holds whatever the errors of the fits have in common.

Repeated recordings of a real machine scatter by more than their own errors say. That excess is estimated from the
differences of neighbouring fits, which a step touches once, and added to each fit. It takes some recordings to be
known: the history is judged anew with each recording that is added. So are the moment, the size and the name of a
change that was seen, by all recordings up to the next one: the first after it may know little.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis.change import Change, compare_models, scaled_inverse
from twin.errors import BadInput
from twin.model.fitted_model import Model

FloatArray = NDArray[np.float64]

#: Alarms per recording of an axis that does not change.
FALSE_ALARMS = 1e-3
#: Fits from which on their scatter is estimated.
FEWEST_FOR_SCATTER = 6
#: Median of a chi-square variable of one degree of freedom.
_MEDIAN_CHI2 = 0.4549


@dataclass(frozen=True)
class Alarm:
    """A change that was seen.

    Attributes
    ----------
    since : int
        Index of the first recording after the change.
    seen : int
        Index of the recording with which it was seen.
    changes : tuple of Change
    """

    since: int
    seen: int
    changes: tuple[Change, ...]


@dataclass(frozen=True, eq=False)
class Track:
    """The history of an axis.

    Attributes
    ----------
    model : Model
        What the recordings are compared with.
    names : tuple of str
        Of the recordings.
    fits : tuple of Model
        One for each recording.
    standardised : tuple of mapping
        For each recording the difference of each parameter from the model over its standard error.
    alarms : tuple of Alarm
    latest : Model
        The pooled fits since the last alarm.
    """

    model: Model
    names: tuple[str, ...]
    fits: tuple[Model, ...]
    standardised: tuple[Mapping[str, float], ...]
    alarms: tuple[Alarm, ...]
    latest: Model


def pool(fits: Sequence[Model]) -> Model:
    """The mean of independent fits of one structure, weighted with their information (n, n).

    Raises
    ------
    BadInput
        Where no fit has standard errors, or the structures differ.
    """
    first = fits[0]
    if any(f.structure != first.structure for f in fits):
        raise BadInput("fits of different structures cannot be pooled")
    names = [n for n in first.fitted if all(n in f.fitted and 0.0 < f.std(n) < math.inf for f in fits)]
    if not names:
        raise BadInput("the fits hold no standard errors: make them with twin identify")
    total, weighted = np.zeros((len(names), len(names))), np.zeros(len(names))
    reference = np.array([first.values[n] for n in names])
    for fit in fits:
        rows = [fit.fitted.index(n) for n in names]
        information = scaled_inverse(fit.covariance[np.ix_(rows, rows)])
        total += information
        weighted += information @ (np.array([fit.values[n] for n in names]) - reference)
    covariance = scaled_inverse(total)
    values = reference + covariance @ weighted
    low = np.array([first.parameter(n).lower for n in names])
    high = np.array([first.parameter(n).upper for n in names])
    found = dict(zip(names, np.clip(values, low, high).tolist(), strict=True))
    return replace(
        fits[-1], values={**fits[-1].values, **found}, fitted=tuple(names), covariance=covariance, intervals={}
    )


def with_scatter(fits: Sequence[Model]) -> list[Model]:
    """The fits with the excess of their scatter over their errors, from the differences of neighbours."""
    if len(fits) < FEWEST_FOR_SCATTER:
        return list(fits)
    excess = {}
    for name in fits[0].fitted:
        stds = np.array([f.std(name) for f in fits])
        values = np.array([f.values[name] for f in fits])
        seen = np.isfinite(stds)
        if seen.sum() < FEWEST_FOR_SCATTER:
            continue
        squares = np.diff(values[seen]) ** 2
        excess[name] = max(0.0, float(np.median(squares) / _MEDIAN_CHI2 / 2.0 - np.median(stds[seen] ** 2)))
    widened = []
    for fit in fits:
        covariance = fit.covariance.copy()
        for i, name in enumerate(fit.fitted):
            covariance[i, i] += excess.get(name, 0.0)
        widened.append(replace(fit, covariance=covariance))
    return widened


def _step(baseline: Model, fits: Sequence[Model], false_alarms: float) -> tuple[int, tuple[Change, ...]] | None:
    """The likeliest moment of a change among the fits since the baseline, and what changed; None where nothing did."""
    best: tuple[float, int, tuple[Change, ...]] | None = None
    for k in range(len(fits)):
        before, after = pool([baseline, *fits[:k]]), pool(fits[k:])
        changes = compare_models(before, after, false_alarms / len(fits))
        if changes.found and (best is None or changes.explained > best[0]):
            best = (changes.explained, k, changes.found)
    return None if best is None else (best[1], best[2])


def _judged_by_all(model: Model, fits: Sequence[Model], alarms: Sequence[Alarm], false_alarms: float) -> list[Alarm]:
    """The alarms with the moment and the changes that the recordings up to the next alarm speak for."""
    found: list[Alarm] = []
    baseline, begin = model, 0
    for i, alarm in enumerate(alarms):
        end = alarms[i + 1].since if i + 1 < len(alarms) else len(fits)
        step = _step(baseline, fits[begin:end], false_alarms)
        since, changes = (alarm.since, alarm.changes) if step is None else (begin + step[0], step[1])
        found.append(Alarm(since, max(alarm.seen, since), changes))
        baseline, begin = pool(fits[since:end]), end
    return found


def track(model: Model, fits: Sequence[Model], names: Sequence[str] = (), false_alarms: float = FALSE_ALARMS) -> Track:
    """Follow an axis through fits of recordings in the order in which they were made.

    Parameters
    ----------
    model : Model
        The twin, with standard errors.
    fits : sequence of Model
        One fit of the same structure for each recording, the oldest first.
    names : sequence of str
        Of the recordings; default: their numbers, from 1.
    false_alarms : float
        Alarms per recording of an axis that does not change.

    Returns
    -------
    Track

    Raises
    ------
    BadInput
        Where structures differ or standard errors are missing.
    """
    shown = tuple(names) or tuple(str(i + 1) for i in range(len(fits)))
    standardised = tuple(compare_models(model, fit).standardised for fit in fits)
    alarms: list[Alarm] = []
    baseline, begin = model, 0
    widened = with_scatter(fits)
    for last in range(len(fits)):
        recent = widened[begin : last + 1]
        step = _step(baseline, recent, false_alarms)
        if step is not None:
            since = begin + step[0]
            alarms.append(Alarm(since, last, step[1]))
            # From here on the axis is what it has become.
            baseline, begin = pool(recent[step[0] :]), last + 1
    alarms = _judged_by_all(model, widened, alarms, false_alarms)
    latest = pool(widened[alarms[-1].since :] if alarms else [model, *widened])
    return Track(model, shown, tuple(fits), standardised, tuple(alarms), latest)


@dataclass(frozen=True)
class Forecast:
    """When a parameter reaches a limit if it goes on as it did.

    Attributes
    ----------
    parameter : str
    limit : float
    recordings : float
        From the last one on; infinite where it does not move towards the limit.
    interval : tuple of float
        95 % interval of that.
    """

    parameter: str
    limit: float
    recordings: float
    interval: tuple[float, float]


def forecast(history: Track, parameter: str, limit: float) -> Forecast:
    """The weighted straight line through a parameter's values, and where it meets the limit.

    Raises
    ------
    BadInput
        Where there are fewer than three fits of the parameter.
    """
    fits = with_scatter(history.fits)
    rows = [(i, f.values[parameter], f.std(parameter)) for i, f in enumerate(fits) if parameter in f.fitted]
    rows = [r for r in rows if math.isfinite(r[2]) and r[2] > 0.0]
    if len(rows) < 3:
        raise BadInput(f"a forecast of {parameter} needs three recordings that fix it; there are {len(rows)}")
    at, value, std = np.array(rows).T
    at = at - len(fits) + 1.0
    design = np.stack([np.ones(len(at)), at], axis=1) / std[:, None]
    known = np.linalg.inv(design.T @ design)
    level, slope = known @ design.T @ (value / std)
    rng = np.random.default_rng(0)
    levels, slopes = rng.multivariate_normal([level, slope], known, 4000).T
    with np.errstate(divide="ignore"):
        reached = np.where(slopes * (limit - levels) > 0.0, (limit - levels) / slopes, math.inf)
    low, high = np.sort(reached)[[100, 3899]]
    ahead = (limit - level) / slope if slope * (limit - level) > 0.0 else math.inf
    return Forecast(parameter, limit, float(ahead), (float(low), float(high)))
