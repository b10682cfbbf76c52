"""Does the missing torque say where an effect acts? Effects confined to a part of the recording, in simulated rigs.

    python scripts/locate_study.py --rigs 120
    python scripts/locate_study.py --rigs 10 --first 20

Each rig holds one effect that acts in a stretch of time, in a range of angle, in a band of speed or in one direction,
or it is sound. Every second one has no gap. The first model is fitted, and its missing torque is asked where it acts.
The table holds the F1 score of the stamps that are reported and the error of the input gain. It also holds the share of
rigs whose missing torque goes with the right variable, and the share of sound rigs in which something is reported.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

import gearmotor_rig
import textbook_rig
from concealed import Concealed
from excitations import EXCITATIONS, FREE

from twin.diagnosis import nonparametric, residual_torque
from twin.diagnosis.residual_torque import MissingTorque
from twin.effects.catalogue import BASE
from twin.estimation import maximum_likelihood, preparation
from twin.io.recording import Recording
from twin.model.stepper import Structure

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Where effects act: the simulator, its effect, and the variables with one of which the missing torque then goes. The
#: sign of the speed is a part of the speed.
PLACES: dict[str, tuple[Any, str, tuple[str, ...]]] = {
    "time": (textbook_rig, "disturbance_pulse", ("time",)),
    "angle": (textbook_rig, "sticky_sector", ("position",)),
    "speed": (gearmotor_rig, "other_friction_hump", ("velocity",)),
    "direction": (textbook_rig, "friction_asymmetry", ("direction", "velocity")),
    "nowhere": (textbook_rig, "", ()),
}
GAPS = {textbook_rig: "gap", gearmotor_rig: "backlash_gap"}
SIZES = (0.1, 0.3)  # of an effect, over the drive's torque at 50 % duty
LOUD = 0.5  # a bin is reported from this share of the loudest bin's power on
BINS = 30


@dataclass(frozen=True)
class Score:
    """What was found of one rig."""

    place: str
    gap: bool
    f1: float  # of the stamps that are reported; NaN where there is nothing to find
    right: bool  # the missing torque goes with the variable that it should, or with none
    gain_error: float  # of the input gain, relative


def f1(said: Flags, true: Flags) -> float:
    """Harmonic mean of precision and recall of flagged stamps (N,); 0 where none is both."""
    both = float(np.count_nonzero(said & true))
    return 2.0 * both / max(float(np.count_nonzero(said) + np.count_nonzero(true)), 1.0)


def acts(effect: Concealed, run: Any) -> Flags:
    """The stamps (N,) at which an effect acts: where its torque is more than half of its largest."""
    p = effect.parameters
    if effect.id == "disturbance_pulse":
        since = run.time - run.time[0] - p["pulse_start"]
        return np.asarray((since >= 0.0) & (since < p["pulse_length"]))
    if effect.id == "sticky_sector":
        return np.asarray(np.cos(run.position - p["sector_angle"]) > math.cos(p["sector_half"]))
    if effect.id == "other_friction_hump":
        off = (np.abs(run.velocity) - p["hump_speed"]) / p["hump_width"]
        return np.asarray(np.exp(-0.5 * off**2) > 0.5)
    side = 1.0 if "dry_forward" in p else -1.0
    return np.asarray(side * run.velocity > 0.02 * np.max(np.abs(run.velocity)))


def reported(missing: MissingTorque, variable: str) -> Flags:
    """The stamps (N,) that lie in segments of the recording, or in bins of a state, with most of the misfit."""
    if variable == "time":
        parts = residual_torque.segments(missing)
        return np.any([(missing.time >= s.start) & (missing.time < s.end) for s in parts] or [missing.time < 0], axis=0)
    values = missing.velocity if variable == "direction" else missing.state(variable)
    if variable == "position":
        values = values % (2.0 * math.pi)
    known = np.isfinite(missing.torque)
    count = 2 if variable == "direction" else BINS
    edges = [0.0] if count == 2 else np.quantile(values[known], np.linspace(0.0, 1.0, count + 1)[1:-1])
    label = np.searchsorted(edges, values)
    power = np.bincount(label[known], missing.torque[known] ** 2, count)
    power /= np.maximum(np.bincount(label[known], minlength=count), 1)
    return np.asarray((power > LOUD * power.max())[label])


def judge(number: int, seed: int = 1, duration: float = 30.0) -> Score:
    """One rig, all by seed and number: places take turns, and so do rigs with a gap and without."""
    place, gap = list(PLACES)[number % len(PLACES)], number // len(PLACES) % 2 == 0
    source, effect, variables = PLACES[place]
    rng = np.random.default_rng([seed, number])
    rig = source.draw_rig(rng)
    rig = rig if gap else rig.with_(**{GAPS[source]: 0.0})
    time, duty = EXCITATIONS["rich"](duration, rng, FREE)
    drawn = [source.draw_effect(rng, effect, rig, float(rng.uniform(*SIZES)), duration)] if effect else []
    run = source.simulate(rig, drawn, time, duty, int(rng.integers(2**31)))
    count = 2.0 * math.pi / run.counts_per_revolution
    recording = Recording(f"rig {number}", run.time, run.duty, run.counts * count, "%", "rad", count)
    structure = preparation.base_structure() if gap else Structure.of(i for i in BASE if i != "backlash")
    problem, point = maximum_likelihood.likeliest([recording], structure)
    case = problem.recordings[0]
    missing = residual_torque.missing_torque(case, point.structure, point.values)
    left = nonparametric.examine_dependence(missing)
    goes = nonparametric.is_dependence_left(left)
    right = goes and bool(set(variables) & set(left.variables)) if drawn else not goes
    score = f1(reported(missing, variables[0]), acts(drawn[0], run)) if drawn else math.nan
    return Score(place, gap, score, right, point.values["input_gain"] / rig.model_values()["input_gain"] - 1.0)


def table(scores: Sequence[Score]) -> str:
    """The scores by place, and by whether there is a gap."""
    lines = [f"{'place':10} {'gap':4} {'rigs':>4} {'F1':>6} {'right':>6} {'gain error, median, %':>22}"]
    for place in PLACES:
        for gap in (True, False):
            own = [s for s in scores if s.place == place and s.gap == gap]
            if own:
                mean, right = np.mean([s.f1 for s in own]), np.mean([s.right for s in own])
                bias = 100.0 * float(np.median([s.gain_error for s in own]))
                lines.append(
                    f"{place:10} {'yes' if gap else 'no':4} {len(own):4} {mean:6.2f} {right:6.2f} {bias:22.2f}"
                )
    alarms = [s for s in scores if s.place == "nowhere"]
    lines.append(f"false alarms on sound rigs: {sum(not s.right for s in alarms)} of {len(alarms)}")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=120)
    parser.add_argument("--first", type=int, default=0, help="number of the first rig, to go on where one stopped")
    parser.add_argument("--seed", type=int, default=1, help="draws everything")
    parser.add_argument("--duration", type=float, default=30.0, help="of a recording, s")
    given = parser.parse_args(arguments)
    scores = []
    for number in range(given.first, given.first + given.rigs):
        scores.append(judge(number, given.seed, given.duration))
        print(f"rig {number}: {scores[-1]}", flush=True)
    print(table(scores))


if __name__ == "__main__":
    main()
