"""A recording made ready for the kernel, and what follows from it alone."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from twin.effects.effect import Recorded
from twin.io.position_loop import own_loop
from twin.io.recording import Recording, command_of, known_quantities
from twin.model.stepper import Structure
from twin.simulation import kernel
from twin.simulation.kernel import Drive

FloatArray = NDArray[np.float64]

#: An axis rests that stays in one count for longer than this, s.
_REST_DURATION = 0.5
#: The filter restarts after a silence of this many s that is also this many times the usual one. How far a model went
#: astray in it is no reading's error.
_MIN_SILENCE, _SILENCE_INTERVALS = 0.5, 10.0


#: Nothing in a model rings faster than its teeth, at 300 Hz at most. Readings at over ten times that rate, which are
#: closer together than this, s, say no more of it.
_CLOSEST_READINGS = 1.0 / 3000.0


@dataclass(frozen=True, eq=False)
class PreparedRecording:
    """A recording made ready for the kernel."""

    recording: Recording
    drive: Drive
    reading_variance: float  # of one reading, output unit squared
    contact: float  # where in the gap the motor starts: -1, 0 or 1
    start: tuple[float, float]  # what is read of the position, and the velocity
    free_run: NDArray[np.bool_] | None = None  # (N,) where the model runs freely and only that is judged; None: nowhere
    contact_mask: NDArray[np.bool_] | None = None  # (N,) readings that are followed but not judged; None: none
    rattle_mask: NDArray[np.bool_] | None = None  # (N,) the same, where motor and link come to no rest; None: nowhere
    start_mask: NDArray[np.bool_] | None = None  # (N,) the same, until motor and link have met; None: nowhere

    @cached_property
    def recorded(self) -> Recorded:
        """What a page may know of the recording: its length, travel and sample time."""
        lowest, highest = float(np.min(self.positions)), float(np.max(self.positions))
        turns = self.recording.is_angle
        return Recorded(float(self.drive.time[-1]), lowest, highest - lowest, turns, self.step, self.recording.lever)

    @cached_property
    def resting(self) -> NDArray[np.bool_]:
        """The stamps (N,) at which nothing but one count is read for long, from the first time that it is read.

        Were the first readings of a count left out, what remains of a slow motion would always be ahead of the count.
        """
        read = np.isfinite(self.drive.measured)
        time, measured = self.drive.time[read], self.drive.measured[read]
        changed = ~(np.abs(np.diff(measured, prepend=np.nan)) < 0.5 * self._count)
        first = np.flatnonzero(changed)
        lasts = np.diff(time[first], append=self.drive.time[-1])
        rests = np.zeros(read.size, dtype=bool)
        rests[read] = (lasts > _REST_DURATION)[np.cumsum(changed) - 1]
        return rests

    @cached_property
    def rounding_allowance(self) -> FloatArray:
        """The part of each reading (N,) that may be rounding and is no error. A resting axis reads the same anywhere
        within its count: that is one error, not one at each stamp."""
        return np.where(self.resting, 0.5 * self._count, 0.0)

    @property
    def _count(self) -> float:
        """Size of the count that an axis may rest in, output unit; where it is read at edges, it passes them."""
        return self.recording.resolution if self.recording.edge_rounding is None else 0.0

    @cached_property
    def renewal(self) -> float:
        """The usual time between readings that are new, s: a computed speed is often held over many stamps."""
        if self.drive.speed:
            read = self.drive.measured[np.isfinite(self.drive.measured)]
            return self.step * len(read) / max(int(np.count_nonzero(np.diff(read))), 1)
        return max(self.step, float(np.median(self._intervals))) if len(self._intervals) else self.step

    @property
    def start_variance(self) -> float:
        """Variance of the position at the start, in those of a reading: at edges, the first is known to a count."""
        if self.recording.edge_rounding is None:
            return 1.0
        return max(self.recording.resolution**2 / 12.0 / self.reading_variance, 1.0)

    @cached_property
    def masked(self) -> NDArray[np.bool_]:
        """The stamps (N,) that are followed but not judged, for whatever reason."""
        led = None if self.free_run is None else ~self.free_run
        masks = [m for m in (self.contact_mask, self.rattle_mask, self.start_mask, led) if m is not None]
        return np.asarray(np.any([np.zeros(len(self.drive.time), dtype=bool), *masks], axis=0))

    @cached_property
    def digest(self) -> bytes:
        """Digest of all that a prediction takes from the case."""
        drive, free = self.drive, self.free_run
        arrays = (
            drive.time,
            drive.command,
            drive.measured,
            drive.known,
            drive.law,
            self.masked,
            self.rounding_allowance,
        )
        digest = hashlib.blake2b(digest_size=16)
        for a in arrays if free is None else (*arrays, free):
            digest.update(a.tobytes())
        rest = (drive.speed, drive.longest, self.reading_variance, self.contact, self.start, self.reading_span)
        digest.update(repr((free is None, rest)).encode())
        return digest.digest()

    @cached_property
    def reading_range(self) -> tuple[float, float]:
        """The least and the largest reading, output unit."""
        return float(np.nanmin(self.recording.output)), float(np.nanmax(self.recording.output))

    @cached_property
    def command_range(self) -> tuple[float, float]:
        """The least and the largest command, input unit."""
        return float(self.drive.command.min()), float(self.drive.command.max())

    @cached_property
    def positions(self) -> FloatArray:
        """Where the link was read to be (M,), axis unit; where a speed is read, since it began."""
        y, time = self.recording.output, self.recording.time
        seen = np.isfinite(y)
        if not self.drive.speed:
            return np.asarray(y[seen])
        return np.asarray(cumulative_trapezoid(np.interp(time, time[seen], y[seen]), time, initial=0.0))

    def stepped(self, structure: Structure) -> PreparedRecording:
        """The same with the longest internal step that the structure allows."""
        longest = 0.002 / structure.substeps * (1.0 + 1e-9)
        same = self.drive.longest == longest
        return self if same else replace(self, drive=replace(self.drive, longest=longest))

    @property
    def reading_span(self) -> float:
        """Range of the readings, output unit."""
        return self.reading_range[1] - self.reading_range[0]

    @cached_property
    def step(self) -> float:
        """The usual time from reading to reading, s."""
        return float(np.median(np.diff(self.drive.time)))

    @cached_property
    def _intervals(self) -> FloatArray:
        """The times between one reading and the next, s."""
        return np.asarray(np.diff(self.drive.time[np.isfinite(self.drive.measured)]))

    @cached_property
    def longest_silence(self) -> float:
        """For how long nothing may be read, s."""
        return (
            max(_MIN_SILENCE, _SILENCE_INTERVALS * float(np.median(self._intervals)))
            if len(self._intervals)
            else _MIN_SILENCE
        )

    @cached_property
    def longest_interval(self) -> float:
        """The longest time between two readings, s; no longer than after which the filter begins anew."""
        return min(float(np.max(self._intervals, initial=0.0)), self.longest_silence)


def _reading_variance(recording: Recording) -> float:
    """Variance of a reading: a twelfth of a count squared, or what third differences say where nothing is counted.

    At edges it is a twelfth of the way squared within which the count changed.
    """
    y = recording.output[np.isfinite(recording.output)]
    third = np.diff(y, 3)
    scatter = float(np.median(np.abs(third)) / 0.6745) ** 2 / 20.0 if len(third) else 0.0
    count = recording.resolution if recording.edge_rounding is None else recording.edge_rounding
    counted = count**2 / 12.0
    if counted > 0.0:
        return max(counted, scatter)
    return max(scatter, (1e-9 * float(np.ptp(y))) ** 2, 1e-30)


def _spaced(time: FloatArray, measured: FloatArray) -> FloatArray:
    """The readings (N,), of which none are taken that come faster than an axis can move.

    An encoder that is read a hundred times within a count rounds a hundred times alike. The likelihood takes such
    errors for independent: their sum would then outweigh all that the motion says.
    """
    read = np.flatnonzero(np.isfinite(measured))
    step = float(np.median(np.diff(time[read]))) if len(read) > 1 else _CLOSEST_READINGS
    every = int(_CLOSEST_READINGS / step)
    if every < 2:
        return measured
    spaced = np.full(len(measured), np.nan)
    spaced[read[::every]] = measured[read[::every]]
    return spaced


def prepare_recording(
    recording: Recording, structure: Structure, closed: bool = False, contact: float = 0.0
) -> PreparedRecording:
    """Make a recording ready; `closed` simulates the rig's own loop from its reference, or raises BadInput."""
    time, command, measured, law = recording.time, command_of(recording), recording.output, np.zeros(5)
    if closed:
        loop = own_loop(recording)
        time, command, law = loop.time, loop.reference, loop.law
        measured = np.full(len(time), np.nan)
        measured[loop.stamps] = recording.output
    if recording.edge_rounding is not None:
        # The first reading is where the model begins, and as one of many it would be too good.
        measured = np.where(np.cumsum(np.isfinite(measured)) > 1, measured, np.nan)
    drive = Drive(
        time=np.ascontiguousarray(time, dtype=float),
        command=np.ascontiguousarray(command, dtype=float),
        measured=_spaced(np.asarray(time), np.ascontiguousarray(measured, dtype=float)),
        speed=recording.is_speed,
        known=kernel.known_vector(known_quantities(recording)),
        law=law,
        longest=0.002 / structure.substeps * (1.0 + 1e-9),
    )
    first = float(recording.output[np.isfinite(recording.output)][0])
    start = (0.0, first) if recording.is_speed else (first, 0.0)
    return PreparedRecording(recording, drive, _reading_variance(recording), contact, start)
