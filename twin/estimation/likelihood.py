"""The likelihood of recordings under a model, and its maximum.

The model runs in innovation form, as a Kalman filter with two numbers. They are the variance of a reading (known from
the encoder's count) and the density of a white torque noise (estimated). A free run would drift away with every
unmodelled torque and then count it twice. Short windows would lose what connects them. A free autoregressive noise
model would absorb the very misfit that is looked for. With torque noise as the only freedom, the recording itself
decides how long the filter's memory is.

The filter knows whether motor and link touch. In the gap each of them is moved by its own half of the noise, and no
sensor sees the motor. At contact, what was known of their common centre of mass becomes what is known of both.

The maximum is found by Gauss-Newton steps on exact derivatives, with damping, bounds and a robust loss.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.estimation import filter_memory, numerics, parameter_bounds
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.model import sensor
from twin.model.stepper import STATES, Structure
from twin.parallel import each
from twin.simulation import kernel
from twin.simulation.kernel import INDEX

FloatArray = NDArray[np.float64]

#: Normalised innovations beyond this count linearly, not squared (Huber).
HUBER_LIMIT = 4.0
#: Stamps whose slopes are held at once: an hour at 2 ms has eighteen times as many.
MAX_STAMPS_AT_ONCE = 100_000
#: Slopes have diverged at this multiple of what the drive can make them within the filter's memory. Where the motor
#: does not rattle they are at most once that, and six times where motor and link touch. No memory is taken to be
#: shorter than this time, s, in which a contact shows.
MAX_SLOPE_RATIO, _CONTACT_DURATION = 10.0, 0.05
#: Stretches beyond one for each parameter from more than which their scatter can be told.
SPARE_BLOCKS = 4
_DELAY_OFFSET = 1e-7  # s
#: Longer than innovations of a slightly wrong model stay correlated, s.
BLOCK_LENGTH = 0.5


def _initial_state(
    case: PreparedRecording, structure: Structure, values: Mapping[str, float], free: Sequence[str]
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """The states at the start and their derivatives (states, n): it begins where its sensor reads what was read."""
    gap, (reading, velocity) = 0.5 * case.contact, case.start
    apart = gap * values.get("backlash_gap", 0.0)
    begins = sensor.position(structure, values, reading, apart)
    x = kernel.start_state(begins, velocity, apart)
    slope = np.zeros((len(STATES), len(free)))
    for name in set(sensor.parameters(structure)).intersection(free):
        slope[0, free.index(name)] = sensor.slope(structure, values, reading, name, apart)
    if "backlash_gap" in free:
        slope[2, free.index("backlash_gap")] = gap
        slope[0, free.index("backlash_gap")] += gap * sensor.gap_slope(structure, values, reading, apart)
    return x, slope


def with_free_runs(case: PreparedRecording, process_noise: float, horizon: float) -> PreparedRecording:
    """The case for predictions up to `horizon` seconds ahead. It is cut into free runs of that length, the last to the
    recording's end. Before each, the filter has a few of its memories to find the state.
    """
    settled = min(5.0 * filter_memory.memory_of(case, process_noise), 0.1 * float(case.drive.time[-1]))
    lead = max(settled, filter_memory.MIN_READINGS_IN_MEMORY * case.step)
    return replace(case, free_run=np.asarray(case.drive.time % (lead + horizon) >= lead), rattle_mask=None)


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

    The effect of another gain decays with the filter's memory. So it is about what the drive does within that memory,
    or within the time of a contact. Where a light motor bounces in its gap, a slope grows beyond that, by a factor with
    each bounce. A handful of such stamps would outweigh all others.
    """
    # A free run has an infinite memory, and one under its own loop is driven by its readings.
    if process_noise == 0.0 or case.free_run is not None or case.drive.closed or "input_gain" not in free:
        return np.zeros(len(slopes), dtype=bool)
    memory = max(filter_memory.memory_of(case, process_noise), _CONTACT_DURATION) + case.longest_interval
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
    noise = filter_memory.filter_noise(case, process_noise)
    x, slope = _initial_state(case, structure, values, free)
    drive = case.drive
    if case.free_run is not None:
        drive = replace(drive, measured=np.where(case.free_run, np.nan, drive.measured))
    if free:
        runs = kernel.in_pieces(drive, p, x, dict(zip(free, slope.T, strict=True)), noise, most)
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
    return kernel.predict(case.drive, p, x, filter_memory.filter_noise(case, process_noise), keep_states=True)


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
    """Whether no recording lies further behind a stop than it travels. The deeper it lies, the shorter the steps that a
    stiff contact needs. A fit whose step leads that far would wait a quarter of a minute for a useless value.
    """
    lower, upper = values.get("stop_lower", -math.inf), values.get("stop_upper", math.inf)
    return all(
        c.drive.speed or (lower - c.reading_span < c.reading_range[1] and upper + c.reading_span > c.reading_range[0])
        for c in cases
    )


#: Points that were looked at last, by all that they come from: a search gets to the same place by several ways.
_CACHE: OrderedDict[Hashable, Fit] = OrderedDict()
_CACHE_SIZE = 4000


