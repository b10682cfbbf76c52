"""The likelihood of recordings under a model, and its maximum.

The model runs in innovation form: a Kalman filter whose only two numbers are the variance of a reading (known
from the encoder's count) and the density of a white torque noise (estimated). A free run would drift away with
every unmodelled torque and then weigh it twice over; short windows would throw away what connects them; a free
autoregressive noise model would absorb the very misfit that is looked for. With torque noise as the only freedom
the predictor forgets at the rate that the recording itself asks for.

The filter knows whether motor and link touch. In the gap each is moved by its own half of the noise, and nobody sees
the motor; when they meet, what was known of their mass centre is what is known of both.

The maximum is found by Gauss-Newton steps on exact derivatives, with damping, bounds and a robust loss.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from twin.io.position_loop import own_loop
from twin.io.recording import Recording, command_of, known_quantities
from twin.model import sensor
from twin.model.stepper import EVERYTHING, STATES, Structure
from twin.parallel import each
from twin.simulation import kernel
from twin.simulation.kernel import INDEX, Drive, Noise

FloatArray = NDArray[np.float64]

#: Normalised innovations beyond this count linearly, not squared (Huber).
HUBER_LIMIT = 4.0
#: The filter weighs at least so many new readings: one that forgets faster follows the rounding of the last.
MIN_READINGS_IN_MEMORY = 2.0
#: Stamps whose slopes are held at once: an hour at 2 ms has eighteen times as many.
MAX_STAMPS_AT_ONCE = 100_000
#: Information along a direction, over that of its parameters each by itself, below which nothing determines it: slopes
#: are rounded to seven digits, which leaves 1e-13 where there is none.
EIGENVALUE_FLOOR = 1e-10
#: A unit of deviance worth so little says that the model errs.
OVERDISPERSION_OF_WRONG_MODEL = 5.0
#: A gradient that scatters by less than this share of what the information says is one of slopes that have run away.
OVERDISPERSION_OF_CHAOS = 0.3
#: Slopes that are so many times as large as the drive can make them within the filter's memory have run away; where
#: the motor does not rattle they are no larger than once that, and six times where motor and link meet. No memory is
#: taken to be shorter than this, s: for so long a meeting shows.
MAX_SLOPE_RATIO, _CONTACT_DURATION = 10.0, 0.05
#: Deviance from which on a change is one that is seen: what is not seen has no slope but the rounding's.
MIN_VISIBLE_DEVIANCE = 1e-6
#: Stretches beyond one for each parameter from more than which their scatter can be told.
SPARE_BLOCKS = 4
#: Far from the maximum that worth says nothing: a climb ends at so many times its tolerance at most.
MAX_OVERDISPERSION = 10.0
_DELAY_OFFSET = 1e-7  # s
#: So many steps in a row that bring nothing, each much shorter than the one before, end a climb.
MAX_REFUSED_STEPS = 4
#: Longer than innovations of a slightly wrong model stay correlated, s.
BLOCK_LENGTH = 0.5
#: An axis rests that stays in one count for longer than this, s.
_REST_DURATION = 0.5
#: After a silence of so many s, and so many times the usual one, the filter begins anew: how far a model went astray in
#: it is no reading's error.
_MIN_SILENCE, _SILENCE_INTERVALS = 0.5, 10.0
_BOUNDS = {p.name: (p.lower, p.upper) for p in EVERYTHING.parameters}


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
    def resting(self) -> NDArray[np.bool_]:
        """The stamps (N,) at which nothing but one count is read for long, from the first time that it is read.

        Were the first readings of a count left out, what remains of a slow motion would always be ahead of the count.
        """
        time, measured = self.drive.time, self.drive.measured
        changed = ~(np.abs(np.diff(measured, prepend=np.nan)) < 0.5 * self.recording.resolution)
        first = np.flatnonzero(changed)
        lasts = np.diff(time[first], append=time[-1])
        return np.asarray((lasts > _REST_DURATION)[np.cumsum(changed) - 1])

    @cached_property
    def rounding_allowance(self) -> FloatArray:
        """What rounding may take from each reading (N,) and is no error: a resting axis reads the same anywhere within
        its count, and that is one error, not one at each stamp."""
        return np.where(self.resting, 0.5 * self.recording.resolution, 0.0)

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
    """Variance of a reading: a twelfth of a count squared, or what third differences say where nothing is counted."""
    y = recording.output[np.isfinite(recording.output)]
    third = np.diff(y, 3)
    scatter = float(np.median(np.abs(third)) / 0.6745) ** 2 / 20.0 if len(third) else 0.0
    counted = recording.resolution**2 / 12.0
    if counted > 0.0:
        return max(counted, scatter)
    return max(scatter, (1e-9 * float(np.ptp(y))) ** 2, 1e-30)


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
    drive = Drive(
        time=np.ascontiguousarray(time, dtype=float),
        command=np.ascontiguousarray(command, dtype=float),
        measured=np.ascontiguousarray(measured, dtype=float),
        speed=recording.is_speed,
        known=kernel.known_vector(known_quantities(recording)),
        law=law,
        longest=0.002 / structure.substeps * (1.0 + 1e-9),
    )
    first = float(recording.output[np.isfinite(recording.output)][0])
    start = (0.0, first) if recording.is_speed else (first, 0.0)
    return PreparedRecording(recording, drive, _reading_variance(recording), contact, start)


@contextmanager
def _ignore_overflow() -> Iterator[None]:
    """For values so wild that the model overflows, and parameters that leave no trace and so have no end of variance.

    Both are looked for in what comes out, and no news. Every thread has to be told anew.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        yield


