"""Which physics was left out.

Candidates compete in two rounds. Coarse: contact without compliance, a filter that remembers a tenth of a
second; the likelihood is then smooth in almost every parameter, a score test along the exact sensitivities says
where each candidate would like to start, and a few Gauss-Newton steps say what it is worth. Fine: the best few are
fitted with everything else to the maximum of the full likelihood, each with its own noise density, and the smaller
model is refitted from the larger one's optimum before the two are compared, so that a badly converged model makes
no discovery.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin import compare, identify, likelihood, locate
from twin.axis import Structure
from twin.effects.catalogue import CANDIDATES, EFFECTS
from twin.likelihood import Case, Point

FloatArray = NDArray[np.float64]

#: Candidates per round that are fitted coarsely, and how many of them go on to a fine fit.
SURVIVORS = 7
FINALISTS = 3
#: Deviance that a few steps must bring for a finalist to be worth a fine fit; in the end it needs far more.
PROMISE = 15.0


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A structure, fitted; `added` is what it has beyond the one it competes with."""

    added: tuple[str, ...]
    point: Point

    @property
    def deviance(self) -> float:
        return self.point.deviance


def _amplitude_spectrum(phase: FloatArray, torque: FloatArray, rates: FloatArray) -> FloatArray:
    """How much of the torque's energy each rate (per unit of phase) explains, (rates,)."""
    centred = torque - torque.mean()
    out = np.empty(len(rates))
    for i, rate in enumerate(rates):
        wave = np.exp(1j * rate * phase)
        out[i] = abs(np.dot(wave, centred)) ** 2
    return out / max(len(torque) * float(np.dot(centred, centred)), 1e-300)


def _peaks(rates: FloatArray, power: FloatArray, count: int) -> list[float]:
    chosen: list[float] = []
    for i in np.argsort(-power):
        if all(abs(rates[i] - c) > 0.15 * c for c in chosen):
            chosen.append(float(rates[i]))
        if len(chosen) == count:
            break
    return chosen


def _lines(missing: locate.Missing, variable: str, rates: FloatArray, count: int) -> list[float]:
    """The rates at which the missing torque is most periodic in position or time."""
    ok = np.isfinite(missing.torque)
    stride = max(int(0.004 / missing.step), 1)
    phase, torque = missing.state(variable)[ok][::stride], missing.torque[ok][::stride]
    power = _amplitude_spectrum(phase, np.clip(torque, *np.quantile(torque, [0.01, 0.99])), rates)
    return _peaks(rates, power, count)


