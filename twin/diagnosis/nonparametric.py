"""Whether the missing torque still depends on a state, and a curve for it where no known effect describes it.

What is missing may depend on any state of motion, alone or with another. For each the missing torque is predicted from
its means over bins of that state, always on stretches that these means have not seen. The noise is correlated over the
filter's memory and louder in some states than in others. Its effect is seen when whole stretches get a random sign (the
wild bootstrap of Liu, Ann. Stat. 16, 1988): the noise stays as it is, and no dependence remains. The best of all tables
has to beat the best of all tables under such signs.

The torque is read through two filters. A short memory sees what changes fast. A memory twice as long lets in a
thirty-second of the variance that the noise of the readings makes, and shows what that noise would hide.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from twin.diagnosis import residual_torque, thresholds
from twin.diagnosis.residual_torque import MissingTorque
from twin.effects.catalogue import pages
from twin.effects.knots import KNOTS, names, slopes, spots, through
from twin.estimation import likelihood, local_optima, multistart, optimizer
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.model.stepper import Structure

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

_TURN = 2.0 * math.pi
#: Length of the stretches held out or given a sign, s.
_BLOCK_LENGTH = 0.25
_FOLDS = 10
#: Memories of the filters that read the missing torque, s. From twice the longer one on, errors would be correlated
#: beyond a stretch.
MEMORIES = (residual_torque.TORQUE_MEMORY, 2.0 * residual_torque.TORQUE_MEMORY)
_BOOTSTRAP_DRAWS = 199
#: So many averages at zero does every bin get beside its own.
_SHRINKAGE = 5.0
#: Waves over position, so many times a turn, each cut into so many phases.
_WAVE_ORDERS = range(2, 61)
_PHASE_BINS = 8
#: Travel after a reversal over which friction and gap may still depend on it, rad.
_REVERSAL_RANGE = 0.3
_EULER_MASCHERONI = 0.5772156649015329


@dataclass(frozen=True)
class Dependence:
    """How well one state, or a pair, predicts the missing torque.

    `share` of the variance of the torque is predicted on stretches not used for it. That is `score` standard
    deviations above what noise gives. `size` is the RMS of the predicted torque, as acceleration. `table` is the
    state's own name. `variables` says the same in the words of the contract.
    """

    table: str
    variables: tuple[str, ...]
    share: float
    score: float
    size: float


@dataclass(frozen=True)
class RemainingDependence:
    """What is still predictable in the missing torque: the best of all dependences.

    `p_value` is the chance that noise does as well in any of the tables. `of_motion` is its size as a share of the
    axis' acceleration. `memory` is that of the filter that shows it, s. `sizes` has the size by each memory asked.
    """

    share: float
    p_value: float
    variables: tuple[str, ...]
    table: str
    size: float
    of_motion: float
    dependences: tuple[Dependence, ...]  # all that were looked at, the most telling first
    memory: float = MEMORIES[0]
    sizes: Mapping[float, float] = field(default_factory=dict)

    def size_at(self, memory: float) -> float:
        """The size that a filter with this memory (s) shows."""
        return self.sizes.get(memory, self.size)


#: The tables by name, and what they stand for in the contract.
_TABLE_VARIABLES: Mapping[str, tuple[str, ...]] = {
    "position": ("position",),
    "angle": ("position",),
    "velocity": ("velocity",),
    "direction": ("direction",),
    "acceleration": ("acceleration",),
    "input": ("input",),
    "time": ("time",),
    "since reversal": ("position", "direction"),
    "angle, direction": ("position", "direction"),
    "angle, push": ("position", "input"),
    "angle, input": ("position", "input"),
    "position, input": ("position", "input"),
    "position, acceleration": ("position", "acceleration"),
    "angle, acceleration": ("position", "acceleration"),
    "velocity, time": ("velocity", "time"),
    "input, time": ("input", "time"),
    "input, velocity": ("input", "velocity"),
    **{f"wave {n}": ("position",) for n in _WAVE_ORDERS},
    **{f"wave {n}, push": ("position", "input") for n in _WAVE_ORDERS},
}


def _averages(missing: MissingTorque) -> dict[str, FloatArray]:
    """Averages of torque and states, and the travel since the last reversal. Stretches with unknown torque are left
    out."""
    means = missing.averages()
    velocity = means["velocity"]
    turned = np.flatnonzero(np.diff(np.sign(velocity), prepend=np.sign(velocity[0])) != 0)
    last = np.concatenate([[0], turned])[np.searchsorted(turned, np.arange(len(velocity)), "right")]
    means["since"] = (means["position"] - means["position"][last]) * np.sign(velocity)
    ok = np.isfinite(means["torque"])
    return {n: m[ok] for n, m in means.items()}


def _bin_labels(values: FloatArray, bins: int) -> IntArray:
    """Bins that hold as many values each; a value that is taken very often has a bin of its own."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, bins + 1)[1:-1]))
    return np.searchsorted(edges, values, "right") + np.searchsorted(edges, values, "left")


