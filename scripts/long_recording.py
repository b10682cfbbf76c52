"""Time and memory that a command takes on recordings of up to an hour at 2 ms, made with the model's own kernel.

python scripts/long_recording.py                 # twin identify on 4, 15 and 60 minutes
python scripts/long_recording.py --minutes 60 --command diagnose
python scripts/long_recording.py --runs 104 --seconds 2      # many short recordings together
python scripts/long_recording.py --runs 288 --seconds 300    # a day
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.effects.catalogue import BASE
from twin.model import fitted_model
from twin.model.stepper import Structure
from twin.simulation import kernel

PERIOD = 0.002
COUNTS = 10000  # per revolution, as the rig file says
VALUES = {
    "input_gain": 0.3, "viscous_friction": 2.0, "dead_band_forward": 4.0, "dead_band_reverse": 5.0,
    "backlash_gap": 0.03, "motor_share": 0.25, "friction_share": 0.7, "tooth_frequency": 90.0, "tooth_damping": 0.3,
}  # fmt: skip
RIG = Path(__file__).resolve().parents[1] / "models" / "shipped" / "rig.toml"


def record(folder: Path, minutes: float, seed: int = 0) -> Path:
    """A recording of steps under a noisy drive, for the shipped rig file."""
    rng = np.random.default_rng(seed)
    count = int(60.0 * minutes / PERIOD)
    structure = Structure.of([*BASE, "tooth_compliance"])
    duty = np.round(np.repeat(rng.uniform(-40.0, 40.0, count // 500 + 1), 500)[:count], 2)
    drive = kernel.Drive(
        PERIOD * np.arange(count), duty + 0.3 * rng.standard_normal(count), np.full(count, np.nan), False,
        kernel.known_vector({}), np.zeros(5), PERIOD / structure.substeps * 1.000001,
    )  # fmt: skip
    start = kernel.start_state(0.0, 0.0, 0.0)
    position = kernel.predict(drive, kernel.vector(structure, VALUES), start).reading
    path = folder / f"recording{seed}.csv"
    with path.open("w", encoding="utf-8") as out:
        out.write("t,duty,counts\n")
        counts = np.round(position * COUNTS / (2.0 * np.pi)).astype(int)
        for t, u, y in zip(drive.time.tolist(), duty.tolist(), counts.tolist(), strict=True):
            out.write(f"{t:.3f},{u},{y}\n")
    return path


def measure(name: str, paths: Sequence[Path], label: str) -> None:
    """Run a command as a child; print processor time, peak memory and the parameter that is furthest off."""
    folder = paths[0].parent
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    code = (
        "import resource, sys; from twin.cli.main import main; done = main(sys.argv[1:]); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024); sys.exit(done)"
    )
    command = [sys.executable, "-c", code, name, *map(str, paths), "--rig", str(RIG)]
    command += ["--out", f"{folder}/model.toml", "--quiet"]
    done = subprocess.run(command, env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"twin {name} ended with {done.returncode}: {done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    found = fitted_model.read(folder / "model.toml")
    missed = {n: found.values[n] - v for n, v in VALUES.items() if n in found.values}
    errors = {n: abs(e) / found.std(n) for n, e in missed.items()}
    worst = max(errors, key=lambda n: errors[n])
    seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    print(
        f"twin {name}, {label}: {seconds:6.0f} s of processor, peak memory {done.stdout.split()[-1]:>5} MB; "
        f"furthest from its truth: {worst}, {100.0 * missed[worst] / VALUES[worst]:.2g} %, "
        f"{errors[worst]:.2g} standard errors",
        flush=True,
    )


def bench_long(minutes: Sequence[float] = (4.0, 15.0, 60.0), name: str = "identify") -> None:
    """One recording of each length."""
    for length in minutes:
        with tempfile.TemporaryDirectory() as folder:
            path = record(Path(folder), length)
            measure(name, [path], f"{length:3.0f} min, {int(60.0 * length / PERIOD):8d} samples")


def bench_many(runs: int, seconds: float, name: str = "identify") -> None:
    """So many recordings of so many seconds, fitted together."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [record(Path(folder), seconds / 60.0, seed) for seed in range(runs)]
        measure(name, paths, f"{runs} recordings of {seconds:g} s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, action="append", help="may be given more than once")
    parser.add_argument("--runs", type=int, help="so many recordings together, of --seconds each")
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--command", choices=("identify", "diagnose"), default="identify")
    given = parser.parse_args()
    if given.runs:
        bench_many(given.runs, given.seconds, given.command)
    else:
        bench_long(given.minutes or (4.0, 15.0, 60.0), given.command)
