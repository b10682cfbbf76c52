"""Where the search starts: speeds and accelerations by local polynomials, then one robust regression."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.estimation.prepared_recording import PreparedRecording
from twin.model.stepper import Structure

FloatArray = NDArray[np.float64]

#: A limit of the drive begins at this share of the largest command. Above that no slope leads back to it.
_START_OF_LIMIT = 0.9


def local_slope(values: FloatArray, width: int, order: int, rank: int, step: float) -> FloatArray:
    """Derivative of this rank of the polynomial that fits each value's `width` neighbours best, (N,).

    At the ends it is that of the first and the last `width` values (Savitzky and Golay, Anal. Chem. 36, 1964). SciPy's
    own comes with a module that takes half a second to import.
    """
    half = width // 2
    offsets = np.arange(-half, half + 1) / half
    powers = np.vander(offsets, order + 1, increasing=True)
    fits = np.linalg.pinv(powers)
    slopes = np.zeros_like(powers)
    for k in range(rank, order + 1):
        slopes[:, k] = math.perm(k, rank) * offsets ** (k - rank)
    slopes /= (half * step) ** rank
    inside = np.correlate(values, slopes[half] @ fits, "valid")
    begin, end = (slopes @ (fits @ part) for part in (values[:width], values[-width:]))
    return np.concatenate([begin[:half], inside, end[half + 1 :]])


def smoothed_motion(
    case: PreparedRecording, window: float = 0.1
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Reading, command, speed and acceleration (each (N,)) on an even grid, where readings are dense."""
    time, y = case.drive.time, case.drive.measured
    ok = np.isfinite(y)
    step = float(np.median(np.diff(time)))
    grid = np.arange(time[0], time[-1], step)
    values = np.interp(grid, time[ok], y[ok])
    width = max(int(window / step) // 2 * 2 + 1, 5)
    if len(grid) <= width:
        width = max((len(grid) - 1) // 2 * 2 - 1, 3)
    order = min(3, width - 1)
    command = case.recording.input[np.clip(np.searchsorted(time, grid, "right") - 1, 0, len(time) - 1)]
    rank = 0 if case.drive.speed else 1
    speed, acceleration = (local_slope(values, width, order, rank + k, step) for k in range(2))
    # A slope across a silence is no speed.
    after = np.clip(np.searchsorted(time[ok], grid), 1, int(ok.sum()) - 1)
    apart = time[ok][after] - time[ok][after - 1]
    dense = apart <= max(window, 3.0 * float(np.median(apart)))
    return values[dense], command[dense], speed[dense], acceleration[dense]


def start_values(cases: Sequence[PreparedRecording], structure: Structure) -> dict[str, float]:
    """Values to start from: input gain, viscous friction and what is lost on the way, by least squares."""
    parts = [smoothed_motion(c) for c in cases]
    _, command, speed, acceleration = (np.concatenate(column) for column in zip(*parts, strict=True))
    moving = np.abs(speed) > 0.02 * np.max(np.abs(speed))
    columns = np.column_stack([command, -speed, -np.sign(speed)])[moving]
    weight = np.ones(moving.sum())
    solution = np.zeros(3)
    for _ in range(10):
        solution = np.linalg.lstsq(columns * weight[:, None], acceleration[moving] * weight, rcond=None)[0]
        rest = np.abs(acceleration[moving] - columns @ solution)
        weight = np.sqrt(1.0 / np.maximum(rest / max(float(np.median(rest)), 1e-12), 1.0))
    values = {p.name: p.start for p in structure.parameters}
    span = float(np.max(np.abs(command)))
    gain = solution[0] if solution[0] > 0.0 else float(np.std(acceleration) / max(np.std(command), 1e-12))
    values["input_gain"] = float(gain)
    if "viscous_friction" in values:
        values["viscous_friction"] = float(max(solution[1], 0.05))
    if "dead_band_forward" in values:
        lost = float(np.clip(solution[2] / gain, 0.002 * span, 0.3 * span))
        values["dead_band_forward"] = values["dead_band_reverse"] = lost
    if "saturation_limit" in values:
        values["saturation_limit"] = _START_OF_LIMIT * span
    if "own_inertia" in values:
        values |= _with_payload(cases, parts)
    if "backlash_gap" in values:
        values["backlash_gap"] = 0.01 * min(cases[0].recording.lever, float(np.max(np.abs(speed))))
    return values


def _with_payload(
    cases: Sequence[PreparedRecording], parts: Sequence[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]
) -> dict[str, float]:
    """Input gain, viscous friction and own inertia where payloads are known.

    The regression explains the command by the motion, not the other way round. The known payloads, with their weight
    and acceleration, set the scale. The noise of the acceleration then stays on the side where it does least harm.
    """
    rows, commands = [], []
    for case, (place, command, speed, acceleration) in zip(cases, parts, strict=True):
        inertia, moment = case.drive.known
        load = inertia * acceleration + 9.80665 * moment * np.sin(place)
        rows.append(np.column_stack([acceleration, speed, np.sign(speed), load]))
        commands.append(command)
    columns, wanted = np.concatenate(rows), np.concatenate(commands)
    moving = np.abs(columns[:, 1]) > 0.02 * np.max(np.abs(columns[:, 1]))
    per_gain, damping, _, per_torque = np.linalg.lstsq(columns[moving], wanted[moving], rcond=None)[0]
    if min(per_gain, damping, per_torque) <= 0.0:
        return {}
    return {
        "input_gain": float(1.0 / per_gain),
        "viscous_friction": float(damping / per_gain),
        "own_inertia": float(per_gain / per_torque),
    }