def _state_tables(means: Mapping[str, FloatArray], lever: float) -> dict[str, IntArray]:
    """Every state on which the torque may depend, cut into bins."""
    fast = float(np.quantile(np.abs(means["velocity"]), 0.95))
    direction = (np.sign(means["velocity"]) * (np.abs(means["velocity"]) > 0.02 * fast) + 1.0).astype(np.intp)
    push = (np.sign(means["input"]) + 1.0).astype(np.intp)
    tables = {n: _bin_labels(means[n], 30) for n in ("position", "velocity", "acceleration", "input", "time")}
    tables |= {
        "direction": direction,
        "since reversal": 3 * _bin_labels(np.clip(means["since"], 0.0, _REVERSAL_RANGE * lever), 12) + direction,
        "velocity, time": 100 * _bin_labels(means["velocity"], 6) + _bin_labels(means["time"], 6),
        "input, time": 100 * _bin_labels(means["input"], 6) + _bin_labels(means["time"], 6),
        "input, velocity": 100 * _bin_labels(means["input"], 8) + _bin_labels(means["velocity"], 8),
        "position, input": 100 * _bin_labels(means["position"], 10) + _bin_labels(means["input"], 4),
        "position, acceleration": 100 * _bin_labels(means["position"], 10) + _bin_labels(means["acceleration"], 5),
    }
    travel = float(np.ptp(means["position"]))
    if travel > 1.5 * _TURN:
        angle = ((means["position"] % _TURN) * (36.0 / _TURN)).astype(np.intp)
        tables |= {
            "angle": angle,
            "angle, direction": 3 * angle + direction,
            "angle, push": 3 * angle + push,
            "angle, input": 100 * (angle // 3) + _bin_labels(means["input"], 5),
            "angle, acceleration": 100 * (angle // 3) + _bin_labels(means["acceleration"], 5),
        }
    for n in _WAVE_ORDERS:
        # What repeats is seen to repeat.
        if n * travel > 2.0 * _TURN:
            phase = (n * means["position"] % _TURN * (_PHASE_BINS / _TURN)).astype(np.intp)
            tables |= {f"wave {n}": phase, f"wave {n}, push": 3 * phase + push}
    return tables


def _without_impacts(torque: FloatArray) -> FloatArray:
    """The torque without single impacts, which are not a dependence."""
    spread = 1.4826 * float(np.median(np.abs(torque - np.median(torque))))
    low, high = np.median(torque) - 6.0 * spread, np.median(torque) + 6.0 * spread
    return np.clip(torque, low, high) if spread > 0.0 else torque


def _cross_validated_squares(
    totals: FloatArray, counts: FloatArray, signs: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squares removed by predicting each stretch from the others (draws,), and the squares of the predictions.

    `totals` and `counts` (bins, stretches); `signs` (draws, stretches). A bin's prediction is its mean over the
    other folds, drawn towards zero where it holds few averages.
    """
    agreed, squared = np.zeros(len(signs)), np.zeros(len(signs))
    whole, weight = totals @ signs.T, counts.sum(axis=1)
    for fold in range(_FOLDS):
        mine = slice(fold, counts.shape[1], _FOLDS)
        own, number = totals[:, mine] @ signs[:, mine].T, counts[:, mine].sum(axis=1)
        predicted = (whole - own) / (weight - number + _SHRINKAGE)[:, None]
        agreed += np.sum(own * predicted, axis=0)
        squared += number @ predicted**2
    return 2.0 * agreed - squared, squared


def _predicted_shares(
    torque: FloatArray, label: IntArray, stretch: IntArray, signs: FloatArray
) -> tuple[float, float, FloatArray]:
    """Share predicted, mean square of the prediction, and the shares (draws,) that noise gives under these signs.

    Noise is what the bins' means leave: what depends on the state must not count as noise.
    """
    bins, pieces = int(label.max()) + 1, signs.shape[1]
    flat = label * pieces + stretch
    totals = np.asarray(np.bincount(flat, torque, bins * pieces), dtype=np.float64).reshape(bins, pieces)
    counts = np.bincount(flat, minlength=bins * pieces).astype(np.float64).reshape(bins, pieces)
    removed, squared = _cross_validated_squares(totals, counts, np.ones((1, pieces)))
    mean = totals.sum(axis=1) / (counts.sum(axis=1) + _SHRINKAGE)
    noise, _ = _cross_validated_squares(totals - counts * mean[:, None], counts, signs)
    rest = max(float(np.sum((torque - mean[label]) ** 2)), 1e-300)
    power = max(float(np.sum(torque**2)), 1e-300)
    return float(removed[0]) / power, float(squared[0]) / len(torque), noise / rest


def _gumbel_p_value(score: float, null: FloatArray) -> float:
    """Chance of a largest score as high as this; beyond the draws by the Gumbel law that fits them."""
    counted = (1.0 + float(np.sum(null >= score))) / (1.0 + len(null))
    if np.any(null >= score):
        return counted
    scale = max(float(null.std()) * math.sqrt(6.0) / math.pi, 1e-12)
    mode = float(null.mean()) - _EULER_MASCHERONI * scale
    return min(counted, -math.expm1(-math.exp(-min((score - mode) / scale, 700.0))))


def examine_dependence(missing: MissingTorque, lever: float = 1.0, seed: int = 1) -> RemainingDependence:
    """Look for dependence of the missing torque on every state; `lever` is what a radian is in the axis' unit.

    The same seed gives the same p-value.
    """
    means = _averages(missing)
    if len(means["torque"]) < 20 * _FOLDS:
        return RemainingDependence(0.0, 1.0, (), "", 0.0, 0.0, ())
    torque = _without_impacts(means["torque"])
    stretch = (means["time"] / _BLOCK_LENGTH).astype(np.intp)
    pieces = int(stretch.max()) + 1
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], (_BOOTSTRAP_DRAWS, pieces))
    found, nulls = [], []
    for name, table in _state_tables(means, lever).items():
        share, square, noise = _predicted_shares(torque, np.unique(table, return_inverse=True)[1], stretch, signs)
        middle, spread = float(noise.mean()), max(float(noise.std()), 1e-12)
        nulls.append((noise - middle) / spread)
        found.append(Dependence(name, _TABLE_VARIABLES[name], share, (share - middle) / spread, math.sqrt(square)))
    p_value = _gumbel_p_value(max(d.score for d in found), np.max(nulls, axis=0))
    found.sort(key=lambda d: -d.share)
    best = found[0]
    of_motion = best.size / max(missing.acceleration_rms, 1e-300)
    return RemainingDependence(
        max(best.share, 0.0), p_value, best.variables, best.table, best.size, of_motion, tuple(found)
    )


def remaining_dependence(
    case: PreparedRecording, structure: Structure, values: Mapping[str, float]
) -> RemainingDependence:
    """Is there still structure in what a fitted model lacks that depends on the state?

    Of what the filters show, that counts which chance does not make, and of this the largest share. Each has its own
    chance, so the p-value is that of both (Bonferroni).
    """
    found = []
    for memory in MEMORIES:
        missing = residual_torque.missing_torque(case, structure, values, memory)
        one = examine_dependence(missing, case.recording.lever)
        found.append(replace(one, p_value=min(len(MEMORIES) * one.p_value, 1.0), memory=memory))
    sizes = {one.memory: one.size for one in found}
    likely = [one for one in found if one.p_value < thresholds.DEPENDENCE_MAX_P_VALUE]
    return replace(max(likely or found[:1], key=lambda one: one.share), sizes=sizes)


def is_dependence_left(found: RemainingDependence) -> bool:
    """Whether the remaining dependence counts: it is significant, and larger than a rig's ordinary imperfection."""
    return (
        found.p_value < thresholds.DEPENDENCE_MAX_P_VALUE
        and found.share >= thresholds.DEPENDENCE_MIN_SHARE
        and found.of_motion >= thresholds.DEPENDENCE_MIN_OF_MOTION
    )


def share_removed(before: RemainingDependence, after: RemainingDependence) -> float:
    """By what share names made the mean square of the missing torque smaller, through the filter that showed it."""
    return 1.0 - (after.size_at(before.memory) / max(before.size, 1e-300)) ** 2


def is_described(named: bool, before: RemainingDependence, after: RemainingDependence) -> bool:
    """Whether the dependence in the first model's missing torque is explained, by names or by chance.

    A name that leaves most of the missing torque where it was describes something else.
    """
    return not is_dependence_left(after) or (named and share_removed(before, after) >= thresholds.MIN_SHARE_REMOVED)


def fixes_drive_curve(cases: Sequence[PreparedRecording]) -> bool:
    """Whether the commands have as many levels as a drive curve has knots: between a few levels its knots are free."""
    return len(np.unique(np.round(np.concatenate([c.drive.command for c in cases]), 6))) >= KNOTS


# ---- the term ----


@dataclass(frozen=True)
class CurveTerm:
    """A shape that no page describes: one of `TERM_KINDS`, and how often a turn it repeats where it is made of waves.

    Raises ValueError for another kind.
    """

    kind: str
    order: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in TERM_KINDS:
            raise ValueError(f"no term over {self.kind!r}: there are {', '.join(TERM_KINDS)}")


#: What a term over a variable makes superfluous: it holds any straight line itself.
_REPLACED_PARAMETER = {"velocity": "viscous_friction", "drag": "viscous_friction", "input": "input_gain"}
#: Kinds of term; each is the effect unknown_<kind>. A drag is viscous friction over time. A gain is the motor's gain
#: over its angle. A push is a torque over the angle that differs with the command's sign. An inertia is the link's over
#: its angle.
TERM_KINDS = ("position", "angle", "velocity", "input", "time", "drag", "gain", "push", "inertia")
#: Those of waves over the angle.
_WAVE_KINDS = ("angle", "gain", "push", "inertia")
#: Period of a wave where the axis does not turn, in travels. The curve need not be the same at both ends.
_TRAVELS_PER_TURN = 1.5
#: Knots of the finer line that shows where a curve bends.
FINE_KNOTS = 30
#: Time that a knot must have seen, as a share of what it would have if all had the same.
_MIN_KNOT_SHARE = 0.05


def _knot_weights(x: FloatArray, at: FloatArray) -> FloatArray:
    """What each knot's height does (N, knots) at x; level outside."""
    each = np.eye(len(at))
    lean = np.array(slopes(np.diff(at).tolist(), list(each)))
    return np.asarray(CubicHermiteSpline(at, each, lean)(np.clip(x, at[0], at[-1])))


def _knot_positions(at: FloatArray, heights: FloatArray) -> FloatArray:
    """Where to put the knots (KNOTS,) of a line: half of them evenly, half where a finer one bends.

    They lie as densely there as the root of its second derivative, where straight lines would miss a curve least (de
    Boor, A Practical Guide to Splines, 1978, ch. III): a smooth one needs them at corners as much.
    """
    dense = np.sqrt(np.pad(np.abs(np.diff(heights, 2)), 1, "edge"))
    steps = dense[1:] + dense[:-1]
    reached = np.concatenate([[0.0], np.cumsum(steps + max(steps.mean(), 1e-300))])
    return np.asarray(np.interp(np.linspace(0.0, reached[-1], KNOTS), reached, at))


def _smooth_heights(columns: FloatArray, torque: FloatArray, weight: float = 3.0) -> FloatArray:
    """Heights that follow the torque, robustly, and bend no more than it asks for."""
    bend = np.diff(np.eye(columns.shape[1]), 2, axis=0)
    heights, trust = np.zeros(columns.shape[1]), np.ones(len(torque))
    for _ in range(10):
        a = columns.T @ (columns * trust[:, None]) + weight * bend.T @ bend + 1e-6 * np.eye(columns.shape[1])
        heights = np.asarray(np.linalg.solve(a, columns.T @ (torque * trust)), dtype=np.float64)
        rest = np.abs(torque - columns @ heights)
        trust = 1.0 / np.maximum(rest / max(2.0 * float(np.median(rest)), 1e-12), 1.0)
    return heights


def wave_parameters(effect: str) -> tuple[str, ...]:
    """Names of the wave coefficients of a term, its own or of an effect that it includes. Each wave has a sine and a
    cosine, in order, and all those of one direction come before the other's.
    """
    return tuple(p.name for page in pages(effect) for p in page.parameters if p.estimated)


def _initial_waves(
    means: Mapping[str, FloatArray], term: CurveTerm, values: Mapping[str, float]
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Start values of the parameters of a term of waves, and which of them are fitted."""
    travel = max(float(np.ptp(means["position"])), 1e-9)
    order = max(term.order, _TURN / (_TRAVELS_PER_TURN * travel))
    phase, gain = order * means["position"], values["input_gain"]
    u = means["input"]
    ahead, behind = values.get("dead_band_forward", 0.0), values.get("dead_band_reverse", 0.0)
    over, under = u > ahead, u < -behind
    acting = np.where(over, u - ahead, np.where(under, u + behind, 0.0))
    weights: tuple[NDArray[Any], ...] = (np.ones(len(u)),)
    if term.kind == "inertia":
        weights = (-means["acceleration"],)
    elif term.kind == "gain":
        weights = (gain * acting,)
    elif term.kind == "push":
        weights = (gain * over, gain * under)
    free = wave_parameters(f"unknown_{term.kind}")
    count = len(free) // (2 * len(weights))
    columns = [w * f(k * phase) for w in weights for k in range(1, count + 1) for f in (np.sin, np.cos)]
    sizes = np.linalg.lstsq(np.column_stack(columns), _without_impacts(means["torque"]), rcond=None)[0]
    start = dict(zip(free, map(float, sizes), strict=True))
    return {**start, f"unknown_{term.kind}_order": order}, free


def _initial_curve(
    means: Mapping[str, FloatArray], term: CurveTerm, values: Mapping[str, float]
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Start values of the parameters of a piecewise curve, and the knots with enough data to be fitted."""
    prefix = f"unknown_{term.kind}"
    variable = "time" if term.kind == "drag" else term.kind
    x = means[variable]
    weight = np.ones(len(x))
    if term.kind == "velocity":
        weight = -weight
    elif term.kind == "drag":
        weight = -means["velocity"]
    elif term.kind == "input":
        weight = values["input_gain"] * weight
    # A first model without the right physics may end where the command does nothing.
    size = float(np.sqrt(np.mean(weight**2))) or math.inf
    torque = _without_impacts(means["torque"])

    def drawn(columns: FloatArray) -> FloatArray:
        return _smooth_heights(columns * (weight / size)[:, None], torque) / size

    between = (0.0, 1.0) if variable in ("time", "input") else (0.005, 0.995)
    low, high = (float(q) for q in np.quantile(x, between))
    fine = np.linspace(low, max(high, low + 1e-6), FINE_KNOTS)
    at = _knot_positions(fine, drawn(_knot_weights(x, fine)))
    columns = _knot_weights(x, at)
    seen = columns.sum(axis=0) > _MIN_KNOT_SHARE * len(x) / KNOTS
    free = tuple(n for n, s in zip(names(prefix), seen, strict=True) if s)
    return through(prefix, at.tolist(), drawn(columns).tolist()), free


def _interpolate_unseen_knots(values: Mapping[str, float], prefix: str, free: Sequence[str]) -> dict[str, float]:
    """Knots that saw too little, on the straight line through the nearest two that did not."""
    knots = names(prefix)
    at = np.array(spots(prefix, values))
    sure = [i for i, n in enumerate(knots) if n in free]
    straight = make_interp_spline(at[sure], [values[knots[i]] for i in sure], k=min(len(sure) - 1, 1))
    return {**values, **dict(zip(knots, straight(at).tolist(), strict=True))}


def _masked_torque(case: PreparedRecording, missing: MissingTorque) -> MissingTorque:
    """The missing torque where readings are judged. A knot that saw only other readings, as while a motor rattles, is
    not determined and could take any value. All of it where too few are judged for a curve.
    """
    torque = np.where(case.masked, np.nan, missing.torque)
    enough = np.count_nonzero(np.isfinite(torque)) * missing.step > KNOTS * residual_torque.AVERAGING_TIME
    return replace(missing, torque=torque) if enough else missing


def is_torque_known(problem: FitProblem, base: Fit) -> bool:
    """Whether the readings are dense enough for the torque that the model lacks to be read off them anywhere."""
    lacking = (residual_torque.missing_torque(c, base.structure, base.values) for c in problem.recordings)
    return any(len(_averages(one)["torque"]) for one in lacking)


def sketch_curve(problem: FitProblem, base: Fit, term: CurveTerm) -> Fit:
    """The base model and a term of no known shape, after a few steps at the base's noise density."""
    kind = term.kind
    structure = base.structure.with_(f"unknown_{kind}")
    parts = [
        _averages(_masked_torque(c, residual_torque.missing_torque(c, base.structure, base.values)))
        for c in problem.recordings
    ]
    means = {n: np.concatenate([p[n] for p in parts]) for n in parts[0]}
    first = _initial_waves if kind in _WAVE_KINDS else _initial_curve
    start, free = first(means, term, base.values)
    free = (*(n for n in base.free if n != _REPLACED_PARAMETER.get(kind)), *free)
    values = {**base.values, **start}
    if kind not in _WAVE_KINDS:
        values = _interpolate_unseen_knots(values, f"unknown_{kind}", free)
    # Gap and teeth stay where they are until it is finished: a run has room for the slopes of all others.
    few = tuple(n for n in free if n not in multistart.MULTIMODAL)
    values = optimizer.levenberg_marquardt(
        problem.at(base.process_noise), structure, values, few, rounds=5, tolerance=1.0
    ).values
    if kind not in _WAVE_KINDS:
        values = _interpolate_unseen_knots(values, f"unknown_{kind}", free)
    return likelihood.evaluate(problem.at(base.process_noise), structure, values, free)


def first_wave_only(sketched: Fit) -> Fit:
    """The sketch of a term of waves with only the first wave, once per turn. It has as many parameters as a named
    effect that repeats once per turn.
    """
    (term,) = (i for i in sketched.structure.ids if i in [f"unknown_{kind}" for kind in _WAVE_KINDS])
    mine = {n for n in wave_parameters(term) if n in sketched.free}
    first = {n for n in mine if n.endswith("_1")}
    values = {**sketched.values, **dict.fromkeys(mine - first, 0.0), f"{term}_order": 1.0}
    return replace(sketched, values=values, free=tuple(n for n in sketched.free if n not in mine - first))


def fit_curve(problem: FitProblem, sketched: Fit) -> Fit:
    """The maximum from a sketch."""
    return optimizer.levenberg_marquardt(
        problem.at(sketched.process_noise), sketched.structure, sketched.values, sketched.free
    )


def restart_curve_gap(problem: FitProblem, point: Fit) -> Fit:
    """The point, or a better one after a new search of gap, shares and teeth. What is not free stays as it is."""
    return local_optima.restart_gap(problem.holding(local_optima.held_values(point)), point)


#: What can draw the tables that are not drawn by the term over their first variable.
_TERMS_OF_TABLE = {
    "direction": ("velocity",), "since reversal": ("position",), "acceleration": ("input",),
    "angle, push": ("push",), "angle, input": ("gain",), "position, input": ("gain",),
    "angle, acceleration": ("inertia",), "position, acceleration": ("inertia",),
    "input, velocity": ("input", "velocity"), "velocity, time": ("velocity", "drag"), "time": ("time", "drag"),
}  # fmt: skip


def terms_of_table(table: str) -> list[CurveTerm]:
    """The terms that may draw what a table shows."""
    wave = re.fullmatch("wave ([0-9]+)(, push)?", table)
    if wave:
        return [CurveTerm("push" if wave[2] else "angle", float(wave[1]))]
    return [CurveTerm(kind) for kind in _TERMS_OF_TABLE.get(table, (table.split(", ")[0],))]


def candidate_terms(found: RemainingDependence, most: int = 5) -> list[CurveTerm]:
    """The terms worth fitting, with a predicted share near the best one's, the best first. None where chance does as
    well."""
    telling = (
        [d for d in found.dependences if d.share > 0.3 * found.share]
        if found.p_value < thresholds.DEPENDENCE_MAX_P_VALUE
        else []
    )
    return list(dict.fromkeys(t for d in telling for t in terms_of_table(d.table)))[:most]
