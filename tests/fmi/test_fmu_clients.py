"""The native FMU in other people's programs. Each client runs in a process of its own: some end in a crash."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary
from native_axis import PERIOD, RIGID, by_kernel, command, model_of

from twin.fmi.ssp import write_ssp
from twin.model.stepper import Structure

STEPS = 512


def needs(module: str) -> pytest.MarkDecorator:
    absent = importlib.util.find_spec(module) is None
    return pytest.mark.skipif(absent, reason=f"the client {module} is not installed")


@pytest.fixture(scope="module")
def fmus(native_fmu_of: Callable[[Structure, int], Path]) -> dict[int, Path]:
    return {fmi: native_fmu_of(RIGID, fmi) for fmi in (2, 3)}


def expected() -> np.ndarray:
    return by_kernel(model_of(RIGID), command(STEPS + 1), 0.0, 0.0)[1:, :3]


def answer(script: str, *arguments: object) -> np.ndarray:
    """What a script prints as a table in JSON; the clients' own log stands around it."""
    told = [str(a) for a in arguments]
    done = subprocess.run([sys.executable, "-c", script, *told], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return np.array(json.loads(next(line for line in done.stdout.splitlines() if line.startswith("[["))))


def agree(got: np.ndarray, wanted: np.ndarray) -> bool:
    return bool(np.max(np.abs(got - wanted) / np.max(np.abs(wanted), axis=0)) < 1e-10)


COSIM = """
import json, sys
from fmpy import read_model_description
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
fmu, period, commands = sys.argv[1], float(sys.argv[2]), json.loads(sys.argv[3])
reference = {v.name: v.valueReference for v in read_model_description(fmu).modelVariables}
run = CosimExecution.from_step_size(round(period * 1e9))
axis = run.add_local_slave(CosimLocalSlave(fmu_path=fmu, instance_name="axis"))
hand, eye = CosimManipulator.create_override(), CosimObserver.create_last_value()
run.add_manipulator(hand)
run.add_observer(eye)
rows = []
for u in commands:
    hand.slave_real_values(axis, [reference["duty"]], [u])
    run.step(1)
    rows.append(eye.last_real_values(axis, [reference[n] for n in ("position", "velocity", "position_measured")]))
print(json.dumps(rows))
"""

ECOS = """
import json, sys
from ecospy import EcosSimulation, EcosSimulationStructure
fmu, period, commands = sys.argv[1], float(sys.argv[2]), json.loads(sys.argv[3])
rows = []
with EcosSimulationStructure() as structure:
    structure.add_model("axis", fmu)
    with EcosSimulation(structure=structure, step_size=period) as run:
        run.init()
        for u in commands:
            run.set_real("axis::duty", u)
            run.step(1)
            rows.append([run.get_real(f"axis::{n}") for n in ("position", "velocity", "position_measured")])
print(json.dumps(rows))
"""


@needs("libcosimpy")
def test_libcosim(fmus: dict[int, Path]) -> None:
    got = answer(COSIM, fmus[2], PERIOD, command(STEPS + 1)[:-1].tolist())
    assert agree(got, expected())


@needs("ecospy")
@pytest.mark.parametrize("fmi", [2, 3])
def test_ecos(fmus: dict[int, Path], fmi: int) -> None:
    got = answer(ECOS, fmus[fmi], PERIOD, command(STEPS + 1)[:-1].tolist())
    assert agree(got, expected())


@needs("ecospy")
def test_ecos_program_runs_the_system_without_python(fmus: dict[int, Path], tmp_path: Path) -> None:
    """The parameter set of the .ssp counts, not the start values inside the FMU."""
    model = model_of(RIGID, gravity_gain=40.0, coulomb_friction=1.0)
    write_ssp(tmp_path / "axis.ssp", fmus[2], None, model)
    spec = importlib.util.find_spec("ecospy")
    assert spec is not None and spec.origin is not None
    program = shutil.copy(Path(spec.origin).parent / "binaries" / "ecos", tmp_path / "ecos")
    Path(program).chmod(0o755)
    wanted = ["--path", "axis.ssp", "--stopTime", "1", "--parameterSet", "identified", "--stepSize"]
    done = subprocess.run([program, "simulate", *wanted, repr(PERIOD)], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (table,) = tmp_path.glob("*.csv")
    names = [n.strip() for n in table.read_text().splitlines()[0].split(",")]
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    column = next(i for i, n in enumerate(names) if n.startswith("axis::position["))
    truth = by_kernel(model, np.zeros(len(rows)), 0.0, 0.0)[:, 0]
    assert np.ptp(truth) > 0.05, "gravity must move it"
    assert np.max(np.abs(rows[:, column] - truth)) < 2e-6  # the table has six decimals


@needs("fmu_manipulation_toolbox")
@pytest.mark.parametrize("fmi", [2, 3])
def test_fmutool_finds_it_compliant(fmus: dict[int, Path], fmi: int) -> None:
    script = "import sys; from fmu_manipulation_toolbox.cli.fmutool import fmutool; fmutool()"
    told = ["-input", str(fmus[fmi]), "-check"]
    done = subprocess.run([sys.executable, "-c", script, *told], capture_output=True, text=True)
    assert done.returncode == 0
    said = done.stdout + done.stderr
    assert f"compliant with FMI-{fmi}.0" in said and f"No semantic error against the FMI-{fmi}" in said, said


@needs("fmu_manipulation_toolbox")
def test_runs_inside_a_container(fmus: dict[int, Path], tmp_path: Path) -> None:
    shutil.copy(fmus[2], tmp_path / "axis.fmu")
    (tmp_path / "both.csv").write_text("rule;from_fmu;from_port;to_fmu;to_port\nFMU;axis.fmu;;;\n")
    script = "import sys; from fmu_manipulation_toolbox.cli.fmucontainer import fmucontainer; fmucontainer()"
    told = ["-fmu-directory", ".", "-container", f"both.csv:{PERIOD!r}"]
    subprocess.run([sys.executable, "-c", script, *told], cwd=tmp_path, check=True, capture_output=True)
    held = np.array([(0.0, 60.0), (1.0, 60.0)], dtype=[("time", float), ("duty", float)])
    got = fmpy.simulate_fmu(str(tmp_path / "both.fmu"), stop_time=1.0, output_interval=PERIOD, input=held)
    truth = by_kernel(model_of(RIGID), np.full(STEPS + 1, 60.0), 0.0, 0.0)
    assert np.allclose(got["position"][1:], truth[1:, 0], rtol=1e-9, atol=1e-9)


@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
@pytest.mark.parametrize("fmi", [2, 3])
def test_its_sources_build_as_described(fmus: dict[int, Path], tmp_path: Path, fmi: int) -> None:
    folder = tmp_path / "x"
    with zipfile.ZipFile(fmus[fmi]) as archive:
        archive.extractall(folder)
    shutil.rmtree(folder / "binaries")
    build_platform_binary(folder)
    u = np.array([(0.0, 60.0), (1.0, 60.0)], dtype=[("time", float), ("duty", float)])
    runs = [fmpy.simulate_fmu(str(f), stop_time=1.0, output_interval=PERIOD, input=u) for f in (folder, fmus[fmi])]
    assert np.allclose(runs[0]["position"], runs[1]["position"], rtol=1e-12)
    assert np.ptp(runs[0]["position"]) > 0.1
