"""What to record next: the input that best tells rival models apart, or best fixes the worst-known parameter.

A signal is put together from a library of blocks, each of which separates one pair of effects (effects.md). They are
slow ramps through zero, coast-downs, plugging, stairs, square waves, kicks, full turns, a chirp, and a dwell between
two equal blocks. The value of a block is the evidence that it adds per second:

Two rivals. One is simulated; the other's predictor runs over that simulation with its own noise, and half its squared
normalised error is the log-likelihood that it loses. What it can regain by moving its parameters, held back by what the
present recordings say of them, does not count. Blocks are judged by a first-order refit, but the signal made of them is
refitted to the end before the next block is chosen. A first-order refit alone promised a hundred where a full one left
nothing: one gap crossing or one edge is easily explained by other parameters. This is the sequence of Atkinson and
Fedorov (Biometrika 62, 1975) with the divergence of Box and Hill (Technometrics 9, 1967). Rival noise levels do not
depend on the signal and are left out.

The standard deviation of an error is not taken from the predictor itself. Where a light motor rattles in its gap, noise
and an unknown start grow from bounce to bounce. Sensitivities grow with them and promise information that cannot be
obtained. Such signals ranked first, and no fit could follow the recordings that real rigs made of them. So each truth
is run a few times with noise, from every side of its gap. Errors are compared with those of its own predictor there.

One model. The information about its parameters that a block adds to the present one (Goodwin and Payne,
Dynamic System Identification, 1977).

Evidence of blocks is nearly additive, so blocks are chosen greedily by sums. Each signal so made is simulated as a
whole, from rest, and is cut as soon as its evidence suffices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import model_comparison, thresholds
from twin.diagnosis.result import Experiment
from twin.effects import knots
from twin.effects.catalogue import EFFECTS
from twin.errors import BadInput
from twin.estimation import likelihood, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.io.recording import Recording
from twin.model.stepper import EVERYTHING, Structure
from twin.simulation import kernel

FloatArray = NDArray[np.float64]
#: Length (s), input at its start, input at its end.
Piece = tuple[float, float, float]
Signal = tuple[Piece, ...]

#: Log-likelihood that is asked of an input, in units of what it is worth. It is half as much again as a verdict of 99
#: to 1 takes, since no rig is quite the model that the input is designed on.
NEEDED_LOG_LIKELIHOOD = 1.5 * thresholds.TEMPERATURE * math.log(99.0)
#: Relative standard error at which a parameter counts as known, and the one that a model brings to its first recording.
_KNOWN_ERROR, _UNKNOWN_ERROR = 0.02, 10.0
_MAX_DURATION = 30.0  # s, where the user sets no limit
_MIN_DURATION = 2.0  # s: a verdict should not hang on one edge or one gap crossing, which no model has quite right
_SAFETY_FACTOR = 1.5  # times what is needed: recordings differ by chance, rivals refit further than predicted
_DESIGN_STEP = 0.004  # s; rivals part over many samples, finer ones cost time and say no more
_CHECK_INTERVAL = 0.2  # s between the moments at which a signal may be cut
_MAX_RIVALS = 3  # the leader is separated from so many less one
_TIME_SCALES = (1.0, 0.6, 0.35, 0.2, 0.1)  # by which a block is shortened until it keeps within the travel
_MIN_RATE = 0.002  # of all that is needed: what a second must bring
_TRUSTED_TRAVEL = 0.9  # of the travel: models err, most of all where little more than the dead-band is overcome
_SHORT_LIST_SIZE = 8  # blocks that are looked at again after each refit
_REFIT_STEPS = 12  # of a refit
_GAP_SIDES = (-1.0, 0.0, 1.0)  # of its gap on which the motor may stand when the signal begins
_LOST_DEVIATIONS = 1e3  # standard deviations that a reading is off where a run ended in no number
_BOUNDS = {p.name: (p.lower, p.upper) for p in EVERYTHING.parameters}
#: What counts only in proportion to a gain.
_GAIN_OF = {
    "dead_band_forward": "input_gain",
    "dead_band_reverse": "input_gain",
    "saturation_limit": "input_gain",
    "spring_rest": "spring_stiffness",
}
#: Parameters that no new recording fixes (the event was in the old one), or that are of no interest.
_NOT_SOUGHT = frozenset({"load_time", "load_added", "disturbance_phase", "tooth_frequency", "tooth_damping"})


@dataclass(frozen=True)
class Limits:
    """What the rig may be given; None stands for what the recordings have shown.

    `input`: largest magnitude, in the input's unit. `duration`: most seconds (30; less where less is enough).
    `travel`: largest distance from the start on either side, rad or m, `math.inf` for an axis that may turn freely.
    `sample_time`: of the signal, s.
    """

    input: float | None = None
    duration: float | None = None
    travel: float | None = None
    sample_time: float | None = None


@dataclass(frozen=True, eq=False)
class _RigLimits:
    """The rig as far as the design needs it."""

    template: Recording
    reading_variance: float
    contact_step: float  # longest internal step, one for all rivals so that its error is common to them
    sample_time: float
    step: float
    lowest: float
    highest: float
    duration: float
    band: tuple[float, float]
    start: float


@dataclass(frozen=True, eq=False)
class _Evidence:
    """The predictor's result for a signal: squared error, score (n,) and information (n, n) at its present values."""

    squared: float
    score: FloatArray
    information: FloatArray

    def __add__(self, other: _Evidence) -> _Evidence:
        return _Evidence(self.squared + other.squared, self.score + other.score, self.information + other.information)

    def part(self, index: NDArray[np.int_]) -> _Evidence:
        """Of some of the parameters, the others held."""
        return _Evidence(self.squared, self.score[index], self.information[np.ix_(index, index)])

    def step(self, damping: float = 0.0) -> FloatArray:
        """The change of parameters that regains most, to first order."""
        size = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        scaled = self.information / np.outer(size, size) + (1e-9 + damping) * np.eye(len(size))
        return np.asarray(np.linalg.solve(scaled, self.score / size) / size)

    @property
    def divergence(self) -> float:
        """Log-likelihood that is lost for good."""
        return max(0.5 * (self.squared - float(self.score @ self.step())), 0.0)