@dataclass(frozen=True, eq=False)
class Fit:
    """A model at certain values: what there is to know for the next step."""

    structure: Structure
    values: dict[str, float]
    process_noise: float  # torque noise over reading variance, 1/s^3 (positions) or 1/s (speeds)
    free: tuple[str, ...]
    deviance: float  # minus twice the log-likelihood, up to a constant of the data
    scale: float  # innovation variance found over that expected
    information: FloatArray  # (n, n) information about the free parameters
    gradient: FloatArray  # (n,) of the log-likelihood
    scatter: FloatArray  # (n, n) of the gradient, from stretch to stretch; the information where the model is right
    converged: bool = True
    message: str = ""

    @property
    @_ignore_overflow()
    def covariance(self) -> FloatArray:
        """Of the free parameters; what cannot be seen gets a huge variance, not a small one, and what leaves no trace
        an infinite one, and none with others."""
        eigenvalues, vectors, size = self._eigen
        inverse = (vectors / np.maximum(eigenvalues, EIGENVALUE_FLOOR)) @ vectors.T
        found = np.asarray(inverse / np.outer(size, size))
        lost = ~np.isfinite(np.diag(found))
        found[lost, :] = found[:, lost] = 0.0
        found[lost, lost] = np.inf
        return found

    @cached_property
    @_ignore_overflow()
    def _eigen(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Eigenvalues (n,) and vectors (n, n) of the information, each parameter in units of its own (n,)."""
        size = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        eigenvalues, vectors = np.linalg.eigh(self.information / np.outer(size, size))
        return eigenvalues, vectors, size

    @property
    @_ignore_overflow()
    def robust_covariance(self) -> FloatArray:
        """Covariance (n, n) of the free parameters that holds where the model errs a little, too.

        The information says how sharply the likelihood bends; how much its slope scatters from stretch to stretch
        says how far the maximum may have moved (White's sandwich, Econometrica 50, 1982). Innovations that a
        slightly wrong model leaves correlated make the second larger; each standard error is the larger of the two.
        """
        wider = np.sqrt(np.fmax(self._variance_inflation, 1.0))
        return np.asarray(self.covariance * np.outer(wider, wider))

    @cached_property
    @_ignore_overflow()
    def _variance_inflation(self) -> FloatArray:
        """Variances (n,) that the scatter of the slopes bears out, over those that the information promises.

        In directions that nothing determines, as gain and dead-band where the command knows one size, both are nothing
        over nothing: what they leave a parameter is what counts, NaN where that is nothing.
        """
        eigenvalues, vectors, size = self._eigen
        known = eigenvalues > EIGENVALUE_FLOOR
        plain = (vectors[:, known] / eigenvalues[known]) @ vectors[:, known].T / np.outer(size, size)
        return np.asarray(np.diag(plain @ self.scatter @ plain) / np.diag(plain))

    @cached_property
    def visible(self) -> NDArray[np.bool_]:
        """Which free parameters (n,) leave a trace: to move one by its own size, or by one, would not go unseen."""
        sizes = np.array([max(abs(self.values.get(n, 0.0)), 1.0) for n in self.free])
        return np.asarray(np.diag(self.information) * sizes**2 > MIN_VISIBLE_DEVIANCE)

    @property
    def overdispersion(self) -> float:
        """What one unit of deviance is worth here: the more the model errs, the less a change of one means."""
        return self.overdispersion_by(self.free)

    @_ignore_overflow()
    def overdispersion_by(self, names: Iterable[str]) -> float:
        """The same by some parameters alone, or by all where none of these is free.

        Parameters that leave no trace have no say in it.
        """
        if not self.free:
            return 1.0
        among = set(names) & set(self.free) or set(self.free)
        own = self._variance_inflation[[n in among for n in self.free]]
        traced = own[np.isfinite(own)]
        return float(np.median(np.maximum(traced, 1.0))) if len(traced) else math.nan

    @property
    @_ignore_overflow()
    def is_chaotic(self) -> bool:
        """Whether the slopes have grown from bounce to bounce until they say nothing about the maximum.

        They then promise an information that the gradient's scatter gives the lie to.
        """
        traced = self._variance_inflation[np.isfinite(self._variance_inflation)]
        return bool(len(traced)) and float(np.median(traced)) < OVERDISPERSION_OF_CHAOS


def _initial_state(
    case: PreparedRecording, structure: Structure, values: Mapping[str, float], free: Sequence[str]
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """The states at the start and their derivatives (states, n): it begins where its sensor reads what was read."""
    gap, (reading, velocity) = 0.5 * case.contact, case.start
    begins = sensor.position(structure, values, reading)
    x = kernel.start_state(begins, velocity, gap * values.get("backlash_gap", 0.0))
    slope = np.zeros((len(STATES), len(free)))
    for name in set(sensor.parameters(structure)).intersection(free):
        slope[0, free.index(name)] = sensor.slope(structure, values, reading, name)
    if "backlash_gap" in free:
        slope[2, free.index("backlash_gap")] = gap
    return x, slope


def process_noise_of(case: PreparedRecording, memory: float) -> float:
    """The noise density, in units of the reading's variance, at which the filter forgets after `memory` seconds."""
    step = case.step
    return step / memory**2 if case.drive.speed else step / memory**4


def memory_of(case: PreparedRecording, process_noise: float) -> float:
    """After how many seconds the filter forgets at a noise density; the inverse of `process_noise_of`."""
    return float((case.step / process_noise) ** (0.5 if case.drive.speed else 0.25))


def with_free_runs(case: PreparedRecording, process_noise: float, horizon: float) -> PreparedRecording:
    """The case for predictions up to `horizon` seconds ahead: free runs of that length, or to the recording's end, each
    after a few memories of the filter in which it finds the state.
    """
    settled = min(5.0 * memory_of(case, process_noise), 0.1 * float(case.drive.time[-1]))
    lead = max(settled, MIN_READINGS_IN_MEMORY * case.step)
    return replace(case, free_run=np.asarray(case.drive.time % (lead + horizon) >= lead), rattle_mask=None)


def filter_noise(case: PreparedRecording, process_noise: float) -> Noise:
    """The filter's beliefs about a case; a density of zero is a free run, from the first reading as it is."""
    if process_noise == 0.0:
        return kernel.FREE
    spread, duration = case.reading_span, max(float(case.drive.time[-1]), 1e-9)
    velocity = (spread if case.drive.speed else max(spread / duration, 1e-3 * spread)) ** 2
    return Noise(
        process_noise, 1.0, 1.0 if case.drive.speed else velocity / case.reading_variance, case.longest_silence
    )


def huber_loss(normalised: FloatArray) -> FloatArray:
    """Huber's loss of normalised innovations: what they take from twice the log-likelihood."""
    z = np.abs(normalised)
    return np.asarray(np.where(z > HUBER_LIMIT, HUBER_LIMIT * (2.0 * z - HUBER_LIMIT), z**2))


@dataclass(frozen=True, eq=False)
class Innovations:
    """Of one case: readings minus predictions, their expected variance, and derivatives if asked for."""

    error: FloatArray  # (N,) output unit; NaN where there is no reading
    variance: FloatArray  # (N,) expected, before the common scale
    slopes: FloatArray  # (N, n) of the prediction


def _diverged_slopes(
    case: PreparedRecording, process_noise: float, free: tuple[str, ...], slopes: FloatArray
) -> NDArray[np.bool_]:
    """The stamps (N,) whose slopes have grown from bounce to bounce until they say nothing.

    What another gain does to an axis is forgotten with the filter's memory, and so is about what the drive does within
    it, or within the time that motor and link take to meet. Where a light motor bounces in its gap a slope grows beyond
    that, by a factor with each bounce, and a handful of such stamps would outweigh all others.
    """
    # A free run forgets nothing, and one under its own loop is driven by what it reads.
    if process_noise == 0.0 or case.free_run is not None or case.drive.closed or "input_gain" not in free:
        return np.zeros(len(slopes), dtype=bool)
    memory = max(memory_of(case, process_noise), _CONTACT_DURATION) + case.longest_interval
    push = max(map(abs, case.command_range)) * memory ** (1 if case.drive.speed else 2)
    return ~(np.abs(slopes[:, free.index("input_gain")]) <= MAX_SLOPE_RATIO * push)


def innovations_in_pieces(
    case: PreparedRecording,
    structure: Structure,
    values: Mapping[str, float],
    process_noise: float,
    free: tuple[str, ...],
    most: int,
) -> Iterator[Innovations]:
    """Run one case through the predictor, at most so many stamps at a time; slopes only where parameters are free."""
    p = kernel.vector(structure, dict(values))
    # Where an edge of the command falls on a stamp the delay has a kink: it is looked at from just behind.
    p[INDEX["delay"]] += _DELAY_OFFSET
    noise = filter_noise(case, process_noise)
    x, slope = _initial_state(case, structure, values, free)
    drive = case.drive
    if case.free_run is not None:
        drive = replace(drive, measured=np.where(case.free_run, np.nan, drive.measured))
    if free:
        runs = kernel.in_pieces(drive, p, x, slope, free, noise, most)
    else:
        runs = iter([(slice(None), kernel.predict(drive, p, x, noise))])
    judge = kernel.compiled().judging
    for at, run in runs:
        rounding, error, variance = case.rounding_allowance[at], run.reading, run.spread
        judge(case.drive.measured[at], case.masked[at], rounding, case.reading_variance, error, variance)
        if case.free_run is not None:
            # What drifts away in a free run is no reading's noise: the errors of all recordings are weighed alike.
            variance[:] = 1.0
        if free:
            run.slopes[(error == 0.0) & (rounding > 0.0)] = 0.0
            run.slopes[_diverged_slopes(case, process_noise, free, run.slopes)] = 0.0
        yield Innovations(error, variance, run.slopes)


def filtered_states(
    case: PreparedRecording, structure: Structure, values: Mapping[str, float], process_noise: float
) -> kernel.Prediction:
    """The case run through the predictor, with the state (N, states) at each stamp."""
    p = kernel.vector(structure, dict(values))
    x, _ = _initial_state(case, structure, values, ())
    return kernel.predict(case.drive, p, x, filter_noise(case, process_noise), keep_states=True)


def innovations(
    case: PreparedRecording,
    structure: Structure,
    values: Mapping[str, float],
    process_noise: float,
    free: tuple[str, ...] = (),
) -> Innovations:
    """Run one case through the predictor; slopes only where parameters are free."""
    return next(innovations_in_pieces(case, structure, values, process_noise, free, len(case.drive.time)))


def _drive_moves_axis(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """Whether some command is beyond the dead-band: a model that nothing moves follows slow readings best of all."""
    forward, reverse = values.get("dead_band_forward", 0.0), values.get("dead_band_reverse", 0.0)
    return any(c.drive.closed or c.command_range[1] >= forward or -c.command_range[0] >= reverse for c in cases)


def _within_stops(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """Whether no recording lies further behind a stop than it travels: the deeper, the shorter the steps that a stiff
    contact needs, and a climb that is thrown so far would wait a quarter of a minute to be told that it is nowhere.
    """
    lower, upper = values.get("stop_lower", -math.inf), values.get("stop_upper", math.inf)
    return all(
        c.drive.speed or (lower - c.reading_span < c.reading_range[1] and upper + c.reading_span > c.reading_range[0])
        for c in cases
    )


#: Points that were looked at last, by all that they come from: a search gets to the same place by several ways.
_CACHE: OrderedDict[Hashable, Fit] = OrderedDict()
_CACHE_SIZE = 4000


@_ignore_overflow()
def evaluate(
    cases: Sequence[PreparedRecording], structure: Structure, values: Mapping[str, float], process_noise: float,
    free: tuple[str, ...] = (), stretch: float = BLOCK_LENGTH,
) -> Fit:  # fmt: skip
    """Deviance, gradient and information at these values; errors further apart than `stretch` (s), or less where
    little is judged, are independent.
    """
    key = (tuple(c.digest for c in cases), structure, tuple(sorted(values.items())), process_noise, free, stretch)
    found = _CACHE.pop(key, None)
    if found is None and _drive_moves_axis(cases, values) and _within_stops(cases, values):
        # Slopes take the memory: of long recordings the errors come first, then the slopes piece by piece.
        seen = () if sum(len(c.drive.time) for c in cases) > MAX_STAMPS_AT_ONCE else free
        results = [innovations(c, structure, values, process_noise, seen) for c in cases]
        found = fit_from_innovations(cases, structure, values, process_noise, free, results, stretch)
    _CACHE[key] = found = found or _not_runnable(structure, values, process_noise, free)
    if len(_CACHE) > _CACHE_SIZE:
        _CACHE.popitem(last=False)
    return found


def _not_runnable(
    structure: Structure, values: Mapping[str, float], process_noise: float, free: tuple[str, ...]
) -> Fit:
    """Where the model cannot run."""
    n = len(free)
    return Fit(structure, dict(values), process_noise, free, math.inf, math.inf, np.eye(n), np.zeros(n), np.eye(n))


@_ignore_overflow()
def fit_from_innovations(
    cases: Sequence[PreparedRecording],
    structure: Structure,
    values: Mapping[str, float],
    process_noise: float,
    free: tuple[str, ...],
    results: Sequence[Innovations],
    stretch: float = BLOCK_LENGTH,
) -> Fit:
    """What `evaluate` makes of innovations, which are run once more where their slopes were not kept."""
    n, compiled = len(free), kernel.compiled()
    squares, logs, count, judged = np.empty(sum(len(r.error) for r in results)), 0.0, 0, 0.0
    for case, r in zip(cases, results, strict=True):
        read, own = compiled.normalising(r.error, r.variance, squares[count:])
        judged += read / len(r.error) * float(case.drive.time[-1])
        logs += own
        count += read
    if count == 0:
        return _not_runnable(structure, values, process_noise, free)
    scale, loss = compiled.scaling(squares[:count], HUBER_LIMIT)
    if not math.isfinite(scale):
        return _not_runnable(structure, values, process_noise, free)
    deviance = loss + logs + count * math.log(scale)
    # A short recording has short stretches: were its scatter not looked at it would speak for whatever is largest.
    stretch = min(stretch, judged / (n + SPARE_BLOCKS + 1))
    kept = results if all(r.slopes.shape[1] == n for r in results) else None
    pulls, weights = _scores_by_block(cases, structure, values, process_noise, free, scale, kept, stretch)
    normal, gradient, scatter = weights.sum(axis=0), pulls.sum(axis=0), pulls.T @ pulls
    if not np.all(np.isfinite(normal)) or not np.all(np.isfinite(gradient)):
        return _not_runnable(structure, values, process_noise, free)
    # The maximum has used up a stretch for each parameter (MacKinnon and White, J. Econometrics 29, 1985).
    stretches = len(pulls)
    scatter = scatter * (stretches / (stretches - n)) if stretches > n + SPARE_BLOCKS else normal
    return Fit(structure, dict(values), process_noise, free, deviance, scale, normal, gradient, scatter)


def _scores_by_block(
    cases: Sequence[PreparedRecording],
    structure: Structure,
    values: Mapping[str, float],
    process_noise: float,
    free: tuple[str, ...],
    scale: float,
    results: Sequence[Innovations] | None,
    stretch: float,
) -> tuple[FloatArray, FloatArray]:
    """Slope (M, n) of the log-likelihood and information (M, n, n) of each stretch in which something was read.

    Without results the recordings are run again, piece by piece.
    """
    n = len(free)
    if not n:
        return np.zeros((0, 0)), np.zeros((0, 0, 0))
    blocks, count = [], 0
    for case in cases:
        blocks.append(count + (case.drive.time / stretch).astype(np.intp))
        count = int(blocks[-1][-1]) + 1
    pulls, weights, read = np.zeros((count, n)), np.zeros((count, n, n)), np.zeros(count, dtype=np.intp)
    gather = kernel.compiled().gathering
    for i, (case, block) in enumerate(zip(cases, blocks, strict=True)):
        begin = 0
        runs = (
            innovations_in_pieces(case, structure, values, process_noise, free, MAX_STAMPS_AT_ONCE)
            if results is None
            else iter([results[i]])
        )
        for r in runs:
            at = block[begin : begin + len(r.error)]
            gather(r.error, r.variance * scale, HUBER_LIMIT, at, r.slopes, pulls, weights, read)
            begin += len(r.error)
    lower = np.tril(weights[read > 0])
    return pulls[read > 0], lower + np.tril(lower, -1).transpose(0, 2, 1)


@_ignore_overflow()
def jackknife_covariance(cases: Sequence[PreparedRecording], point: Fit, stretch: float = BLOCK_LENGTH) -> FloatArray:
    """The point's, by leaving out each stretch (s) in turn.

    A parameter that a few stretches decide bends to what these happen to say, and the errors there look small: the
    estimate without a stretch tells how much hangs on it (jackknife; MacKinnon and White, J. Econometrics 29, 1985).
    """
    pulls, weights = _scores_by_block(
        cases, point.structure, point.values, point.process_noise, point.free, point.scale, None, stretch
    )
    plain = point.covariance
    if len(pulls) <= 2 * len(point.free):
        return plain
    whole = weights.sum(axis=0)
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    moved = [
        least_squares_solution((whole - w) / np.outer(size, size), g / size) / size
        for g, w in zip(pulls, weights, strict=True)
    ]
    wider = np.sqrt(np.maximum(np.sum(np.square(moved), axis=0) / np.maximum(np.diag(plain), 1e-300), 1.0))
    return np.asarray(plain * np.outer(wider, wider))


def deviances(
    cases: Sequence[PreparedRecording],
    structure: Structure,
    trials: Sequence[Mapping[str, float]],
    process_noise: float,
) -> list[float]:
    """The deviance at each of many values."""
    return each(lambda v: evaluate(cases, structure, v, process_noise).deviance, trials)


def least_squares_solution(a: FloatArray, b: FloatArray) -> FloatArray:
    """The smallest solution of a x = b, which is there also where a parameter leaves no trace and a is singular."""
    return np.asarray(np.linalg.lstsq(a, b, rcond=EIGENVALUE_FLOOR)[0])


def bounds_of(name: str) -> tuple[float, float]:
    """Between what a parameter lies."""
    return _BOUNDS[name]


def within_bounds(values: Mapping[str, float]) -> bool:
    """Whether every parameter lies where it may."""
    return all(_BOUNDS[n][0] <= v <= _BOUNDS[n][1] for n, v in values.items())


def _clipped_to_bounds(values: Mapping[str, float]) -> dict[str, float]:
    """The values, each moved to its nearest bound where it lies beyond."""
    return {n: min(max(v, _BOUNDS[n][0]), _BOUNDS[n][1]) for n, v in values.items()}


def _with_resisting_friction(values: dict[str, float], free: Sequence[str]) -> dict[str, float]:
    """The values where dry friction resists both ways. Friction that would push is none, so that beyond there values
    differ which say the same, and none of them is known.
    """
    lean, dry = values.get("friction_asymmetry", 0.0), values.get("coulomb_friction", 0.0)
    beyond = abs(lean) - dry
    if beyond <= 0.0 or "friction_asymmetry" not in free:
        return values
    size = dry + 0.5 * beyond if "coulomb_friction" in free else dry
    return {**values, "coulomb_friction": size, "friction_asymmetry": math.copysign(size, lean)}


def _damped_step(point: Fit, damping: float) -> dict[str, float]:
    """The values after one damped Gauss-Newton step, the best one within the bounds."""
    here = np.array([point.values[n] for n in point.free])
    low, high = np.array([_BOUNDS[n] for n in point.free]).T
    least, most = low - here, high - here
    size = np.sqrt(np.maximum(np.diag(point.information), 1e-300))
    scaled = point.information / np.outer(size, size)
    scaled[np.diag_indices_from(scaled)] += damping + EIGENVALUE_FLOOR
    step, inside = np.zeros(len(here)), point.visible.copy()
    while inside.any():
        pull = point.gradient / size - scaled @ np.where(inside, 0.0, step * size)
        step[inside] = least_squares_solution(scaled[np.ix_(inside, inside)], pull[inside]) / size[inside]
        beyond = np.where(inside, np.maximum(least - step, step - most) * size, 0.0)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 0.0:
            break
        # What would leave its bounds farthest ends there, and the others make the best of it.
        step[worst] = least[worst] if step[worst] < least[worst] else most[worst]
        inside[worst] = False
    moved = np.clip(here + step, low, high)
    return _with_resisting_friction({**point.values, **dict(zip(point.free, moved.tolist(), strict=True))}, point.free)


def levenberg_marquardt(
    cases: Sequence[PreparedRecording],
    structure: Structure,
    values: Mapping[str, float],
    process_noise: float,
    free: tuple[str, ...],
    rounds: int = 30,
    tolerance: float = 0.05,
) -> Fit:
    """Maximise the likelihood over the free parameters at a fixed noise density (Levenberg-Marquardt).

    Stops when a step promises, or has brought, less than `tolerance` of what a unit of deviance is worth there.
    """
    return levenberg_marquardt_from(cases, evaluate(cases, structure, values, process_noise, free), rounds, tolerance)


def levenberg_marquardt_from(cases: Sequence[PreparedRecording], best: Fit, rounds: int, tolerance: float) -> Fit:
    """From a point that is known already."""
    damping, refused, wary = 1e-3, 0, False
    for _ in range(rounds):
        if not math.isfinite(best.deviance):
            return replace(best, converged=False, message="the start lies where the model cannot run")
        enough = tolerance * min(best.overdispersion, MAX_OVERDISPERSION)
        trial_values = _damped_step(best, damping)
        change = np.array([trial_values[n] - best.values[n] for n in best.free])
        promised = float(2.0 * best.gradient @ change - change @ best.information @ change)
        if promised < enough:
            return best
        # Where one step was refused half of the others are, too: these are looked at without their slopes first.
        trial = evaluate(cases, best.structure, trial_values, best.process_noise, () if wary else best.free)
        gained = best.deviance - trial.deviance
        if gained > 0.0:
            best = evaluate(cases, best.structure, trial_values, best.process_noise, best.free) if wary else trial
            refused = 0
            damping = max(damping * (0.1 if gained > 0.5 * promised else 0.5), 1e-9)
            if gained < enough:
                return best
        else:
            refused, wary = refused + 1, True
            if refused == MAX_REFUSED_STEPS:
                return replace(best, message="steps along the slope lead no higher: the likelihood is rough here")
            damping = max(damping * 10.0, 0.03)
    return replace(best, converged=False, message="the search ran out of rounds")


#: Deviance at the ends of a 95 % interval of one parameter.
_CHI2_95 = 3.841
#: So often at most an end of such an interval is moved, and steps in which all other parameters follow it there: where
#: gap and motor's share make up for each other, fewer end on the ridge's flank, and the interval too soon.
PROFILE_PASSES, PROFILE_STEPS = 4, 8


def _shifted_along_slope(point: Fit, name: str, value: float) -> dict[str, float]:
    """The values with a free parameter at this one, and the others where the information says that they follow it."""
    i = point.free.index(name)
    rest = [k for k in range(len(point.free)) if k != i]
    slope = -least_squares_solution(point.information[np.ix_(rest, rest)], point.information[rest, i])
    change = {point.free[k]: (value - point.values[name]) * f for k, f in zip(rest, slope.tolist(), strict=True)}
    return {**point.values, **_clipped_to_bounds({n: point.values[n] + c for n, c in change.items()}), name: value}


def _shifted_by_powers(point: Fit, name: str, value: float, powers: Mapping[str, float]) -> dict[str, float]:
    """The same where others go with powers of it."""
    ratio = max(value, 1e-3 * point.values[name]) / max(point.values[name], 1e-300)
    moved = {n: point.values[n] * ratio**power for n, power in powers.items() if n in point.free}
    return {**point.values, **_clipped_to_bounds(moved), name: value}


def profile_interval(
    cases: Sequence[PreparedRecording], point: Fit, name: str, std: float, powers: Mapping[str, float]
) -> tuple[float, float]:
    """95 % interval of a free parameter from the profile of the likelihood, all others refitted.

    For bounded and kinked parameters, whose likelihood is no parabola: on either side the profile is looked at where
    the parabola of the standard error `std` would end, and the end moved to where it says. Where a unit of deviance is
    worth so little that a profile would only show how the model errs, the parabola has to do.

    `powers` says how others go with the parameter along a ridge of the likelihood. Bounces of a light motor make
    valleys across it, and beyond the end that a profile finds others may be as deep: the interval holds these, too.
    """
    if not math.isfinite(std):
        return _BOUNDS[name]  # it leaves no trace, and may be anything
    here = point.values[name]
    others = tuple(n for n in point.free if n != name)
    i = point.free.index(name)
    plain = math.sqrt(max(float(point.covariance[i, i]), 1e-300))
    wanted = _CHI2_95 * (std / plain) ** 2
    passes = PROFILE_PASSES if point.overdispersion < OVERDISPERSION_OF_WRONG_MODEL else 0

    def likeliest(near: Fit, value: float, free: tuple[str, ...]) -> Fit:
        begun = [_shifted_along_slope(near, name, value)] + (
            [_shifted_by_powers(near, name, value, powers)] if powers else []
        )
        reached = [
            levenberg_marquardt(cases, point.structure, begin, point.process_noise, free, PROFILE_STEPS)
            for begin in begun
        ]
        return min(reached, key=lambda p: p.deviance)

    ends = []
    for bound, sign in zip(_BOUNDS[name], (-1.0, 1.0), strict=True):
        room = sign * (bound - here)
        reach = min(1.96 * std, room)
        for _ in range(passes):
            if reach <= 0.0:
                break
            rise = likeliest(point, here + sign * reach, others).deviance - point.deviance
            factor = math.sqrt(wanted / rise) if rise > 0.0 else 2.0
            reach = min(reach * min(max(factor, 0.4), 2.0), room)
            if 0.7 < factor < 1.4:
                break
        valley, held = point, reach
        for _ in range(passes if powers else 0):
            valley = likeliest(valley, here + sign * min(held + 0.5 * reach, room), point.free)
            found = sign * (valley.values[name] - here)
            if valley.deviance - point.deviance > wanted or found <= held:
                break
            held = found
        ends.append(here + sign * max(held, 0.0))
    return ends[0], ends[1]


def _renewal_interval(case: PreparedRecording) -> float:
    """The usual time between readings that are new, s: a computed speed is often held over many stamps."""
    if not case.drive.speed:
        return case.step
    read = case.drive.measured[np.isfinite(case.drive.measured)]
    return case.step * len(read) / max(int(np.count_nonzero(np.diff(read))), 1)


def largest_process_noise(cases: Sequence[PreparedRecording]) -> float:
    """The noise density at which the filter weighs the fewest readings that it may."""
    return min(process_noise_of(c, MIN_READINGS_IN_MEMORY * _renewal_interval(c)) for c in cases)


def is_misspecified(cases: Sequence[PreparedRecording], point: Fit) -> bool:
    """Whether the model misses so much that its noise forgets as fast as it may, and errors stay correlated still.

    Such a likelihood is rough, and which of its many valleys is the deepest says little about the axis.
    """
    return point.overdispersion > OVERDISPERSION_OF_WRONG_MODEL and point.process_noise > 0.5 * largest_process_noise(
        cases
    )


def most_likely_process_noise(
    cases: Sequence[PreparedRecording], structure: Structure, values: Mapping[str, float], around: float | None = None
) -> float:
    """The noise density that makes the recordings likeliest at fixed parameters; none that forgets too fast.

    `around` a density that is known already it is looked for within a factor of three hundred.
    """
    top = math.log10(largest_process_noise(cases))

    def looked(exponents: Sequence[float]) -> list[float]:
        return each(lambda d: evaluate(cases, structure, values, 10.0**d).deviance, exponents)

    if around is None:
        # Readings that are rounded and held have a second valley, where the last reading is all that is believed.
        grid = [top - d for d in range(0, 9)]
        begin = grid[int(np.argmin(looked(grid)))]
    else:
        begin = math.log10(around)
    middle, low, high = min(begin, top), min(begin, top) - 2.5, min(begin + 2.5, top)
    for _ in range(5):
        below, here, above = looked([middle - 0.4, middle, middle + 0.4])
        bend = below - 2.0 * here + above
        step = 0.2 * (below - above) / bend if bend > 0.0 else math.copysign(1.0, below - above)
        found = min(max(middle + min(max(step, -1.0), 1.0), low), high)
        if abs(found - middle) < 0.3:
            return float(10.0**found)
        middle = found
    return float(10.0**middle)


def fit_with_process_noise(
    cases: Sequence[PreparedRecording],
    structure: Structure,
    values: Mapping[str, float],
    free: tuple[str, ...],
    process_noise: float | None = None,
    rounds: int = 15,
    most: float = math.inf,
) -> Fit:
    """Maximum likelihood over the free parameters and the noise density, alternating until neither moves; the density
    stays at most so much.

    Until the density is settled the parameters only have to be about right.
    """
    current = process_noise if process_noise is not None else most_likely_process_noise(cases, structure, values)
    point = levenberg_marquardt(cases, structure, values, current, free, min(rounds, 5), tolerance=1.0)
    for _ in range(6):
        found = min(most_likely_process_noise(cases, structure, point.values, around=current), most)
        if abs(math.log10(found / current)) < 0.1:
            break
        current = found
        point = levenberg_marquardt(cases, structure, point.values, current, free, min(rounds, 5), tolerance=1.0)
    return levenberg_marquardt_from(cases, point, rounds, 0.05)
