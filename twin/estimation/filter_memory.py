"""The process noise of the Kalman filter, and the memory that follows from it.

The process noise is the density of a white torque noise over the variance of a reading, in 1/s^3 (positions) or 1/s
(speeds). The larger it is, the shorter the filter's memory.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.estimation.prepared_recording import PreparedRecording
from twin.simulation import kernel
from twin.simulation.kernel import Noise

FloatArray = NDArray[np.float64]

#: The filter's memory holds at least this many readings: a shorter one follows the rounding of the last.
MIN_READINGS_IN_MEMORY = 2.0


def process_noise_of(case: PreparedRecording, memory: float) -> float:
    """The noise density, in units of the reading's variance, at which the filter's memory is `memory` seconds."""
    step = case.step
    return step / memory**2 if case.drive.speed else step / memory**4


def memory_of(case: PreparedRecording, process_noise: float) -> float:
    """The filter's memory, s, at a noise density; the inverse of `process_noise_of`."""
    return float((case.step / process_noise) ** (0.5 if case.drive.speed else 0.25))


def filter_noise(case: PreparedRecording, process_noise: float) -> Noise:
    """The filter's beliefs about a case; a density of zero is a free run, from the first reading as it is."""
    if process_noise == 0.0:
        return kernel.FREE
    spread, duration = case.reading_span, max(float(case.drive.time[-1]), 1e-9)
    velocity = (spread if case.drive.speed else max(spread / duration, 1e-3 * spread)) ** 2
    return Noise(
        process_noise,
        case.start_variance,
        1.0 if case.drive.speed else velocity / case.reading_variance,
        case.longest_silence,
    )


def largest_process_noise(cases: Sequence[PreparedRecording]) -> float:
    """The noise density at which the filter weighs the fewest readings that it may."""
    return min(process_noise_of(c, MIN_READINGS_IN_MEMORY * c.renewal) for c in cases)
