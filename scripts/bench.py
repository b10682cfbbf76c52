"""How fast: the kernel against a C loop written by hand, a step of the FMU, and the commands from end to end.

python scripts/bench.py            # all of it
python scripts/bench.py kernel     # a part: kernel, fmu, identify or commands
python scripts/bench.py diagnose   # fresh rigs with one effect concealed, and with two; not among "all of it"
python scripts/bench.py fleet      # a fleet's axes with two workers against one; not among "all of it"
python scripts/bench.py long       # time and memory on recordings of up to an hour; not among "all of it"
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy loads, as the commands do

import argparse
import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
BASE_VALUES = {
    "input_gain": 0.3,
    "viscous_friction": 2.0,
    "dead_band_forward": 4.0,
    "dead_band_reverse": 5.0,
    "backlash_gap": 0.03,
    "motor_share": 0.25,
    "friction_share": 0.7,
}
SAMPLES = 30000
SHIPPED = ROOT / "models" / "shipped" / "recording.csv"


def best(work: Callable[[], object], repeats: int = 15) -> float:
    """Shortest of several runs, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def bare_loop(duty: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Seconds and positions of the loop written by hand; None without a C compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "bare_loop.so"
        source = Path(__file__).with_name("bare_loop.c")
        subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
        loop = ctypes.CDLL(str(library)).bare_loop
    numbers = ctypes.POINTER(ctypes.c_double)
    loop.argtypes = [numbers, numbers, ctypes.c_long, ctypes.c_double, numbers]
    position, p = np.empty(len(duty)), np.array(list(BASE_VALUES.values()))
    arguments = [a.ctypes.data_as(numbers) for a in (duty, position, p)]
    return best(lambda: loop(arguments[0], arguments[1], len(duty), 0.002, arguments[2])), position


def bench_kernel() -> None:
    """Print the kernel's times and their ratio to the bare loop."""
    start = time.perf_counter()
    from twin.model.stepper import BASE, Structure
    from twin.simulation import kernel

    rng = np.random.default_rng(0)
    duty = np.repeat(rng.uniform(-60.0, 60.0, SAMPLES // 500), 500)
    stamps, unseen = np.arange(SAMPLES) * 0.002, np.full(SAMPLES, np.nan)
    drive = kernel.Drive(stamps, duty, unseen, False, kernel.known_vector({}), np.zeros(5), 0.0020001)
    p = kernel.vector(Structure.of(BASE), BASE_VALUES)
    x, names = kernel.start_state(0.0, 0.0, 0.0), tuple(BASE_VALUES)
    tangents = kernel.fixed_start(names)
    position = kernel.predict(drive, p, x).reading
    kernel.predict_with_slopes(drive, p, x, tangents)
    print(f"first call, loading or compiling included: {time.perf_counter() - start:.1f} s")
    value = best(lambda: kernel.predict(drive, p, x))
    slopes = best(lambda: kernel.predict_with_slopes(drive, p, x, tangents))
    bare = bare_loop(duty)
    print(f"{SAMPLES} samples, base model, one core:")
    if bare is not None:
        seconds, by_hand = bare
        print(f"  bare C loop                 {1e3 * seconds:7.2f} ms")
        print(f"  kernel                      {1e3 * value:7.2f} ms   {value / seconds:5.2f} x")
        print(f"  kernel, {len(names)} exact slopes     {1e3 * slopes:7.2f} ms   {slopes / seconds:5.2f} x")
        print(f"  largest difference between kernel and bare loop: {np.abs(position - by_hand).max():.1e} rad")
    else:
        print(f"  kernel                      {1e3 * value:7.2f} ms")
        print(f"  kernel, {len(names)} exact slopes     {1e3 * slopes:7.2f} ms   (no C compiler to compare with)")


def bench_identify() -> None:
    """Print where the time of an identification goes: without what the shipped recording hides, and with it."""
    from twin.estimation import estimate, maximum_likelihood
    from twin.io.recording import load

    recordings, _ = load([SHIPPED], SHIPPED.with_name("rig.toml"))
    reading = best(lambda: load([SHIPPED], SHIPPED.with_name("rig.toml")), 3)
    print(f"reading and looking for faults, {len(recordings[0].time)} samples: {1e3 * reading:.0f} ms")
    estimate.compile_kernel(lambda sentence, share: None)
    bare = bare_loop(recordings[0].input)
    first = estimate.first_structure(recordings)
    for structure in (first, first.with_("motor_lag")):
        laps: list[tuple[str, float, float]] = []

        def lap(stage: str, share: float, laps: list[tuple[str, float, float]] = laps) -> None:
            laps.append((stage, time.perf_counter(), time.process_time()))

        maximum_likelihood.identify(recordings, structure, progress=lap)
        lap("in all", 1.0)
        print(f"identify, {len(recordings[0].time)} samples, {structure}:        s    CPU-s")
        ends = [*laps[1:], laps[-1]]
        for (stage, *begun), (_, *ended) in zip(laps, ends, strict=True):
            wall, cpu = (e - b for b, e in zip(laps[0][1:] if stage == "in all" else begun, ended, strict=True))
            ratio = f"   {cpu / bare[0]:.0f} x the bare C loop" if bare and stage == "in all" else ""
            print(f"  {stage:40} {wall:6.2f}   {cpu:6.2f}{ratio}")


def bench_diagnose(trials: int = 8, seconds: float = 60.0) -> None:
    """Print how long a diagnosis takes, stage by stage, of as many rigs of the second simulator as trials."""
    from blind_trial import START, make

    from twin.diagnosis import diagnose
    from twin.estimation import estimate, preparation
    from twin.simulation import kernel

    estimate.compile_kernel(lambda sentence, share: None)
    kernel.warm(preparation.base_structure().with_("unknown_time"))
    for kind in ("single", "pair"):
        walls = []
        for trial in range(trials):
            label, _, recording = make(83, trial, (kind,), seconds, "circuit")
            found = diagnose.diagnose([recording], START)
            walls.append(sum(found.seconds.values()))
            stages = ", ".join(f"{stage} {s:.1f}" for stage, s in found.seconds.items())
            hidden = " + ".join(e.id for e in label.effects)
            print(f"{hidden}, {label.excitation}: {walls[-1]:.1f} s ({stages})", flush=True)
        print(f"{kind}, {seconds:g} s at 2 ms: median {np.median(walls):.1f} s, longest {max(walls):.1f} s", flush=True)


def bench_commands() -> None:
    """Print how long the commands take on the recording that ships with the project."""
    rig = SHIPPED.with_name("rig.toml")
    with tempfile.TemporaryDirectory() as folder:
        for name, extra in (("identify", ["--out", f"{folder}/model.toml"]), ("run", ["--out", f"{folder}/out"])):
            command = [sys.executable, "-m", "twin.cli.main", name, str(SHIPPED), "--rig", str(rig), "--quiet", *extra]
            start = time.perf_counter()
            done = subprocess.run(command, check=False)
            state = "" if done.returncode == 0 else f" (exit {done.returncode})"
            print(f"twin {name}: {time.perf_counter() - start:.1f} s{state}")


def bench_fleet(axes: int = 6, seconds: float = 4.0) -> None:
    """Print how much sooner two processes are done with a fleet than one: 1 is twice as soon.

    Where other work keeps the cores busy, the clock says nothing. The processor time does: two workers waste what they
    take of it beyond one.
    """
    import resource

    from blind_trial import make

    from twin.batch.axis_run import Task, run_axis
    from twin.batch.execution import run_local
    from twin.io.manifest import read_fleet

    with tempfile.TemporaryDirectory() as name:
        folder, lines = Path(name), ["axis,file"]
        for trial in range(axes):
            _, _, made = make(84, trial, ("none",), seconds, "circuit")
            table = np.stack([made.time, made.input, made.output], axis=1)
            np.savetxt(folder / f"{trial}.csv", table, "%.9g", ",", header="t,duty,position", comments="")
            lines.append(f"axis{trial},{trial}.csv")
        (folder / "fleet.csv").write_text("\n".join(lines))
        walls, worked = [], []
        for processes in (1, 2):
            out = folder / f"by{processes}"
            out.mkdir()
            start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
            done = list(run_local(run_axis, [Task(a, out) for a in read_fleet(folder / "fleet.csv")], processes))
            walls.append(time.perf_counter() - start)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            worked.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
            failed = sum(getattr(outcome, "failed", True) for _, outcome in done)
            print(
                f"fleet of {axes} axes, {processes} at a time: {walls[-1]:.1f} s, {worked[-1]:.1f} s of processor, "
                f"{failed} failed",
                flush=True,
            )
    print(f"efficiency of two workers against one: {walls[0] / (2.0 * walls[1]):.2f} by the clock, "
          f"{worked[0] / worked[1]:.2f} by processor time, were both cores free")  # fmt: skip


if __name__ == "__main__":
    from fmu_cost import bench_fmu
    from long_recording import bench_long

    parts = {"kernel": bench_kernel, "fmu": bench_fmu, "identify": bench_identify, "commands": bench_commands}
    usual = tuple(parts)
    parts |= {"long": bench_long, "diagnose": bench_diagnose, "fleet": bench_fleet}
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    usual_ones = f"{', '.join(parts)}; all but the last three unless given"
    parser.add_argument("part", nargs="*", metavar="PART", help=usual_ones)
    given = parser.parse_args().part
    if unknown := [part for part in given if part not in parts]:
        parser.error(f"there is no part {unknown[0]!r}: choose from {', '.join(parts)}")
    for part in given or usual:
        parts[part]()
