"""Six recordings of simulated axes, and the report that twin writes of each: one of each kind of answer.

The recordings come from `textbook_rig`, which shares nothing with the model. Each lies beside its report, with its rig
file, so that every answer of the gallery can be asked for again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import textbook_rig
from concealed import Concealed
from numpy.typing import NDArray

import twin
from twin.io.files import put

Array = NDArray[np.float64]

COUNTS = """[time]
column = "t"
[input]
column = "duty"
unit = "%"
[output]
column = "counts"
unit = "count"
counts_per_revolution = {counts}
"""
SPEED = """[time]
column = "t"
[input]
column = "duty"
unit = "%"
[output]
column = "speed"
unit = "rpm"
"""


@dataclass(frozen=True)
class Case:
    """One report: what was concealed, how the axis was driven, and what was done to the log."""

    effect: str  # "" is nothing
    size: float  # its torque over that of the drive at half duty
    amplitude: float  # %, of the largest command
    spoil: Callable[[Array], Array] = lambda counts: counts


def _spoiled(counts: Array) -> Array:
    """A freeze of 0.6 s, three wild readings and 0.2 s without any."""
    out = counts.copy()
    out[4000:4300] = out[4000]
    out[[1500, 6000, 9000]] += 3000
    out[7000:7100] = np.nan
    return out


CASES = {
    "explained": Case("gravity", 0.4, 60.0),
    "nothing": Case("", 0.0, 60.0),
    "cannot-tell": Case("input_delay", 0.05, 60.0),
    "unknown": Case("other_cubic_drag", 0.6, 90.0),
    "faults": Case("coulomb_friction", 0.2, 60.0, _spoiled),
    "speed-only": Case("quadratic_drag", 0.4, 80.0),
}


def command(time: Array, amplitude: float, seed: int) -> Array:
    """Levels drawn at random, each held for half a second, a quarter of them rest."""
    rng = np.random.default_rng(seed)
    levels = rng.uniform(-amplitude, amplitude, int(time[-1] / 0.5) + 2)
    levels[rng.random(len(levels)) < 0.25] = 0.0
    return np.asarray(levels[(time / 0.5).astype(int)])


def record(name: str, folder: Path, seconds: float) -> Path:
    """Write the recording of one case and its rig file into a folder; returns the log."""
    case = CASES[name]
    seed = sorted(CASES).index(name)
    rng = np.random.default_rng([71, seed])
    rig = textbook_rig.draw_rig(rng)
    effects: list[Concealed] = []
    if case.effect:
        effects.append(textbook_rig.draw_effect(rng, case.effect, rig, case.size, seconds))
    time = 0.002 * np.arange(round(seconds / 0.002))
    run = textbook_rig.simulate(rig, effects, time, command(time, case.amplitude, seed), seed)
    folder.mkdir(parents=True, exist_ok=True)
    if name == "speed-only":
        # A tachometer of 12 bits over 300 rpm.
        read = np.round(run.velocity * 60.0 / (2.0 * np.pi) / 0.15) * 0.15
        column, told = "speed", SPEED
    else:
        read, column, told = case.spoil(run.counts.astype(float)), "counts", COUNTS
    rows = zip(time, run.duty, read, strict=True)
    body = "".join(f"{t:.3f},{u:.4g},{'' if np.isnan(y) else f'{y:.6g}'}\n" for t, u, y in rows)
    put(folder / "rig.toml", told.format(counts=run.counts_per_revolution))
    put(folder / "log.csv", f"t,duty,{column}\n{body}")
    return folder / "log.csv"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/gallery"))
    parser.add_argument("--seconds", type=float, default=30.0, help="of each recording")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    args = parser.parse_args()
    for name in args.only:
        log = record(name, args.out / name, args.seconds)
        found = twin.diagnose(twin.load(log))
        twin.write_report(found, args.out / name / "report.html", force=True)
        names = ", ".join(f"{f.id} {f.probability:.2f}" for f in found.findings) or "no name"
        print(f"{name}: concealed {CASES[name].effect or 'nothing'}; {found.verdict}, {names}", flush=True)


if __name__ == "__main__":
    main()
