"""Where the search starts: speeds and accelerations by local polynomials, then one robust regression."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from twin.axis import Structure
from twin.likelihood import Case

FloatArray = NDArray[np.float64]


def motion(case: Case, window: float = 0.1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Command, speed and acceleration (each (N,)) on an even grid; only where readings are dense."""
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
    if case.drive.speed:
        speed = savgol_filter(values, width, order)
        acceleration = savgol_filter(values, width, order, deriv=1, delta=step)
    else:
        speed = savgol_filter(values, width, order, deriv=1, delta=step)
        acceleration = savgol_filter(values, width, order, deriv=2, delta=step)
    return command, speed, acceleration


def start_values(cases: Sequence[Case], structure: Structure) -> dict[str, float]:
    """Values to start from: input gain, viscous friction and what is lost on the way, by least squares."""
    parts = [motion(c) for c in cases]
    command, speed, acceleration = (np.concatenate([p[i] for p in parts]) for i in range(3))
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
    if "backlash_gap" in values:
        values["backlash_gap"] = min(0.01, 0.01 * float(np.max(np.abs(speed))))
    return values
