"""Make the recording that ships with the project: the base rig and one more effect, both drawn by the seed.

    python scripts/make_recording.py --out models/shipped

writes recording.csv and rig.toml (the shipped one), which the tool reads, and truth.json, which it does not.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from concealed import Concealed
from excitations import FREE, rich
from mujoco_rig import Rig, Simulated, draw_effect, draw_rig, simulate

CANDIDATES = ("coulomb_friction", "gravity", "motor_lag", "torque_ripple")
RIG_FILE = Path(__file__).resolve().parents[1] / "models" / "shipped" / "rig.toml"
COUNTS = 10000  # per revolution, as it says there


def make(seed: int, duration: float = 60.0) -> tuple[Rig, Concealed, Simulated]:
    """Everything that is not fixed above comes from the seed, the effect's name included."""
    rng = np.random.default_rng(seed)
    rig = replace(draw_rig(rng), counts_per_revolution=COUNTS)
    name = str(rng.choice(CANDIDATES))
    effect = draw_effect(rng, name, rig, float(rng.uniform(0.1, 0.25)), duration)
    time, duty = rich(duration, rng, FREE)
    return rig, effect, simulate(rig, [effect], time, np.round(duty, 1), seed)


def write(out: Path, seed: int) -> None:
    """The three files into the folder `out`."""
    rig, effect, run = make(seed)
    out.mkdir(parents=True, exist_ok=True)
    rows = zip(run.time.tolist(), run.duty.tolist(), run.counts.tolist(), strict=True)
    lines = [f"{t:.3f},{duty:g},{counts}\n" for t, duty, counts in rows]
    (out / "recording.csv").write_text("t,duty,counts\n" + "".join(lines), encoding="utf-8", newline="\n")
    (out / "rig.toml").write_bytes(RIG_FILE.read_bytes())
    truth = {
        "seed": seed,
        "excitation": "rich",
        "rig": rig.truths(),
        "effects": [{"id": effect.id, "parameters": effect.parameters}],
        "units": "accelerations in rad/s^2, duty in percent, angles in rad, times in s",
    }
    (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8", newline="\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for the three files")
    parser.add_argument("--seed", type=int, default=1, help="draws the rig, the effect and the noise")
    given = parser.parse_args()
    write(given.out, given.seed)


if __name__ == "__main__":
    main()
