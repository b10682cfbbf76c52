"""The likelihood of recordings under a model, and its maximum.

The model runs in innovation form: a Kalman filter whose only two numbers are the variance of a reading (known
from the encoder's count) and the density of a white torque noise (estimated). A free run would drift away with
every unmodelled torque and then weigh it twice over; short windows would throw away what connects them; a free
autoregressive noise model would absorb the very misfit that is looked for. With torque noise as the only freedom
the predictor forgets at the rate that the recording itself asks for.

The maximum is found by Gauss-Newton steps on exact derivatives, with damping, bounds and a robust loss.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from twin import kernel
from twin.axis import EVERYTHING, STATES, Structure
from twin.kernel import INDEX, Drive
from twin.loop import own_loop
from twin.recording import Recording

FloatArray = NDArray[np.float64]

#: Normalised innovations beyond this count linearly, not squared (Huber).
ROBUST_LIMIT = 4.0
#: The filter weighs at least so many readings. A torque noise so dense that it forgets faster is no noise: neighbouring
#: readings share their rounding and the jitter of their stamps, and being many they would decide what the slow part of
#: the misfit, in which the physics shows, has to say.
LEAST_READINGS = 5.0
#: Stamps whose slopes are held at once: an hour at 2 ms has eighteen times as many.
AT_ONCE = 100_000
_BEHIND = 1e-7  # s
_BOUNDS = {p.name: (p.lower, p.upper) for p in EVERYTHING.parameters}


@dataclass(frozen=True, eq=False)
class Case:
    """A recording made ready for the kernel."""

    recording: Recording
    drive: Drive
    reading_variance: float  # of one reading, output unit squared
    contact: float  # where in the gap the motor starts: -1, 0 or 1
    start: tuple[float, float]  # position and velocity
    free: NDArray[np.bool_] | None = None  # (N,) where the model runs freely and only that is judged; None: nowhere

    @property
    def count(self) -> int:
        """Readings that take part."""
        return int(np.isfinite(self.drive.measured).sum())


def _reading_variance(recording: Recording) -> float:
    """Variance of a reading: a twelfth of a count squared, or what third differences say where nothing is counted."""
    y = recording.output[np.isfinite(recording.output)]
    third = np.diff(y, 3)
    scatter = float(np.median(np.abs(third)) / 0.6745) ** 2 / 20.0 if len(third) else 0.0
    counted = recording.resolution**2 / 12.0
    if counted > 0.0:
        return max(counted, scatter)
    return max(scatter, (1e-9 * float(np.ptp(y))) ** 2, 1e-30)


def known_quantities(recording: Recording) -> dict[str, float]:
    """Inertia and first moment of the payload about the axis, from what the user knows of it."""
    known = recording.known
    mass, arm = known.get("payload_mass", 0.0), known.get("arm_length", 0.0)
    rod = known.get("arm_mass", 0.0)
    return {
        "payload": known.get("payload_inertia", mass * arm**2 + rod * arm**2 / 3.0),
        "moment": known.get("payload_moment", mass * arm + rod * arm / 2.0),
    }


def command_of(recording: Recording) -> FloatArray:
    """The input as it acts: a duty drives in proportion to the supply where that is logged."""
    supply = recording.optional.get("supply")
    if supply is None or recording.input_unit != "%":
        return recording.input
    nominal = float(np.nanmedian(supply))
    return recording.input * np.where(np.isfinite(supply), supply, nominal) / nominal


def prepare(recording: Recording, structure: Structure, closed: bool = False, contact: float = 0.0) -> Case:
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
    return Case(recording, drive, _reading_variance(recording), contact, start)


@dataclass(frozen=True, eq=False)
class Point:
    """A model at certain values: what there is to know for the next step."""

    structure: Structure
    values: dict[str, float]
    density: float  # torque noise over reading variance, 1/s^3 (positions) or 1/s (speeds)
    free: tuple[str, ...]
    deviance: float  # minus twice the log-likelihood, up to a constant of the data
    scale: float  # innovation variance found over that expected
    normal: FloatArray  # (n, n) information about the free parameters
    gradient: FloatArray  # (n,) of the log-likelihood
    converged: bool = True
    says: str = ""

    @property
    def covariance(self) -> FloatArray:
        """Of the free parameters; what cannot be seen gets a huge variance, not a small one."""
        size = np.sqrt(np.maximum(np.diag(self.normal), 1e-300))
        scaled = self.normal / np.outer(size, size)
        eigenvalues, vectors = np.linalg.eigh(scaled)
        inverse = (vectors / np.maximum(eigenvalues, 1e-12)) @ vectors.T
        return np.asarray(inverse / np.outer(size, size))


def _start(case: Case, p: FloatArray, free: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    gap = 0.5 * case.contact
    x = kernel.start_state(*case.start, gap * p[INDEX["backlash_gap"]])
    slope = np.zeros((len(STATES), len(free)))
    if "backlash_gap" in free:
        slope[2, free.index("backlash_gap")] = gap
    return x, slope


def step_of(case: Case) -> float:
    """The usual time from reading to reading, s."""
    return float(np.median(np.diff(case.drive.time)))


def density_of(case: Case, memory: float) -> float:
    """The noise density, in units of the reading's variance, at which the filter forgets after `memory` seconds."""
    step = step_of(case)
    return step / memory**2 if case.drive.speed else step / memory**4


