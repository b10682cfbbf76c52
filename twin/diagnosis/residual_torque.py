"""Where simulation and recording differ: the missing torque, in time, in the state and in the machine.

The position error is the double integral of what is missing, so it shows the misfit late, smeared and everywhere after.
The missing torque is what a filter with a short memory has to add to the model at each stamp to follow the recording.
It is the velocity correction per time, shifted back by the filter's delay.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.estimation import filter_memory, likelihood
from twin.estimation.prepared_recording import PreparedRecording
from twin.model.stepper import Structure

FloatArray = NDArray[np.float64]

#: Memory of the filter that reads the missing torque, s: short enough to see an edge, long enough to beat the count.
TORQUE_MEMORY = 0.04
#: Length of the averages in which it is regressed and laid out in tables, s: half of that memory.
AVERAGING_TIME = 0.5 * TORQUE_MEMORY
_BLOCKS = 20


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """The torque that the model lacks, along the recording. All arrays have shape (N,)."""

    time: FloatArray  # s
    torque: FloatArray  # acceleration of the axis, NaN where nothing was read
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    command: FloatArray
    step: float  # median sample time, s
    averaging: float = AVERAGING_TIME  # length of its averages, s

    @property
    def rms(self) -> float:
        """Root mean square of the torque; zero where nothing was read."""
        read = self.torque[np.isfinite(self.torque)]
        return float(np.sqrt(np.sum(np.square(read)) / max(len(read), 1)))

    @property
    def acceleration_rms(self) -> float:
        """Root mean square of the acceleration of the axis."""
        return float(np.sqrt(np.mean(np.square(self.acceleration))))

    @property
    def time_of_largest(self) -> float:
        """When it is largest, s."""
        return float(self.time[np.nanargmax(np.abs(self.torque))])

    def between(self, begin: float, end: float) -> MissingTorque:
        """From one moment (s) to another."""
        here = (self.time >= begin) & (self.time <= end)
        return MissingTorque(
            self.time[here], self.torque[here], self.position[here], self.velocity[here], self.acceleration[here],
            self.command[here], self.step, self.averaging,
        )  # fmt: skip

    def state(self, variable: str) -> FloatArray:
        """The named variable along the recording: one of `VARIABLES`."""
        table = {
            "position": self.position,
            "velocity": self.velocity,
            "acceleration": self.acceleration,
            "input": self.command,
            "load": self.acceleration,
            "time": self.time,
            "direction": np.sign(self.velocity) * (np.abs(self.velocity) > 0.02 * np.nanmax(np.abs(self.velocity))),
        }
        chosen: FloatArray = table[variable]
        return chosen

    def averages(self) -> dict[str, FloatArray]:
        """Torque and states, each averaged over `averaging` (M,); NaN where any of what is averaged is."""
        width = max(round(self.averaging / self.step), 1)
        count = len(self.time) // width
        columns = {
            "torque": self.torque,
            "position": self.position,
            "velocity": self.velocity,
            "acceleration": self.acceleration,
            "input": self.command,
            "time": self.time,
        }
        return {n: c[: count * width].reshape(count, width).mean(axis=1) for n, c in columns.items()}


VARIABLES = ("position", "velocity", "direction", "acceleration", "input", "time")


@dataclass(frozen=True, eq=False)
class TorqueShape:
    """The missing torque over one variable: bin centres, mean, standard error (each (bins,)), and what it explains."""

    variable: str
    centre: FloatArray
    mean: FloatArray
    error: FloatArray
    share: float  # of the missing torque's variance that this shape predicts on blocks it was not drawn from


def _advanced(values: FloatArray, samples: int) -> FloatArray:
    if samples <= 0:
        return values
    shifted = np.full_like(values, np.nan)
    shifted[:-samples] = values[samples:]
    return shifted


def _held_back(time: FloatArray, corrections: FloatArray, read: NDArray[np.intp], longest: float) -> FloatArray:
    """Each reading's correction per time since the reading before it, at all stamps (N,) since then.

    NaN in silences of more than `longest` seconds: when the torque acted in them is not known.
    """
    if len(read) == 0:
        return np.full(len(time), np.nan)
    before = np.append(read[0] - 1, read[:-1])
    since = time[read] - np.where(before >= 0, time[before], time[read] - longest)
    rates = np.where(since > longest, np.nan, corrections[read] / since)
    following = np.searchsorted(read, np.arange(len(time)))
    return np.asarray(np.append(rates, np.nan)[following])


def missing_torque(
    case: PreparedRecording, structure: Structure, values: Mapping[str, float], memory: float = TORQUE_MEMORY
) -> MissingTorque:
    """Read the missing torque off the corrections of a filter with the given memory, s. Its averages last half of that.

    A sensor may be read more slowly than it is logged. Each correction then covers the time since the last reading.
    """
    case = case.stepped(structure)
    step = float(np.median(np.diff(case.drive.time)))
    read = np.flatnonzero(np.isfinite(case.drive.measured))
    usual = float(np.median(np.diff(case.drive.time[read]))) if len(read) > 1 else step
    averaging, memory = 0.5 * memory, max(memory, 4.0 * usual)
    run = likelihood.filtered_states(case, structure, values, filter_memory.process_noise_of(case, memory))
    raw = _held_back(case.drive.time, run.pull * (case.drive.measured - run.reading), read, memory)
    # A second-order filter at its optimum delays by the square root of two of its memory; a first-order one by it.
    late = round((1.0 if case.drive.speed else np.sqrt(2.0)) * memory / step)
    torque = _advanced(raw, late)
    for begun in (0, *np.flatnonzero(np.isnan(run.reading))):
        torque[max(begun - late, 0) : begun + int(5.0 * memory / step)] = np.nan
    velocity = run.states[:, 1]
    return MissingTorque(
        time=case.drive.time,
        torque=torque,
        position=run.states[:, 0],
        velocity=velocity,
        acceleration=np.gradient(velocity, case.drive.time),
        command=case.recording.input,
        step=step,
        averaging=averaging,
    )


def _bins(variable: str, values: FloatArray, count: int) -> NDArray[np.intp]:
    """The bin of each value: as many values in each; directions as they are."""
    if variable == "direction":
        return (values + 1.0).astype(np.intp)
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)[1:-1]))
    return np.searchsorted(edges, values)


def torque_shape(missing: MissingTorque, variable: str, bins: int = 30) -> TorqueShape:
    """The mean missing torque over a variable, and what it predicts on blocks of time held out in turn."""
    values = missing.state(variable)
    ok = np.isfinite(missing.torque) & np.isfinite(values)
    torque, values = missing.torque[ok], values[ok]
    which = _bins(variable, values, bins)
    count = int(which.max()) + 1
    block = (np.arange(len(torque)) * _BLOCKS) // max(len(torque), 1)
    flat = which * _BLOCKS + block
    totals = np.bincount(flat, torque, count * _BLOCKS).reshape(count, _BLOCKS)
    weights = np.bincount(flat, minlength=count * _BLOCKS).reshape(count, _BLOCKS).astype(float)
    whole, weight = totals.sum(axis=1), weights.sum(axis=1)
    mean = whole / np.maximum(weight, 1.0)
    others = (whole[:, None] - totals) / np.maximum(weight[:, None] - weights, 1.0)
    left = torque - others[which, block]
    share = 1.0 - float(np.sum(left**2) / max(np.sum(torque**2), 1e-300))
    per_block = totals / np.maximum(weights, 1.0)
    seen = np.maximum((weights > 0).sum(axis=1), 1)
    scatter = np.sqrt(np.sum((weights > 0) * (per_block - mean[:, None]) ** 2, axis=1) / seen)
    centre = np.bincount(which, values, count) / np.maximum(weight, 1.0)
    filled = weight > 0
    return TorqueShape(variable, centre[filled], mean[filled], (scatter / np.sqrt(seen))[filled], max(share, 0.0))


def torque_shapes(missing: MissingTorque) -> list[TorqueShape]:
    """The shape over every variable, the most telling first."""
    return sorted((torque_shape(missing, v) for v in VARIABLES), key=lambda s: -s.share)
