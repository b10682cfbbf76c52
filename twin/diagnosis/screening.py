"""Start values of each candidate, and the gain that it promises: the score test beside a fitted point.

The test is made at the value at which an effect does nothing. The exact sensitivities of the whole model to its
parameters give in one step its likely size. They also give the deviance that it would remove, with all other parameters
refitted. Parameters that do nothing there themselves (a rate, a time, a place) are tried from a grid, and phases are
solved for.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import call

import numpy as np
from numpy.typing import NDArray

from twin.codegen.simd_derivatives import WIDTH
from twin.diagnosis import residual_torque
from twin.diagnosis.residual_torque import MissingTorque
from twin.diagnosis.thresholds import MIN_REPEATS
from twin.effects.catalogue import CANDIDATES, EFFECTS, pages
from twin.effects.effect import Recorded, Seen
from twin.estimation import likelihood, multistart, numerics, optimizer, parameter_bounds, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem, free_parameters
from twin.model import equations
from twin.model.stepper import Structure
from twin.parallel import each

FloatArray = NDArray[np.float64]

_TURN = 2.0 * math.pi
#: Number of rows of a local law that are tried: those that the missing torque follows best. Largest correlation of two
#: of them, as a share of the best one's.
_MAX_PLACES, _MAX_OVERLAP = 4, 0.8
#: Number of the strongest lines of the missing torque that are tried. Their least spacing, as a share of their rate.
#: Rates that are tried in the width of one line.
_MAX_LINES, _MIN_LINE_SPACING, _RATES_PER_LINE = 3, 0.15, 4.0


def _without_impacts(torque: FloatArray) -> FloatArray:
    """The torque (N,) without its largest hundredths, which impacts make."""
    return np.asarray(np.clip(torque, *np.quantile(torque, [0.01, 0.99])))


def _spectral_lines(
    phase: FloatArray, torques: Sequence[FloatArray], circle: float, lowest: float, highest: float
) -> list[float]:  # fmt: skip
    """The rates (per unit of phase) between two limits at which torques (N,) are most periodic together, whatever the
    phase of each. Unknown torques are NaN. The strongest rate comes first.

    All rates are looked at that close after `circle`: as many in a line's width as it has ranges of the phase. The
    phase is rounded to an eighth of the shortest period.
    """
    rate = 2.0 * math.pi / circle
    last = max(int(highest / rate), 1)
    first = min(math.ceil(lowest / rate), last)
    power = np.zeros(last + 1 - first)
    for torque in torques:
        read = np.isfinite(torque)
        if not read.any():
            continue
        place = (phase[read] % circle * (8 * last / circle)).astype(np.intp) % (8 * last)
        clipped = _without_impacts(torque[read])
        around = np.bincount(place, clipped - clipped.mean(), 8 * last)
        power += np.square(np.abs(np.fft.rfft(around)[first : last + 1]))
    beside = np.pad(power, 1, constant_values=-1.0)
    peaks = np.flatnonzero((power >= beside[:-2]) & (power >= beside[2:]))
    chosen: list[float] = []
    for found in (rate * (first + peaks[np.argsort(-power[peaks])])).tolist():
        if len(chosen) < _MAX_LINES and all(abs(found - c) > _MIN_LINE_SPACING * c for c in chosen):
            chosen.append(found)
    return chosen


def _heating_command(missing: MissingTorque, values: Mapping[str, float], span: float) -> float:
    """The command that heats a held motor as much as the recording does in the mean."""
    share, gain = neutral_values("thermal_fade")["fade_emf"], max(values["input_gain"], 1e-9)
    current = missing.command - share * values.get("viscous_friction", 0.0) / gain * missing.velocity
    mean = float(np.sqrt(np.nanmean(np.square(current)))) if np.isfinite(current).any() else span
    return min(max(mean, 0.05 * span), span)


def _unit_law(effect: str, row: Mapping[str, float], states: Mapping[str, FloatArray]) -> FloatArray:
    """Torque (N,) that the effect's law adds per unit of its gain along these states."""
    page = EFFECTS[effect]
    assert page.screen is not None
    law = equations.along(effect, states, {**neutral_values(effect), **row, page.screen.gain: 1.0})
    return -states["direction"] * law if page.slot == "grip" else law


