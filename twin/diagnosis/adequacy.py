"""How good a model is, measured apart from the search that chose it.

Three figures, each for the first and the last model, that no fit has made small: the error of the free run against the
one that the model's own noise makes (`twin.diagnosis.drift`), on fitted and on held-out data; the torque that the model
lacks against the torque that the drive made; and where the held-out data leave the range of the fitted ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import drift
from twin.diagnosis.drift import Dynamics, MeanSquare
from twin.diagnosis.holdout import RecordingPart
from twin.estimation import filter_memory, likelihood, optimizer, parameter_bounds
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.fmi.python_fmu import start_state
from twin.io.recording import known_quantities
from twin.model import equations
from twin.model.stepper import STATES, Structure
from twin.parallel import each

FloatArray = NDArray[np.float64]

#: Points of the grid on which the error of all free runs together is followed, and the least for one of them.
POINTS, FEWEST = 400, 20
#: The start of a free run is read off so many memories of the filter, off so many readings at least and averages at
#: most, in so many looks.
_MEMORIES, _FEWEST_READ, _MOST_READ, _LOOKS = 6.0, 10, 100, 2
#: Share of a variable's range by which it is moved to see how a torque goes with it.
_MOVED = 1e-4
_STATE = {name: i for i, name in enumerate(STATES)}


@dataclass(frozen=True)
class FreeRun:
    """A free run: RMSE found, the one that the model's own noise makes (output unit), and the chance that noise makes
    one as large as was found. NaN where nothing was read.
    """

    rmse: float
    expected: float
    p_value: float


NOTHING_READ = FreeRun(math.nan, math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class Error:
    """The error of one free run on a grid of K points, with what noise and parameters make of it."""

    squares: float  # sum of the squares of what was found, output unit^2
    readings: int
    share: FloatArray  # (K,) of the readings
    factor: FloatArray  # (K, sources) of the error's covariance, without reading noise
    parameters: FloatArray  # (K, n) change of the free run by one standard error along each axis of their covariance
    reading: float  # variance of a reading, output unit^2


def dynamics(
    structure: Structure, values: Mapping[str, float], case: PreparedRecording, states: FloatArray
) -> Dynamics:
    """How a small error moves along a run of the model whose states (N, states) are given."""
    x, v = states[:, _STATE["position"]], states[:, _STATE["velocity"]]
    time = case.drive.time
    known = known_quantities(case.recording)
    given = {
        "time": time,
        "moment": np.full(len(time), known["moment"]),
        "payload": np.full(len(time), known["payload"]),
    }
    push = _MOVED * max(float(np.ptp(x)), 1e-9), _MOVED * max(float(np.ptp(v)), 1e-9)

    def torque(position: FloatArray, velocity: FloatArray) -> FloatArray:
        at = {**given, "position": position, "velocity": velocity}
        total = np.zeros(len(time))
        for effect in structure.effects:
            if effect.slot in ("load", "drag") and effect.law is not None:
                total += equations.along(effect.id, at, values)
        return total

    inertia = np.ones(len(time))
    for effect in structure.effects:
        if effect.slot == "mass" and effect.law is not None:
            inertia += equations.along(effect.id, {**given, "position": x}, values)
    by_position = (torque(x + push[0], v) - torque(x - push[0], v)) / (2.0 * push[0])
    by_velocity = (torque(x, v + push[1]) - torque(x, v - push[1])) / (2.0 * push[1])
    dry = any(effect.slot == "grip" for effect in structure.effects)
    held = (v == 0.0) & (np.append(v[1:], v[-1]) == 0.0) if dry else np.zeros(len(v), dtype=bool)
    return Dynamics(time, -by_position / inertia, -by_velocity / inertia, ~held)


def _axes(point: Fit) -> FloatArray:
    """The principal axes (n, n) of the parameters' uncertainty, one standard error long; what leaves no trace has
    none."""
    covariance = point.covariance
    known = np.isfinite(np.diag(covariance))
    inside = np.where(np.outer(known, known), covariance, 0.0)
    size = np.sqrt(np.maximum(np.diag(inside), 1e-300))
    eigenvalues, vectors = np.linalg.eigh(inside / np.outer(size, size))
    return np.asarray((vectors * np.sqrt(np.maximum(eigenvalues, 0.0))) * size[:, None])


def _chords(case: PreparedRecording, point: Fit) -> FloatArray:
    """What one standard error along each axis changes in the free run (N, n): half the difference of both sides.

    A chord holds where the slope does not: behind a gap a slope grows from meeting to meeting without end.
    """

    def run(step: FloatArray) -> FloatArray:
        moved = {}
        for name, change in zip(point.free, step.tolist(), strict=True):
            low, high = parameter_bounds.bounds_of(name)
            moved[name] = min(max(point.values[name] + change, low), high)
        return likelihood.filtered_states(case, point.structure, {**point.values, **moved}, 0.0).reading

    axes = _axes(point).T
    runs = each(run, [*axes, *(-axes)])
    if not runs:
        return np.zeros((len(case.drive.time), 0))
    return np.asarray(0.5 * (np.array(runs[: len(axes)]) - np.array(runs[len(axes) :])).T)


@dataclass(frozen=True, eq=False)
class Grid:
    """The points at which the error of a free run is followed: every few stamps while its start is read, fewer after.

    `edges` (K + 1,) are stamps; the start is read off the first `begun` points, each of which stands for `stride`
    readings.
    """

    edges: NDArray[np.intp]
    begun: int
    stride: int


def _grid(case: PreparedRecording, process_noise: float, points: int) -> Grid:
    """So many points, and before them those of the first memories of the filter, in which its start is read."""
    count = len(case.drive.time)
    length = _MEMORIES * filter_memory.memory_of(case, process_noise) / case.step
    read = int(np.clip(length, min(_FEWEST_READ, count - 2), max(count // 2, 2)))
    stride = -(-read // _MOST_READ)
    first = np.arange(0, read + 1, stride)
    rest = np.linspace(first[-1], count - 1, points + 1).astype(np.intp)
    return Grid(np.unique(np.concatenate([first, rest])).astype(np.intp), len(first) - 1, stride)


def _estimator(unit: FloatArray, noise: FloatArray, grid: Grid, reading: float) -> FloatArray:
    """The generalised least squares (2, begun) of a change of the start from the errors at the first points.

    `unit` (K, 2) is what a change of the start does to the error, `noise` (K, sources) what torque noise does. Where
    dry friction holds the axis its velocity cannot be told, and stays as it was.
    """
    a, g = unit[: grid.begun], noise[: grid.begun]
    size = np.maximum(np.sqrt(np.mean(a * a, axis=0)), 1e-300)
    covariance = g @ g.T + max(reading / grid.stride, 1e-300) * np.eye(len(a))
    solved = np.linalg.solve(covariance, a / size)
    information = (a / size).T @ solved
    return np.asarray(np.linalg.pinv(information, rcond=1e-9, hermitian=True) @ solved.T / size[:, None])


def _means(found: FloatArray, grid: Grid) -> FloatArray:
    """The error at the first points (begun,): the mean of the readings up to each; zero where there is none."""
    blocks = found[1 : 1 + grid.begun * grid.stride].reshape(grid.begun, grid.stride)
    read = np.isfinite(blocks)
    return np.asarray(np.where(read, blocks, 0.0).sum(axis=1) / np.maximum(read.sum(axis=1), 1))


def _unknown_gap(point: Fit, states: FloatArray) -> FloatArray:
    """Standard deviation (N,) by which the link is ahead or behind because nobody saw where in its gap the motor began:
    anywhere, with the same chance; it shows once the link has moved.
    """
    gap = point.values.get("backlash_gap", 0.0)
    moved = np.abs(states[:, _STATE["position"]] - states[0, _STATE["position"]]) > 0.5 * gap
    return np.asarray(np.where(np.logical_or.accumulate(moved), gap / math.sqrt(12.0), 0.0))


@dataclass(frozen=True, eq=False)
class Started:
    """A free run from the start that the first readings speak for, under the model's own torque noise."""

    case: PreparedRecording  # with that start
    reading: FloatArray  # (N,) what the sensor should read
    factor: FloatArray  # (K, sources) of the error's covariance at the points, that of the start included
    grid: Grid


