"""The paper's method: steady states, then transients in which the gears are in mesh (its equations 6 to 21).

Stage 1: the steady speeds over all duties of the recording give q = b/c and the dead-band. Stage 2: after each change
of the input, the stretch in which the gap is crossed is found and left out. In the rest, speed is a constant and one
exponential, linear in all but b. So b is a bounded scalar search (variable projection, Golub and Pereyra, SIAM J.
Numer. Anal. 10, 1973). The data are speeds (differences of readings, as printed in the paper) or the readings
themselves. The latter exist because one count between two samples is more speed than the axis has.

The paper's signs: it adds delta to the duty (eq. 6). So delta is minus the forward dead-band when driving forwards, and
plus the reverse dead-band when driving backwards.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from twin.effects.catalogue import BASE
from twin.io.recording import Recording, command_of, known_quantities, told_of
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

FloatArray = NDArray[np.float64]

#: Names of the estimates, in the order of `TwoStage.covariance`.
NAMES = ("q", "dead_band_forward", "dead_band_reverse", "b", "c")

_MIN_READINGS = 40  # readings in a hold, and a third of that in a piece
_CROSSING_WINDOW = 1.5  # s after a change of the input in which the crossing of the gap is looked for
_SETTLING_TIME = 2.5  # time constants after which a hold shows its steady speed, the rest of the transient fitted
_CROSSING_TIME = 1.5  # time constants in which the crossing is looked for once b is known; later noise has the say
_MIN_EVIDENCE = (20.0, 0.05)  # of minus twice the log-likelihood, at all and per reading, that a bend must gain
_PIECE_LENGTH = 3.0  # time constants of transient that make a piece; later only drift would be added
_RATE_GRID = np.geomspace(0.05, 40.0, 28)  # 1/s, where b is looked for at first


@dataclass(frozen=True, eq=False)
class Piece:
    """What remains of one hold of the input once the gears are in mesh, and the b that it gives."""

    recording: int  # which of the recordings, from 0
    held_since: float  # s, when the input took its value; from here to `start` the gap is crossed
    start: float  # s
    end: float  # s
    input: float
    b: float  # 1/s; NaN where the piece gives none
    b_std: float  # Cramer-Rao bound, the steady speed taken as known
    used: bool
    why: str  # a sentence, empty where the piece is used
    time: FloatArray = field(repr=False)  # (n,) s
    measured: FloatArray = field(repr=False)  # (n,) position or speed
    fitted: FloatArray = field(repr=False)  # (n,) the same by the piece's own b


@dataclass(frozen=True, eq=False)
class TwoStage:
    """The result; numbers are NaN where `ok` is False, and `says` tells why."""

    form: str  # "speeds" | "positions"
    q: float  # input unit per unit of speed
    dead_band_forward: float  # input unit, what is lost
    dead_band_reverse: float
    b: float  # 1/s; speeds: average of the pieces; positions: joint fit of the pieces
    c: float  # acceleration per input unit
    covariance: FloatArray  # (5, 5) of NAMES
    pieces: tuple[Piece, ...]
    steady: tuple[tuple[float, float, float], ...]  # input, speed, standard error
    says: str
    ok: bool

    def std(self, name: str) -> float:
        """Standard error of one of NAMES."""
        index = NAMES.index(name)
        return math.sqrt(float(self.covariance[index, index])) if self.ok else math.nan

    @property
    def skipped(self) -> tuple[tuple[float, float], ...]:
        """Start and end (s) of the stretches in which the gap is crossed, thrown away."""
        return tuple((p.held_since, p.start) for p in self.pieces if p.start > p.held_since)

    @property
    def average(self) -> float:
        """Of the pieces' b, as the paper takes it."""
        return float(np.mean([p.b for p in self.pieces if p.used])) if self.ok else math.nan

    @property
    def scatter(self) -> float:
        """Standard deviation of the pieces' b; NaN for a single piece."""
        found = [p.b for p in self.pieces if p.used]
        return float(np.std(found, ddof=1)) if len(found) > 1 else math.nan

    def __repr__(self) -> str:
        if not self.ok:
            return f"no estimate: {self.says}"
        numbers = ", ".join(f"{n} = {getattr(self, n):.4g} +- {self.std(n):.2g}" for n in NAMES)
        return f"{numbers} from {self.form} of {sum(p.used for p in self.pieces)} pieces"