def _rows_followed(missing: MissingTorque, effect: str, rows: Sequence[dict[str, float]]) -> list[dict[str, float]]:
    """The rows whose law the missing torque follows best, beside what the base's own laws could follow of it.

    All laws are linear in their gain: what counts is the correlation, once gain, dead-band, viscous and dry friction
    and a constant are projected out.
    """
    states = missing.averages()
    speed = states["velocity"]
    known = np.isfinite([states[n] for n in ("torque", "position", "velocity", "input", "time")]).all(axis=0)
    states = {n: c[known] for n, c in states.items()} | {"direction": np.sign(speed[known])}
    command, speed, direction = states["input"], states["velocity"], states["direction"]
    own = np.stack([command, command > 0.0, command < 0.0, speed, direction, np.ones(len(speed))], axis=1)
    basis, _ = np.linalg.qr(own / (np.linalg.norm(own, axis=0) + 1e-300)) if len(own) >= 6 else (np.zeros_like(own), 0)

    def beside(column: FloatArray) -> FloatArray:
        left = column - basis @ (basis.T @ column)
        return np.asarray(left / max(float(np.linalg.norm(left)), 1e-6 * float(np.linalg.norm(column)), 1e-300))

    torque = beside(_without_impacts(states["torque"])) if known.any() else states["torque"]
    laws = np.array([beside(_unit_law(effect, row, states)) for row in rows])
    follows = laws @ torque
    # A gain that is never negative follows in one direction only.
    if parameter_bounds.bounds_of(_gain(effect))[0] < 0.0:
        follows = np.abs(follows)
    chosen: list[int] = []
    for i in np.argsort(-follows).tolist():
        if len(chosen) < _MAX_PLACES and all(abs(float(laws[i] @ laws[j])) < _MAX_OVERLAP for j in chosen):
            chosen.append(i)
    return [rows[i] for i in chosen]


def _gain(effect: str) -> str:
    screen = EFFECTS[effect].screen
    assert screen is not None
    return screen.gain


def trial_grids(
    problem: FitProblem, base: Fit, effects: Iterable[str] = CANDIDATES
) -> dict[str, list[dict[str, float]]]:
    """For each of these candidates, values of its non-linear parameters that are worth a try on these recordings."""
    missing = residual_torque.missing_torque(problem.longest, base.structure, base.values)
    return trials_for_torque(problem, missing, base, effects)


def trials_for_torque(
    problem: FitProblem, missing: MissingTorque, base: Fit, effects: Iterable[str] = CANDIDATES
) -> dict[str, list[dict[str, float]]]:
    """The same where the base lacks this torque in the longest of the recordings."""
    seen = _seen(problem, problem.longest.recorded, missing, base.values)
    return {e: with_gap_sides(_page_trials(missing, seen, e), base.structure, base.values, e) for e in effects}


def _seen(problem: FitProblem, recorded: Recorded, missing: MissingTorque, values: Mapping[str, float]) -> Seen:
    """What the pages may know: the range of all recordings, and what a model with these values makes of the longest."""
    places = np.concatenate([c.positions for c in problem.recordings])
    speeds = np.abs(missing.velocity[np.isfinite(missing.velocity)])
    span = float(max(np.max(np.abs(c.recording.input)) for c in problem.recordings))
    return Seen(
        **{**vars(recorded), "lowest": float(places.min()), "travel": float(np.ptp(places)), "step": missing.step},
        fast=float(np.quantile(speeds, 0.95)) if len(speeds) else 1.0,
        span=span,
        heating=_heating_command(missing, values, span),
        push=values["input_gain"] * span,
        dry_friction=values.get("coulomb_friction"),
    )


