"""Effects that mask each other: is the concealed one named, and its mask not?

    python scripts/masked_pairs.py
    python scripts/masked_pairs.py --cases end_stop motor_lag

The recordings are MuJoCo's, which shares no code with the model. All come from one drawn rig and from the protocol that
was made to separate what others mix up. Every effect of `SIZE` changes at least ten times as much as noise does.
Dead-band and backlash are in every model from the start, so the answer to a wide dead-band is that nothing is missing.
The table holds one line a case: what was concealed, what was named, and whether that is right. Exit code 1 where one is
not. All cases take some quarter of an hour on one core.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from excitations import rich
from mujoco_rig import TURN, draw_effect, draw_rig, simulate

from twin.diagnosis import diagnose
from twin.diagnosis.result import Diagnosis
from twin.effects.catalogue import BASE, CANDIDATES
from twin.io.recording import Recording
from twin.model.stepper import Structure

SEED, SECONDS, SIZE = 3, 20.0, 0.15
DEAD_BANDS = (14.0, 12.0)  # forward and backward, % of full drive, where a wide dead-band is concealed
LIKELY = 0.9  # the least probability of the effect that is there
MASKS = (
    ("dead_band", "coulomb_friction"),
    ("motor_lag", "input_delay", "joint_elasticity"),
    ("quadratic_drag", "thermal_fade", "drive_saturation"),
    ("spring", "end_stop"),
    ("torque_ripple", "encoder_eccentricity"),
    ("load_change", "thermal_fade"),
)
SINGLE = tuple(dict.fromkeys(i for group in MASKS for i in group))
#: What is concealed in each case: every effect by itself, and pairs that have to be named, or fitted, together.
CASES = (*((effect,) for effect in SINGLE), ("quadratic_drag", "drive_saturation"), ("coulomb_friction", "dead_band"))


@dataclass(frozen=True)
class Answer:
    """What the tool said of one case."""

    concealed: tuple[str, ...]
    named: tuple[tuple[str, float], ...]  # effects and their probabilities, the likeliest first
    undecided: frozenset[str]  # effects that it could not tell from another
    verdict: str
    dead_bands: tuple[float, float]  # forward and backward, % of full drive

    @property
    def right(self) -> bool:
        """Whether what is there is named, and no mask of it."""
        ids = [i for i, _ in self.named]
        wide = "dead_band" in self.concealed
        if wide and not np.allclose(self.dead_bands, DEAD_BANDS, atol=0.5):
            return False
        if self.concealed == ("dead_band",):
            return self.verdict == "nothing_missing" and not ids
        there = [i for i in self.concealed if i != "dead_band"]
        if len(there) > 1:
            return set(ids) == set(there)
        masks = {i for group in MASKS if there[0] in group for i in group} - set(self.concealed)
        return ids[:1] == there and self.named[0][1] > LIKELY and not masks & {*ids, *self.undecided}


def record(concealed: Sequence[str]) -> Recording:
    """A recording of the rig with these effects."""
    rng = np.random.default_rng(SEED)
    rig = draw_rig(rng)
    if "dead_band" in concealed:
        rig = replace(rig, dead_band_forward=DEAD_BANDS[0], dead_band_backward=DEAD_BANDS[1])
    drawn = [draw_effect(rng, i, rig, SIZE, SECONDS) for i in concealed if i != "dead_band"]
    run = simulate(rig, drawn, *rich(SECONDS, rng), SEED)
    count = TURN / rig.counts_per_revolution
    return Recording("masked", run.time, run.duty, run.counts * count, "%", "rad", count)


def ask(concealed: Sequence[str], candidates: Sequence[str] = CANDIDATES) -> tuple[Answer, Diagnosis]:
    """What the tool says of the rig with these effects, from the base model and with these candidates."""
    found = diagnose.diagnose([record(concealed)], Structure.of(BASE), candidates=candidates)
    values = found.after.values
    answer = Answer(
        tuple(concealed),
        tuple((f.id, f.probability) for f in found.findings),
        frozenset(i for pair in found.undecided for i in pair.ids),
        found.verdict,
        (values.get("dead_band_forward", 0.0), values.get("dead_band_reverse", 0.0)),
    )
    return answer, found


def line(answer: Answer) -> str:
    """One line of the table."""
    named = ", ".join(f"{i} {p:.2f}" for i, p in answer.named) or "nothing"
    return f"{' + '.join(answer.concealed):34} {named:44} {'right' if answer.right else 'WRONG'}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Ask, print a line a case. Returns 1 where an answer is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", metavar="EFFECT", choices=SINGLE, help="those with this effect")
    args = parser.parse_args(arguments)
    chosen = [c for c in CASES if args.cases is None or set(c) & set(args.cases)]
    print(f"{'concealed':34} {'named, with its probability':44} answer")
    answers = []
    for concealed in chosen:
        answers.append(ask(concealed)[0])
        print(line(answers[-1]), flush=True)
    print(f"{sum(a.right for a in answers)} of {len(answers)} right")
    return 0 if all(a.right for a in answers) else 1


if __name__ == "__main__":
    sys.exit(main())