@dataclass(frozen=True, eq=False)
class _Hold:
    """A stretch of constant input, or what is left of it; times count from `since`."""

    recording: int
    since: float
    before: float  # the input until then
    input: float
    time: FloatArray
    value: FloatArray
    speed: bool  # the values are speeds
    noise: float  # variance of a reading (position, or speed where only that is logged), unit squared

    def part(self, start: float, end: float = math.inf) -> _Hold:
        keep = (self.time >= start) & (self.time <= end)
        return replace(self, time=self.time[keep], value=self.value[keep])

    def as_speeds(self) -> _Hold:
        """Differences of readings over differences of stamps: what eq. (14) takes for speed."""
        if self.speed:
            return self
        middle = 0.5 * (self.time[1:] + self.time[:-1])
        return replace(self, time=middle, value=np.diff(self.value) / np.diff(self.time), speed=True)

    @property
    def length(self) -> float:
        return float(self.time[-1] - self.time[0]) if len(self.time) else 0.0


def _holds(recordings: Sequence[Recording]) -> list[_Hold]:
    """All stretches of constant input with enough readings."""
    holds = []
    for index, recording in enumerate(recordings):
        command, time = command_of(recording), recording.time
        changed = np.abs(np.diff(recording.input)) > 1e-6 * max(float(np.ptp(recording.input)), 1e-300)
        edges = [0, *(np.flatnonzero(changed) + 1).tolist(), len(time)]
        for first, last in itertools.pairwise(edges):
            # The reading at the next change is still the work of this input.
            rows = np.arange(first, min(last + 1, len(time)))
            rows = rows[np.isfinite(recording.output[rows])]
            if len(rows) < _MIN_READINGS:
                continue
            since = float(time[first])
            level = float(np.median(command[first:last]))
            before = float(command[max(first - 1, 0)])
            noise = recording.resolution**2 / 12.0
            values = recording.output[rows]
            holds.append(_Hold(index, since, before, level, time[rows] - since, values, recording.is_speed, noise))
    return holds


def _columns(time: FloatArray, b: float, speed: bool) -> FloatArray:
    """Columns steady and transient, of position also a constant in front (eq. 14 integrated once)."""
    decay = np.exp(-b * time)
    if speed:
        return np.column_stack([np.ones_like(time), decay])
    return np.column_stack([np.ones_like(time), time, (1.0 - decay) / b])


def _residuals(columns: FloatArray, y: FloatArray) -> FloatArray:
    """What least squares leaves of y: s - H (H'H)^-1 H's, the complement of eq. (18)."""
    return np.asarray(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0])


def _tail_residuals(columns: FloatArray, y: FloatArray) -> FloatArray:
    """Sum of squares that least squares leaves of y[k:], for every k (n,)."""
    basis, _ = np.linalg.qr(columns)
    rows = np.column_stack([basis, y - basis @ (basis.T @ y)])  # small numbers: sums of their squares stay exact
    gram = np.cumsum((rows[:, :, None] * rows[:, None, :])[::-1], axis=0)[::-1]
    a, g = gram[:, :-1, :-1], gram[:, :-1, -1]
    trace = np.trace(a, axis1=1, axis2=2)[:, None, None] * 1e-12 + 1e-30
    solved = np.linalg.solve(a + trace * np.eye(a.shape[1]), g[:, :, None])[:, :, 0]
    return np.asarray(np.maximum(gram[:, -1, -1] - (g * solved).sum(axis=1), 0.0))