def _page_trials(missing: MissingTorque, seen: Seen, effect: str) -> list[dict[str, float]]:
    """Values that the effect's own page would try."""
    screen = EFFECTS[effect].screen
    assert screen is not None
    if screen.rate is not None:
        lines = _disturbance_frequencies if "time" in EFFECTS[effect].depends_on else _ripple_orders
        return [{screen.rate: rate} for rate in lines(missing, seen)]
    if screen.trials is None:
        return [dict(zip(screen.grid, values, strict=True)) for values in itertools.product(*screen.grid.values())]
    rows = screen.trials(seen)
    return _rows_followed(missing, effect, rows) if screen.local else rows


def _ripple_orders(missing: MissingTorque, seen: Seen) -> list[float]:
    """Rates, per unit of the axis, at which the missing torque repeats most over the position.

    A ripple has to repeat within the travel. On more than half a turn it repeats a whole number of times per turn. A
    wave over the motor's angle has another phase over the link's when the motor pushes from the other side of its gap.
    """
    travel = max(seen.travel, 1e-9)
    least = MIN_REPEATS * _TURN / travel
    turning = seen.turns and travel > 3.0
    circle, most = (_TURN, 60.0) if turning else (_RATES_PER_LINE * travel, 45.0 * least)
    sides = [np.where(np.sign(missing.command) == s, missing.torque, np.nan) for s in (1.0, -1.0)]
    orders = (_spectral_lines(missing.position, t, circle, least, most) for t in ([missing.torque], sides))
    return list(dict.fromkeys(itertools.chain(*orders)))


def _disturbance_frequencies(missing: MissingTorque, seen: Seen) -> list[float]:
    """Frequencies, Hz, at which the missing torque repeats most over the time."""
    slowest, fastest = _TURN * max(0.1, 2.0 / seen.end), _TURN * min(25.0, 0.2 / missing.step)
    rates = _spectral_lines(missing.time, [missing.torque], _RATES_PER_LINE * seen.end, slowest, fastest)
    return [rate / _TURN for rate in rates]


def with_gap_sides(
    rows: Sequence[dict[str, float]], structure: Structure, values: Mapping[str, float], effect: str
) -> list[dict[str, float]]:  # fmt: skip
    """The rows, each with the effect on the link and on the motor where that is open.

    The side of the gap on which a torque acts decides how the gap is crossed. No slope leads from the wrong side, or
    from half of it on each, to the right one.
    """
    slot = EFFECTS[effect].slot
    shares = [p.name for p in structure.with_(effect).parameters if p.acts_on == slot and p.name not in values]
    sides = list(itertools.product((0.0, 1.0), repeat=len(shares)))
    return [{**row, **dict(zip(shares, side, strict=True))} for row in rows for side in sides]


#: Candidates whose gain has no neutral value to differentiate at, or acts too far from it: tried as they are.
WITHOUT_SCORE_TEST = (
    "drive_saturation", "motor_lag", "input_delay", "end_stop", "joint_elasticity", "presliding_friction",
)  # fmt: skip


#: Candidates that repeat with a full turn: a linear axis has none.
_NEEDS_TURN = ("gravity", "position_dependent_friction", "encoder_eccentricity")
#: Travel from which on a wave of one turn is told from other physics, rad. An eccentric encoder needs a wave whose
#: curvature is visible. Friction changes sign with the motion, as nothing else does that depends on the angle. Gravity
#: is known by its angle of rest.
_MIN_TRAVEL = {"encoder_eccentricity": 0.5 * math.pi, "position_dependent_friction": 0.5}
#: Candidates that happen at a moment of their own: not at the same one of several recordings.
_MOMENTARY = ("load_change", "periodic_disturbance", "disturbance_pulse")


