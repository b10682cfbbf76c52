"""The same fit by twin and by ModestPy, a calibration tool for any FMU, on the FMU that twin exports: time and error.

    python scripts/modestpy_comparison.py --python VENV/bin/python [--samples 15001]

ModestPy needs an environment of its own, because it runs only with old versions of what it stands on:

    pip install modestpy pandas==1.5.3 numpy==1.26.4 fmpy==0.3.20

Three parameters of an axis with dry friction, from a free run over a recording without noise. ModestPy uses the
fastest of its methods (L-BFGS-B through scipy); both start from the same values. Times are of the processor.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from twin.estimation import optimizer, prepared_recording
from twin.estimation.problem import FitProblem
from twin.fmi import native_fmu
from twin.io.recording import Recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.simulation import kernel

STRUCTURE = Structure.of(["inertia", "viscous_friction", "coulomb_friction"])
TRUTH = {"input_gain": 0.4, "viscous_friction": 1.5, "coulomb_friction": 1.0}
BEGIN = {"input_gain": 0.3, "viscous_friction": 2.0, "coulomb_friction": 0.5}
BOUNDS = {"input_gain": (0.1, 1.0), "viscous_friction": (0.3, 5.0), "coulomb_friction": (0.0, 4.0)}
PERIOD = 0.002

#: What the other environment runs: folder, start values and bounds in; estimates, seconds and simulations out.
THEIRS = """
import json, os, sys, time
folder, begin, bounds = sys.argv[1], json.loads(sys.argv[2]), json.loads(sys.argv[3])
import pandas
from modestpy import Estimation
data = pandas.read_csv(os.path.join(folder, "recording.csv")).set_index("time")
started = time.process_time()
session = Estimation(
    folder, os.path.join(folder, "axis.fmu"), data[["duty"]], {}, {n: (begin[n], *bounds[n]) for n in begin},
    data[["position"]], methods=("SCIPY",), scipy_opts={"solver": "L-BFGS-B"}, ftype="RMSE", default_log=False,
)
found = session.estimate()
print(json.dumps({"seconds": time.process_time() - started, "values": {n: float(found[n]) for n in begin}}))
"""


def made(samples: int) -> Recording:
    rng = np.random.default_rng(0)
    stamps = PERIOD * np.arange(samples)
    duty = np.repeat(rng.uniform(-40.0, 40.0, samples // 500 + 1), 500)[:samples]
    nothing = np.full(samples, np.nan)
    drive = kernel.Drive(stamps, duty, nothing, False, kernel.known_vector({}), np.zeros(5), 1.000001 * PERIOD)
    start = kernel.start_state(0.0, 0.0, 0.0)
    position = kernel.predict(drive, kernel.vector(STRUCTURE, TRUTH), start).reading
    return Recording("made", stamps, duty, position, "%", "rad")


def ours(recording: Recording) -> tuple[dict[str, float], float]:
    """Estimates and seconds, warm."""
    case = prepared_recording.prepare_recording(recording, STRUCTURE)
    fits, seconds = [], []
    for _ in range(4):
        begun = time.process_time()
        fits.append(
            optimizer.levenberg_marquardt(
                FitProblem([case], process_noise=0.0), STRUCTURE, BEGIN, tuple(TRUTH), rounds=100, tolerance=1e-9
            )
        )
        seconds.append(time.process_time() - begun)
    return fits[-1].values, min(seconds[1:])


def theirs(recording: Recording, python: str) -> tuple[dict[str, float], float]:
    """Estimates and seconds by ModestPy, or the end of the program where it is missing or fails."""
    has = subprocess.run([python, "-c", "import modestpy"], capture_output=True, check=False)
    if has.returncode:
        sys.exit(f"ModestPy is not installed for {python}: see {Path(__file__).name}, and give --python")
    with tempfile.TemporaryDirectory() as folder:
        native_fmu.export_native(Model(STRUCTURE, BEGIN, sample_time=PERIOD), Path(folder) / "axis.fmu", 2)
        rows = zip(recording.time.tolist(), recording.input.tolist(), recording.output.tolist(), strict=True)
        lines = ["time,duty,position", *(f"{t:.6f},{u!r},{y!r}" for t, u, y in rows)]
        (Path(folder) / "recording.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        command = [python, "-c", THEIRS, folder, json.dumps(BEGIN), json.dumps(BOUNDS)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    if done.returncode:
        sys.exit(f"ModestPy failed: {done.stderr.strip().splitlines()[-1]}")
    answer = json.loads(done.stdout.strip().splitlines()[-1])
    return answer["values"], answer["seconds"]


def error(values: Mapping[str, float]) -> float:
    """The largest relative error of a parameter."""
    return max(abs(values[n] / true - 1.0) for n, true in TRUTH.items())


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--python", default=sys.executable, help="of the environment that has ModestPy")
    parser.add_argument("--samples", type=int, default=15001)
    given = parser.parse_args(arguments)
    recording = made(given.samples)
    own, own_seconds = ours(recording)
    other, other_seconds = theirs(recording, given.python)
    print(f"{given.samples} samples, {len(TRUTH)} parameters, free run, largest relative error:")
    print(f"  twin      {own_seconds:9.3f} s   {error(own):.1e}")
    print(f"  ModestPy  {other_seconds:9.3f} s   {error(other):.1e}")
    print(f"  ratio     {other_seconds / own_seconds:9.0f}")


if __name__ == "__main__":
    main()
