"""Does an addition make the free run better where it was not fitted?

Errors one step ahead hardly feel a curve that is wrong for seconds. So blocks of the fitted part are left out, the
addition is fitted to the rest, and both models run freely through the blocks. A free run drifts: as long as noise makes
larger errors than both, their ratio is chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import adequacy, thresholds, verdict
from twin.diagnosis.adequacy import Comparison, FreeRun
from twin.diagnosis.data_split import RecordingPart
from twin.estimation import likelihood, optimizer
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording

FloatArray = NDArray[np.float64]

#: Which blocks of a recording are left out, as shares of its readings.
LEFT_OUT = ((0.15, 0.25), (0.45, 0.55), (0.75, 0.85))
#: How far ahead a name is asked to predict, s, beside the free run; the search itself looks a tenth of a second ahead.
HORIZON = 1.0


def blocks_of(recording: Recording) -> list[RecordingPart]:
    """The blocks that are left out. What is held out holds no readings here, and is in none of them by itself."""
    read = recording.time[np.isfinite(recording.output)]
    return [RecordingPart(recording, *map(float, np.quantile(read, shares))) for shares in LEFT_OUT]


def free_run(problem: FitProblem, point: Fit) -> FreeRun:
    """The free runs through the blocks as one, each from the start that the model reads ahead of it."""
    parts = [part for c in problem.recordings for part in blocks_of(c.recording) if part.is_read]
    return adequacy.together(adequacy.free_runs(*adequacy.led_problem(problem, parts, point), point), False)


def without_blocks(problem: FitProblem, smaller: Fit, larger: Fit) -> Fit:
    """The larger model with what it has beyond the smaller one fitted without the blocks."""
    masked = []
    for case in problem.recordings:
        hidden = np.any([part.inside for part in blocks_of(case.recording)], axis=0)
        masked.append(replace(case, contact_mask=case.masked | hidden))
    own = tuple(n for n in larger.free if n not in smaller.free)
    if not own:
        return larger
    rest = problem.on(masked).at(larger.process_noise)
    return optimizer.levenberg_marquardt(rest, larger.structure, larger.values, own)


def _squares_ahead(problem: FitProblem, point: Fit, ahead: float) -> FloatArray:
    """Mean square (M,) of the errors of each prediction up to `ahead` seconds ahead; NaN outside the blocks."""
    found = []
    for case in problem.stepped(point.structure):
        running = likelihood.with_free_runs(case, problem.process_noise, ahead)
        error = likelihood.innovations(running, point.structure, point.values, problem.process_noise).error
        inside = np.any([part.inside for part in blocks_of(case.recording)], axis=0)
        runs = np.asarray(running.free_run, dtype=np.int8)
        judged = inside & (runs > 0) & np.isfinite(error)
        number = np.cumsum(np.diff(runs, prepend=0) == 1)
        last = int(number[-1]) + 1
        read = np.bincount(number[judged], minlength=last)
        squares = np.bincount(number[judged], error[judged] ** 2, minlength=last)
        found.append(np.divide(squares, read, out=np.full(last, np.nan), where=read > 0))
    return np.concatenate(found)


@dataclass(frozen=True)
class Ahead:
    """The larger model's error on the blocks over the smaller one's, `horizon` seconds ahead or in the free run. And
    whether it is larger by more than noise and chance make it.
    """

    horizon: float
    ratio: float
    is_worse: bool


def _seconds_ahead(problem: FitProblem, smaller: Fit, larger: Fit) -> Ahead:
    both = np.array([_squares_ahead(problem, p, HORIZON) for p in (smaller, larger)])
    before, after = both[:, np.isfinite(both).all(axis=0)]  # one model may not run where the other does
    more, count = after - before, len(after)
    ratio = math.sqrt(float(np.mean(after)) / max(float(np.mean(before)), 1e-300)) if count else 1.0
    chance = float(np.std(more)) / math.sqrt(max(count - 1, 1))
    sure = count > 1 and float(np.mean(more)) > thresholds.WORSE_IN_ERRORS * chance
    return Ahead(HORIZON, ratio, ratio > verdict.LARGER and sure)


def _in_free_run(problem: FitProblem, smaller: Fit, larger: Fit) -> Ahead:
    before, after = (free_run(problem, p) for p in (smaller, larger))
    ratio = after.rmse / before.rmse if before.rmse > 0.0 else 1.0
    if ratio > verdict.LARGER:
        before, after = (free_run(problem, adequacy.at_own_noise(problem, p)) for p in (smaller, larger))
    return Ahead(math.inf, ratio, verdict.is_worse(Comparison(before, after, math.nan)))


def errors_ahead(problem: FitProblem, smaller: Fit, larger: Fit) -> list[Ahead]:
    """Both models' errors on blocks that the larger one's own part was not fitted to."""
    problem, found = problem.at(larger.process_noise), without_blocks(problem, smaller, larger)
    return [_seconds_ahead(problem, smaller, found), _in_free_run(problem, smaller, found)]


def improves(problem: FitProblem, smaller: Fit, larger: Fit) -> bool:
    """Whether the larger model's free run is better on blocks that its own part was not fitted to."""
    return free_run(problem, without_blocks(problem, smaller, larger)).rmse < free_run(problem, smaller).rmse