def testable_candidates(problem: FitProblem, candidates: Sequence[str], structure: Structure) -> list[str]:
    """The candidates that recordings of this kind can show beside the first model.

    Several recordings of speed begin at unknown angles. So no law over the position can be fitted to all. Dry friction
    that gives would take the place of the dry friction that the user knows.
    """
    first = problem.recordings[0].recording
    readings = [c.drive.measured for c in problem.recordings]
    out: set[str] = set()
    if not first.is_angle:
        out.update(_NEEDS_TURN)
    if not first.is_speed:
        travel = max(float(np.nanmax(y) - np.nanmin(y)) for y in readings)
        out.update(e for e, least in _MIN_TRAVEL.items() if travel < least)
    if len(problem.recordings) > 1:
        out.update(_MOMENTARY)
    if first.is_speed:
        out.update(e for e in candidates if EFFECTS[e].slot == "sensor")
    if first.is_speed and len(problem.recordings) > 1:
        out.update(e for e in candidates if "position" in EFFECTS[e].depends_on)
    if any(e.slot == "grip" for e in structure.effects):
        out.add("presliding_friction")
    return [e for e in candidates if e not in out]


#: Size of what does nothing yet and has a phase.
_SMALLEST = 1e-9

#: Starts of such a candidate that are looked at closely, with derivatives; steps of each, and more of the likeliest.
_MAX_CLOSE_STARTS, _FIRST_STEPS, _MORE_STEPS = 3, 2, 3


@dataclass(frozen=True)
class ScoreStart:
    """Start values of a candidate, and the gain in deviance that the score test promises."""

    values: dict[str, float]  # of the whole model
    steps: dict[str, float]  # from there, to where the candidate would like to be and what follows it
    promised_gain: float

    def at(self, share: float) -> dict[str, float]:
        """The values after a share of the steps."""
        return {**self.values, **clipped_to_bounds({n: self.values[n] + share * s for n, s in self.steps.items()})}


def neutral_values(effect: str) -> dict[str, float]:
    """Values at which the effect and what it brings along do nothing; the usual start where there is none."""
    return {
        p.name: (p.neutral if p.neutral is not None else p.start) for page in pages(effect) for p in page.parameters
    }


def _score_test(base: Fit, point: Fit, news: Sequence[str]) -> tuple[FloatArray, float]:
    """One Newton step over the base's parameters and new ones, and the deviance that the new ones promise."""
    index = np.array([point.free.index(n) for n in (*base.free, *news)])
    moves = point.visible[index] | (np.arange(len(index)) >= len(base.free))
    index, old = index[moves], int(moves.sum()) - len(news)
    size = np.sqrt(np.maximum(np.diag(point.information), 1e-300))[index]
    g = point.gradient[index] / size
    block = point.information[np.ix_(index, index)] / np.outer(size, size) + 1e-9 * np.eye(len(index))
    ahead = numerics.least_squares_solution(block, g)
    without = numerics.least_squares_solution(block[:old, :old], g[:old])
    step = np.zeros(len(moves))
    step[moves] = ahead / size
    return step, max(float(g @ ahead - g[:old] @ without), 0.0)


def values_with(base: Fit, structure: Structure, effect: str, trial: Mapping[str, float]) -> dict[str, float]:
    """The base's values, and the effect's as in the trial, or at which it does nothing."""
    unmoved = {k: v for k, v in neutral_values(effect).items() if k not in base.values}
    return preparation.complete_values(structure, {**base.values, **unmoved, **trial})


@dataclass(frozen=True, eq=False)
class _Trial:
    """A candidate that has a neutral value, as it is tried there; the base's and its own values, and what is new."""

    effect: str
    structure: Structure
    values: dict[str, float]
    phased: bool
    news: tuple[str, ...]