@numerics.ignore_overflow()
def evaluate(
    problem: FitProblem, structure: Structure, values: Mapping[str, float],
    free: tuple[str, ...] = (), stretch: float = BLOCK_LENGTH,
) -> Fit:  # fmt: skip
    """Deviance, gradient and information at these values; errors further apart than `stretch` (s), or less where
    little is judged, are independent.
    """
    cases = problem.stepped(structure)
    key = (
        tuple(c.digest for c in cases),
        structure,
        tuple(sorted(values.items())),
        problem.process_noise,
        free,
        stretch,
    )
    found = _CACHE.pop(key, None)
    if found is None and _drive_moves_axis(cases, values) and _within_stops(cases, values):
        # Slopes take the memory: of long recordings the errors come first, then the slopes piece by piece.
        seen = () if sum(len(c.drive.time) for c in cases) > MAX_STAMPS_AT_ONCE else free
        results = [innovations(c, structure, values, problem.process_noise, seen) for c in cases]
        found = fit_from_innovations(problem, structure, values, free, results, stretch)
    _CACHE[key] = found = found or _not_runnable(structure, values, problem.process_noise, free)
    if len(_CACHE) > _CACHE_SIZE:
        _CACHE.popitem(last=False)
    return found


def _not_runnable(
    structure: Structure, values: Mapping[str, float], process_noise: float, free: tuple[str, ...]
) -> Fit:
    """Where the model cannot run."""
    n = len(free)
    return Fit(structure, dict(values), process_noise, free, math.inf, math.inf, np.eye(n), np.zeros(n), np.eye(n))


@numerics.ignore_overflow()
def fit_from_innovations(
    problem: FitProblem,
    structure: Structure,
    values: Mapping[str, float],
    free: tuple[str, ...],
    results: Sequence[Innovations],
    stretch: float = BLOCK_LENGTH,
) -> Fit:
    """What `evaluate` makes of innovations, which are run once more where their slopes were not kept."""
    n, compiled = len(free), kernel.compiled()
    squares, logs, count, judged = np.empty(sum(len(r.error) for r in results)), 0.0, 0, 0.0
    for case, r in zip(problem.recordings, results, strict=True):
        read, own = compiled.normalising(r.error, r.variance, squares[count:])
        judged += read / len(r.error) * float(case.drive.time[-1])
        logs += own
        count += read
    if count == 0:
        return _not_runnable(structure, values, problem.process_noise, free)
    scale, loss = compiled.scaling(squares[:count], HUBER_LIMIT)
    if not math.isfinite(scale):
        return _not_runnable(structure, values, problem.process_noise, free)
    deviance = loss + logs + count * math.log(scale)
    # A short recording has short stretches. Without a look at its scatter it would support whatever is largest.
    stretch = min(stretch, judged / (n + SPARE_BLOCKS + 1))
    kept = results if all(r.slopes.shape[1] == n for r in results) else None
    fit = Fit(structure, dict(values), problem.process_noise, free, deviance, scale, np.eye(n), np.zeros(n), np.eye(n))
    pulls, weights = _scores_by_block(problem, fit, kept, stretch)
    normal, gradient, scatter = weights.sum(axis=0), pulls.sum(axis=0), pulls.T @ pulls
    if not np.all(np.isfinite(normal)) or not np.all(np.isfinite(gradient)):
        return _not_runnable(structure, values, problem.process_noise, free)
    # The maximum has used up a stretch for each parameter (MacKinnon and White, J. Econometrics 29, 1985).
    stretches = len(pulls)
    scatter = scatter * (stretches / (stretches - n)) if stretches > n + SPARE_BLOCKS else normal
    return replace(fit, information=normal, gradient=gradient, scatter=scatter)


def _scores_by_block(
    problem: FitProblem, fit: Fit, results: Sequence[Innovations] | None, stretch: float
) -> tuple[FloatArray, FloatArray]:
    """Slope (M, n) of the log-likelihood and information (M, n, n) of each stretch in which something was read.

    Without results the recordings are run again, piece by piece.
    """
    n, cases = len(fit.free), problem.stepped(fit.structure)
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
            innovations_in_pieces(case, fit.structure, fit.values, fit.process_noise, fit.free, MAX_STAMPS_AT_ONCE)
            if results is None
            else iter([results[i]])
        )
        for r in runs:
            at = block[begin : begin + len(r.error)]
            gather(r.error, r.variance * fit.scale, HUBER_LIMIT, at, r.slopes, pulls, weights, read)
            begin += len(r.error)
    lower = np.tril(weights[read > 0])
    return pulls[read > 0], lower + np.tril(lower, -1).transpose(0, 2, 1)


@numerics.ignore_overflow()
def jackknife_covariance(problem: FitProblem, point: Fit, stretch: float = BLOCK_LENGTH) -> FloatArray:
    """The point's, by leaving out each stretch (s) in turn.

    A parameter that a few stretches decide follows what these happen to say, and the errors there look small. The
    estimate without a stretch tells how much depends on it (jackknife; MacKinnon and White, J. Econometrics 29, 1985).
    Like any estimate it lies within the bounds. What a single stretch tells of a share, from 0 to 1, would else move
    without end where that is left out, and take with it what the others tell.
    """
    pulls, weights = _scores_by_block(problem, point, None, stretch)
    plain = point.covariance
    if len(pulls) <= 2 * len(point.free):
        return plain
    whole = weights.sum(axis=0)
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    bounds = np.array([parameter_bounds.bounds_of(n) for n in point.free]).T
    room = (bounds - np.array([point.values[n] for n in point.free])) * size
    moved = [
        numerics.bounded_solution((whole - w) / np.outer(size, size), -g / size, room) / size
        for g, w in zip(pulls, weights, strict=True)
    ]
    wider = np.sqrt(np.maximum(np.sum(np.square(moved), axis=0) / np.maximum(np.diag(plain), 1e-300), 1.0))
    return numerics.without_what_is_lost(plain * np.outer(wider, wider))


def deviances(
    problem: FitProblem,
    structure: Structure,
    trials: Sequence[Mapping[str, float]],
) -> list[float]:
    """The deviance at each of many values."""
    return each(lambda v: evaluate(problem, structure, v).deviance, trials)