def started(case: PreparedRecording, point: Fit, points: int) -> Started:
    """Run the model freely from the start that makes the first readings likeliest under its own torque noise.

    A velocity read off the first few counts is wrong by half a count over their time, which a free run keeps for ever
    as an error of that speed times the time constant. The model knows how the axis goes on.
    """
    first = start_state(case.recording)
    case = replace(case, start=(first.position, first.velocity))
    reading = case.reading_variance * point.scale
    grid = _grid(case, point.process_noise, points)
    noise = drift.Noise(point.process_noise * reading, 1.0, 1.0)
    for _ in range(_LOOKS):
        run = likelihood.filtered_states(case, point.structure, point.values, 0.0)
        moves = dynamics(point.structure, point.values, case, run.states)
        factor = drift.factor(moves, grid.edges, noise, case.drive.speed)
        unit, sources = factor[:, :2], factor[:, 2:]
        estimator = _estimator(unit, sources, grid, reading)
        change = estimator @ _means(case.recording.output - run.reading, grid)
        position, velocity = case.start
        case = replace(case, start=(position + float(change[0]), velocity + float(change[1])))
    run = likelihood.filtered_states(case, point.structure, point.values, 0.0)
    # What noise does to the first readings moves the start, and that moves all that follows.
    kept = sources - unit @ (estimator @ sources[: grid.begun])
    own = unit @ estimator * math.sqrt(reading / grid.stride)
    met = _unknown_gap(point, run.states)[grid.edges[1:], None]
    return Started(case, run.reading, np.hstack([kept, own, met]), grid)


