"""Does an addition make the free run better where it was not fitted?

Errors one step ahead hardly feel a curve that is wrong for seconds. So blocks of the fitted part are left out, the
addition is fitted to the rest, and both models run freely through the blocks.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twin.diagnosis import data_split, free_run
from twin.diagnosis.data_split import RecordingPart
from twin.estimation import likelihood, optimizer, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording

#: Which blocks of a recording are left out, as shares of its readings.
LEFT_OUT = ((0.15, 0.25), (0.45, 0.55), (0.75, 0.85))
#: How far ahead a name is asked to predict, s; the search itself looks a tenth of a second ahead.
HORIZONS = (1.0, math.inf)
#: Points at which noise is followed while the start of a run is read.
_POINTS = 20


def blocks_of(recording: Recording) -> list[RecordingPart]:
    """The blocks that are left out. What is held out holds no readings here, and is in none of them by itself."""
    read = recording.time[np.isfinite(recording.output)]
    return [RecordingPart(recording, *map(float, np.quantile(read, shares))) for shares in LEFT_OUT]


def free_run_rmse(problem: FitProblem, point: Fit) -> float:
    """RMSE of the free runs through the blocks, each from the start that the model reads ahead of it; output unit."""
    parts = [part for c in problem.recordings for part in blocks_of(c.recording) if part.is_read]
    recordings, inside = data_split.led(parts, point.structure, data_split.lead_of(point.values))
    squares, count = 0.0, 0
    own = preparation.prepare_recordings(recordings, point.structure)
    for case, part in zip(own.stepped(point.structure), inside, strict=True):
        judged = np.flatnonzero(part.inside & np.isfinite(case.recording.output))
        if len(judged) == 0:
            continue
        error = (case.recording.output - free_run.started(case, point, _POINTS).reading)[judged]
        if not case.drive.speed:
            error = error - error[0]
        squares, count = squares + float(np.sum(error**2)), count + len(judged)
    return math.sqrt(squares / count) if count else math.nan


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


def prediction_rmse(problem: FitProblem, point: Fit, ahead: float) -> float:
    """RMSE in the blocks, of predictions up to `ahead` seconds ahead. Where that is infinite, of free runs."""
    if math.isinf(ahead):
        return free_run_rmse(problem, point)
    squares, count = 0.0, 0
    for case in problem.stepped(point.structure):
        running = likelihood.with_free_runs(case, problem.process_noise, ahead)
        error = likelihood.innovations(running, point.structure, point.values, problem.process_noise).error
        inside = np.any([part.inside for part in blocks_of(case.recording)], axis=0)
        judged = inside & running.free_run & np.isfinite(error)
        squares, count = squares + float(np.sum(error[judged] ** 2)), count + int(np.count_nonzero(judged))
    return math.sqrt(squares / count) if count else math.nan


def error_ratios(problem: FitProblem, smaller: Fit, larger: Fit) -> list[tuple[float, float]]:
    """How far ahead (s), and the larger model's error there over the smaller one's, on blocks that its own part was not
    fitted to.
    """
    problem, found = problem.at(larger.process_noise), without_blocks(problem, smaller, larger)
    out = []
    for ahead in HORIZONS:
        before, after = (prediction_rmse(problem, p, ahead) for p in (smaller, found))
        if before > 0.0:
            out.append((ahead, after / before))
    return out


def improves(problem: FitProblem, smaller: Fit, larger: Fit) -> bool:
    """Whether the larger model's free run is better on blocks that its own part was not fitted to."""
    return free_run_rmse(problem, without_blocks(problem, smaller, larger)) < free_run_rmse(problem, smaller)
