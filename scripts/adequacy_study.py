"""Is the p-value of a free run uniform on rigs from which nothing is missing?

    python scripts/adequacy_study.py --rigs 100
    python scripts/adequacy_study.py --rigs 40 --gapless --dry

Rigs of the textbook simulator with white torque noise and a counted encoder are recorded, the model with the right
structure is fitted to the first 70 %, and its free runs through the fitted and the held-out part get the p-values of
`twin.diagnosis.adequacy`. Printed are histograms, Kolmogorov-Smirnov tests and the median error over that expected.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import kstest

sys.path.insert(0, str(Path(__file__).resolve().parent))

import textbook_rig
from excitations import EXCITATIONS, FREE

from twin.diagnosis import adequacy, data_split
from twin.diagnosis.adequacy import FreeRun
from twin.diagnosis.data_split import RecordingPart
from twin.effects.catalogue import BASE
from twin.estimation import optimizer, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import free_parameters
from twin.io.recording import Recording
from twin.model.stepper import Structure

SHARE_OF_DRIVE = 0.08  # dry friction over the torque of the drive at 50 % duty
LEAD = 3.0  # s, in which a free run through the held-out part comes to its speed


@dataclass(frozen=True)
class Kind:
    """What a rig has."""

    gap: bool = True
    dry: bool = False


def record(seed: int, kind: Kind, duration: float = 40.0) -> tuple[Recording, Structure, dict[str, float]]:
    """One rig's recording, the right structure and its true values."""
    rng = np.random.default_rng([seed, 71])
    rig = textbook_rig.draw_rig(rng)
    values = rig.model_values()
    structure = preparation.base_structure()
    if not kind.gap:
        rig = rig.with_(gap=0.0)
        structure = Structure.of(i for i in BASE if i != "backlash")
    name = str(rng.choice(sorted(EXCITATIONS)))
    time, duty = EXCITATIONS[name](duration, rng, FREE)
    effects = []
    if kind.dry:
        friction = SHARE_OF_DRIVE * rig.half_torque
        effects = [textbook_rig.draw_effect(rng, "coulomb_friction", rig, SHARE_OF_DRIVE, duration)]
        structure = structure.with_("coulomb_friction")
        values = {**values, "coulomb_friction": friction}
    ran = textbook_rig.simulate(rig, effects, time, duty, seed)
    count = 2.0 * np.pi / rig.counts_per_revolution
    recording = Recording(f"{name} {seed}", time, duty, ran.counts * count, "%", "rad", count)
    return recording, structure, preparation.complete_values(structure, values)


def judge(recording: Recording, structure: Structure, values: dict[str, float]) -> tuple[FreeRun, FreeRun, Fit]:
    """The free runs through the fitted and the held-out part of the model fitted from these values."""
    train, held_out = data_split.split([recording])
    problem = preparation.prepare_recordings(train, structure)
    free = free_parameters(structure)
    fitted = optimizer.fit_with_process_noise(problem, structure, values, free)
    point = adequacy.at_own_noise(problem, fitted)
    seen = adequacy.together(adequacy.free_runs([RecordingPart(r) for r in train], problem, point), True)
    tests, parts = data_split.led(held_out, structure, LEAD)
    unseen = adequacy.free_runs(parts, preparation.prepare_recordings(tests, structure), point)
    return seen, adequacy.together(unseen, False), point


def study(seeds: Sequence[int], kind: Kind, duration: float = 40.0) -> dict[str, list[FreeRun]]:
    """The free runs of many rigs, "train" and "holdout"."""
    found: dict[str, list[FreeRun]] = {"train": [], "holdout": []}
    for seed in seeds:
        recording, structure, values = record(seed, kind, duration)
        seen, unseen, _ = judge(recording, structure, values)
        found["train"].append(seen)
        found["holdout"].append(unseen)
    return found


def report(found: dict[str, list[FreeRun]]) -> str:
    """Histograms of the p-values in tenths, the test that they are uniform, and errors over those expected."""
    lines = []
    for role, runs in found.items():
        p = np.array([r.p_value for r in runs])
        ratio = np.median([r.rmse / r.expected for r in runs])
        bins = " ".join(f"{n:3d}" for n in np.histogram(p, 10, (0.0, 1.0))[0])
        lines.append(
            f"{role:8s} {len(p)} rigs  p in tenths: {bins}  KS p = {kstest(p, 'uniform').pvalue:.3f}  "
            f"least p = {p.min():.2g}  median of error / expected = {ratio:.2f}"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--gapless", action="store_true")
    parser.add_argument("--dry", action="store_true")
    given = parser.parse_args()
    kind = Kind(gap=not given.gapless, dry=given.dry)
    print(report(study(range(given.seed, given.seed + given.rigs), kind)))


if __name__ == "__main__":
    main()
