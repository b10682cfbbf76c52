"""How good a model is, measured apart from the search that chose it.

Three figures, each for the first and the last model, that no fit has minimised. (1) The error of the free run against
the one that the model's own noise makes (`twin.diagnosis.drift`), on fitted and on held-out data. (2) The torque that
the model lacks against the torque of the drive. (3) Where the held-out data leave the range of the fitted ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import coverage, data_split, drift, free_run, residual_torque
from twin.diagnosis.coverage import Beyond
from twin.diagnosis.data_split import RecordingPart
from twin.diagnosis.drift import MeanSquare
from twin.diagnosis.residual_torque import MissingTorque
from twin.estimation import likelihood, optimizer, parameter_bounds, preparation
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.model import equations
from twin.model.stepper import Structure
from twin.parallel import each

FloatArray = NDArray[np.float64]

#: Points of the grid on which the error of all free runs together is followed, and the least for one of them.
POINTS, FEWEST = 400, 20


@dataclass(frozen=True)
class FreeRun:
    """A free run: RMSE found, the one that the model's own noise makes (output unit), and the chance that noise makes
    one as large as was found. And the RMSE that noise exceeds once in twenty times: a drift has few degrees of freedom,
    so that it may be twice what is expected. NaN where nothing was read.
    """

    rmse: float
    expected: float
    p_value: float
    largest: float


#: How often noise exceeds `FreeRun.largest`.
RARE = 0.05
NOTHING_READ = FreeRun(math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class Error:
    """The error of one free run on a grid of K points, with what noise and parameters make of it."""

    squares: float  # sum of the squares of what was found, output unit^2
    readings: int
    share: FloatArray  # (K,) of the readings
    factor: FloatArray  # (K, sources) of the error's covariance, without reading noise
    parameters: FloatArray  # (K, n) change of the free run by one standard error along each axis of their covariance
    reading: float  # variance of a reading, output unit^2


def _axes(point: Fit) -> FloatArray:
    """The principal axes (n, n) of the parameters' uncertainty, one standard error long. Parameters that leave no trace
    have none."""
    covariance = point.covariance
    known = np.isfinite(np.diag(covariance))
    inside = np.where(np.outer(known, known), covariance, 0.0)
    size = np.sqrt(np.maximum(np.diag(inside), 1e-300))
    eigenvalues, vectors = np.linalg.eigh(inside / np.outer(size, size))
    return np.asarray((vectors * np.sqrt(np.maximum(eigenvalues, 0.0))) * size[:, None])


def _chords(case: PreparedRecording, point: Fit) -> FloatArray:
    """What one standard error along each axis changes in the free run (N, n): half the difference of both sides.

    A chord holds where the slope does not: behind a gap a slope grows from contact to contact without end.
    """

    def run(step: FloatArray) -> FloatArray:
        moved = {}
        for name, change in zip(point.free, step.tolist(), strict=True):
            low, high = parameter_bounds.bounds_of(name)
            moved[name] = min(max(point.values[name] + change, low), high)
        return likelihood.filtered_states(case, point.structure, {**point.values, **moved}, 0.0).reading

    axes = _axes(point).T
    runs = each(run, [*axes, *(-axes)])
    if not runs:
        return np.zeros((len(case.drive.time), 0))
    return np.asarray(0.5 * (np.array(runs[: len(axes)]) - np.array(runs[len(axes) :])).T)


@np.errstate(over="ignore", invalid="ignore")
def error(case: PreparedRecording, part: RecordingPart, point: Fit, points: int) -> Error:
    """The error of the free run through a part, which starts where the case does.

    Parameters
    ----------
    case : PreparedRecording
        The recording from where the free run starts; its first readings give the initial state.
    part : RecordingPart
        What of the recording is judged. Where it begins later than the recording, the run is moved to the first
        reading in the part.
    point : Fit
        The model, with the covariance of its parameters and its own torque noise.
    points : int
        Of the grid.
    """
    judged = np.flatnonzero(part.inside & np.isfinite(case.recording.output))
    if len(judged) == 0:
        return Error(0.0, 0, np.ones(1), np.zeros((1, 1)), np.zeros((1, 0)), 0.0)
    run = free_run.started(case, point, points)
    found, factor = case.recording.output - run.reading, run.factor
    reading = case.reading_variance * point.scale
    ends = run.grid.edges[1:]
    chords = _chords(run.case, point)[ends]
    if part.begin > 0.0 and not case.drive.speed:
        # The first reading becomes the start, with its own noise.
        found = found - found[judged[0]]
        at = min(int(np.searchsorted(ends, judged[0])), len(ends) - 1)
        one = np.full((len(factor), 1), math.sqrt(reading))
        factor, chords = np.hstack([factor - factor[at], one]), chords - chords[at]
    step = np.clip(np.searchsorted(run.grid.edges, judged, "left") - 1, 0, len(ends) - 1)
    share = np.bincount(step, minlength=len(ends)) / len(judged)
    kept = share > 0.0
    squares = float(np.sum(found[judged] ** 2))
    return Error(squares, len(judged), share[kept], factor[kept], chords[kept], reading)


def together(errors: Sequence[Error], was_fitted: bool) -> FreeRun:
    """Several free runs as one: what was found, and what the model's own noise makes of them.

    Runs of different recordings share the errors of the parameters and nothing else. Where the parameters were fitted
    to the same readings, their errors reduce the free run's error by what they can follow. Elsewhere they add to it.
    """
    readings = sum(e.readings for e in errors)
    if readings == 0:
        return NOTHING_READ
    weights = [e.readings / readings for e in errors]
    reading = sum(w * e.reading for w, e in zip(weights, errors, strict=True))
    runs = [
        # Each point stands for several readings, whose noise averages out.
        drift.Run(e.factor, e.parameters, w * e.share, reading / np.maximum(e.share * e.readings, 1.0))
        for w, e in zip(weights, errors, strict=True)
        if e.readings
    ]
    square = sum(e.squares for e in errors) / readings
    made = [x for r in runs for x in (r.factor, r.parameters)]
    if not (math.isfinite(square) and all(np.isfinite(x).all() for x in made)):
        # Within its errors the model does not run: nobody knows what to expect.
        return FreeRun(math.sqrt(square), math.nan, math.nan, math.nan)
    null: MeanSquare = drift.mean_square(runs, reading, readings, was_fitted)
    return FreeRun(math.sqrt(square), math.sqrt(null.mean), null.chance(square), math.sqrt(null.exceeded(RARE)))


def at_own_noise(problem: FitProblem, point: Fit) -> Fit:
    """The same model at its most likely torque noise, with its parameters' covariance there.

    A search judges at a noise of its own choice.
    """
    process_noise = optimizer.most_likely_process_noise(
        problem, point.structure, point.values, around=point.process_noise
    )
    return likelihood.evaluate(problem.at(process_noise), point.structure, point.values, point.free)


def free_runs(parts: Sequence[RecordingPart], problem: FitProblem, point: Fit) -> list[Error]:
    """The errors of the free runs through these parts, one part for each recording of the problem. The points of the
    grid are shared out by length.
    """
    mine = problem.stepped(point.structure)
    whole = sum(len(c.drive.time) for c in mine)
    return [
        error(c, p, point, min(max(POINTS * len(c.drive.time) // whole, FEWEST), len(c.drive.time) - 1))
        for c, p in zip(mine, parts, strict=True)
    ]


def led_problem(
    problem: FitProblem, parts: Sequence[RecordingPart], point: Fit
) -> tuple[list[RecordingPart], FitProblem]:
    """Parts of recordings, each within what a free run of the model goes through to come there, and these runs as a
    problem. One sensor read them and the problem that is given.
    """
    runs, inside = data_split.led(parts, point.structure, data_split.lead_of(point.values))
    variance = problem.recordings[0].reading_variance
    prepared = preparation.prepare_recordings(runs, point.structure)
    return inside, prepared.on([replace(r, reading_variance=variance) for r in prepared.recordings])


# ---- the torque that the model lacks ----


@dataclass(frozen=True)
class TorqueFigures:
    """The torque that the first and the last model lack, root mean square over the fitted recordings, as acceleration.

    `share_left` is the second over the first, and `of_drive` the second over the drive's torque. Both are beyond what
    the noise of the readings makes, which is `by_reading`. `drive` is the drive's torque. NaN where there is nothing to
    compare with.
    """

    before: float = math.nan
    after: float = math.nan
    by_reading: float = math.nan
    share_left: float = math.nan
    of_drive: float = math.nan
    unit: str = "rad/s^2"
    drive: float = math.nan

    @property
    def is_hidden(self) -> bool:
        """Whether what is beyond the noise of the readings is less than half of that noise: it then is not measured."""
        return self.after**2 - self.by_reading**2 < 0.25 * self.by_reading**2


def _drive_torque(case: PreparedRecording, values: Mapping[str, float]) -> FloatArray:
    """The drive's torque (N,) beyond its dead-band and within its limit, as acceleration."""
    u = case.drive.command
    ahead, behind = values.get("dead_band_forward", 0.0), values.get("dead_band_reverse", 0.0)
    acting = np.maximum(u - ahead, 0.0) - np.maximum(-u - behind, 0.0)
    limit = values.get("saturation_limit", math.inf)
    return np.asarray(values["input_gain"] * np.clip(acting, -limit, limit))


