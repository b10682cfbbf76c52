"""Does identification end at the maximum of the likelihood, or in a lesser optimum?

    python scripts/optimum_study.py --simulator circuit --seed 210911 --rigs 8

Rigs from which nothing is missing are recorded for 30 s. The first model is identified as for a user, and once more
from the true values, which no user has. Printed is by how much the deviance of what a user gets is above that of the
other, and gap, shares and teeth of both. Below zero the user has the better one: the likelihood is rough there, and the
simulator's physics are not the model's.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from blind_trial import draw, make
from simulators import SIMULATORS

from twin.diagnosis import data_split
from twin.estimation import filter_memory, maximum_likelihood, multistart, optimizer, preparation
from twin.estimation.fit import Fit

DURATION = 30.0  # s
#: Memories of the filter with which a fit begins at the truth, s: the likelihood differs with the memory.
MEMORIES = (0.02, 0.05, 0.1)
#: Deviance from which on an optimum is lesser: less is the roughness of a likelihood with contacts.
LESSER = 10.0


@dataclass(frozen=True)
class Outcome:
    """What a user gets on one rig, and what a fit from the truth gives."""

    name: str
    found: Fit
    from_truth: Fit

    @property
    def lost(self) -> float:
        """Deviance of the first above that of the second."""
        return self.found.deviance - self.from_truth.deviance

    @property
    def text(self) -> str:
        """One line, values as found / from the truth."""
        values = (
            f"{n} {self.found.values[n]:.3g}/{self.from_truth.values[n]:.3g}"
            for n in multistart.MULTIMODAL
            if n in self.found.free
        )
        return f"{self.name}: {self.lost:.0f}  {', '.join(values)}"


def ask(simulator: str, seed: int, trial: int) -> Outcome:
    """One rig of a simulator, by seed and number."""
    rig = draw(seed, trial, ("none",), DURATION, simulator).rig
    label, _, recording = make(seed, trial, ("none",), DURATION, simulator)
    train, _ = data_split.split([recording])
    problem, found = maximum_likelihood.likeliest(train, preparation.base_structure())
    truth = preparation.complete_values(found.structure, rig.model_values())
    case = problem.recordings[0]
    noises = [found.process_noise, *(filter_memory.process_noise_of(case, m) for m in MEMORIES)]
    fits = [optimizer.fit_with_process_noise(problem.at(n), found.structure, truth, found.free) for n in noises]
    name = f"{simulator} {seed} {trial} {label.excitation}"
    return Outcome(name, found, min(fits, key=lambda p: p.deviance))


def summary(outcomes: Iterable[Outcome]) -> str:
    """How many end in a lesser optimum."""
    lost = [o.lost for o in outcomes]
    lesser = sum(one > LESSER for one in lost)
    return f"{lesser} of {len(lost)} rigs end in a lesser optimum, by a deviance of more than {LESSER:g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulator", choices=sorted(SIMULATORS), default="circuit")
    parser.add_argument("--rigs", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="number of the first rig")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    outcomes = []
    for trial in range(given.first, given.first + given.rigs):
        outcomes.append(ask(given.simulator, given.seed, trial))
        print(outcomes[-1].text, flush=True)
    print(summary(outcomes))


if __name__ == "__main__":
    main()
