"""How far the FMU's model exchange is from the model under solvers of FMPy, on 20 s of a recorded duty.

python scripts/exchange_study.py                          # CVode, and Euler with three steps
python scripts/exchange_study.py --solver Euler --step 1e-5

Prints the largest distance from the compiled kernel, which holds the command between stamps, in rad. The duty is given
as a table with a doubled row at each edge, as a table with one row a stamp, and as the latter to an FMU whose input is
held (`twin export --held-input`).
"""

from __future__ import annotations

import argparse
import csv
import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import fmpy
import numpy as np

from twin.effects.catalogue import BASE
from twin.fmi import native_fmu, python_fmu
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.simulation import kernel

RECORDED = Path(__file__).resolve().parents[1] / "models" / "shipped" / "recording.csv"
PERIOD = 0.002
SECONDS = 20.0
START = {"position_start": 0.3, "velocity_start": -1.0}
STRUCTURES = {
    # The duty reverses while the axis is about to break away.
    "friction": Structure.of(("inertia", "viscous_friction", "coulomb_friction")),
    # Two bodies, the second one pushed across a gap.
    "teeth": Structure.of((*BASE, "tooth_compliance", "coulomb_friction", "gravity")),
}
VALUES = {
    "input_gain": 1.2, "viscous_friction": 3.0, "dead_band_forward": 4.0, "dead_band_reverse": 3.0,
    "backlash_gap": 0.05, "coulomb_friction": 6.0, "gravity_gain": 9.0, "gravity_angle": 0.2,
}  # fmt: skip


def axis(name: str) -> Model:
    """One of the structures with its values."""
    structure = STRUCTURES[name]
    return Model(structure, {p.name: VALUES.get(p.name, p.start) for p in structure.parameters})


@contextmanager
def for_this_machine() -> Iterator[None]:
    """Native FMUs for one platform: all of them take five times as long."""
    with mock.patch.dict("sys.modules", {"ziglang": None}):
        yield


def recorded_duty() -> np.ndarray:
    """The first 20 s of the recording that ships with the project (N,), percent."""
    with RECORDED.open() as file:
        rows = list(csv.DictReader(file))
    return np.array([float(row["duty"]) for row in rows[: round(SECONDS / PERIOD) + 1]])


def table(duty: np.ndarray, doubled: bool) -> np.ndarray:
    """The duty as FMPy takes it: an edge is two rows of one time, or one row, which FMPy draws a line to."""
    rows = [(0.0, duty[0])]
    for i in range(1, len(duty)):
        if doubled and duty[i] != duty[i - 1]:
            rows.append((i * PERIOD, duty[i - 1]))
        if not doubled or duty[i] != duty[i - 1]:
            rows.append((i * PERIOD, duty[i]))
    rows.append((len(duty) * PERIOD, duty[-1]))
    return np.array(rows, dtype=[("time", float), ("duty", float)])


def by_kernel(model: Model, duty: np.ndarray, period: float = PERIOD) -> np.ndarray:
    """Positions of the model (N,) under a command that is held between stamps."""
    count = len(duty)
    drive = kernel.Drive(
        np.arange(count) * period, duty, np.full(count, math.nan), False, kernel.known_vector(model.known),
        np.zeros(5), model.longest_step,
    )  # fmt: skip
    start = kernel.start_state(START["position_start"], START["velocity_start"], 0.0)
    return kernel.predict(drive, kernel.vector(model.structure, dict(model.values)), start).reading


def largest_error(fmu: Path, truth: np.ndarray, given: np.ndarray, options: Mapping[str, object]) -> float:
    """Of FMPy's positions at the stamps against the truth there (N,), rad; `options` are those of `simulate_fmu`."""
    seconds = (len(truth) - 1) * PERIOD
    run = fmpy.simulate_fmu(
        str(fmu), fmi_type="ModelExchange", stop_time=seconds, input=given, output=["position"], start_values=START,
        **options,
    )  # fmt: skip
    at = np.round(run["time"] / PERIOD).astype(int)
    on = np.abs(run["time"] - at * PERIOD) < 1e-9
    if abs(run["time"][-1] - seconds) > 1e-6 or on.sum() < seconds / 0.02:
        raise RuntimeError(f"the run ended at {run['time'][-1]:.9g} s of {seconds:.9g} s")
    return float(np.max(np.abs(run["position"][on] - truth[at[on]])))


def settings(solver: str, steps: Sequence[float]) -> Iterator[tuple[str, dict[str, object]]]:
    """What a row is called, and FMPy's options for it."""
    if solver in ("CVode", "all"):
        for interval in (0.01, PERIOD):
            yield f"CVode, output {interval:g} s", {"solver": "CVode", "output_interval": interval,
                                                    "relative_tolerance": 1e-6}  # fmt: skip
    if solver in ("Euler", "all"):
        for h in steps:
            yield f"Euler, {h:g} s", {"solver": "Euler", "output_interval": h, "step_size": h}


def study(name: str, solver: str, steps: Sequence[float], folder: Path) -> None:
    """Print the rows of one structure."""
    model, duty = axis(name), recorded_duty()
    with for_this_machine():
        fmu = native_fmu.export_native(model, folder / f"{name}.fmu")
        held = native_fmu.export_native(model, folder / f"{name}_held.fmu")
    python_fmu.hold_input(held)
    truth = by_kernel(model, duty)
    for row, options in settings(solver, steps):
        begun = time.process_time()
        errors = [
            largest_error(fmu, truth, table(duty, True), options),
            largest_error(fmu, truth, table(duty, False), options),
            largest_error(held, truth, table(duty, False), options),
        ]
        spent = (time.process_time() - begun) / len(errors)
        print(f"{name:<10}{row:<24}" + "".join(f"{e:>12.2g}" for e in errors) + f"{spent:>10.1f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--solver", choices=("CVode", "Euler", "all"), default="all")
    parser.add_argument("--step", type=float, action="append", help="of Euler, s; may be given more than once")
    parser.add_argument("--structure", choices=tuple(STRUCTURES), action="append", help="default: both")
    given = parser.parse_args()
    print(f"{'axis':<10}{'solver':<24}{'doubled':>12}{'one row':>12}{'held':>12}{'processor':>12}")
    with tempfile.TemporaryDirectory() as folder:
        for name in given.structure or STRUCTURES:
            study(name, given.solver, given.step or (4e-4, 2e-4, 1e-4), Path(folder))


if __name__ == "__main__":
    main()