def memory_of(case: Case, density: float) -> float:
    """After how many seconds the filter forgets at a noise density; the inverse of `density_of`."""
    return float((step_of(case) / density) ** (0.5 if case.drive.speed else 0.25))


def ahead(case: Case, density: float, horizon: float) -> Case:
    """The case for predictions up to `horizon` seconds ahead: free runs of that length, or to the recording's end, each
    after a few memories of the filter in which it finds the state.
    """
    lead = max(5.0 * memory_of(case, density), LEAST_READINGS * step_of(case))
    return replace(case, free=np.asarray(case.drive.time % (lead + horizon) >= lead))


def gains_for(case: Case, damping: float, density: float) -> tuple[FloatArray, FloatArray]:
    """Kalman gains and innovation variances in units of the reading's; a density of zero is a free run.

    A free run starts from the first reading as it is.
    """
    if density == 0.0:
        return kernel.free_gains(len(case.drive.time)), np.ones(len(case.drive.time))
    y = case.recording.output
    spread = float(np.nanmax(y) - np.nanmin(y))
    duration = max(float(case.drive.time[-1]), 1e-9)
    velocity = (spread if case.drive.speed else max(spread / duration, 1e-3 * spread)) ** 2
    first = (1.0, 1.0) if case.drive.speed else (1.0, velocity / case.reading_variance)
    gains, expected = kernel.kalman(case.drive, damping, density, first)
    if case.free is None:
        return gains, expected
    # What drifts away in a free run is no reading's noise: the errors of all recordings are weighed alike.
    gains[case.free] = 0.0
    return gains, np.full(len(expected), 1.0 / case.reading_variance)


