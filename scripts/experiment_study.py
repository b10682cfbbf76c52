"""Whether the designed experiment needs fewer seconds of recording than the default protocol.

    python scripts/experiment_study.py --rigs 2

Each trial draws a rig, conceals one effect of a pair that is easily confused in it and records the paper's protocol.
Both effects are fitted. The designed input, over and over, and the `rich` protocol, within the same range of duty, are
then played on the same rig; after each of a ladder of seconds both models are refitted to the first recording and that
much of the second. Printed are the length of the design, the seconds after which the true model has gained the
log-likelihood that makes a verdict (inf: not within 30 s designed, 60 s default), and their ratio. The rigs are
MuJoCo's and share no code with the model.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from excitations import Limits as Range
from excitations import paper, rich
from mujoco_rig import TURN, Concealed, Rig, draw_effect, draw_rig, simulate

from twin import experiment, identify, likelihood
from twin.axis import BASE, Structure
from twin.experiment import NEEDED, separate
from twin.likelihood import Case, Point
from twin.recording import Recording

PAIRS = (
    ("coulomb_friction", "quadratic_drag"),
    ("motor_lag", "input_delay"),
    ("spring", "end_stop"),
    ("gravity", "encoder_eccentricity"),
    ("quadratic_drag", "drive_saturation"),
    ("coulomb_friction", ""),  # or dead-band, which every model has
)
LADDER = (1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0, 30.0, 45.0, 60.0)
FIRST = 12.0  # s of the first recording


def record(rig: Rig, effects: list[Concealed], signal: tuple[np.ndarray, np.ndarray], seed: int) -> Recording:
    """What the rig answers, as the tool would load it."""
    run = simulate(rig, effects, *signal, seed)
    count = TURN / rig.counts_per_revolution
    return Recording("rig", run.time, run.duty, run.counts * count, "%", "rad", resolution=count)


def starts(rig: Rig, effect: str, reach: float) -> list[dict[str, float]]:
    """Values near the rig's own, with the effect at a few sizes; finding them is another script's business."""
    speed = rig.half_speed
    base = {
        "input_gain": rig.input_gain,
        "viscous_friction": rig.viscous_friction,
        "dead_band_forward": rig.dead_band_forward,
        "dead_band_reverse": rig.dead_band_backward,
        "backlash_gap": rig.backlash,
        "motor_share": rig.motor_share,
        "friction_share": rig.motor_friction_share,
        "tooth_frequency": rig.teeth_frequency,
        "tooth_damping": rig.teeth_damping,
    }
    torque = rig.half_torque
    tries: dict[str, list[dict[str, float]]] = {
        "": [{}],
        "coulomb_friction": [{"coulomb_friction": f * torque} for f in (0.03, 0.15)],
        "quadratic_drag": [{"quadratic_drag": f * torque / speed**2} for f in (0.05, 0.3)],
        "motor_lag": [{"lag_time": f} for f in (0.005, 0.02, 0.05)],
        "input_delay": [{"delay": f} for f in (0.004, 0.012, 0.03)],
        "spring": [{"spring_stiffness": f * torque, "spring_rest": 0.0} for f in (0.03, 0.15)],
        "end_stop": [
            {"stop_stiffness": 5e3, "stop_damping": 1.0, "stop_upper": f * reach, "stop_lower": -f * reach}
            for f in (0.5, 0.95)
        ],
        "gravity": [{"gravity_gain": 0.1 * torque, "gravity_angle": a} for a in (-2.0, 0.0, 2.0)],
        "encoder_eccentricity": [{"eccentricity": 0.02, "eccentricity_angle": a} for a in (-2.0, 0.0, 2.0)],
        "drive_saturation": [{"saturation_limit": f} for f in (20.0, 27.0, 33.0)],
    }
    return [{**base, **t} for t in tries[effect]]


def fitted(recordings: list[Recording], effect: str, values: list[dict[str, float]], density: float = 0.0) -> Point:
    """The best fit from several starts; its noise density is estimated unless given."""
    structure = Structure.of([*BASE, "tooth_compliance", *([effect] if effect else [])])
    cases = [likelihood.prepare(r, structure) for r in recordings]
    free = identify.free_parameters(structure)
    coarse = density or likelihood.density_of(cases[0], identify.MEMORY)
    points = [likelihood.climb(cases, structure, v, coarse, free, 15) for v in values]
    best = min(points, key=lambda p: p.deviance)
    return best if density else likelihood.fit(cases, structure, best.values, free, coarse, 15)


def lead(first: Recording, second: Recording, seconds: float, true: Point, rival: Point) -> float:
    """Log-likelihood by which the truth leads after so many seconds of the second recording."""
    both = [first, second.part(0.0, seconds)]
    density = min(true.density, rival.density)
    ends = []
    for point in (true, rival):
        effect = next((i for i in point.structure.named), "")
        ends.append(fitted(both, effect, [point.values, {**point.values, **_shared(true, point)}], density).deviance)
    return 0.5 * (ends[1] - ends[0])


def _shared(true: Point, point: Point) -> dict[str, float]:
    return {n: true.values[n] for n in point.values if n in true.values}


def needed(first: Recording, second: Recording, true: Point, rival: Point) -> float:
    """Seconds on the ladder until the truth has gained what a verdict needs; infinite where it never does."""
    density = min(true.density, rival.density)
    alone = [fitted([first], next(iter(p.structure.named), ""), [p.values], density).deviance for p in (true, rival)]
    before = 0.5 * (alone[1] - alone[0])
    end = float(second.time[-1])
    for seconds in (*(s for s in LADDER if s < end), end):
        if lead(first, second, seconds, true, rival) - before >= NEEDED:
            return seconds
    return math.inf


def trial(pair: tuple[str, str], seed: int, size: float) -> tuple[float, float, float, str]:
    """Length of the design, seconds with the designed input and with the default protocol, and what the design said."""
    rng = np.random.default_rng(seed)
    rig = draw_rig(rng)
    effect = draw_effect(rng, pair[0], rig, size, FIRST)
    first = record(rig, [effect], paper(FIRST, rng), seed)
    reach = float(np.abs(first.output - first.output[0]).max())
    points = [fitted([first], e, starts(rig, e, reach)) for e in pair]
    most = float(np.abs(first.input).max())
    case: Case = likelihood.prepare(first, points[0].structure)
    design = separate(points, [case], experiment.Limits(input=most, travel=math.inf))
    default = record(rig, [effect], rich(60.0, rng, Range(duty=most)), seed + 1)
    by_default = needed(first, default, points[0], points[1])
    if len(design.time) == 0:
        return math.nan, math.inf, by_default, design.why
    step = float(design.time[1])
    over = np.tile(design.input, math.ceil(30.0 / (step * len(design.input))))[: round(30.0 / step)]
    answer = record(rig, [effect], (np.round(np.arange(len(over)) * step, 9), over), seed + 2)
    return float(design.time[-1]), needed(first, answer, points[0], points[1]), by_default, design.why


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=2, help="rigs for each pair")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--size", type=float, default=0.1, help="of the effect, as a share of the torque at half duty")
    parser.add_argument("--verbose", action="store_true", help="print what each design promised")
    given = parser.parse_args()
    ratios = []
    print(f"{'truth':24s}{'rival':24s}{'length, s':>12s}{'designed, s':>12s}{'default, s':>12s}{'ratio':>8s}")
    for number, pair in enumerate(PAIRS):
        for k in range(given.rigs):
            length, designed, default, why = trial(pair, given.seed + 1000 * number + 10 * k, given.size)
            ratio = designed / default if math.isfinite(designed) else (math.nan if math.isinf(default) else math.inf)
            ratios.append(ratio)
            row = f"{pair[0]:24s}{pair[1] or 'nothing more':24s}"
            row += f"{length:12.1f}{designed:12.1f}{default:12.1f}{ratio:8.2f}"
            print(row + (f"  {why}" if given.verbose else ""), flush=True)
    known = np.array([r for r in ratios if not math.isnan(r)])
    if len(known):
        shorter, equal = np.sum(known < 1.0), np.sum(known == 1.0)
        print(f"designed over default: median {np.median(known):.2f}")
        print(f"shorter in {shorter}, equal in {equal}, of {len(known)} in which either led to a verdict")


if __name__ == "__main__":
    main()