def error(case: PreparedRecording, part: RecordingPart, point: Fit, points: int) -> Error:
    """The error of the free run through a part, which starts where the case does.

    Parameters
    ----------
    case : PreparedRecording
        The recording from where the free run starts; its first readings give the initial state.
    part : RecordingPart
        What of the recording is judged. Where it begins later than the recording, the run is moved to the first
        reading in the part.
    point : Fit
        The model, with the covariance of its parameters and its own torque noise.
    points : int
        Of the grid.
    """
    judged = np.flatnonzero(part.inside & np.isfinite(case.recording.output))
    if len(judged) == 0:
        return Error(0.0, 0, np.ones(1), np.zeros((1, 1)), np.zeros((1, 0)), 0.0)
    run = started(case, point, points)
    found, factor = case.recording.output - run.reading, run.factor
    reading = case.reading_variance * point.scale
    ends = run.grid.edges[1:]
    chords = _chords(run.case, point)[ends]
    if part.begin > 0.0 and not case.drive.speed:
        # The first reading becomes the start, with its own noise.
        found = found - found[judged[0]]
        at = min(int(np.searchsorted(ends, judged[0])), len(ends) - 1)
        one = np.full((len(factor), 1), math.sqrt(reading))
        factor, chords = np.hstack([factor - factor[at], one]), chords - chords[at]
    step = np.clip(np.searchsorted(run.grid.edges, judged, "left") - 1, 0, len(ends) - 1)
    share = np.bincount(step, minlength=len(ends)) / len(judged)
    kept = share > 0.0
    squares = float(np.sum(found[judged] ** 2))
    return Error(squares, len(judged), share[kept], factor[kept], chords[kept], reading)


def together(errors: Sequence[Error], was_fitted: bool) -> FreeRun:
    """Several free runs as one: what was found, and what the model's own noise makes of them.

    Runs of different recordings share the errors of the parameters and nothing else. Where the parameters were fitted
    to the same readings their errors take from the free run's error what they can follow; elsewhere they add to it.
    """
    readings = sum(e.readings for e in errors)
    if readings == 0:
        return NOTHING_READ
    weights = [e.readings / readings for e in errors]
    share = np.concatenate([w * e.share for w, e in zip(weights, errors, strict=True)])
    sizes = [len(e.share) for e in errors]
    covariance = np.zeros((sum(sizes), sum(sizes)))
    begin = 0
    for e, size in zip(errors, sizes, strict=True):
        covariance[begin : begin + size, begin : begin + size] = e.factor @ e.factor.T
        begin += size
    sensitivity = np.vstack([e.parameters for e in errors])
    reading = sum(w * e.reading for w, e in zip(weights, errors, strict=True))
    if not was_fitted:
        covariance = covariance + sensitivity @ sensitivity.T
    elif sensitivity.shape[1]:
        # Each point stands for several readings, whose noise averages out.
        covariance = drift.fitted(covariance, sensitivity, reading / np.maximum(share * readings, 1.0))
    null: MeanSquare = drift.mean_square(covariance, share, reading, readings)
    square = sum(e.squares for e in errors) / readings
    return FreeRun(math.sqrt(square), math.sqrt(null.mean), null.chance(square))


def at_own_noise(problem: FitProblem, point: Fit) -> Fit:
    """The same model at the torque noise that makes the recordings likeliest, with its parameters' covariance there.

    A search judges at a noise of its own choice.
    """
    process_noise = optimizer.most_likely_process_noise(
        problem, point.structure, point.values, around=point.process_noise
    )
    return likelihood.evaluate(problem.at(process_noise), point.structure, point.values, point.free)


def free_runs(parts: Sequence[RecordingPart], problem: FitProblem, point: Fit, was_fitted: bool) -> list[Error]:
    """The errors of the free runs through these parts, one for each of the problem's recordings, with the points of the
    grid shared out by length.
    """
    mine = problem.stepped(point.structure)
    whole = sum(len(c.drive.time) for c in mine)
    return [
        error(c, p, point, min(max(POINTS * len(c.drive.time) // whole, FEWEST), len(c.drive.time) - 1))
        for c, p in zip(mine, parts, strict=True)
    ]
