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

from twin import identify, likelihood, locate
from twin.axis import Structure
from twin.effects.catalogue import CANDIDATES, EFFECTS
from twin.likelihood import Case, Point

FloatArray = NDArray[np.float64]

#: Coarse fits per round, and how many of them go on to a fine fit.
FINALISTS = 3


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


def grids(cases: Sequence[Case], structure: Structure, values: Mapping[str, float]) -> dict[str, list[dict[str, float]]]:
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
        orders = np.arange(2.0, 61.0) if travel > 3.0 else np.linspace(2.0, 60.0, 117)
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
        for inside in (0.005, 0.03):
            stops.append(
                {
                    "stop_upper": float(places.max()) - inside * travel if high else float(places.max()) + travel,
                    "stop_lower": float(places.min()) + inside * travel if low else float(places.min()) - travel,
                    "stop_stiffness": 2e4,
                    "stop_damping": 60.0,
                }
            )
    out["end_stop"] = stops
    return out


#: Candidates whose gain has no neutral value to differentiate at, or acts too far from it: tried as they are.
_DIRECT = ("drive_saturation", "motor_lag", "input_delay", "end_stop", "joint_elasticity")


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
    step = np.linalg.solve(block, g[index])
    without = np.linalg.solve(block[: len(old), : len(old)], g[old])
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
                replace(a, slopes=np.column_stack([a.slopes, b.slopes[:, column]])) for a, b in zip(one, two, strict=True)
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


def _cases_for(cases: Sequence[Case], structure: Structure) -> list[Case]:
    longest = 0.002 / structure.substeps * (1.0 + 1e-9)
    return [replace(c, drive=replace(c.drive, longest=longest)) for c in cases]


def coarse_fit(cases: Sequence[Case], base: Point, effect: str, trials: Sequence[Mapping[str, float]]) -> Hypothesis:
    """The candidate's best coarse fit beside everything that the base model has."""
    structure = base.structure.with_(effect)
    mine = _cases_for(cases, structure)
    free = identify.free_parameters(structure)
    held = set(base.structure.parameters and identify.free_parameters(base.structure)) - set(base.free)
    free = tuple(n for n in free if n not in held)
    if effect in _DIRECT:
        neutral = {k: v for k, v in _neutral(effect).items() if k not in base.values}
        starts = [Start({**base.values, **neutral, **_inside(t)}, 0.0) for t in trials]
        tried = [
            likelihood.climb(mine, structure, s.values, base.density, free, rounds=3, tolerance=1.0) for s in starts
        ]
    else:
        starts = sorted(_nested_starts(mine, base, effect, trials), key=lambda s: -s.promise)[:2]
        tried = [
            likelihood.climb(mine, structure, s.values, base.density, free, rounds=3, tolerance=1.0) for s in starts
        ]
    best = min(tried, key=lambda q: q.deviance)
    best = likelihood.climb(mine, structure, best.values, base.density, free, rounds=12, tolerance=1.0)
    return Hypothesis((effect,), best)


def coarse_round(cases: Sequence[Case], base: Point, candidates: Sequence[str]) -> list[Hypothesis]:
    """Every candidate's coarse fit, the best first."""
    trials = grids(cases, base.structure, base.values)
    with ThreadPoolExecutor(2) as pool:
        fits = list(pool.map(lambda e: coarse_fit(cases, base, e, trials[e]), candidates))
    return sorted(fits, key=lambda h: h.deviance)