def _by_reading(case: PreparedRecording, point: Fit) -> MissingTorque:
    """What would seem to be missing from an axis at rest that is read with this noise: the filter is linear there."""
    rest = Structure.of(("inertia", "viscous_friction"))
    noise = math.sqrt(case.reading_variance) * np.random.default_rng(1).standard_normal(len(case.drive.time))
    measured = np.where(np.isfinite(case.drive.measured), noise, np.nan)
    still = replace(case.drive, measured=measured, command=np.zeros(len(measured)))
    values = {p.name: point.values.get(p.name, p.start) for p in rest.parameters}
    return residual_torque.missing_torque(replace(case, drive=still, start=(0.0, 0.0)), rest, values)


def _rms(parts: Iterable[FloatArray]) -> float:
    values = np.concatenate(list(parts))
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def missing_torque(problem: FitProblem, before: Fit, after: Fit) -> TorqueFigures:
    """The torque that both models lack in the fitted recordings, against each other and against the drive's."""
    sizes, floors = [], []
    for point in (before, after):
        mine = problem.stepped(point.structure)
        found = [residual_torque.missing_torque(c, point.structure, point.values).torque for c in mine]
        sizes.append(_rms(found))
        floors.append(_rms(_by_reading(c, point).torque for c in mine))
    rest = [math.sqrt(max(size**2 - floor**2, 0.0)) for size, floor in zip(sizes, floors, strict=True)]
    drive = _rms(_drive_torque(c, after.values) for c in problem.recordings)
    unit = f"{problem.recordings[0].recording.output_unit.removesuffix('/s')}/s^2"
    share = rest[1] / rest[0] if rest[0] > 0.0 else math.nan
    of_drive = rest[1] / drive if drive > 0.0 else math.nan
    return TorqueFigures(sizes[0], sizes[1], floors[1], share, of_drive, unit, drive)


