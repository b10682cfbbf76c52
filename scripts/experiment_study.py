"""Whether the designed experiment needs fewer seconds of recording than a protocol that is the same for every rig.

    python scripts/experiment_study.py --rigs 24 --seed 1

Each trial draws a rig in MuJoCo, which shares no code with the model, and records 12 s of the paper's protocol. From
that the tool designs what to record next, within the range of duty and the travel of this first recording. The design
is played on the same rig, over and over, and so are a minute of the paper's protocol and a minute of `rich`, which was
made to separate what others mix up; both are within the same range of duty and may travel as far as they like.

Half of the trials ask for the worst-known parameter of the right model: after how many seconds does either protocol
bring its standard error (leaving out each stretch in turn) to where the design, played once, brings it? All are judged
at the values that all recordings together make likeliest. The last columns are the parameter's actual errors when the
first recording and the design, or as many seconds of a protocol, are fitted.

The other half conceal one effect of a pair that is easily confused, as large as leaves the first recording undecided,
and ask for the verdict: after how many seconds has the right one of the two models, refitted to both recordings, the
log-likelihood that makes one?

Printed are seconds; the median ratios have a 95 % interval that supposes nothing of their distribution. The last lines
say by how much the rig, which is not the model, left the limits that the design was given.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parent))

from concealed import Concealed
from excitations import Limits as Range
from excitations import Signal, paper, rich
from mujoco_rig import TURN, Rig, draw_effect, draw_rig, simulate

from twin.diagnosis import model_comparison, selection_round
from twin.diagnosis.experiment_design import (
    NEEDED_LOG_LIKELIHOOD,
    Limits,
    design_for_discrimination,
    design_for_precision,
)
from twin.diagnosis.result import Experiment
from twin.estimation import likelihood, local_optima, multistart, preparation
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording

Array = NDArray[np.float64]

PAIRS = (
    ("coulomb_friction", "quadratic_drag"),
    ("motor_lag", "input_delay"),
    ("input_delay", "motor_lag"),
    ("spring", "end_stop"),
    ("quadratic_drag", "drive_saturation"),
    ("coulomb_friction", "stribeck_friction"),
)
PROTOCOLS = {"paper": paper, "rich": rich}
FIRST, LONGEST = 12.0, 60.0  # s of the first recording and of a protocol
LADDER = np.geomspace(0.5, LONGEST, 15)  # s at which a verdict may be there
STRETCH = 0.5  # s
COAST = 2.0  # s during which the rig is watched after the end of a design
SIZES = 0.2 / 3.0 ** np.arange(6)  # of an effect, the largest that leaves the first recording undecided is taken
TRUTH = {
    "dead_band_reverse": "dead_band_backward",
    "backlash_gap": "backlash",
    "friction_share": "motor_friction_share",
}


@dataclass(frozen=True)
class Row:
    """One trial: seconds with the design and with each protocol; inf where that is not reached."""

    question: str
    length: float  # of the design, s
    designed: float
    protocols: tuple[float, ...]
    errors: tuple[float, ...] = ()  # of the parameter, relative to its value: with the design, with each protocol
    beyond: tuple[float, float, float] = (0.0, 0.0, 0.0)  # duty, seconds, travel: beyond the limit, as a share of it

    def text(self) -> str:
        told = "".join(f"{s:9.1f}" for s in (self.length, self.designed, *self.protocols))
        return f"{self.question:38s}{told}" + "".join(f"{100.0 * e:9.2f}" for e in self.errors)


def record(rig: Rig, effects: Sequence[Concealed], signal: Signal, seed: int) -> Recording:
    """What the rig answers, as the tool would load it."""
    run = simulate(rig, effects, *signal, seed)
    count = TURN / rig.counts_per_revolution
    return Recording("rig", run.time, run.duty, run.counts * count, "%", "rad", resolution=count)


def repeated(design: Experiment, duration: float) -> Signal:
    """The design over and over."""
    step = float(design.time[1])
    count = round(duration / step)
    over = np.tile(design.input, math.ceil(count / len(design.input)))[:count]
    return np.round(np.arange(count) * step, 9), over


def given_limits(first: Recording) -> Limits:
    """As far as the first recording went."""
    travel = float(np.abs(first.output - first.output[0]).max())
    return Limits(input=float(np.abs(first.input).max()), duration=30.0, travel=travel)


def beyond(rig: Rig, effects: Sequence[Concealed], design: Experiment, limits: Limits, seed: int) -> tuple[float, ...]:
    """By how much duty, seconds and travel go beyond their limits, as shares of these."""
    assert limits.input and limits.duration and limits.travel
    rest = np.arange(1, round(COAST / float(design.time[1]))) * float(design.time[1])
    time = np.concatenate([design.time, np.round(design.time[-1] + rest, 9)])
    seen = record(rig, effects, (time, np.concatenate([design.input, np.zeros(len(rest))])), seed)
    travel = float(np.abs(seen.output - seen.output[0]).max())
    return (
        max(float(np.abs(design.input).max()) / limits.input - 1.0, 0.0),
        max(float(design.time[-1]) / limits.duration - 1.0, 0.0),
        max(travel / limits.travel - 1.0, 0.0),
    )


def in_mesh(case: PreparedRecording, point: Fit) -> PreparedRecording:
    """The case with the motor on the side of its gap that the recording speaks for."""
    trials = [replace(case, contact=s) for s in (0.0, -1.0, 1.0)]
    return min(
        trials,
        key=lambda c: (
            likelihood.evaluate(
                FitProblem([c], process_noise=point.process_noise), point.structure, point.values
            ).deviance
        ),
    )


def fitted(first: PreparedRecording, recordings: Sequence[Recording], point: Fit, *others: Fit) -> Fit:
    """The model refitted to the first recording and others, from its values or those it shares with other points."""
    added = preparation.prepare_recordings(recordings, point.structure).recordings
    cases = [first, *(replace(in_mesh(c, point), reading_variance=first.reading_variance) for c in added)]
    starts = [{n: p.values.get(n, v) for n, v in point.values.items()} for p in (point, *others)]
    tried = [
        local_optima.refit(FitProblem(cases, process_noise=point.process_noise), point.structure, v) for v in starts
    ]
    return min(tried, key=lambda p: p.deviance)


def smallest(first: Recording) -> tuple[FitProblem, list[Fit], Fit]:
    """The base model of a recording, roughly and as structures compete with it, the way the tool comes to it."""
    structure = preparation.base_structure()
    problem, rough = multistart.coarse_starts([first], structure, {})
    problem, fine = multistart.leave_local_optima(problem, multistart.fit_from_starts(problem, structure, rough))
    noise = local_optima.judging_process_noise(problem, fine)
    return problem, rough, local_optima.refit(problem.at(noise), structure, fine.values)


# ---- the worst-known parameter ----


def worths(recording: Recording, first: PreparedRecording, point: Fit) -> tuple[Array, Array]:
    """Of each stretch of a recording: slope (m, n) and information (m, n, n) about the free parameters."""
    (case,) = FitProblem(preparation.prepare_recordings([recording], point.structure).recordings).stepped(
        point.structure
    )
    case = replace(in_mesh(case, point), reading_variance=first.reading_variance)
    run = likelihood.innovations(case, point.structure, point.values, point.process_noise, point.free)
    variance = run.variance * point.scale
    z = np.abs(run.error) / np.sqrt(variance)
    weight = np.minimum(1.0, likelihood.HUBER_LIMIT / np.maximum(z, 1e-300)) / variance
    edges = [*np.searchsorted(recording.time, np.arange(0.0, recording.time[-1], STRETCH) - 1e-9), len(recording.time)]
    pairs = [(run.slopes[a:b], weight[a:b, None], run.error[a:b]) for a, b in pairwise(edges)]
    return np.array([(s * w).T @ e for s, w, e in pairs]), np.array([(s * w).T @ s for s, w, _ in pairs])


def standard_error(pulls: Array, infos: Array, index: int) -> float:
    """Of one parameter, leaving out each stretch in turn, but no less than the information allows."""
    whole = infos.sum(axis=0)
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    scaled = infos / np.outer(size, size)
    whole = scaled.sum(axis=0) + 1e-12 * np.eye(len(size))
    centred = (pulls - pulls.mean(axis=0)) / size
    moved = np.array([np.linalg.solve(whole - i, p)[index] for i, p in zip(scaled, centred, strict=True)])
    plain = float(np.linalg.inv(whole)[index, index])
    return math.sqrt(max(float(moved @ moved), plain)) / float(size[index])


def parameter_trial(seed: int) -> Row | None:
    """The worst-known parameter of a rig without further effects; None where no input is designed."""
    rng = np.random.default_rng([seed, 1])
    rig = draw_rig(rng)
    first = record(rig, [], paper(FIRST, rng), seed)
    problem, _, point = smallest(first)
    cases = problem.recordings
    limits = given_limits(first)
    design = design_for_precision(point, cases, limits)
    if len(design.time) == 0:
        return None
    (name,) = design.about
    length = float(design.time[-1])
    answer = record(rig, [], (design.time, design.input), seed + 1)
    minutes = [record(rig, [], p(LONGEST, rng, Range(duty=limits.input)), seed + 2) for p in PROTOCOLS.values()]
    judge = fitted(cases[0], [answer, *minutes], point)
    index = judge.free.index(name)
    begun = worths(first, cases[0], judge)

    def after(pulls: Array, infos: Array) -> float:
        return standard_error(np.concatenate([begun[0], pulls]), np.concatenate([begun[1], infos]), index)

    goal = after(*worths(answer, cases[0], judge))
    seconds = []
    for minute in minutes:
        pulls, infos = worths(minute, cases[0], judge)
        reached = (k for k in range(1, len(pulls) + 1) if after(pulls[:k], infos[:k]) <= goal)
        seconds.append(STRETCH * next(reached, math.inf))
    true = rig.truths()[TRUTH.get(name, name)]
    same = [answer, *(m.part(0.0, length) for m in minutes)]
    errors = [abs(fitted(cases[0], [r], point).values[name] / true - 1.0) for r in same]
    return Row(name, length, length, tuple(seconds), tuple(errors), beyond(rig, [], design, limits, seed + 3))


# ---- two rivals ----


def rivals(first: Recording, pair: tuple[str, str]) -> tuple[Sequence[PreparedRecording], dict[str, Fit]]:
    """Both models of a pair as the tool fits them; one may be missing where a recording cannot show it."""
    problem, _, base = smallest(first)
    found = selection_round.run_round(problem, base, (), pair)
    return problem.recordings, {h.added[0]: h.point for h in found.rivals}


def units(one: Fit, other: Fit) -> float:
    """Log-likelihood by which one model leads the other, in units of what it is worth."""
    return 0.5 * (other.deviance - one.deviance) / model_comparison.overdispersion([one, other])


@dataclass(frozen=True, eq=False)
class Contest:
    """Two models, the first of them true, as the first recording and as all recordings together have them."""

    first: PreparedRecording
    points: tuple[Fit, Fit]
    judges: tuple[Fit, Fit]

    def lead(self, *second: Recording) -> float:
        """Log-likelihood by which the truth leads once both are refitted, from every start that is known."""
        (one, two), (a, b) = self.points, self.judges
        true, rival = fitted(self.first, second, one, two, a), fitted(self.first, second, two, one, b)
        return units(true, rival)


def verdict(contest: Contest, second: Recording) -> float:
    """Seconds on the ladder until the lead makes a verdict, found by halving; infinite where it never does."""
    steps = [s for s in LADDER if s <= float(second.time[-1]) + 1.0]
    low, high = -1, len(steps)
    while high - low > 1:
        middle = (low + high) // 2
        if contest.lead(second.part(0.0, steps[middle])) >= NEEDED_LOG_LIKELIHOOD:
            high = middle
        else:
            low = middle
    return float(steps[high]) if high < len(steps) else math.inf


def rivals_trial(pair: tuple[str, str], seed: int) -> Row | None:
    """Two rivals, the first of them true; None where no size leaves them undecided, or no input is designed."""
    rng = np.random.default_rng([seed, 2])
    rig, draw = draw_rig(rng), int(rng.integers(2**31))
    signal = paper(FIRST, rng)
    for size in SIZES:
        effect = draw_effect(np.random.default_rng(draw), pair[0], rig, float(size), FIRST)
        first = record(rig, [effect], signal, seed)
        cases, fits = rivals(first, pair)
        if set(fits) == set(pair) and abs(units(fits[pair[0]], fits[pair[1]])) < NEEDED_LOG_LIKELIHOOD:
            break
    else:
        return None
    points = fits[pair[0]], fits[pair[1]]
    limits = given_limits(first)
    design = design_for_discrimination(sorted(points, key=lambda p: p.deviance), cases, limits)
    if len(design.time) == 0:
        return None
    answer = record(rig, [effect], repeated(design, LONGEST / 2.0), seed + 1)
    minutes = [record(rig, [effect], p(LONGEST, rng, Range(duty=limits.input)), seed + 2) for p in PROTOCOLS.values()]
    second = [answer, *minutes]
    judges = fitted(cases[0], second, *points), fitted(cases[0], second, *reversed(points))
    contest = Contest(cases[0], points, judges)
    if contest.lead() >= NEEDED_LOG_LIKELIHOOD:
        return None  # what looked undecided was a fit that had not arrived
    told = [verdict(contest, r) for r in second]
    outside = beyond(rig, [effect], design, limits, seed + 3)
    return Row(f"{pair[0]}, not {pair[1]}", float(design.time[-1]), told[0], tuple(told[1:]), (), outside)


# ---- what came out ----


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """The median and the order statistics between which that of the population lies, in 95 % of all studies.

    Of fewer than six values, the least and the largest, which hold it less often.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    n = len(ordered)
    low = max(int(stats.binom.ppf(0.025, n, 0.5)) - 1, 0)
    return float(ordered[(n - 1) // 2] + ordered[n // 2]) / 2.0, float(ordered[low]), float(ordered[n - 1 - low])


def ratio(row: Row, protocol: int) -> float:
    """Seconds designed over seconds by a protocol; infinite where only the protocol gets there, NaN where neither."""
    designed, default = row.designed, row.protocols[protocol]
    if math.isinf(designed):
        return math.nan if math.isinf(default) else math.inf
    return 0.0 if math.isinf(default) else designed / default


def summary(rows: Sequence[Row]) -> str:
    """Median ratios, errors and limits."""
    lines = []
    for what, own in (
        ("worst-known parameter", [r for r in rows if r.errors]),
        ("verdict on two rivals", [r for r in rows if not r.errors]),
    ):
        for k, protocol in enumerate(PROTOCOLS):
            ratios = [x for x in (ratio(r, k) for r in own) if not math.isnan(x)]
            if ratios:
                middle, low, high = median_interval(ratios)
                fewer = sum(x < 1.0 for x in ratios)
                told = f"median {middle:.2f} ({low:.2f} to {high:.2f}), fewer in {fewer} of {len(ratios)}"
                lines.append(f"{what}: seconds designed over seconds by {protocol}: {told}")
        if own and own[0].errors:
            errors = np.median([r.errors for r in own], axis=0)
            told = ", ".join(f"{n} {100.0 * e:.2g} %" for n, e in zip(("designed", *PROTOCOLS), errors, strict=True))
            lines.append(f"{what}: median actual error after as many seconds: {told}")
    for k, limit in enumerate(("duty", "seconds", "travel")):
        over = [r.beyond[k] for r in rows]
        lines.append(f"{limit}: beyond the limit in {sum(x > 0.0 for x in over)} of {len(over)}, at most by "
                     f"{100.0 * max(over, default=0.0):.1f} %")  # fmt: skip
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=4, help="half of them for either question")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    names = "".join(f"{n + ', s':>9s}" for n in ("length", "design", *PROTOCOLS))
    print(f"{'question':38s}{names}" + "".join(f"{'err, %':>9s}" for _ in ("design", *PROTOCOLS)))
    rows, left_out = [], 0
    for number in range(given.rigs):
        seed = 100_000 * given.seed + 10 * number
        row = rivals_trial(PAIRS[number // 2 % len(PAIRS)], seed) if number % 2 else parameter_trial(seed)
        if row is None:
            left_out += 1
        else:
            rows.append(row)
            print(row.text(), flush=True)
    print(f"left out, because there was nothing to ask or no input would answer: {left_out} of {given.rigs}")
    print(summary(rows))


if __name__ == "__main__":
    main()