def grids(
    cases: Sequence[Case], structure: Structure, values: Mapping[str, float]
) -> dict[str, list[dict[str, float]]]:
    """For each candidate, values of its non-linear parameters that are worth a try on these recordings."""
    longest = max(cases, key=lambda c: c.drive.time[-1])
    span = float(max(np.max(np.abs(c.recording.input)) for c in cases))
    end = float(longest.drive.time[-1])
    missing = locate.missing_torque(longest, structure, values)
    places = np.concatenate([c.recording.output[np.isfinite(c.recording.output)] for c in cases])
    travel = float(np.ptp(places))
    out: dict[str, list[dict[str, float]]] = {}
    for effect in CANDIDATES:
        screen = EFFECTS[effect].screen
        assert screen is not None
        out[effect] = [{}]
        for name, trial in screen.grid.items():
            out[effect] = [{**row, name: v} for row in out[effect] for v in trial]
    speeds = np.abs(missing.velocity[np.isfinite(missing.velocity)])
    fast = float(np.quantile(speeds, 0.95)) if len(speeds) else 1.0
    out["stribeck_friction"] = [{"stribeck_velocity": f * fast} for f in (0.02, 0.06, 0.15)]
    if travel > 0.0:
        # A ripple is one that is seen to repeat: on a turn in whole numbers, on a short or linear travel three times.
        least = 2.0 * math.pi * 3.0 / travel
        whole = np.arange(2.0, 61.0)
        short = least * np.geomspace(1.0, 30.0, 117)
        angular = not longest.recording.output_unit.startswith("m")
        orders = whole[whole >= least] if angular and travel > 3.0 else short
        out["torque_ripple"] = [{"ripple_order": n} for n in _lines(missing, "position", orders, 3)]
    rates = 2.0 * math.pi * np.geomspace(max(0.1, 2.0 / end), min(25.0, 0.2 / missing.step), 600)
    out["periodic_disturbance"] = [
        {"disturbance_frequency": r / (2.0 * math.pi)} for r in _lines(missing, "time", rates, 3)
    ]
    out["thermal_fade"] = [
        {"fade_time": f * end, "fade_reference": span} for f in (0.15, 0.5, 1.5) if 1.0 <= f * end <= 3600.0
    ]
    out["load_change"] = [{"load_time": f * end} for f in np.linspace(0.1, 0.9, 9)]
    out["drive_saturation"] = [{"saturation_limit": f * span} for f in (0.4, 0.55, 0.7, 0.85, 0.95)]
    out["motor_lag"] = [{"lag_time": t} for t in (0.003, 0.01, 0.03)]
    out["input_delay"] = [{"delay": t} for t in (0.002, 0.006, 0.015)]
    stops = []
    for high, low in ((1, 0), (0, 1), (1, 1)):
        # A stop gives by what the link runs in a few milliseconds, so it sits that much inside the furthest reading.
        for depth in (0.002 * fast, 0.012 * fast):
            stops.append(
                {
                    "stop_upper": float(places.max()) - depth if high else float(places.max()) + travel,
                    "stop_lower": float(places.min()) + depth if low else float(places.min()) - travel,
                    "stop_stiffness": 2e4,
                    "stop_damping": 0.3,
                }
            )
    out["end_stop"] = stops
    if "backlash" in structure:
        # Ringing is told by its frequency, which no gradient finds from afar, and changes what the gap looked like.
        out["joint_elasticity"] = [
            {
                "joint_frequency": f,
                "joint_damping": 0.15,
                "motor_share": share,
                "backlash_gap": gap,
                "friction_share": 0.7,
            }
            for f in (3.0, 4.0, 5.3, 7.2, 10.0, 14.0, 20.0, 28.0)
            for share in (0.15, 0.3, 0.45)
            for gap in (0.015, 0.04)
        ]
    return out


#: Candidates whose gain has no neutral value to differentiate at, or acts too far from it: tried as they are.
_DIRECT = ("drive_saturation", "motor_lag", "input_delay", "end_stop", "joint_elasticity")


#: Candidates that repeat with a full turn: a linear axis has none.
_TURNING = ("gravity", "position_dependent_friction", "encoder_eccentricity")
#: Of these, the ones that only a full turn tells from other physics; gravity is known by its angle of rest.
_WHOLE_TURN = ("position_dependent_friction", "encoder_eccentricity")
#: Candidates that happen at a moment of their own: not at the same one of several recordings.
_MOMENTARY = ("load_change", "periodic_disturbance")
#: Share of a disturbance's wave that follows the motion from which on it does not come from outside.
_OWN = 0.8


def offered(cases: Sequence[Case], candidates: Sequence[str]) -> list[str]:
    """The candidates that recordings of this kind can show.

    Several recordings of speed begin at angles that nobody knows, so that nothing of position can be fitted to all.
    """
    first = cases[0].recording
    readings = [c.drive.measured for c in cases]
    out: set[str] = set()
    if first.output_unit.startswith("m"):
        out.update(_TURNING)
    if not first.is_speed and max(float(np.nanmax(y) - np.nanmin(y)) for y in readings) < 1.8 * math.pi:
        out.update(_WHOLE_TURN)
    if len(cases) > 1:
        out.update(_MOMENTARY)
    if first.is_speed:
        out.update(e for e in candidates if EFFECTS[e].slot == "sensor")
    if first.is_speed and len(cases) > 1:
        out.update(e for e in candidates if "position" in EFFECTS[e].depends_on)
    return [e for e in candidates if e not in out]