@dataclass(frozen=True, eq=False)
class _Pair:
    """The model that is taken as true, and the rival that predicts, with its parameters at `values`."""

    truth: Fit
    rival: Fit
    values: dict[str, float]

    @cached_property
    def overdispersion(self) -> float:
        """What deviance counts for between the two, as in a verdict."""
        return model_comparison.overdispersion([self.truth, self.rival])

    @property
    def before(self) -> _Evidence:
        """What the present recordings say of the rival's values: a parabola in torques."""
        moved, bend = _as_torques(self.rival, self.values)
        normal = self.rival.information / self.overdispersion
        pull = bend.T @ normal
        return _Evidence(float(moved @ normal @ moved), -pull @ moved, pull @ bend)


def _as_torques(point: Fit, values: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
    """How far free parameters have moved (n,) from a fitted point, and the derivative of that (n, n).

    What a gain multiplies counts in proportion to it. Recordings may fix only the torque. A parabola in gain and
    dead-band would then block the hyperbola on which both explain them equally well.
    """
    moved = np.array([values[n] - point.values[n] for n in point.free])
    bend = np.eye(len(moved))
    for i, name in enumerate(point.free):
        gain = _GAIN_OF.get(name, "")
        if gain in point.free and abs(point.values[gain]) > 1e-9:
            at = point.values[gain]
            bend[i, point.free.index(gain)] = moved[i] / at
            bend[i, i] = values[gain] / at
            moved[i] *= bend[i, i]
    return moved, bend


Ledger = Sequence[_Evidence]  # one entry for each pair
Shortfall = Callable[[Ledger], float]


@dataclass(frozen=True, eq=False)
class _SimulatedReading:
    """Simulated readings of a truth, and the ratio of its own predictor's squared errors to their expected value."""

    case: PreparedRecording
    error_inflation: FloatArray  # (N,), no less than 1

    def until(self, end: float) -> _SimulatedReading:
        keep = self.case.drive.time <= end + 1e-9
        drive = self.case.drive
        cut = replace(drive, time=drive.time[keep], command=drive.command[keep], measured=drive.measured[keep])
        return _SimulatedReading(replace(self.case, drive=cut), self.error_inflation[keep])


@dataclass(frozen=True, eq=False)
class _SimulatedSignal:
    """A signal that stays within the travel, the simulated readings of each pair's truth, and the rivals' evidence."""

    signal: Signal
    seen: tuple[_SimulatedReading, ...]
    safe: NDArray[np.bool_]  # at each check: the signal may end there
    evidence: tuple[list[_Evidence], ...]  # for each pair, up to each check

    @property
    def length(self) -> float:
        return _length(self.signal)

    @property
    def whole(self) -> tuple[_Evidence, ...]:
        return tuple(e[-1] for e in self.evidence)


# ---- signals ----


def _hold(length: float, level: float) -> Piece:
    return length, level, level


def _length(signal: Signal) -> float:
    return sum(p[0] for p in signal)


def _mirrored(signal: Signal) -> Signal:
    return tuple((length, -a, -b) for length, a, b in signal)


def _there_and_back(signal: Signal) -> Signal:
    return signal + _mirrored(signal)


def library(lost: float, most: float, pace: float, turn: float) -> dict[str, Signal]:
    """Blocks that start and end at rest.

    `lost` is the input below which nothing moves, `most` the largest. `pace` (s) is how fast the axis settles. `turn`
    (s) is the time for a turn, or for its travel, at half of the input above `lost`.
    """

    def level(share: float) -> float:
        return lost + share * (most - lost)

    low, rest = level(0.15), _hold(0.4 * pace, 0.0)
    slow = max(pace, 0.5)
    blocks: dict[str, Signal] = {
        "slow triangle": ((1.2 * slow, 0.0, low), (2.4 * slow, low, -low), (1.2 * slow, -low, 0.0), rest),
        "stairs": _there_and_back((*[_hold(0.7 * pace, level(s)) for s in (0.1, 0.3, 0.6, 1.0)], _hold(pace, 0.0))),
        "full turns": _there_and_back((_hold(pace + turn, level(0.5)), _hold(pace, 0.0))),
        "dwell": (
            *_there_and_back((_hold(pace, level(0.4)),)),
            *_there_and_back((_hold(3.0, most),)),
            *_there_and_back((_hold(pace, level(0.4)),)),
            rest,
        ),
    }
    for share in (0.3, 0.6, 1.0):
        top = level(share)
        blocks[f"coast-down {share:g}"] = _there_and_back((_hold(1.5 * pace, top), _hold(1.5 * pace, 0.0)))
        blocks[f"plugging {share:g}"] = _there_and_back(
            (_hold(1.2 * pace, top), _hold(0.8 * pace, -0.7 * top), _hold(0.3 * pace, 0.0))
        )
    for share in (0.1, 0.35, 0.9):
        wave = _there_and_back((_hold(0.6 * pace, level(share)),))
        blocks[f"square wave {share:g}"] = (*wave * 2, rest)
    # A brief input of little more than `lost` moves the motor in its gap and nothing else. Fits to such rattle end in
    # any local optimum nearby, some hundred of deviance apart.
    for share in (0.35, 0.9):
        quick = _there_and_back((_hold(max(0.12 * pace, 0.04), level(share)),))
        kick = _there_and_back((_hold(0.06, level(share)), _hold(0.24, 0.0)))
        blocks[f"quick square wave {share:g}"] = (*quick * 6, rest)
        blocks[f"kicks {share:g}"] = (*kick * 3, rest)
    halves = np.geomspace(0.8 * pace, max(0.05 * pace, 0.02), 18)
    blocks["chirp"] = (*[_hold(float(h), level(0.6) * (-1.0) ** i) for i, h in enumerate(halves)], rest)
    return blocks


def _sampled(signal: Signal, step: float, lowest: float, highest: float) -> tuple[FloatArray, FloatArray]:
    """Time (N,) and input (N,), clipped, in steps that a drive's register can hold; the last sample is zero."""
    ends = np.cumsum([p[0] for p in signal])
    starts = np.concatenate([[0.0], ends[:-1]])
    time = np.arange(round(float(ends[-1]) / step) + 1) * step
    index = np.minimum(np.searchsorted(ends, time + 1e-9, side="right"), len(signal) - 1)
    share = (time - starts[index]) / (ends - starts)[index]
    first, last = np.array([p[1] for p in signal]), np.array([p[2] for p in signal])
    level = np.clip(first[index] + share * (last - first)[index], lowest, highest)
    digits = 4 - math.ceil(math.log10(max(-lowest, highest)))
    level = np.clip(np.round(level, digits), lowest, highest)
    level[-1] = 0.0
    return np.round(time, 9), level


def _on_grid(signal: Signal, step: float) -> Signal:
    """Pieces of whole steps, so that the design and what is played have the same edges."""
    return tuple((max(round(length / step), 1) * step, a, b) for length, a, b in signal)


def _cut_signal(signal: Signal, end: float) -> Signal:
    out: list[Piece] = []
    for length, a, b in signal:
        left = end - _length(tuple(out))
        if left <= 1e-9:
            break
        share = min(left / length, 1.0)
        out.append((share * length, a, a + share * (b - a)))
    return tuple(out)


# ---- the rig ----


def _recorded_band(cases: Iterable[PreparedRecording]) -> tuple[float, float]:
    """Lowest and highest position in any recording; those of a speed recording count from its start."""
    low, high = math.inf, -math.inf
    for case in cases:
        y = case.recording.output
        ok = np.isfinite(y)
        place = y[ok]
        if case.drive.speed:
            time = case.recording.time[ok]
            place = np.concatenate([[0.0], np.cumsum(np.diff(time) * 0.5 * (place[1:] + place[:-1]))])
        low, high = min(low, float(place.min())), max(high, float(place.max()))
    return low, high


def _rig_limits(points: Sequence[Fit], cases: Sequence[PreparedRecording], limits: Limits) -> _RigLimits:
    if not points or not cases:
        raise BadInput("an experiment is designed for at least one fitted model and the recordings it was fitted to")
    for name in ("input", "duration", "travel", "sample_time"):
        value = getattr(limits, name)
        if value is not None and not value > 0.0:
            raise BadInput(f"the experiment's limit on {name} is {value:g}; it must be greater than zero")
    # Not the drive's command: of a recording simulated in its own loop, that is the reference.
    lowest = min(0.0, *(float(c.recording.input.min()) for c in cases))
    highest = max(0.0, *(float(c.recording.input.max()) for c in cases))
    if limits.input is not None:
        lowest, highest = -limits.input, limits.input
    if lowest == highest == 0.0:
        raise BadInput("the recordings' input is zero throughout; say how large the experiment's may be")
    sample_time = limits.sample_time or float(np.median(np.diff(cases[0].recording.time)))
    start = 0.0 if cases[0].drive.speed else cases[0].start[0]
    low, high = _recorded_band(cases)
    if limits.travel is not None:
        low, high = start - limits.travel, start + limits.travel
    band = start + _TRUSTED_TRAVEL * (low - start), start + _TRUSTED_TRAVEL * (high - start)
    bench = _RigLimits(
        template=cases[0].recording,
        reading_variance=float(np.median([c.reading_variance for c in cases])),
        contact_step=0.002 / max(p.structure.substeps for p in points) * (1.0 + 1e-9),
        sample_time=sample_time,
        step=sample_time * max(math.ceil(_DESIGN_STEP / sample_time - 1e-9), 1),
        lowest=lowest,
        highest=highest,
        duration=_MAX_DURATION if limits.duration is None else limits.duration,
        band=band,
        start=start,
    )
    return replace(bench, start=_resting_place(bench, points[0]))


def _case(
    bench: _RigLimits, time: FloatArray, command: FloatArray, output: FloatArray, structure: Structure
) -> PreparedRecording:
    made = Recording(
        "experiment", time, command, output, bench.template.input_unit, bench.template.output_unit,
        known=bench.template.known,
    )  # fmt: skip
    case = prepared_recording.prepare_recording(made, structure)
    drive = replace(case.drive, longest=bench.contact_step)
    return replace(case, drive=drive, reading_variance=bench.reading_variance)


def _free_run(
    bench: _RigLimits, point: Fit, time: FloatArray, command: FloatArray
) -> tuple[PreparedRecording, FloatArray]:
    """What the model would have us read, as a recording, and its states (N, states)."""
    blank = np.zeros(len(time))
    case = _case(bench, time, command, blank, point.structure)
    p = kernel.vector(point.structure, point.values)
    x = kernel.start_state(bench.start, 0.0, 0.0)
    run = kernel.predict(case.drive, p, x, keep_states=True)
    return _case(bench, time, command, run.reading, point.structure), run.states


def _error_inflation(bench: _RigLimits, point: Fit, case: PreparedRecording, checks: NDArray[np.int_]) -> FloatArray:
    """Ratio (N,) of the model's squared errors on noisy recordings of itself to their expected value, at least 1."""
    drive, p = case.drive, kernel.vector(point.structure, point.values)
    variance = bench.reading_variance * max(point.scale, 1e-12)
    shake = math.sqrt(point.process_noise * variance / bench.step) / max(
        abs(point.values.get("input_gain", 1.0)), 1e-12
    )
    rng = np.random.default_rng(0)
    total = np.zeros(len(drive.time))
    for side in _GAP_SIDES:
        # A drive inside its dead-band passes no noise on; one that stands still needs none.
        noise = np.where(drive.command != 0.0, shake * rng.standard_normal(len(drive.time)), 0.0)
        x = kernel.start_state(bench.start, 0.0, 0.5 * side * point.values.get("backlash_gap", 0.0))
        output = kernel.predict(replace(drive, command=drive.command + noise), p, x).reading
        read = output + math.sqrt(variance) * rng.standard_normal(len(output))
        noisy = replace(case, drive=replace(drive, measured=read))
        run = likelihood.innovations(noisy, point.structure, point.values, point.process_noise)
        z = np.nan_to_num(np.abs(run.error) / np.sqrt(run.variance * max(point.scale, 1e-12)), nan=_LOST_DEVIATIONS)
        total += likelihood.huber_loss(z) / len(_GAP_SIDES)
    begins = np.concatenate([[0], checks[:-1] + 1])
    lengths = np.diff(np.append(begins, len(total)))
    return np.repeat(np.maximum(np.add.reduceat(total, begins) / lengths, 1.0), lengths)


def _resting_place(bench: _RigLimits, point: Fit) -> float:
    """Where the axis comes to rest when it is left alone where the first recording began."""
    time = bench.step * np.arange(round(5.0 / bench.step), dtype=float)
    _, states = _free_run(bench, point, time, np.zeros(len(time)))
    place = float(states[-1, 0])
    return place if bench.band[0] <= place <= bench.band[1] else bench.start


def _is_within_travel(bench: _RigLimits, point: Fit, states: FloatArray, checks: NDArray[np.int_]) -> NDArray[np.bool_]:
    """At each check: the path so far keeps within the band, and so does the coasting from there."""
    low, high = bench.band
    slack = 1e-3 * (high - low) if math.isfinite(high - low) else 0.0
    place, speed = states[:, 0], states[:, 1]
    out = (place < low - slack) | (place > high + slack) | ~np.isfinite(place)
    friction = point.values.get("viscous_friction", 0.0)
    end = place + speed / friction if friction > 0.0 else place
    coasting = (end < low - slack) | (end > high + slack)
    return np.asarray((np.cumsum(out)[checks] == 0) & ~coasting[checks])


# ---- evidence ----


def _checks(time: FloatArray) -> NDArray[np.int_]:
    """Index of the sample at each check, the last one included."""
    count = max(round(float(time[-1]) / _CHECK_INTERVAL), 1)
    return np.unique(np.searchsorted(time, np.linspace(0.0, float(time[-1]), count + 1)[1:] - 1e-9))


def _evidence(seen: _SimulatedReading, pair: _Pair) -> list[_Evidence]:
    """What the rival's predictor makes of what the truth would have us read, up to each check."""
    rival = pair.rival
    run = likelihood.innovations(seen.case, rival.structure, pair.values, rival.process_noise, rival.free)
    deviation = np.sqrt(run.variance * max(rival.scale, 1e-12) * seen.error_inflation * pair.overdispersion)
    z = run.error / deviation
    # Errors beyond the robust limit count linearly, as they will in the fit.
    weight = np.sqrt(np.minimum(1.0, likelihood.HUBER_LIMIT / np.maximum(np.abs(z), 1e-300)))
    z, slopes = np.nan_to_num(z * weight), np.nan_to_num(run.slopes * (weight / deviation)[:, None])
    n, out, first = len(rival.free), [], 0
    total = _Evidence(0.0, np.zeros(n), np.zeros((n, n)))
    for check in _checks(seen.case.drive.time):
        k = slice(first, check + 1)
        total = total + _Evidence(float(z[k] @ z[k]), slopes[k].T @ z[k], slopes[k].T @ slopes[k])
        out.append(total)
        first = check + 1
    return out


def _simulate_signal(bench: _RigLimits, signal: Signal, pairs: Sequence[_Pair]) -> _SimulatedSignal | None:
    """Simulate each truth once, and let the rivals predict what it shows; None where a truth leaves the travel."""
    time, command = _sampled(signal, bench.step, bench.lowest, bench.highest)
    checks = _checks(time)
    runs: dict[int, _SimulatedReading] = {}
    safe = np.ones(len(checks), dtype=bool)
    for pair in pairs:
        if id(pair.truth) not in runs:
            case, states = _free_run(bench, pair.truth, time, command)
            safe &= _is_within_travel(bench, pair.truth, states, checks)
            if not safe[-1]:
                return None
            runs[id(pair.truth)] = _SimulatedReading(case, _error_inflation(bench, pair.truth, case, checks))
    seen = tuple(runs[id(pair.truth)] for pair in pairs)
    return _SimulatedSignal(signal, seen, safe, tuple(_evidence(c, pair) for c, pair in zip(seen, pairs, strict=True)))


def _damped_step(pair: _Pair, total: _Evidence, damping: float) -> _Pair:
    """The rival after a damped step within its bounds; none of its parameters loses more than half at once."""
    values, free = dict(pair.values), pair.rival.free
    here = np.array([values[n] for n in free])
    low, high = (np.array([_BOUNDS[n][i] for n in free]) for i in (0, 1))
    active = np.ones(len(free), dtype=bool)
    step = np.zeros(len(free))
    for _ in free:
        index = np.flatnonzero(active)
        step = np.zeros(len(free))
        step[index] = total.part(index).step(damping)
        stuck = ((here <= low) & (step < 0.0)) | ((here >= high) & (step > 0.0))
        if not stuck.any():
            break
        active &= ~stuck
    lowest = np.where(np.isfinite(low), np.maximum(low, np.minimum(0.5 * here, here - 0.1 * low)), -np.inf)
    there = np.clip(here + np.where(active, step, 0.0), np.where(here > low, np.minimum(lowest, here), low), high)
    return replace(pair, values={**values, **dict(zip(free, map(float, there), strict=True))})


def _climb_rival(seen: _SimulatedReading, pair: _Pair) -> tuple[_Pair, float]:
    """The rival where it explains the present recordings and the new one best (Levenberg-Marquardt), and how badly."""
    best, damping = pair, 1e-3
    total = best.before + _evidence(seen, best)[-1]
    for _ in range(_REFIT_STEPS):
        trial = _damped_step(best, total, damping)
        after = trial.before + _evidence(seen, trial)[-1]
        gained = total.squared - after.squared
        if gained > 0.0:
            best, total, damping = trial, after, 0.1 * damping
        else:
            damping = max(10.0 * damping, 1e-2)
        if abs(gained) < 1.0:
            break
    return best, total.squared


def _refit_rival(seen: _SimulatedReading, pair: _Pair) -> _Pair:
    """The better of two fits: from the rival's own values, and from those that it shares with the truth."""
    shared = {n: pair.truth.values.get(n, v) for n, v in pair.values.items()}
    climbs = [_climb_rival(seen, pair), _climb_rival(seen, replace(pair, values=shared))]
    return min(climbs, key=lambda c: c[1])[0]


def _blocks(bench: _RigLimits, point: Fit) -> dict[str, list[Signal]]:
    """Every block at all its tempi, the first as it should be, each also mirrored."""
    values = point.values
    gain, friction = values.get("input_gain", 1.0), max(values.get("viscous_friction", 0.0), 1e-3)
    most = max(-bench.lowest, bench.highest)
    dead = max(values.get("dead_band_forward", 0.0), values.get("dead_band_reverse", 0.0))
    lost = min(dead + values.get("coulomb_friction", 0.0) / max(gain, 1e-12), 0.8 * most)
    pace = min(max(1.0 / friction, 0.25), 1.0)
    span = bench.band[1] - bench.band[0]
    way = min(2.0 * math.pi, span) if bench.template.is_angle else span
    turn = min(way / max(0.5 * gain * (most - lost) / friction, 1e-12), 4.0)
    out: dict[str, list[Signal]] = {}
    for name, signal in library(lost, most, pace, turn).items():
        out[name] = []
        for tempo in _TIME_SCALES:
            quicker = _on_grid(tuple((tempo * length, a, b) for length, a, b in signal), bench.step)
            out[name] += [quicker, _mirrored(quicker)]
    return out


def _sum_ledgers(*ledgers: Ledger) -> tuple[_Evidence, ...]:
    return tuple(sum(entries[1:], entries[0]) for entries in zip(*ledgers, strict=True))


def _feasible_blocks(bench: _RigLimits, pairs: Sequence[_Pair]) -> list[_SimulatedSignal]:
    """Each block at the slowest tempo that keeps within the travel and the duration."""
    found = []
    for variants in _blocks(bench, pairs[0].truth).values():
        fitting = (v for v in variants if _length(v) <= bench.duration + 1e-9)
        tried = (_simulate_signal(bench, v, pairs) for v in fitting)
        if (first := next((t for t in tried if t is not None), None)) is not None:
            found.append(first)
    return found


@dataclass(frozen=True, eq=False)
class _Plan:
    """The signal so far, the rivals refitted to it, and the evidence of it and the present recordings together."""

    pairs: tuple[_Pair, ...]
    ledger: tuple[_Evidence, ...]
    trial: _SimulatedSignal | None = None


def _plan_with(trial: _SimulatedSignal, pairs: Sequence[_Pair], check: int = -1) -> _Plan:
    """The signal up to a check, with every rival refitted to it; a model is not refitted to itself."""
    time = trial.seen[0].case.drive.time
    end = float(time[_checks(time)[check]])
    seen = [s.until(end) for s in trial.seen]
    moved = tuple(p if p.truth is p.rival else _refit_rival(c, p) for p, c in zip(pairs, seen, strict=True))
    evidence = tuple(_evidence(c, p) for c, p in zip(seen, moved, strict=True))
    cut = _SimulatedSignal(_cut_signal(trial.signal, end), tuple(seen), trial.safe[: len(evidence[0])], evidence)
    return _Plan(moved, _sum_ledgers([p.before for p in moved], cut.whole), cut)


def _compose_signal(bench: _RigLimits, pairs: Sequence[_Pair], shortfall: Shortfall) -> _Plan:
    """The signal, block by block, whose evidence leaves the least to be wished for."""
    plan = _Plan(tuple(pairs), tuple(p.before for p in pairs))
    blocks = _feasible_blocks(bench, pairs)
    left = begin = shortfall(plan.ledger)
    while blocks and left > 0.0:
        worth = [(left - shortfall(_sum_ledgers(plan.ledger, b.whole))) / b.length for b in blocks]
        order = np.argsort(worth)[::-1]
        block, rate = blocks[order[0]], worth[order[0]]
        if rate < _MIN_RATE * begin:
            break
        signal = block.signal if plan.trial is None else plan.trial.signal + block.signal
        whole = _simulate_signal(bench, signal, plan.pairs) if _length(signal) <= bench.duration + 1e-9 else None
        longer = None if whole is None else _plan_with(whole, plan.pairs)
        if longer is None or left - shortfall(longer.ledger) < max(0.2 * rate, _MIN_RATE * begin) * block.length:
            blocks.remove(block)
            continue
        plan, left = longer, shortfall(longer.ledger)
        short = [blocks[i] for i in order[:_SHORT_LIST_SIZE]]
        blocks = [replace(b, evidence=tuple(map(_evidence, b.seen, plan.pairs))) for b in short]
    return plan if left > 0.0 or plan.trial is None else _shorten_plan(plan, pairs, shortfall)


def _shorten_plan(plan: _Plan, pairs: Sequence[_Pair], shortfall: Shortfall) -> _Plan:
    """The signal up to where it has told enough."""
    assert plan.trial is not None
    before = [p.before for p in plan.pairs]
    time = plan.trial.seen[0].case.drive.time
    times = time[_checks(time)]
    for check in np.flatnonzero(plan.trial.safe & (times >= _MIN_DURATION))[:-1]:
        if shortfall(_sum_ledgers(before, [e[check] for e in plan.trial.evidence])) > 0.0:
            continue
        cut = _plan_with(plan.trial, pairs, int(check))
        if shortfall(cut.ledger) <= 0.0:
            return cut
    return plan


def _to_experiment(bench: _RigLimits, signal: Signal, why: str, about: tuple[str, ...]) -> Experiment:
    time, command = _sampled(signal, bench.sample_time, bench.lowest, bench.highest)
    return Experiment(why, time, command, about)


# ---- the two questions ----


def _difference_in_words(a: Structure, b: Structure) -> str:
    """What the first has that the second has not, in words."""
    names = [EFFECTS[i].title for i in a.named if i not in b]
    return " and ".join(names)


def _question(leader: Fit, other: Fit) -> str:
    one, two = (
        _difference_in_words(leader.structure, other.structure),
        _difference_in_words(other.structure, leader.structure),
    )
    if one and two:
        return f"tell {one} from {two}"
    if one or two:
        return f"show whether there is {one or two}"
    return "tell the two sets of values apart"


def _acting_effects(point: Fit) -> set[str]:
    """The effects that a model has and that do anything in it."""
    return {e.id for e in point.structure.effects if not e.screen or point.values[e.screen.gain] != 0.0}


def _rival_pairs(rivals: Sequence[Fit]) -> list[_Pair]:
    """The leader against each other rival, both ways. A truth that the rival contains is left out."""
    leader, both = rivals[0], []
    for other in rivals[1:_MAX_RIVALS]:
        for truth, rival in ((leader, other), (other, leader)):
            if truth.structure == rival.structure or not _acting_effects(truth) <= set(rival.structure.ids):
                both.append(_Pair(truth, rival, rival.values))
    return both


def design_for_discrimination(
    rivals: Sequence[Fit], cases: Sequence[PreparedRecording], limits: Limits | None = None
) -> Experiment:
    """The input that tells the first of the rivals, the likeliest, from the others.

    Rivals are fitted models in the order of their probability (the first three count), `cases` the recordings that they
    were fitted to. With one rival, or others that add only what does nothing, `design_for_precision` answers instead.
    The input starts from rest and is as short as a verdict needs. Its promise holds as far as the physics that the
    rivals share is right. With rigid teeth on a rig whose teeth are compliant, it promises far more than comes
    (scripts/experiment_study.py).

    Raises BadInput where the limits or the recordings leave no room for any input.
    """
    limits = limits or Limits()
    bench = _rig_limits(rivals[:_MAX_RIVALS], cases, limits)
    pairs = _rival_pairs(rivals)
    if not pairs:
        return design_for_precision(rivals[0], cases, limits)
    shown = [r.structure for r in rivals[:_MAX_RIVALS]]

    def shortfall(ledger: Ledger) -> float:
        return sum(max(1.0 - e.divergence / (_SAFETY_FACTOR * NEEDED_LOG_LIKELIHOOD), 0.0) for e in ledger) / len(
            ledger
        )

    plan = _compose_signal(bench, pairs, shortfall)
    goal = " and to ".join(_question(rivals[0], other) for other in rivals[1:_MAX_RIVALS])
    if plan.trial is None:
        return Experiment(f"No input within these limits would {goal}; allow more input, travel or time.")
    margin = min(e.divergence for e in plan.ledger)
    seconds = f"{plan.trial.length:.1f} s of this input"
    if margin >= NEEDED_LOG_LIKELIHOOD:
        why = (
            f"{seconds} should {goal}: the wrong model is expected to lose a log-likelihood of {margin:.0f} or more; "
            f"{NEEDED_LOG_LIKELIHOOD:.0f} make a verdict safe."
        )
    else:
        why = (
            f"{seconds} go furthest within these limits to {goal}, but in the worst case the wrong model loses a "
            f"log-likelihood of only {margin:.1f}. {NEEDED_LOG_LIKELIHOOD:.0f} make a verdict safe: "
            "allow more input, travel or time."
        )
    told = dict.fromkeys(i for r in rivals[:_MAX_RIVALS] for i in r.structure.named if not all(i in o for o in shown))
    return _to_experiment(bench, plan.trial.signal, why, tuple(told))


def _parameter_scales(point: Fit, bench: _RigLimits) -> FloatArray:
    """What an error of each free parameter is compared with.

    Its value; for an angle a radian, and for a position the travel. For what may well be zero it is at least a fiftieth
    of the input's range, or of the torque at that input.
    """
    known = {p.name: p for p in point.structure.parameters}
    span = bench.band[1] - bench.band[0]
    travel = span if math.isfinite(span) and span > 0.0 else 1.0
    most = max(-bench.lowest, bench.highest)
    least = {"{u}": 0.02 * most, "{x}/s^2": 0.02 * most * point.values.get("input_gain", 1.0), "rad": 1.0}
    sizes = []
    for name in point.free:
        parameter = known[name]
        floor = least.get(parameter.unit, 0.1 * abs(parameter.start))
        if parameter.unit == "{x}" and math.isinf(parameter.lower):
            floor = travel
        sizes.append(max(abs(point.values[name]), floor, 1e-9))
    return np.array(sizes)


def _relative_errors(information: FloatArray) -> FloatArray:
    """What information (n, n) leaves open of parameters that were known to within `_UNKNOWN_ERROR` before, (n,).

    What readings cannot tell apart leaves an eigenvalue that is only rounding, of either sign: it says nothing.
    """
    known, ways = np.linalg.eigh(information)
    told = np.where(known > len(known) * np.finfo(float).eps * known[-1], known, 0.0)
    return np.asarray(np.sqrt(np.sum(ways**2 / (told + 1.0 / _UNKNOWN_ERROR**2), axis=1)))


def design_for_precision(point: Fit, cases: Sequence[PreparedRecording], limits: Limits | None = None) -> Experiment:
    """The input that fixes the worst-known parameter of a fitted model, and the others as far as it can.

    Aims at relative standard errors of 2 %, or half of the worst one where all are known better than that. Raises
    BadInput as `design_for_discrimination` does.
    """
    bench = _rig_limits([point], cases, limits or Limits())
    sizes = _parameter_scales(point, bench)
    sought = np.array([i for i, n in enumerate(point.free) if n not in _NOT_SOUGHT], dtype=int)
    if len(sought) == 0:
        return Experiment("No parameter is left that an experiment could fix.")

    def errors(ledger: Ledger) -> FloatArray:
        return np.asarray(_relative_errors(ledger[0].information * np.outer(sizes, sizes))[sought])

    pair = _Pair(point, point, point.values)
    before = errors([pair.before])
    worst = int(np.argmax(before))
    target = min(_KNOWN_ERROR, 0.5 * float(before[worst]))

    def shortfall(ledger: Ledger) -> float:
        excess = np.log(np.maximum(errors(ledger) / target, 1.0))
        # The worst counts; the mean keeps the search moving where several are as bad.
        return float(excess.max() + 0.3 * excess.mean())

    plan = _compose_signal(bench, [pair], shortfall)
    name = point.free[int(sought[worst])]
    parameters = {p.name: p for p in point.structure.parameters}
    axis = bench.template.output_unit.removesuffix("/s")

    def unit_of(name: str) -> str:
        unit = parameters[name].unit_for(axis, bench.template.input_unit)
        return "" if unit == "1" else f" {unit}"

    unit, seat = unit_of(name), knots.seat(name, point.values)
    at = f", at {seat[1]:.3g}{unit_of(seat[0])}" if seat else ""
    size = float(sizes[sought[worst]])
    known = f"The worst-known parameter is {name} ({parameters[name].meaning}{at})"
    if plan.trial is None:
        return Experiment(f"{known}; no input within these limits fixes it better. Allow more input, travel or time.")
    after = float(errors(plan.ledger)[worst])
    fixed = before[worst] <= 0.5 * _UNKNOWN_ERROR
    was = f"its standard error is now {before[worst] * size:.2g}{unit}" if fixed else "this recording does not fix it"
    why = (
        f"{known}: {was}. {plan.trial.length:.1f} s of this input should bring the standard error to "
        f"{after * size:.2g}{unit}."
    )
    return _to_experiment(bench, plan.trial.signal, why, (name,))