# ---- all figures ----


@dataclass(frozen=True)
class Comparison:
    """The free runs of the first and of the last model through the same data, and the recorded range of that data."""

    before: FreeRun
    after: FreeRun
    span: float  # output unit


@dataclass(frozen=True)
class Adequacy:
    """What may be claimed of a model, in figures that no search has made small.

    `free_run` is keyed by "train" and "holdout"; `recordings` lists role, name and comparison of each recording.
    `says` is one sentence.
    """

    free_run: Mapping[str, Comparison] = field(default_factory=dict)
    recordings: tuple[tuple[str, str, Comparison], ...] = ()
    missing_torque: TorqueFigures = field(default_factory=TorqueFigures)
    beyond_training: tuple[Beyond, ...] = ()
    says: str = ""


def compare(
    parts: Sequence[RecordingPart], problem: FitProblem, points: tuple[Fit, Fit], was_fitted: bool
) -> tuple[Comparison, list[tuple[str, Comparison]]]:
    """Both models through these parts, as a whole and by recording."""
    errors = [free_runs(parts, problem, point) for point in points]
    outputs = [p.recording.output[p.inside & np.isfinite(p.recording.output)] for p in parts]
    span = float(np.ptp(np.concatenate(outputs))) if any(map(len, outputs)) else math.nan
    whole = Comparison(together(errors[0], was_fitted), together(errors[1], was_fitted), span)
    names = list(dict.fromkeys(c.recording.name for c in problem.recordings))
    each_one = []
    for name in names if len(names) > 1 else ():
        mine = [i for i, c in enumerate(problem.recordings) if c.recording.name == name]
        first, last = (together([e[i] for i in mine], was_fitted) for e in errors)
        own = np.concatenate([outputs[i] for i in mine])
        each_one.append((name, Comparison(first, last, float(np.ptp(own)) if len(own) else math.nan)))
    return whole, each_one


