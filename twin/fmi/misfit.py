"""How far an FMU is from a recording: the errors of its free run, or of its prediction a set time ahead."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.errors import BadInput
from twin.fmi.python_fmu import Replay
from twin.io.recording import Recording

FloatArray = NDArray[np.float64]

#: Stamps are rounded: a stamp that is early by this share of the time ahead is on time.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Misfit:
    """The errors of an FMU on one recording.

    Attributes
    ----------
    time
        s (N,), the stamps that the errors belong to.
    error
        Simulated less recorded (N,), in the unit of the output; NaN where a reading is left out.
    span
        Range of what was to be predicted, in the unit of the output.
    ahead
        How far ahead was predicted, s; None for the free run.
    """

    time: FloatArray
    error: FloatArray
    span: float
    ahead: float | None = None

    @property
    def rmse(self) -> float:
        """Root mean square error, in the unit of the output."""
        return float(np.sqrt(np.nanmean(self.error**2)))

    @property
    def peak(self) -> float:
        """Largest error without its sign, in the unit of the output."""
        return float(np.nanmax(np.abs(self.error)))

    @property
    def nrmse_percent(self) -> float:
        """rmse over the range of what was to be predicted, percent."""
        return 100.0 * self.rmse / self.span if self.span > 0.0 else math.inf

    def worst(self, length: float = 1.0) -> tuple[float, float]:
        """The stretch of that length (s) with the largest sum of squared errors: its begin and its end, s."""
        summed = np.concatenate([[0.0], np.cumsum(np.nan_to_num(self.error) ** 2)])
        ends = np.searchsorted(self.time, self.time + length)
        first = int(np.argmax(summed[ends] - summed[:-1]))
        # A stretch that the recording's end cuts short shows what led there instead.
        begin = max(min(float(self.time[first]), float(self.time[-1]) - length), float(self.time[0]))
        return begin, min(begin + length, float(self.time[-1]))


def misfit(recording: Recording, ran: Replay, ahead: float | None = None, since: float = 0.0) -> Misfit:
    """Errors of a free run, or of the prediction `ahead` seconds ahead.

    The prediction is the recorded output plus what the FMU moves from then on. The error of the free run at that time
    is subtracted as a constant output disturbance, as in dynamic matrix control (Cutler and Ramaker, 1980). So errors
    that were gathered long before do not count, and those that arise within that time do, such as those of a lag.

    Parameters
    ----------
    recording
        What was measured.
    ran
        The free run of the FMU over it.
    ahead
        s; None for the free run itself.
    since
        s; what comes before is not judged. A position is then moved to the first reading that is judged, as for a free
        run in a diagnosis. Without that, a lag that starts at rest amid the motion would leave a permanent offset.

    Raises
    ------
    BadInput
        The recording is shorter than that, or no two readings are so far apart.
    """
    time, error, wanted = recording.time, ran.output(recording) - recording.output, recording.output
    if ahead is not None:
        if not 0.0 < ahead <= time[-1]:
            raise BadInput(f"`ahead` is {ahead:g} s and {recording.name} lasts {time[-1]:.3g} s: give a time within it")
        later = np.searchsorted(time, time + ahead * (1.0 - _ROUNDING))
        later = later[later < len(time)]
        error, wanted = (v[later] - v[: len(later)] for v in (error, wanted))
        time = time[later]
    inside = time >= since
    time, error, wanted = time[inside], error[inside], wanted[inside]
    seen = np.isfinite(error)
    if not seen.any():
        raise BadInput(f"{recording.name}: no readings are left to judge by, or none so far apart: give a longer one")
    if since > 0.0 and ahead is None and not recording.is_speed:
        error = error - error[np.argmax(seen)]
    return Misfit(time, error, float(np.ptp(wanted[seen])), ahead)