def _bend_misfits(head: _Hold, exponentials: Sequence[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """How badly (minus twice a log-likelihood) a bend at each of the first readings fits, for each (columns, values).

    While the gap is crossed the link coasts, then it is hit: speed is a line, then jumps to an exponential.
    """
    n = len(head.time)
    floor = 0.5 * n * max(head.noise, 1e-12 * float(np.var(head.value)), 1e-30)
    coast = np.vander(head.time, 2)
    before = np.concatenate(
        [[0.0], _tail_residuals(coast[::-1], head.value[::-1])[::-1][:-1]]
    )  # of the first k readings
    total = floor + before + np.array([_tail_residuals(columns, values) for columns, values in exponentials])
    return np.asarray(n * np.log(total[:, : int(0.6 * n)]))


def _mesh_time(time: FloatArray, misfit: FloatArray, gain: float) -> float:
    """When the gears are in mesh: after the best bend (n,), if it is better than none (the first) by `gain`."""
    k = int(np.argmin(misfit))
    # Teeth bounce on arrival, about as long again as the crossing took.
    return float(2.0 * time[k] + 0.01) if k and misfit[0] - misfit[k] > gain else 0.0


def _required_evidence(readings: int) -> float:
    return _MIN_EVIDENCE[0] + _MIN_EVIDENCE[1] * readings


def _first_speeds(hold: _Hold, length: float) -> _Hold:
    """Speeds of the hold's first seconds, over steps so long that there are some 150 to 300.

    A drifting load makes of positions a smooth curve with bends of its own; in speeds it stays noise.
    """
    head = hold.part(0.0, length)
    stride = max(len(head.time) // 150, 1)
    return replace(head, time=head.time[::stride], value=head.value[::stride]).as_speeds()


def _first_mesh_time(hold: _Hold) -> tuple[float, FloatArray]:
    """When the gears are in mesh while nothing else is known; and the evidence against each of _RATES."""
    head = _first_speeds(hold, _CROSSING_WINDOW)
    misfit = _bend_misfits(head, [(_columns(head.time, b, True), head.value) for b in _RATE_GRID])
    chosen = misfit[int(np.argmin(np.min(misfit, axis=1)))]
    return _mesh_time(head.time, chosen, _required_evidence(len(head.time))), np.min(misfit, axis=1)


def _mesh_times(holds: Sequence[_Hold], b: float, line: FloatArray) -> list[float]:
    """When the gears are in mesh, with b and the steady speeds roughly known; like changes of the input share it."""
    groups: dict[tuple[int, float, float], list[int]] = {}
    for i, hold in enumerate(holds):
        groups.setdefault((hold.recording, round(hold.before, 6), round(hold.input, 6)), []).append(i)
    starts = [0.0] * len(holds)
    for members in groups.values():
        heads = [_first_speeds(holds[i], min(_CROSSING_WINDOW, 0.2 + _CROSSING_TIME / b)) for i in members]
        misfits = [_bend_misfits(h, [_without_steady(h, b, _steady_speed(h.input, line))])[0] for h in heads]
        n = min(len(m) for m in misfits)
        shortest = min(heads, key=lambda h: len(h.time))
        gain = _required_evidence(sum(len(h.time) for h in heads))
        start = _mesh_time(shortest.time, np.sum([m[:n] for m in misfits], axis=0), gain)
        for i in members:
            starts[i] = start
    return starts


def _without_steady(hold: _Hold, b: float, steady: float) -> tuple[FloatArray, FloatArray]:
    """Columns that remain when the steady speed is known, and what they are to explain: s of eq. (18)."""
    columns = _columns(hold.time, b, hold.speed)
    known = columns.shape[1] - 2
    return np.delete(columns, known, axis=1), hold.value - steady * columns[:, known]


def _steady_regressors(duty: FloatArray) -> FloatArray:
    """Steady speed is linear in (1/q, forward dead-band / q, reverse dead-band / q)."""
    return np.column_stack([duty, -(duty > 0.0).astype(float), (duty < 0.0).astype(float)])


def _steady_speed(duty: float, line: FloatArray) -> float:
    return float((_steady_regressors(np.array([duty])) @ line)[0])


def steady_gains(steady: Sequence[tuple[float, float, float]]) -> tuple[FloatArray, FloatArray]:
    """(1/q, d_f/q, d_r/q) and their covariance from (input, speed, standard error) by weighted least squares.

    With the paper's four duties and equal errors this is eq. (11) solved by hand: the speeds carry the errors, so they
    are regressed on the duties, with one slope and an intercept for each direction. Raises numpy's LinAlgError when
    the duties do not suffice.
    """
    duty, speed, error = (np.array(column) for column in zip(*steady, strict=True))
    unit = np.array([max(float(np.max(np.abs(duty))), 1e-300), 1.0, 1.0])  # so that the rank asks for no unit of input
    weighted = _steady_regressors(duty) / unit / error[:, None]
    if np.linalg.matrix_rank(weighted) < 3:
        raise np.linalg.LinAlgError
    inverse = np.linalg.inv(weighted.T @ weighted)
    solution = inverse @ weighted.T @ (speed / error)
    spare = len(duty) - 3
    excess = float(np.sum((speed / error - weighted @ solution) ** 2)) / spare if spare else 1.0
    return solution / unit, inverse / np.outer(unit, unit) * max(excess, 1.0)


def _settled_holds(holds: Sequence[_Hold], b: float) -> tuple[list[_Hold], float]:
    """The holds that settle, and b from them alone, each with its own steady speed: a known one would be circular."""
    long = [h for h in holds if h.length * b > _SETTLING_TIME and len(h.time) >= _MIN_READINGS]
    if not long:
        return [], b

    def misfit(rate: float) -> float:
        left = [float(np.mean(_residuals(_columns(h.time, rate, h.speed), h.value) ** 2)) for h in long]
        return sum(len(h.time) * math.log(max(x, h.noise, 1e-300)) for x, h in zip(left, long, strict=True))

    return long, _bounded_search(misfit, b)


def _steady_state(hold: _Hold, b: float) -> tuple[float, float] | None:
    """Steady speed and its standard error from one hold; None where the axis does not settle.

    Two errors add up. The white noise of the readings is seen from one to the next. A drifting load is seen in how much
    further the mean speeds of eight blocks are apart.
    """
    columns = _columns(hold.time, b, hold.speed)
    solution = np.linalg.lstsq(columns, hold.value, rcond=None)[0]
    rest = hold.value - columns @ solution
    place = columns.shape[1] - 2
    speed, n = float(solution[place]), len(rest)
    white = max(0.5 * float(np.mean(np.diff(rest) ** 2)), hold.noise)
    blocks = np.array([np.mean(block) for block in np.array_split(rest, 8)])
    if hold.speed:
        spread = float(np.mean(blocks**2))
        expected = 8.0 * white / n
    else:
        spread = float(np.mean(np.diff(blocks) ** 2)) / (hold.length / 8.0) ** 2
        expected = 16.0 * white / n / (hold.length / 8.0) ** 2
    drift = max(spread - expected, 0.0) / 6.0
    error = math.sqrt(white * float(np.linalg.inv(columns.T @ columns)[place, place]) + drift)
    if max(math.sqrt(6.0 * drift), 2.0 * error) > 0.1 * abs(speed):
        return None
    return speed, max(error, 1e-9 * abs(speed))


def cramer_rao_bound(
    time: FloatArray, b: float, amplitude: float, noise: float, speed: bool = False, known: bool = True
) -> float:
    """Cramer-Rao bound of b from one piece (standard error).

    `time` (n,) s; `amplitude` the A of eq. (14); `noise` the standard deviation of a reading, white; `speed`: readings
    are speeds; `known`: the steady speed is known, else it is estimated as well.
    """
    columns = _columns(time - time[0], b, speed)
    slope = amplitude * _transient_slope(time - time[0], b, speed)
    nuisance = np.delete(columns, columns.shape[1] - 2, axis=1) if known else columns
    seen = float(np.sum(_residuals(nuisance, slope) ** 2))
    return noise / math.sqrt(seen) if seen > 0.0 else math.inf


def _transient_slope(time: FloatArray, b: float, speed: bool) -> FloatArray:
    """Derivative of the transient column with respect to b."""
    decay = np.exp(-b * time)
    return np.asarray(-time * decay if speed else (time * decay - (1.0 - decay) / b) / b)


@dataclass(frozen=True, eq=False)
class _Transient:
    """A piece made ready: the steady speed is taken off, nuisance and transient columns remain."""

    hold: _Hold  # in the form that is fitted; time from the piece's start
    reading: _Hold  # as read
    steady: float

    def left(self, b: float) -> tuple[FloatArray, FloatArray]:
        return _without_steady(self.hold, b, self.steady)

    def misfit(self, b: float) -> float:
        return float(np.sum(_residuals(*self.left(b)) ** 2))

    def linearised(self, b: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """At b, cleared of the nuisance: slope in b, slope in the steady speed, what is left (all (n,))."""
        columns, y = self.left(b)
        amplitude = float(np.linalg.lstsq(columns, y, rcond=None)[0][-1])
        slope = amplitude * _transient_slope(self.hold.time, b, self.hold.speed)
        whole = _columns(self.hold.time, b, self.hold.speed)
        return _residuals(columns, slope), _residuals(columns, whole[:, whole.shape[1] - 2]), _residuals(columns, y)

    def variance(self, b: float) -> float:
        return max(self.misfit(b) / max(len(self.hold.time) - 3, 1), 1e-12 * float(np.var(self.hold.value)), 1e-300)


def _bounded_search(misfit: Callable[[float], float], around: float) -> float:
    """b of the least misfit between a tenth and ten times a first value; a scan guards against side minima."""
    grid = np.log(around) + np.linspace(-math.log(10.0), math.log(10.0), 25)
    k = int(np.argmin([misfit(math.exp(x)) for x in grid]))
    limits = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    found = minimize_scalar(lambda x: misfit(math.exp(x)), bounds=limits, method="bounded", options={"xatol": 1e-6})
    return float(math.exp(found.x))


def _transient(hold: _Hold, start: float, b: float, steady: float, form: str) -> _Transient:
    reading = hold.part(start, start + _PIECE_LENGTH / b)
    reading = replace(reading, time=reading.time - start, since=hold.since + start)
    return _Transient(reading.as_speeds() if form == "speeds" else reading, reading, steady)


def _evaluate_piece(transient: _Transient, held_since: float, around: float) -> Piece:
    """The piece's own b, its bound, and whether it says anything about b."""
    t = transient
    if len(t.hold.time) < _MIN_READINGS // 3:
        b, why = math.nan, "fewer readings than a piece needs are left after the gap"
    else:
        b = _bounded_search(t.misfit, around)
        at_limit = not 0.105 * around < b < 9.5 * around
        why = "the search for b ends at its limit: there is hardly a transient" if at_limit else ""
    error, fitted = math.inf, np.full(len(t.reading.time), math.nan)
    if math.isfinite(b):
        columns, values = _without_steady(t.reading, b, t.steady)
        solution = np.linalg.lstsq(columns, values, rcond=None)[0]
        fitted = t.reading.value - values + columns @ solution
        scatter = float(np.sum((t.reading.value - fitted) ** 2)) / max(len(fitted) - 3, 1)
        noise = math.sqrt(max(scatter, t.reading.noise))
        error = cramer_rao_bound(t.reading.time, b, float(solution[-1]), noise, t.reading.speed)
        if not why and error > 0.3 * b:
            why = f"its bound for b is {error:.2g} 1/s: there is hardly a transient"
    since = t.reading.since
    end = since + (float(t.reading.time[-1]) if len(t.reading.time) else 0.0)
    return Piece(
        recording=t.reading.recording, held_since=held_since, start=since, end=end, input=t.reading.input,
        b=b, b_std=error, used=not why, why=why,
        time=since + t.reading.time, measured=t.reading.value, fitted=fitted,
    )  # fmt: skip


def _mean_rate(used: Sequence[_Transient], bs: Sequence[float]) -> tuple[float, float, FloatArray]:
    """Speeds as printed: mean of the pieces, its variance, and its slope in (1/q, d_f/q, d_r/q)."""
    slopes = []
    for transient, b in zip(used, bs, strict=True):
        in_b, in_steady, _ = transient.linearised(b)
        slopes.append(
            -float(in_b @ in_steady / (in_b @ in_b)) * _steady_regressors(np.array([transient.hold.input]))[0]
        )
    variance = float(np.var(bs, ddof=1)) / len(bs) if len(bs) > 1 else math.inf
    return float(np.mean(bs)), variance, np.mean(slopes, axis=0)


def _joint_rate(used: Sequence[_Transient], bs: Sequence[float]) -> tuple[float, float, FloatArray]:
    """One b for all pieces, each weighted with its own scatter; the same three numbers.

    The variance is that of the pieces' scores, because readings within a piece drift together.
    """
    weights = [1.0 / t.variance(b) for t, b in zip(used, bs, strict=True)]
    b = _bounded_search(
        lambda x: sum(w * t.misfit(x) for w, t in zip(weights, used, strict=True)), float(np.median(bs))
    )
    information, scores, slope = 0.0, [], np.zeros(3)
    for w, transient in zip(weights, used, strict=True):
        in_b, in_steady, left = transient.linearised(b)
        information += w * float(in_b @ in_b)
        scores.append(w * float(in_b @ left))
        slope -= w * float(in_b @ in_steady) * _steady_regressors(np.array([transient.hold.input]))[0]
    n = len(scores)
    spread = float(np.sum(np.square(scores))) * n / (n - 1) / information**2 if n > 1 else 1.0 / information
    return b, max(spread, 1.0 / information), slope / information


def _covariance(line: FloatArray, spread: FloatArray, b: float, variance: float, slope: FloatArray) -> FloatArray:
    """(5, 5) of NAMES, by the linear parts, from those of the line and of b."""
    inner = np.zeros((4, 4))
    inner[:3, :3] = spread
    inner[3, :3] = inner[:3, 3] = spread @ slope
    inner[3, 3] = variance + float(slope @ spread @ slope)
    q = 1.0 / line[0]
    outer = np.zeros((5, 4))
    outer[0, 0] = -(q**2)
    outer[1, :2] = -line[1] * q**2, q
    outer[2, 0], outer[2, 2] = -line[2] * q**2, q
    outer[3, 3] = 1.0
    outer[4, 0], outer[4, 3] = b, line[0]
    return np.asarray(outer @ inner @ outer.T)


def _no_estimate(
    form: str, says: str, pieces: tuple[Piece, ...] = (), steady: Sequence[tuple[float, float, float]] = ()
) -> TwoStage:
    nan = math.nan
    return TwoStage(form, nan, nan, nan, nan, nan, np.full((5, 5), nan), pieces, tuple(steady), says, False)


def _mean_levels(found: Sequence[tuple[float, float, float]]) -> tuple[tuple[float, float, float], ...]:
    """Steady speeds by input, forwards first: repetitions of a level as one weighted mean."""
    levels = []
    for level in sorted({round(duty, 9) for duty, _, _ in found}, key=lambda duty: (duty < 0.0, abs(duty))):
        same = [(speed, error) for duty, speed, error in found if round(duty, 9) == level]
        weight = np.array([error**-2.0 for _, error in same])
        speed = float(np.sum(weight * [speed for speed, _ in same]) / weight.sum())
        levels.append((level, speed, float(weight.sum() ** -0.5)))
    return tuple(levels)


def _missing_levels(levels: Sequence[tuple[float, float, float]]) -> str:
    """Why the steady states do not give q and the dead-band; empty where they do."""
    more = "hold the input at two duties or more in each direction until the speed is steady"
    if not levels:
        return f"no steady state was found: {more}"
    for name, side in (("forwards", 1.0), ("backwards", -1.0)):
        if not any(duty * side > 0.0 for duty, _, _ in levels):
            return f"no steady state was found driving {name}: {more}"
    if all(sum(duty * side > 0.0 for duty, _, _ in levels) < 2 for side in (1.0, -1.0)):
        return f"only one duty in each direction reaches a steady state, and q needs two: {more}"
    return ""


def two_stage(recordings: Sequence[Recording], form: str = "positions") -> TwoStage:
    """Estimate q, dead-band, b and c from recordings of the paper's kind; never fails for what they lack.

    `form` is "speeds" or "positions"; a recording that holds speeds only is fitted as speeds. A result with `ok`
    False says in one sentence what the recordings lack.
    """
    note = ""
    if any(r.is_speed for r in recordings) and form == "positions":
        form, note = "speeds", " The recording holds speeds only, so these were fitted."
    if len({tuple(known_quantities(r).values()) for r in recordings}) > 1:
        says = "the recordings differ in their payload, and this method knows one inertia: fit them jointly"
        return _no_estimate(form, says)
    holds = _holds(recordings)
    if not holds:
        says = "the input is never constant long enough: hold it at several duties, then play a square wave"
        return _no_estimate(form, says + note)
    looks = [_first_mesh_time(hold) for hold in holds]
    first = float(_RATE_GRID[int(np.argmin(np.sum([misfit for _, misfit in looks], axis=0)))])
    driven = [(h, h.part(start)) for h, (start, _) in zip(holds, looks, strict=True) if h.input != 0.0]
    long, b = _settled_holds([m.as_speeds() if form == "speeds" else m for _, m in driven], first)
    found = [(h.input, *settled) for h in long if (settled := _steady_state(h, b)) is not None]
    levels = _mean_levels(found)
    if lacking := _missing_levels(levels):
        return _no_estimate(form, lacking + note, steady=levels)
    line, spread = steady_gains(found)
    if line[0] <= 0.0:
        says = "the steady speeds do not rise with the duty: something else moves the axis"
        return _no_estimate(form, says + note, steady=levels)
    q = 1.0 / float(line[0])
    moving = [h for h, _ in driven if abs(h.input) > 1.05 * q * (line[1] if h.input > 0.0 else line[2])]
    starts = _mesh_times(moving, b, line)
    transients = [
        _transient(h, start, b, _steady_speed(h.input, line), form) for h, start in zip(moving, starts, strict=True)
    ]
    pieces = tuple(_evaluate_piece(t, h.since, b) for t, h in zip(transients, moving, strict=True))
    used = [t for t, p in zip(transients, pieces, strict=True) if p.used]
    if not used:
        says = "no piece shows a transient from which b could be had: play a square wave with slower reversals"
        return _no_estimate(form, says + note, pieces, levels)
    combine = _mean_rate if form == "speeds" else _joint_rate
    b, variance, slope = combine(used, [p.b for p in pieces if p.used])
    says = (
        f"{len(levels)} steady speeds and {len(used)} of {len(pieces)} pieces were used; "
        f"dead-band and dry friction are the same thing in what this method looks at.{note}"
    )
    covariance = _covariance(line, spread, b, variance, slope)
    return TwoStage(
        form, q, q * float(line[1]), q * float(line[2]), b, b * float(line[0]), covariance, pieces, levels, says, True
    )


def to_model(result: TwoStage, recordings: Sequence[Recording]) -> Model:
    """The base effects with what this method knows; the gap is zero and its note says that it was not looked for.

    Raises ValueError for a result that is not ok.
    """
    if not result.ok:
        raise ValueError(result.says)
    structure = Structure.of(BASE)
    unseen = "not estimated: this method throws away the readings that show it; use the joint method"
    lost = "what dead-band and dry friction lose together: in steady driving they are the same thing"
    values = {p.name: p.start for p in structure.parameters}
    values |= {
        "input_gain": result.c, "viscous_friction": result.b, "backlash_gap": 0.0,
        "dead_band_forward": max(result.dead_band_forward, 0.0),
        "dead_band_reverse": max(result.dead_band_reverse, 0.0),
    }  # fmt: skip
    rows = [NAMES.index(n) for n in ("c", "b", "dead_band_forward", "dead_band_reverse")]
    first = recordings[0]
    known = {k: v for k, v in known_quantities(first).items() if v}
    known |= told_of(first)
    return Model(
        structure=structure,
        values=values,
        fitted=("input_gain", "viscous_friction", "dead_band_forward", "dead_band_reverse"),
        covariance=result.covariance[np.ix_(rows, rows)],
        notes={
            "dead_band_forward": lost,
            "dead_band_reverse": lost,
            "backlash_gap": unseen,
            "motor_share": unseen,
            "friction_share": unseen,
        },
        axis_unit=first.output_unit.removesuffix("/s"),
        input_unit=first.input_unit,
        sample_time=float(np.round(np.median(np.diff(first.time)), 9)),
        resolution=first.resolution,
        reads_speed=first.is_speed,
        reading_std=first.resolution / math.sqrt(12.0),
        known=known,
        provenance={
            "method": f"two-stage, {result.form}",
            "recordings": ", ".join(r.name for r in recordings),
            "says": result.says,
        },
    )