#: Starts of such a candidate that are looked at closely, with derivatives.
_CLOSELY = 6


@dataclass(frozen=True)
class Start:
    """Where a candidate would like to begin, and the gain in deviance that the score test promises."""

    values: dict[str, float]
    promise: float


def _neutral(effect: str) -> dict[str, float]:
    return {
        p.name: (p.neutral if p.neutral is not None else p.start)
        for i in (*EFFECTS[effect].includes, effect)
        for p in EFFECTS[i].parameters
    }


def _score(base: Point, point: Point, news: Sequence[str]) -> tuple[FloatArray, float]:
    """Best gains of new columns beside the base ones, by one Newton step, and the deviance it promises."""
    old = [point.free.index(n) for n in base.free]
    new = [point.free.index(n) for n in news]
    a = point.normal
    size = np.sqrt(np.maximum(np.diag(a), 1e-300))
    a = a / np.outer(size, size)
    g = point.gradient / size
    index = [*old, *new]
    block = a[np.ix_(index, index)] + 1e-9 * np.eye(len(index))
    step = likelihood.solved(block, g[index])
    without = likelihood.solved(block[: len(old), : len(old)], g[old])
    promise = float(g[index] @ step - g[old] @ without)
    return step[len(old) :] / size[new], max(promise, 0.0)


def _nested_starts(
    cases: Sequence[Case], base: Point, effect: str, trials: Sequence[Mapping[str, float]]
) -> list[Start]:
    """Starts of a candidate with a neutral value, from the exact sensitivities at that value."""
    screen = EFFECTS[effect].screen
    assert screen is not None
    structure = base.structure.with_(effect)
    others = [EFFECTS[i].screen for i in EFFECTS[effect].includes if i not in base.structure]
    companions = [s.gain for s in others if s is not None]
    neutral = {k: v for k, v in _neutral(effect).items() if k not in base.values}
    starts = []
    for trial in trials:
        values = {**base.values, **neutral, **trial}
        free = (*base.free, screen.gain, *companions)
        if screen.pair is None:
            point = likelihood.evaluate(cases, structure, values, base.density, free)
            gains, promise = _score(base, point, (screen.gain, *companions))
            found = {screen.gain: float(gains[0]), **dict(zip(companions, map(float, gains[1:]), strict=True))}
        else:
            name, first, second = screen.pair
            runs = [
                likelihood.innovations(c, structure, {**values, name: phase}, base.density, free)
                for phase in (first, second)
                for c in cases
            ]
            one, two = runs[: len(cases)], runs[len(cases) :]
            column = free.index(screen.gain)
            merged = [
                replace(a, slopes=np.column_stack([a.slopes, b.slopes[:, column]]))
                for a, b in zip(one, two, strict=True)
            ]
            point = likelihood.evaluate(
                cases, structure, values, base.density, (*free, "second"), run=lambda m=merged: m
            )
            gains, promise = _score(base, point, (screen.gain, "second", *companions))
            assert screen.combine is not None
            gain, phase = screen.combine(float(gains[0]), float(gains[1]))
            found = {screen.gain: gain, name: phase, **dict(zip(companions, map(float, gains[2:]), strict=True))}
        starts.append(Start({**values, **_inside(found)}, promise))
    return starts


def _inside(values: Mapping[str, float]) -> dict[str, float]:
    """Values moved inside their parameters' bounds."""
    bounds = {p.name: (p.lower, p.upper) for e in EFFECTS.values() for p in e.parameters}
    return {n: float(min(max(v, bounds[n][0]), bounds[n][1])) for n, v in values.items()}


def _promised(point: Point) -> float:
    """Deviance that one Gauss-Newton step over all free parameters promises to take away."""
    size = np.sqrt(np.maximum(np.diag(point.normal), 1e-300))
    a = point.normal / np.outer(size, size) + 1e-6 * np.eye(len(size))
    g = point.gradient / size
    return float(g @ likelihood.solved(a, g))


