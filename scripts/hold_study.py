"""Is a sensor that is read more slowly than it is logged found? Rigs of every simulator, written as logs.

    python scripts/hold_study.py --rigs 20

Every second rig of a simulator has a sensor that is read anew only every 5 to 50 ms, at moments that are none of the
log's. The log is written as a file and read as a user's would be, before any fit. The table holds how many of the slow
sensors were found, how far off their interval was, and how many of the others were called slow.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from excitations import EXCITATIONS, FREE
from gallery import COUNTS
from simulators import SIMULATORS

from twin.diagnosis import held_sensor
from twin.io import recording

SHORTEST, LONGEST = 0.005, 0.05  # s, between readings of a slow sensor


@dataclass(frozen=True)
class Held:
    """One rig: the interval of its sensor (s), 0 where each row is a reading, and the interval that was found."""

    simulator: str
    true: float
    found: float


def judge(simulator: str, number: int, seed: int = 1, duration: float = 20.0) -> Held:
    """One rig, all by simulator, seed and number; the odd ones have a slow sensor."""
    module = SIMULATORS[simulator]
    rng = np.random.default_rng([seed, number])
    rig = module.draw_rig(rng)
    time, duty = EXCITATIONS["rich"](duration, rng, FREE)
    run = module.simulate(rig, [], time, duty, int(rng.integers(2**31)))
    interval = float(np.exp(rng.uniform(math.log(SHORTEST), math.log(LONGEST)))) if number % 2 else 0.0
    counts = run.counts
    if interval:
        late = (time + rng.uniform(0.0, interval)) % interval
        counts = counts[np.searchsorted(time, time - late, "right").clip(1) - 1]
    with tempfile.TemporaryDirectory() as folder:
        log, told = Path(folder) / "log.csv", Path(folder) / "rig.toml"
        rows = np.column_stack([time, duty, counts])
        np.savetxt(log, rows, ("%.4f", "%.2f", "%d"), ",", header="t,duty,counts", comments="")
        told.write_text(COUNTS.format(counts=run.counts_per_revolution), encoding="utf-8")
        findings = held_sensor.finding(recording.load([log], told)[0])
    return Held(simulator, interval, findings[0].parameters["refresh"].value if findings else 0.0)


def table(seen: Sequence[Held]) -> str:
    """One line for each simulator."""
    lines = [
        f"{'simulator':10} {'slow':>5} {'found':>6} {'interval off, worst %':>22} {'others':>7} {'called slow':>12}"
    ]
    for name in dict.fromkeys(s.simulator for s in seen):
        own = [s for s in seen if s.simulator == name]
        slow, others = [s for s in own if s.true], [s for s in own if not s.true]
        found = [s for s in slow if s.found]
        off = max((abs(s.found / s.true - 1.0) for s in found), default=math.nan)
        alarms = sum(bool(s.found) for s in others)
        lines.append(f"{name:10} {len(slow):5} {len(found):6} {100.0 * off:22.2f} {len(others):7} {alarms:12}")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=20, help="of each simulator")
    parser.add_argument("--seed", type=int, default=1, help="draws everything")
    given = parser.parse_args(arguments)
    seen = []
    for name in SIMULATORS:
        for number in range(given.rigs):
            seen.append(judge(name, number, given.seed))
            print(f"{name} {number}: read every {seen[-1].true:.4f} s, said {seen[-1].found:.4f} s", flush=True)
    print(table(seen))


if __name__ == "__main__":
    main()