def _trial(base: Fit, effect: str, trial: Mapping[str, float]) -> _Trial:
    screen = EFFECTS[effect].screen
    assert screen is not None
    structure = structure_with(base.structure, effect)
    others = [EFFECTS[i].screen for i in EFFECTS[effect].includes if i not in base.structure]
    values = values_with(base, structure, effect, trial)
    phase = () if screen.phase is None else (screen.phase,)
    if phase:
        # Of no size at all it has no phase either; the smallest shows what both lead to.
        values |= {screen.gain: _SMALLEST, phase[0]: 0.0}
    news = (screen.gain, *phase, *(s.gain for s in others if s is not None))
    return _Trial(effect, structure, values, bool(phase), news)


def _group_trials(base: Fit, rows: Sequence[_Trial]) -> list[list[_Trial]]:
    """The rows in groups that share one run. Rows that do nothing do not disturb each other, if they want the same
    values and there are lanes for the slopes of all. A row with a phase does a little, and is grouped with its like.
    """
    groups: list[list[_Trial]] = []
    for row in rows:
        for group in groups:
            shared = {n: v for other in group for n, v in other.values.items()}
            news = {n for other in (*group, row) for n in other.news}
            alike = row.phased == group[0].phased and len(base.free) % WIDTH + len(news) <= WIDTH
            if alike and all(shared.get(n, v) == v for n, v in row.values.items()):
                group.append(row)
                break
        else:
            groups.append([row])
    return groups


def _score_starts(problem: FitProblem, base: Fit, rows: Sequence[_Trial]) -> list[ScoreStart]:
    """Starts of candidates from the exact sensitivities where none of them does anything."""
    structure = base.structure.with_(*(i for row in rows for i in row.structure.ids))
    news = dict.fromkeys(n for row in rows for n in row.news)
    values = preparation.complete_values(structure, {n: v for row in rows for n, v in row.values.items()})
    point = likelihood.evaluate(problem.at(base.process_noise), structure, values, (*base.free, *news))
    return [_score_start(base, point, row) for row in rows]


def _score_start(base: Fit, point: Fit, row: _Trial) -> ScoreStart:
    """The start of one of the candidates that a run has served."""
    screen = EFFECTS[row.effect].screen
    assert screen is not None
    step, promise = _score_test(base, point, row.news)
    found = dict(zip((*base.free, *row.news), step.tolist(), strict=True))
    values = row.values
    if screen.phase is not None:
        assert screen.combine is not None
        found[screen.gain], phase = screen.combine(found[screen.gain], _SMALLEST * found.pop(screen.phase))
        values = {**values, screen.gain: 0.0, screen.phase: phase}
    return ScoreStart(values, found, promise)


def clipped_to_bounds(values: Mapping[str, float]) -> dict[str, float]:
    """Values moved inside their parameters' bounds."""
    bounds = {n: parameter_bounds.bounds_of(n) for n in values}
    return {n: float(min(max(v, bounds[n][0]), bounds[n][1])) for n, v in values.items()}


def _promised_gain(point: Fit) -> float:
    """Deviance that one Gauss-Newton step over all free parameters promises to take away."""
    size = np.sqrt(np.maximum(np.diag(point.information), 1e-300))
    a = point.information / np.outer(size, size) + 1e-6 * np.eye(len(size))
    g = point.gradient / size
    return float(g @ numerics.least_squares_solution(a, g))


def _direct_start(
    problem: FitProblem,
    seen: FitProblem,
    base: Fit,
    effect: str,
    trials: Sequence[Mapping[str, float]],
    free: tuple[str, ...],
) -> tuple[float, dict[str, float]]:
    """The largest gain of a candidate that is tried at its own values, with the gain of refitting the rest of the
    model, and the values. It is looked for in the part `seen` of the recordings.
    """
    structure = structure_with(base.structure, effect)
    places = [values_with(base, structure, effect, clipped_to_bounds(t)) for t in trials]
    # A local optimum may be narrow, and a place beside it shows only its slopes. So the likeliest places are refined by
    # a few steps before they are judged. So is the likeliest one of every choice that no step changes.
    places.sort(key=lambda v: likelihood.evaluate(seen.at(base.process_noise), structure, v).deviance)
    first: dict[tuple[float, ...], dict[str, float]] = {}
    for place in places:
        first.setdefault(tuple(v for n, v in place.items() if n not in free), place)
    rest = [place for place in places if place not in first.values()]
    near = [*first.values(), *rest[: max(_MAX_CLOSE_STARTS - len(first), 0)]]
    points = [
        optimizer.levenberg_marquardt(
            seen.at(base.process_noise), structure, v, free, rounds=_FIRST_STEPS, tolerance=1.0
        )
        for v in near
    ]
    best = optimizer.levenberg_marquardt_from(
        seen, min(points, key=lambda p: p.deviance), rounds=_MORE_STEPS, tolerance=1.0
    )
    found = likelihood.evaluate(problem.at(base.process_noise), structure, best.values, free)
    return base.deviance - found.deviance + _promised_gain(found), found.values


