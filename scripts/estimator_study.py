"""How exact are the estimates? The paper's method and the joint fit on simulated rigs, whose truth is known.

    python scripts/estimator_study.py --rigs 100
    python scripts/estimator_study.py --rigs 100 --simulator circuit

prints for every parameter the median and the 95th percentile of the error, that error over the Cramer-Rao bound (1
for a perfect estimator), and how often the 95 % interval holds the truth. Relative errors in percent, those of the
dead-band in percent of duty.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parent))

from excitations import EXCITATIONS, FREE
from simulators import SIMULATORS

from twin.estimation import likelihood, maximum_likelihood, optimizer, prepared_recording
from twin.estimation.preparation import base_structure
from twin.estimation.problem import FitProblem, free_parameters
from twin.estimation.two_stage import two_stage
from twin.io.recording import Recording

METHODS = ("paper, speeds", "paper, positions", "joint")
DUTIES = ("dead_band_forward", "dead_band_reverse")  # errors in duty, not relative
#: MuJoCo's own step, s. At the usual one, where teeth bounce for long, positions are wrong by a count and more
#: within seconds, which an estimator of this kind sees; at this one by a quarter of that.
FINER: dict[str, dict[str, Any]] = {
    name: {"stepping": simulator.Stepping(step=5e-5)} if name == "mujoco" else {}
    for name, simulator in SIMULATORS.items()
}
Estimate = tuple[float, float, float, float]  # value, standard error, ends of the interval (NaN: by the error)
NORMAL_MEDIAN = 0.6745  # of the absolute value of a standard normal


@dataclass(frozen=True)
class Outcome:
    """One parameter by one method on one rig; NaN where the method gives none."""

    rig: int
    excitation: str
    method: str
    parameter: str
    truth: float
    estimate: float
    std: float
    bound: float  # Cramer-Rao, at the truth
    seconds: float  # that the whole fit took
    low: float = math.nan  # of the 95 % interval, where it is not the estimate and 1.96 standard errors
    high: float = math.nan

    @property
    def holds(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return self.low <= self.truth <= self.high
        return abs(self.estimate - self.truth) <= 1.96 * self.std

    @property
    def error(self) -> float:
        """In percent: of duty for a dead-band, else of the truth."""
        error = abs(self.estimate - self.truth)
        return error if self.parameter in DUTIES else 100.0 * error / self.truth


def record(simulator: str, rig: Any, excitation: str, duration: float, rng: np.random.Generator) -> Recording:
    stamps, duty = EXCITATIONS[excitation](duration, rng, FREE)
    run = SIMULATORS[simulator].simulate(rig, [], stamps, duty, int(rng.integers(2**31)), **FINER[simulator])
    count = 2.0 * math.pi / run.counts_per_revolution
    return Recording(f"{excitation} of a random rig", run.time, run.duty, run.counts * count, "%", "rad", count)


def bounds(recording: Recording, truth: dict[str, float]) -> dict[str, float]:
    """Cramer-Rao bound of every parameter, all of them unknown, with the noise that the recording shows."""
    structure = base_structure()
    cases, free = [prepared_recording.prepare_recording(recording, structure)], free_parameters(structure)
    process_noise = optimizer.most_likely_process_noise(FitProblem(cases), structure, truth)
    point = likelihood.evaluate(FitProblem(cases, process_noise=process_noise), structure, truth, free)
    return dict(zip(free, np.sqrt(np.diag(point.covariance)).tolist(), strict=True))


def by_paper(recording: Recording, form: str) -> dict[str, Estimate]:
    found = two_stage([recording], form)
    names = {"input_gain": "c", "viscous_friction": "b", **{n: n for n in DUTIES}}
    return {name: (getattr(found, own), found.std(own), math.nan, math.nan) for name, own in names.items()}


def jointly(recording: Recording) -> dict[str, Estimate]:
    found = maximum_likelihood.identify([recording], base_structure())
    return {n: (found.values[n], found.std(n), *found.intervals.get(n, (math.nan, math.nan))) for n in found.fitted}


def study_rig(index: int, seed: int, duration: float, excitations: tuple[str, ...], simulator: str) -> list[Outcome]:
    """All methods on one rig; the rig is the same for every excitation."""
    rig = SIMULATORS[simulator].draw_rig(np.random.default_rng([seed, index]))
    truth = rig.model_values()
    estimators: dict[str, Callable[[Recording], dict[str, Estimate]]] = {
        METHODS[0]: partial(by_paper, form="speeds"),
        METHODS[1]: partial(by_paper, form="positions"),
        METHODS[2]: jointly,
    }
    outcomes = []
    for number, excitation in enumerate(excitations):
        recording = record(simulator, rig, excitation, duration, np.random.default_rng([seed, index, number]))
        bound = bounds(recording, truth)
        for method, estimate in estimators.items():
            begun = time.process_time()
            found = estimate(recording)
            taken = time.process_time() - begun
            for name, true in truth.items():
                value, std, low, high = found.get(name, (math.nan,) * 4)
                outcomes.append(
                    Outcome(index, excitation, method, name, true, value, std, bound[name], taken, low, high)
                )
    return outcomes


def study(
    rigs: int, seed: int, duration: float, excitations: tuple[str, ...], simulator: str, processes: int
) -> list[Outcome]:
    """The study on the first `rigs` rigs of a seed."""
    run = partial(study_rig, seed=seed, duration=duration, excitations=excitations, simulator=simulator)
    if processes == 1:
        return [o for i in range(rigs) for o in run(i)]
    # Fresh processes, so that the linear algebra in them starts with one thread each.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        return [o for some in tqdm(pool.map(run, range(rigs)), total=rigs, unit="rig") for o in some]


def cell(outcomes: Iterable[Outcome]) -> str:
    """Median and 95th percentile of the error, ratio to the bound, coverage; of rigs with an estimate."""
    found = [o for o in outcomes if math.isfinite(o.estimate)]
    if not found:
        return f"{'-':>8} {'-':>8} {'-':>6} {'-':>5}"
    errors = [o.error for o in found]
    ratio = np.median([abs(o.estimate - o.truth) / o.bound for o in found]) / NORMAL_MEDIAN
    held = np.mean([o.holds for o in found])
    return f"{np.median(errors):8.3g} {np.percentile(errors, 95):8.3g} {ratio:6.3g} {100 * held:4.0f}%"


def table(outcomes: list[Outcome]) -> str:
    """One table for each excitation, the methods side by side."""
    lines = []
    for excitation in dict.fromkeys(o.excitation for o in outcomes):
        own = [o for o in outcomes if o.excitation == excitation]
        rigs = len({o.rig for o in own})
        lines += ["", f"excitation '{excitation}', {rigs} rigs", ""]
        lines.append(f"{'':19}" + "".join(f" | {m:^30}" for m in METHODS))
        lines.append(f"{'':19}" + f" | {'median':>8} {'95 %':>8} {'/bound':>6} {'cover':>5}" * len(METHODS))
        for name in dict.fromkeys(o.parameter for o in own):
            cells = [cell(o for o in own if (o.method, o.parameter) == (m, name)) for m in METHODS]
            lines.append(f"{name:19}" + "".join(f" | {c}" for c in cells))
        first = [o for o in own if o.parameter == "input_gain"]
        counts = [sum(o.method == m and math.isfinite(o.estimate) for o in first) for m in METHODS]
        seconds = [float(np.median([o.seconds for o in first if o.method == m])) for m in METHODS]
        lines.append(f"{'rigs with estimate':19}" + "".join(f" | {f'{n} of {rigs}':>30}" for n in counts))
        lines.append(f"{'CPU-seconds a fit':19}" + "".join(f" | {s:30.2f}" for s in seconds))
    lines += ["", "Errors in percent of the truth, of dead-bands in percent of duty. /bound: median error over the"]
    lines += ["Cramer-Rao bound of the whole recording, 1 for a perfect estimator. cover: of the 95 % intervals."]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=100, help="how many random rigs")
    parser.add_argument("--seed", type=int, default=1, help="draws the rigs and their noise")
    parser.add_argument("--duration", type=float, default=60.0, help="of a recording, s")
    parser.add_argument(
        "--excitation", action="append", choices=list(EXCITATIONS), help="default: paper and rich; may be repeated"
    )
    parser.add_argument("--simulator", choices=SIMULATORS, default="mujoco", help="what makes the recordings")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, help="JSON file for every single estimate")
    given = parser.parse_args(arguments)
    excitations = tuple(given.excitation or ("paper", "rich"))
    outcomes = study(given.rigs, given.seed, given.duration, excitations, given.simulator, given.processes)
    if given.out:
        given.out.write_text(json.dumps([asdict(o) for o in outcomes], indent=1) + "\n", encoding="utf-8")
    print(table(outcomes))


if __name__ == "__main__":
    main()