def measure(
    problem: FitProblem, held_out: Sequence[RecordingPart], before: Fit, after: Fit, beyond: Sequence[Beyond]
) -> Adequacy:
    """The figures of the first and the last model on the fitted recordings and the held-out parts."""
    points = (at_own_noise(problem, before), at_own_noise(problem, after))
    train = [RecordingPart(r.recording) for r in problem.recordings]
    runs, rows = {}, []
    runs["train"], own = compare(train, problem, points, True)
    rows += [("train", *row) for row in own]
    tested = [p for p in held_out if p.is_read]
    if tested:
        parts, same = led_problem(problem, tested, after)
        runs["holdout"], own = compare(parts, same, points, False)
        rows += [("holdout", *row) for row in own]
    later = (
        coverage.later([r.recording for r in problem.recordings], held_out) if equations.timed(after.structure) else []
    )
    return Adequacy(runs, tuple(rows), missing_torque(problem, *points), (*beyond, *later))


def unchanged(figures: Adequacy) -> Adequacy:
    """The figures where the first model is the last one, too."""
    torque = figures.missing_torque
    share = math.nan if math.isnan(torque.share_left) else 1.0
    # What the drive makes is about the same in both.
    of_drive = torque.of_drive / torque.share_left if torque.share_left > 0.0 else torque.of_drive
    return replace(
        figures,
        free_run={role: replace(c, after=c.before) for role, c in figures.free_run.items()},
        recordings=tuple((role, name, replace(c, after=c.before)) for role, name, c in figures.recordings),
        missing_torque=replace(torque, after=torque.before, share_left=share, of_drive=of_drive),
    )


def _run_json(run: FreeRun) -> dict[str, float]:
    values = {"rmse": run.rmse, "expected": run.expected, "p_value": run.p_value}
    return {n: v for n, v in values.items() if math.isfinite(v)}


def _comparison_json(compared: Comparison) -> dict[str, object]:
    return {**_run_json(compared.after), "before": _run_json(compared.before)}


def to_json(figures: Adequacy) -> dict[str, object]:
    """The figures as the contract's JSON; what could not be told is null."""
    torque = {
        n: v if isinstance(v, str) or math.isfinite(v) else None for n, v in asdict(figures.missing_torque).items()
    }
    return {
        "missing_torque": torque,
        "free_run": {role: _comparison_json(c) for role, c in figures.free_run.items()},
        "recordings": [{"role": role, "name": name, **_comparison_json(c)} for role, name, c in figures.recordings],
        "beyond_training": [
            {"variable": b.variable, "train": list(b.train), "holdout": list(b.holdout)}
            for b in figures.beyond_training
        ],
        "says": figures.says,
    }
