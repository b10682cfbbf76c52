"""One axis with every effect on, a command that takes it through all of them, and what the kernel makes of it."""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from twin.effects.catalogue import UNKNOWN
from twin.model import stepper
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.simulation import kernel

VALUES = {
    "input_gain": 1.2,
    "viscous_friction": 3.0,
    "fade": 0.3,
    "fade_time": 5.0,
    "supply_sag": 0.002,
    "saturation_limit": 70.0,
    "dead_band_forward": 4.0,
    "dead_band_reverse": 3.0,
    "backlash_gap": 0.05,
    "own_inertia": 0.01,
    "coulomb_friction": 6.0,
    "stribeck_friction": 4.0,
    "friction_asymmetry": 0.7,
    "friction_variation": 1.5,
    "load_friction": 0.1,
    "offset": 0.8,
    "quadratic_drag": 0.05,
    "gravity_gain": 9.0,
    "gravity_angle": 0.2,
    "spring_stiffness": 1.5,
    "ripple_torque": 1.1,
    # A push that sets in at once, as that of damping does, is where solvers without state events go apart.
    "stop_damping": 0.0,
    "stop_hysteresis": 0.5,
    "stop_upper": 6.0,
    "stop_lower": -6.0,
    "joint_frequency": 12.0,
    "lag_time": 0.01,
    "lag_dead_band": 0.5,
    "delay": 2.0**-8,
    "load_added": 0.4,
    "load_time": 9.0,
    "eccentricity": 0.02,
    "disturbance": 1.0,
    "disturbance_frequency": 0.7,
    "flexible_load_share": 0.1,
}
#: Every effect that has a name, and a curve of each kind: knots and waves. The other curves are the same text over
#: other variables, which takes a compiler with sanitizers minutes.
EVERYTHING = stepper.EVERYTHING.without(*set(UNKNOWN) - {"unknown_position", "unknown_angle"})
#: With compliance there is no rigid contact, without it there is: both are needed to have every effect on.
RIGID = EVERYTHING.without("joint_elasticity", "tooth_compliance")
NAMES = ("position", "velocity", "position_measured", "gap", "motor_velocity", "lag", "heat", "bend", "ride",
         "ride_velocity")  # fmt: skip
COLUMNS = (0, 1, None, 2, 3, 4, 5, 6, 7, 8)
#: Exact in binary, so that stamps, spans and edges of the delay carry no rounding for the motion to amplify.
PERIOD = 2.0**-9


@contextmanager
def without_zig() -> Iterator[None]:
    """Native FMUs are made for this machine alone: one platform takes a fifth of the time of all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "ziglang", None)
        yield


def model_of(structure: Structure, **values: float) -> Model:
    chosen = {p.name: VALUES.get(p.name, p.start) for p in structure.parameters}
    return Model(structure, chosen | values, known={"payload": 0.004, "moment": 0.005})


def command(count: int, held: int = 1) -> np.ndarray:
    """Steps, sines and rests, so that the axis sticks, slips and crosses its gap."""
    t = np.arange(count) * PERIOD
    u = 60.0 * np.sin(1.3 * t) + 35.0 * np.sign(np.sin(7.1 * t)) * (np.sin(0.9 * t) > -0.3)
    u[np.sin(0.5 * t) > 0.8] = 0.0
    return np.repeat(u[::held], held)[:count]


def by_kernel(model: Model, u: np.ndarray, position: float, velocity: float, period: float = PERIOD) -> np.ndarray:
    """Position, velocity, reading and hidden states (N, states) from a free run of the compiled kernel."""
    count = len(u)
    drive = kernel.Drive(
        np.arange(count) * period, u, np.full(count, math.nan), False, kernel.known_vector(model.known),
        np.zeros(5), model.longest_step,
    )  # fmt: skip
    p = kernel.vector(model.structure, dict(model.values))
    x = kernel.start_state(position, velocity, 0.0)
    run = kernel.predict(drive, p, x, keep_states=True)
    return np.column_stack([run.reading if c is None else run.states[:, c] for c in COLUMNS])


def abuse(folder: Path, fmi: int) -> subprocess.CompletedProcess[str]:
    """What comes of calling the exported sources in a folder as no importer should, built with sanitizers."""
    flags = ["-std=c99", "-g", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-DFMI={fmi}", "-I."]
    flags += ["-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    source = Path(__file__).parent / "native" / "abuse.c"
    subprocess.run(["gcc", *flags, "-o", "abuse", str(source), "-lm"], cwd=folder, check=True)
    (folder / "misread").mkdir()
    return subprocess.run(["./abuse", folder.as_uri()], cwd=folder, capture_output=True, text=True)


def has_thread_sanitizer(folder: Path) -> bool:
    """Whether the local compiler builds with the thread sanitizer, and what it builds runs here."""
    if shutil.which("gcc") is None:
        return False
    (folder / "nothing.c").write_text("int main(void) { return 0; }\n")
    built = subprocess.run(["gcc", "-fsanitize=thread", "-o", "nothing", "nothing.c"], cwd=folder, capture_output=True)
    return built.returncode == 0 and subprocess.run(["./nothing"], cwd=folder, capture_output=True).returncode == 0


def in_two_threads(folder: Path, fmi: int) -> subprocess.CompletedProcess[str]:
    """What comes of stepping two instances of the exported sources in a folder in two threads, under the sanitizer."""
    flags = ["-std=c99", "-g", "-O1", "-Wall", "-Wextra", "-Werror", f"-DFMI={fmi}", "-I.", "-fsanitize=thread"]
    source = Path(__file__).parent / "native" / "threads.c"
    subprocess.run(["gcc", *flags, "-o", "threads", str(source), "-pthread", "-lm"], cwd=folder, check=True)
    return subprocess.run(["./threads", folder.as_uri()], cwd=folder, capture_output=True, text=True)
