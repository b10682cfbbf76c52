"""A free run from the start that the model itself reads off the first readings, and what noise makes of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import drift
from twin.diagnosis.drift import Dynamics
from twin.estimation import filter_memory, likelihood
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.fmi.python_fmu import start_state
from twin.io.recording import known_quantities
from twin.model import equations
from twin.model.stepper import STATES, Structure

FloatArray = NDArray[np.float64]

#: Readings that the start of a free run is estimated from: memories of the filter, least number, most averages, and
#: passes.
_MEMORIES, _FEWEST_READ, _MOST_READ, _LOOKS = 6.0, 10, 100, 2
#: Share of a variable's range by which it is moved to see how a torque goes with it.
_MOVED = 1e-4
_STATE = {name: i for i, name in enumerate(STATES)}


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
    dry friction holds the axis its velocity cannot be told, and stays as it was. So does the whole start where errors
    grow beyond all numbers.
    """
    a, g = unit[: grid.begun], noise[: grid.begun]
    if not (np.isfinite(a).all() and np.isfinite(g).all()):
        return np.zeros((2, len(a)))
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
    """Standard deviation (N,) of the link's position from the motor's unknown place in its gap at the start. All places
    are equally likely. It shows once the link has moved.
    """
    gap = point.values.get("backlash_gap", 0.0)
    moved = np.abs(states[:, _STATE["position"]] - states[0, _STATE["position"]]) > 0.5 * gap
    return np.asarray(np.where(np.logical_or.accumulate(moved), gap / math.sqrt(12.0), 0.0))


@dataclass(frozen=True, eq=False)
class Started:
    """A free run from the likeliest start for the first readings, under the model's own torque noise."""

    case: PreparedRecording  # with that start
    reading: FloatArray  # (N,) what the sensor should read
    factor: FloatArray  # (K, sources) of the error's covariance at the points, that of the start included
    grid: Grid


@np.errstate(over="ignore", invalid="ignore")
def started(case: PreparedRecording, point: Fit, points: int) -> Started:
    """Run the model freely from the start that makes the first readings likeliest under its own torque noise.

    A velocity read off the first few counts is wrong by half a count over their time. A free run keeps this as an error
    of that speed times the time constant. The model knows how the axis goes on.
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