def _direct_starts(
    cases: Sequence[Case], base: Point, effect: str, trials: Sequence[Mapping[str, float]], free: tuple[str, ...]
) -> list[Start]:
    """Starts of a candidate that is tried as it is; what the rest of the model would regain is promised too."""
    structure = base.structure.with_(effect)
    neutral = {k: v for k, v in _neutral(effect).items() if k not in base.values}
    places = [{**base.values, **neutral, **_inside(t)} for t in trials]
    if len(places) <= _CLOSELY:
        points = [likelihood.evaluate(cases, structure, values, base.density, free) for values in places]
    else:
        # So many starts are there because the valley is narrow: the likeliest walk a little before they are judged.
        places.sort(key=lambda v: likelihood.evaluate(cases, structure, v, base.density).deviance)
        near = places[: _CLOSELY // 2]
        points = [likelihood.climb(cases, structure, v, base.density, free, rounds=5, tolerance=1.0) for v in near]
    starts = [Start(p.values, base.deviance - p.deviance + _promised(p)) for p in points]
    return starts


@dataclass(frozen=True)
class Entry:
    """A candidate at the start line."""

    effect: str
    free: tuple[str, ...]
    start: Start


def _enter(cases: Sequence[Case], base: Point, effect: str, trials: Sequence[Mapping[str, float]]) -> Entry:
    structure = base.structure.with_(effect)
    mine = identify.with_steps(cases, structure)
    held = set(identify.free_parameters(base.structure)) - set(base.free)
    free = tuple(n for n in identify.free_parameters(structure) if n not in held)
    if effect in _DIRECT:
        starts = _direct_starts(mine, base, effect, trials, free)
    else:
        starts = _nested_starts(mine, base, effect, trials)
    return Entry(effect, free, max(starts, key=lambda s: s.promise))


def _climb(cases: Sequence[Case], base: Point, entry: Entry) -> Hypothesis:
    structure = base.structure.with_(entry.effect)
    mine = identify.with_steps(cases, structure)
    found = likelihood.climb(mine, structure, entry.start.values, base.density, entry.free, rounds=12, tolerance=1.0)
    return Hypothesis((entry.effect,), found)


def coarse_round(cases: Sequence[Case], base: Point, candidates: Sequence[str]) -> list[Hypothesis]:
    """The coarse fits of the candidates that promise most, the best first."""
    candidates = offered(cases, candidates)
    trials = grids(cases, base.structure, base.values)
    with ThreadPoolExecutor(2) as pool:
        entries = sorted(
            pool.map(lambda e: _enter(cases, base, e, trials[e]), candidates), key=lambda e: -e.start.promise
        )
        fits = list(pool.map(lambda e: _climb(cases, base, e), entries[:SURVIVORS]))
    return sorted(fits, key=lambda h: h.deviance)


@dataclass(frozen=True, eq=False)
class Round:
    """One addition: the model before, the rivals (fitted finely, the best first), and what the coarse round said."""

    before: Point
    rivals: tuple[Hypothesis, ...]
    coarse: tuple[tuple[str, float], ...]  # effect and its coarse gain in deviance


def fine_fit(
    cases: Sequence[Case],
    structure: Structure,
    starts: Sequence[Mapping[str, float]],
    held: Mapping[str, float],
    density: float,
) -> Point:
    """Maximum likelihood with everything free, from the likeliest of the starts."""
    structure = identify.with_teeth(structure)
    mine = identify.with_steps(cases, structure)
    free = tuple(n for n in identify.free_parameters(structure) if n not in held)
    full = [{p.name: s.get(p.name, p.start) for p in structure.parameters} | dict(held) for s in starts]
    if len(full) > 1:
        full.sort(key=lambda values: likelihood.evaluate(mine, structure, values, density).deviance)
    return likelihood.fit(mine, structure, full[0], free, rounds=12)


def refit_smaller(cases: Sequence[Case], smaller: Point, larger: Point, held: Mapping[str, float]) -> Point:
    """The smaller model from the larger one's optimum, if that is better than where it was."""
    values = {**smaller.values, **{n: larger.values[n] for n in smaller.values if n in larger.values}}
    again = fine_fit(cases, smaller.structure, [values], held, smaller.density)
    return again if again.deviance < smaller.deviance else smaller


def plausible(cases: Sequence[Case], point: Point) -> bool:
    """Whether the fit still is what its name says.

    A ripple has repeated, a disturbance comes from outside, a spring is more than a constant.
    """
    places = np.concatenate([c.recording.output[np.isfinite(c.recording.output)] for c in cases])
    turns = point.values.get("ripple_order", math.inf) * float(np.ptp(places)) / (2.0 * math.pi)
    frequency = point.values.get("disturbance_frequency", math.inf)
    cycles = frequency * max(float(c.drive.time[-1]) for c in cases)
    outside = not math.isfinite(frequency) or all(_follows(c, point.values) < _OWN for c in cases)
    middle = 0.5 * float(places.max() + places.min())
    varies = abs(point.values.get("spring_rest", middle) - middle) <= 2.0 * float(np.ptp(places))
    return turns >= 2.0 and cycles >= 2.0 and outside and varies


def _follows(case: Case, values: Mapping[str, float]) -> float:
    """The share of a periodic disturbance's wave that position and direction of motion predict along a recording.

    Where the motion itself is periodic, a disturbance with its period cannot be told from a torque that depends on
    the state, and that is the likelier of the two.
    """
    if case.drive.speed:
        return 0.0
    time, y = case.drive.time, case.drive.measured
    seen = np.isfinite(y)
    time, y = time[seen], y[seen]
    wave = np.sin(2.0 * math.pi * values["disturbance_frequency"] * time - values["disturbance_phase"])
    place = np.searchsorted(np.unique(np.quantile(y, np.linspace(0.0, 1.0, 13)[1:-1])), y)
    label = 2 * place + (np.gradient(y, time) > 0.0)
    count = np.maximum(np.bincount(label), 1)
    mean = np.bincount(label, wave) / count
    spread = float(np.sum((wave - wave.mean()) ** 2))
    return 1.0 - float(np.sum((wave - mean[label]) ** 2)) / max(spread, 1e-300)


def promising(cases: Sequence[Case], before: Point, coarse: Sequence[Hypothesis]) -> bool:
    """Whether any finalist gains anything beside a converged fine model, in a few steps from where that stands."""

    def gain(h: Hypothesis) -> float:
        structure = identify.with_teeth(h.point.structure)
        values = {p.name: h.point.values.get(p.name, p.start) for p in structure.parameters} | before.values
        free = tuple(n for n in identify.free_parameters(structure) if n in before.free or n not in before.values)
        mine = identify.with_steps(cases, structure)
        return before.deviance - likelihood.climb(mine, structure, values, before.density, free, rounds=6).deviance

    with ThreadPoolExecutor(2) as pool:
        return max(pool.map(gain, coarse[:FINALISTS])) > PROMISE


def fine_round(cases: Sequence[Case], before: Point, coarse: Sequence[Hypothesis], held: Mapping[str, float]) -> Round:
    """Fit the best coarse candidates finely and let the smaller model learn from the best of them."""

    def finely(h: Hypothesis) -> Hypothesis:
        # From the coarse valley, teeth looked for anew: what the smaller model took for teeth may be the effect.
        structure = identify.with_teeth(h.point.structure)
        return Hypothesis(h.added, identify.refine(cases, structure, h.point, held))

    with ThreadPoolExecutor(2) as pool:
        fitted = list(pool.map(finely, coarse[:FINALISTS]))
    rivals = sorted(fitted, key=lambda h: (not plausible(cases, h.point), compare.criterion(h.point)))
    if rivals[0].deviance < before.deviance - 3.0 * compare.PRICE:
        before = refit_smaller(cases, before, rivals[0].point, held)
    gains = tuple((h.added[0], h.deviance) for h in coarse)
    return Round(before, tuple(rivals), gains)
