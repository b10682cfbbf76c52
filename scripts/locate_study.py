"""Does the missing torque say where an effect acts? Effects confined to a part of the recording, in simulated rigs.

    python scripts/locate_study.py --rigs 120
    python scripts/locate_study.py --rigs 10 --first 20
    python scripts/locate_study.py --rigs 60 --places nowhere --gap no --between

Each rig holds one effect that acts in a stretch of time, in a range of angle, in a band of speed or in one direction,
or it is sound. Half of them have no gap. The first model is fitted, and its missing torque is asked where it acts. With
`--between` the command changes between stamps, and shows from the next stamp on. The table holds the F1 score of the
stamps that are reported and the error of the input gain, as fitted and as the missing torque corrects it. It also holds
the share of rigs whose missing torque goes with the right variable, and of sound rigs in which something is reported.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

import gearmotor_rig
import textbook_rig
from concealed import Concealed
from excitations import EXCITATIONS, Limits

from twin.diagnosis import localization, nonparametric, residual_torque
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
STEP, FINE = 0.002, 4  # s between stamps; parts of it at which a command may change
SIZES = (0.1, 0.3)  # of an effect, over the drive's torque at 50 % duty


@dataclass(frozen=True)
class Score:
    """What was found of one rig."""

    place: str
    gap: bool
    f1: float  # of the stamps that are reported; NaN where there is nothing to find
    right: bool  # the missing torque goes with the variable that it should, or with none
    gain_error: float  # of the fitted input gain, relative
    corrected: float  # the same once the missing torque has been asked


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
    """The stamps (N,) that lie in segments of the recording, or in regimes of a state, that the tool reports."""
    none = np.zeros(len(missing.time), dtype=bool)
    if variable == "time":
        parts = localization.segments(missing)
        return np.any([none, *((missing.time >= s.start) & (missing.time < s.end) for s in parts)], axis=0)
    period = 2.0 * math.pi if variable == "position" else 0.0
    values = missing.state(variable) % period if period else missing.state(variable)
    found = localization.regimes(missing, variable, period)
    inside = [(values >= r.low) & (values <= r.high) for r in found if r.low <= r.high]
    across = [(values >= r.low) | (values <= r.high) for r in found if r.low > r.high]
    return np.any([none, *inside, *across], axis=0) & ((values != 0.0) | (variable != "direction"))


def played(source: Any, rig: Any, concealed: Sequence[Concealed], signal: tuple[Array, Array], seed: int) -> Any:
    """The run of a rig, at the stamps that are logged."""
    run = source.simulate(rig, concealed, *signal, seed)
    every = round(STEP / float(signal[0][1] - signal[0][0]))
    arrays = {f.name: getattr(run, f.name) for f in fields(run)}
    return replace(run, **{n: a[::every] for n, a in arrays.items() if isinstance(a, np.ndarray)})


def kinds(places: Sequence[str], gaps: Sequence[bool]) -> list[tuple[str, bool]]:
    """The kinds of rig, which take turns: where the effect acts, and whether there is a gap."""
    return [(place, gap) for gap in gaps for place in places]


@dataclass(frozen=True)
class Study:
    """What all rigs of a study share."""

    kinds: Sequence[tuple[str, bool]] = tuple(kinds(list(PLACES), (True, False)))
    seed: int = 1
    duration: float = 30.0  # s
    step: float = STEP  # s, at which the command may change


def judge(number: int, study: Study) -> Score:
    """One rig, all by seed and number."""
    (place, gap), duration = study.kinds[number % len(study.kinds)], study.duration
    source, effect, variables = PLACES[place]
    rng = np.random.default_rng([study.seed, number])
    rig = source.draw_rig(rng)
    rig = rig if gap else rig.with_(**{GAPS[source]: 0.0})
    signal = EXCITATIONS["rich"](duration, rng, Limits(sample_time=study.step))
    drawn = [source.draw_effect(rng, effect, rig, float(rng.uniform(*SIZES)), duration)] if effect else []
    run = played(source, rig, drawn, signal, int(rng.integers(2**31)))
    count = 2.0 * math.pi / run.counts_per_revolution
    recording = Recording(f"rig {number}", run.time, run.duty, run.counts * count, "%", "rad", count)
    structure = preparation.base_structure() if gap else Structure.of(i for i in BASE if i != "backlash")
    problem, point = maximum_likelihood.likeliest([recording], structure)
    case = problem.recordings[0]
    missing = residual_torque.missing_torque(case, point.structure, point.values)
    left = nonparametric.examine_dependence(missing)
    goes = nonparametric.is_dependence_left(left)
    right = goes and bool(set(variables) & set(left.variables)) if drawn else not goes
    local = localization.without_base(missing)
    score = f1(reported(local, variables[0]), acts(drawn[0], run)) if drawn else math.nan
    true, fitted = rig.model_values()["input_gain"], point.values["input_gain"]
    corrected = fitted + localization.gain_error(missing)
    return Score(place, gap, score, right, fitted / true - 1.0, corrected / true - 1.0)


def table(scores: Sequence[Score]) -> str:
    """The scores by place, and by whether there is a gap."""
    lines = [f"{'place':10} {'gap':4} {'rigs':>4} {'F1':>6} {'right':>6} {'gain off, %':>12} {'corrected':>10}"]
    for place in PLACES:
        for gap in (True, False):
            own = [s for s in scores if s.place == place and s.gap == gap]
            if own:
                kind = f"{place:10} {'yes' if gap else 'no':4} {len(own):4}"
                mean, right = np.mean([s.f1 for s in own]), np.mean([s.right for s in own])
                off, less = (100.0 * float(np.median(np.abs(e))) for e in zip(*map(_errors, own), strict=True))
                lines.append(f"{kind} {mean:6.2f} {right:6.2f} {off:12.2f} {less:10.2f}")
    for place in PLACES:
        own = [s for s in scores if s.place == place]
        if own and place != "nowhere":
            lines.append(f"{place}: mean F1 {np.mean([s.f1 for s in own]):.3f} of {len(own)} rigs")
    alarms = [s for s in scores if s.place == "nowhere"]
    lines.append(f"false alarms on sound rigs: {sum(not s.right for s in alarms)} of {len(alarms)}")
    return "\n".join(lines)


def _errors(score: Score) -> tuple[float, float]:
    return score.gain_error, score.corrected


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=120)
    parser.add_argument("--first", type=int, default=0, help="number of the first rig, to go on where one stopped")
    parser.add_argument("--seed", type=int, default=1, help="draws everything")
    parser.add_argument("--duration", type=float, default=30.0, help="of a recording, s")
    parser.add_argument("--places", nargs="+", choices=list(PLACES), default=list(PLACES))
    parser.add_argument("--gap", choices=("yes", "no", "both"), default="both")
    parser.add_argument("--between", action="store_true", help="the command changes between stamps, too")
    given = parser.parse_args(arguments)
    gaps = {"yes": (True,), "no": (False,), "both": (True, False)}[given.gap]
    step = STEP / FINE if given.between else STEP
    study = Study(kinds(given.places, gaps), given.seed, given.duration, step)
    scores = []
    for number in range(given.first, given.first + given.rigs):
        scores.append(judge(number, study))
        print(f"rig {number}: {scores[-1]}", flush=True)
    print(table(scores))


if __name__ == "__main__":
    main()