@dataclass(frozen=True)
class Candidate:
    """A candidate before its fit, and the places of which the likeliest is the start of the fit."""

    effect: str
    structure: Structure
    free: tuple[str, ...]
    places: tuple[dict[str, float], ...]
    promised_gain: float


#: Shares of a Newton step among which the likeliest is where a climb begins.
_STEP_SHARES = (1.0, 0.3, 0.1, 0.0)


def structure_with(structure: Structure, effect: str) -> Structure:
    """The structure with the effect; a soft joint stands for the teeth, too, and dry friction that gives for all that
    does not.
    """
    longer = structure.with_(effect)
    if effect == "joint_elasticity":
        return longer.without("tooth_compliance")
    if effect == "presliding_friction":
        return longer.without(*(e.id for e in longer.effects if e.slot == "grip"))
    return longer


def most_likely_values(
    problem: FitProblem, structure: Structure, places: Sequence[dict[str, float]]
) -> dict[str, float]:
    """The likeliest of some values of the structure."""
    if len(places) == 1:
        return places[0]
    return min(places, key=lambda v: likelihood.evaluate(problem, structure, v).deviance)


def score_candidates(
    problem: FitProblem, base: Fit, trials: Mapping[str, Sequence[Mapping[str, float]]]
) -> list[Candidate]:  # fmt: skip
    """The candidates, each where it promises most beside the base."""
    held = set(free_parameters(base.structure)) - set(base.free)
    rows = {e: [{n: v for n, v in row.items() if n not in held} for row in tried] for e, tried in trials.items()}
    parts = multistart.excerpts(problem, base.structure)

    def free(structure: Structure) -> tuple[str, ...]:
        return problem.free(structure)

    def direct(effect: str) -> list[Candidate]:
        structure = structure_with(base.structure, effect)
        # What happens at some place may happen there in no part that is seen.
        seen = problem if "position" in EFFECTS[effect].depends_on else parts
        promise, values = _direct_start(problem, seen, base, effect, rows[effect], free(structure))
        return [Candidate(effect, structure, free(structure), (values,), promise)]

    def nested(group: Sequence[_Trial]) -> list[Candidate]:
        out = []
        for row, start in zip(group, _score_starts(problem, base, group), strict=True):
            places = tuple(start.at(share) for share in _STEP_SHARES)
            out.append(Candidate(row.effect, row.structure, free(row.structure), places, start.promised_gain))
        return out

    # What takes longest comes first, so that both cores end at about the same time.
    longest = sorted((e for e in rows if e in WITHOUT_SCORE_TEST), key=lambda e: -len(rows[e]))
    groups = _group_trials(
        base, [_trial(base, e, row) for e, tried in rows.items() if e not in WITHOUT_SCORE_TEST for row in tried]
    )
    ways = [*(partial(direct, e) for e in longest), *(partial(nested, g) for g in groups)]
    best: dict[str, Candidate] = {}
    for entry in (entry for found in each(call, ways) for entry in found):
        best[entry.effect] = max(best.get(entry.effect, entry), entry, key=lambda e: e.promised_gain)
    return list(best.values())