def _loss(z2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Huber's loss of squared normalised innovations, and the weights of its quadratic majorant."""
    z = np.sqrt(z2)
    far = z > ROBUST_LIMIT
    loss = np.where(far, ROBUST_LIMIT * (2.0 * z - ROBUST_LIMIT), z2)
    return loss, np.where(far, ROBUST_LIMIT / np.maximum(z, 1e-300), 1.0)


@dataclass(frozen=True, eq=False)
class Innovations:
    """Of one case: readings minus predictions, their expected variance, and derivatives if asked for."""

    error: FloatArray  # (N,) output unit; NaN where there is no reading
    variance: FloatArray  # (N,) expected, before the common scale
    slopes: FloatArray  # (N, n) of the prediction


def pieces(
    case: Case, structure: Structure, values: Mapping[str, float], density: float, free: tuple[str, ...], most: int
) -> Iterator[Innovations]:
    """Run one case through the predictor, at most so many stamps at a time; slopes only where parameters are free."""
    p = kernel.vector(structure, dict(values))
    # Where an edge of the command falls on a stamp the delay has a kink: it is looked at from just behind.
    p[INDEX["delay"]] += _BEHIND
    gains, spread = gains_for(case, values.get("viscous_friction", 0.0), density)
    x, slope = _start(case, p, free)
    measured = case.drive.measured if case.free is None else np.where(case.free, case.drive.measured, np.nan)
    if not free:
        predicted, _ = kernel.predict(case.drive, p, x, gains)
        yield Innovations(measured - predicted, spread * case.reading_variance, np.zeros((len(predicted), 0)))
        return
    for at, predicted, slopes in kernel.in_pieces(case.drive, p, x, slope, free, gains, most):
        yield Innovations(measured[at] - predicted, spread[at] * case.reading_variance, slopes)


def innovations(
    case: Case, structure: Structure, values: Mapping[str, float], density: float, free: tuple[str, ...] = ()
) -> Innovations:
    """Run one case through the predictor; slopes only where parameters are free."""
    return next(pieces(case, structure, values, density, free, len(case.drive.time)))


def _scale_of(z2: FloatArray) -> float:
    """Scale of squared normalised innovations, by Huber's loss: a few rounds reach its fixed point."""
    mean = float(np.mean(z2))
    scale = max(float(np.median(z2)) / 0.4549, mean * 1e-3, 1e-30)
    for _ in range(30):
        far = z2[z2 > ROBUST_LIMIT**2 * scale]
        excess = float(far.sum()) - ROBUST_LIMIT * math.sqrt(scale) * float(np.sqrt(far).sum())
        new = max(mean - excess / len(z2), 1e-30)
        if abs(new - scale) < 1e-9 * scale:
            break
        scale = new
    return scale


def evaluate(
    cases: Sequence[Case],
    structure: Structure,
    values: Mapping[str, float],
    density: float,
    free: tuple[str, ...] = (),
    run: Callable[..., list[Innovations]] | None = None,
) -> Point:
    """Deviance, gradient and information at these values."""
    # Slopes take the memory: of long recordings the errors come first, then the slopes piece by piece.
    long = run is None and sum(len(c.drive.time) for c in cases) > AT_ONCE
    seen = () if long else free
    results = [innovations(c, structure, values, density, seen) for c in cases] if run is None else run()
    n = len(free)
    z2s, logs, count = [], 0.0, 0
    for r in results:
        ok = np.isfinite(r.error)
        z2s.append(r.error[ok] ** 2 / r.variance[ok])
        logs += float(np.log(r.variance[ok]).sum())
        count += int(ok.sum())
    joined = np.concatenate(z2s)
    if not np.all(np.isfinite(joined)) or count == 0:
        return Point(structure, dict(values), density, free, math.inf, math.inf, np.eye(n), np.zeros(n))
    scale = _scale_of(joined)
    loss, _ = _loss(joined / scale)
    deviance = float(loss.sum()) + logs + count * math.log(scale)
    normal, gradient = np.zeros((n, n)), np.zeros(n)
    if n:
        run_again = (r for c in cases for r in pieces(c, structure, values, density, free, AT_ONCE))
        for r in run_again if long else results:
            ok = np.isfinite(r.error)
            _, weight = _loss(r.error[ok] ** 2 / (r.variance[ok] * scale))
            weight = weight / (scale * r.variance[ok])
            slopes = r.slopes[ok]
            weighted = slopes * weight[:, None]
            normal += weighted.T @ slopes
            gradient += weighted.T @ r.error[ok]
    if not np.all(np.isfinite(normal)) or not np.all(np.isfinite(gradient)):
        return Point(structure, dict(values), density, free, math.inf, math.inf, np.eye(n), np.zeros(n))
    return Point(structure, dict(values), density, free, deviance, scale, normal, gradient)


def robust_covariance(cases: Sequence[Case], point: Point, stretch: float = 0.5) -> FloatArray:
    """Covariance (n, n) of the free parameters that holds where the model errs a little, too.

    The information says how sharply the likelihood bends; how much its slope scatters from stretch to stretch (s)
    says how far the maximum may have moved (White's sandwich, Econometrica 50, 1982). Innovations that a slightly
    wrong model leaves correlated make the second larger; each standard error is the larger of the two.
    """
    scatters = []
    for case in cases:
        block = (case.drive.time / stretch).astype(np.intp)
        totals, counts = np.zeros((block[-1] + 1, len(point.free))), np.zeros(block[-1] + 1, dtype=np.intp)
        begin = 0
        for run in pieces(case, point.structure, point.values, point.density, point.free, AT_ONCE):
            ok = np.flatnonzero(np.isfinite(run.error))
            here, begin = block[begin + ok], begin + len(run.error)
            if len(ok) == 0:
                continue
            variance = run.variance[ok] * point.scale
            _, weight = _loss(run.error[ok] ** 2 / variance)
            starts = np.flatnonzero(np.diff(here, prepend=-1))
            pulls = run.slopes[ok] * (weight * run.error[ok] / variance)[:, None]
            totals[here[starts]] += np.add.reduceat(pulls, starts, axis=0)
            counts[here[starts]] += 1
        scatters.append(totals[counts > 0])
    scatter = np.concatenate(scatters)
    plain = point.covariance
    if len(scatter) <= 2 * len(point.free):
        return plain
    robust = plain @ (scatter.T @ scatter) @ plain
    wider = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(plain), 1e-300), 1.0))
    return np.asarray(plain * np.outer(wider, wider))


def deviances(
    cases: Sequence[Case], structure: Structure, trials: Sequence[Mapping[str, float]], density: float
) -> list[float]:
    """The deviance at each of many values, on two threads: the kernel runs without Python's lock."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda v: evaluate(cases, structure, v, density).deviance, trials))


def solved(a: FloatArray, b: FloatArray) -> FloatArray:
    """The smallest solution of a x = b, which is there also where a parameter leaves no trace and a is singular."""
    return np.asarray(np.linalg.lstsq(a, b, rcond=1e-14)[0])


def _moved(point: Point, damping: float) -> dict[str, float]:
    """The values after one damped Gauss-Newton step that respects the bounds."""
    active = np.ones(len(point.free), dtype=bool)
    values = dict(point.values)
    bounds = [_BOUNDS[name] for name in point.free]
    here = np.array([values[name] for name in point.free])
    step = np.zeros(len(here))
    for _ in range(len(here) + 1):
        index = np.flatnonzero(active)
        if len(index) == 0:
            break
        a = point.normal[np.ix_(index, index)].copy()
        size = np.sqrt(np.maximum(np.diag(a), 1e-300))
        a = a / np.outer(size, size)
        a[np.diag_indices_from(a)] += damping + 1e-12
        step = np.zeros(len(here))
        step[index] = solved(a, point.gradient[index] / size) / size
        stuck = [
            i
            for i in index
            if (here[i] <= bounds[i][0] and step[i] < 0.0) or (here[i] >= bounds[i][1] and step[i] > 0.0)
        ]
        if not stuck:
            break
        active[stuck] = False
        step[stuck] = 0.0
    for i, name in enumerate(point.free):
        low, high = bounds[i]
        values[name] = float(min(max(here[i] + step[i], low), high))
    return values


def climb(
    cases: Sequence[Case],
    structure: Structure,
    values: Mapping[str, float],
    density: float,
    free: tuple[str, ...],
    rounds: int = 30,
    tolerance: float = 0.05,
) -> Point:
    """Maximise the likelihood over the free parameters at a fixed noise density (Levenberg-Marquardt).

    Stops when a step promises less than `tolerance` of deviance.
    """
    best = evaluate(cases, structure, values, density, free)
    damping = 1e-3
    for _ in range(rounds):
        if not math.isfinite(best.deviance):
            return replace(best, converged=False, says="the start lies where the model cannot run")
        trial_values = _moved(best, damping)
        change = np.array([trial_values[n] - best.values[n] for n in free])
        promised = float(2.0 * best.gradient @ change - change @ best.normal @ change)
        if promised < tolerance:
            return best
        trial = evaluate(cases, structure, trial_values, density, free)
        gained = best.deviance - trial.deviance
        if gained > 0.0:
            best = trial
            damping = max(damping * (0.1 if gained > 0.5 * promised else 0.5), 1e-9)
            if gained < tolerance:
                return best
        else:
            damping = max(damping * 10.0, 1e-4)
            if damping > 1e6:
                return best
    return replace(best, converged=False, says="the search ran out of rounds")


#: Deviance at the ends of a 95 % interval of one parameter.
_CHI2_95 = 3.841


def profile_interval(cases: Sequence[Case], point: Point, name: str, std: float) -> tuple[float, float]:
    """95 % interval of a free parameter from the profile of the likelihood, all others refitted at each value.

    For bounded and kinked parameters, whose likelihood is no parabola. `std` is the standard error to start from;
    where it is wider than the information says, because the model errs a little, the interval is wider alike.
    """
    others = tuple(n for n in point.free if n != name)
    i = point.free.index(name)
    plain = math.sqrt(max(float(point.covariance[i, i]), 0.0))
    wanted = _CHI2_95 * max(std / plain, 1.0) ** 2 if plain > 0.0 else _CHI2_95
    low, high = _BOUNDS[name]
    ends = []
    for sign, bound in ((-1.0, low), (1.0, high)):
        step, inside, end = 1.96 * std, 0.0, point.values[name]
        for _ in range(4):
            value = min(max(point.values[name] + sign * (inside + step), low), high)
            trial = climb(cases, point.structure, {**point.values, name: value}, point.density, others, rounds=3)
            rise = trial.deviance - point.deviance
            end = value
            if value == bound or 0.7 * wanted < rise < 1.4 * wanted:
                break
            # The profile is near a parabola in the distance: aim where it would reach the threshold.
            factor = math.sqrt(wanted / rise) if rise > 0.0 else 2.0
            step = (inside + step) * min(max(factor, 0.3), 2.0) - inside
        ends.append(float(end))
    return ends[0], ends[1]


def best_density(
    cases: Sequence[Case], structure: Structure, values: Mapping[str, float], around: float | None = None
) -> float:
    """The noise density that makes the recordings likeliest at fixed parameters; none that forgets too fast."""
    top = math.log10(min(density_of(c, LEAST_READINGS * step_of(c)) for c in cases))

    def deviance(d: float) -> float:
        return evaluate(cases, structure, values, 10.0**d).deviance

    if around is None:
        # Readings that are rounded and held have a second valley, where the last reading is all that is believed.
        middle, reach = min((top - d for d in range(0, 9)), key=deviance), 1.0
    else:
        middle, reach = math.log10(around), 1.5
    low, high = min(middle, top) - reach, min(middle + reach, top)
    found = minimize_scalar(deviance, bounds=(low, high), method="bounded", options={"xatol": 0.05})
    # The search never tries its bounds themselves.
    return float(10.0 ** (found.x if found.x < high - 0.1 else high))


def fit(
    cases: Sequence[Case],
    structure: Structure,
    values: Mapping[str, float],
    free: tuple[str, ...],
    density: float | None = None,
    rounds: int = 30,
) -> Point:
    """Maximum likelihood over the free parameters and the noise density, alternating until neither moves."""
    current = density if density is not None else best_density(cases, structure, values)
    point = climb(cases, structure, values, current, free, rounds)
    for _ in range(6):
        found = best_density(cases, structure, point.values, around=current)
        if abs(math.log10(found / current)) < 0.1:
            break
        current = found
        point = climb(cases, structure, point.values, current, free, rounds)
    return point
