"""Parameter sets and systems: valid by the standard's schema, and run by clients that read them."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy.ssp.ssd import read_ssd, read_ssv
from native_axis import RIGID, model_of

from twin.errors import BadInput
from twin.fmi import python_fmu
from twin.fmi.ssp import write_ssp, write_ssv
from twin.model.stepper import Structure
from twin.model.variables import variables

CONTROLLER = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Proportional(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.reference, self.position_measured, self.duty, self.gain = 1.0, 0.0, 0.0, 50.0
        self.register_variable(Real("reference", causality=Fmi2Causality.input, start=1.0))
        self.register_variable(Real("position_measured", causality=Fmi2Causality.input, start=0.0))
        self.register_variable(Real("duty", causality=Fmi2Causality.output))
        tunable = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("gain", **tunable))

    def do_step(self, time, step):
        self.duty = self.gain * (self.reference - self.position_measured)
        return True
"""
MODEL = model_of(RIGID)


@pytest.fixture(scope="module")
def parts(
    tmp_path_factory: pytest.TempPathFactory, native_fmu_of: Callable[[Structure, int], Path]
) -> tuple[Path, Path]:
    """A plant with other friction than the model's, and a controller."""
    folder = tmp_path_factory.mktemp("ssp")
    plant = python_fmu.update(native_fmu_of(RIGID, 2), model_of(RIGID, coulomb_friction=3.0), folder / "plant.fmu")
    (folder / "proportional.py").write_text(CONTROLLER)
    build = [sys.executable, "-m", "pythonfmu", "build", "-f", "proportional.py"]
    subprocess.run(build, cwd=folder, check=True, capture_output=True)
    return plant, folder / "Proportional.fmu"


def test_parameter_set_is_valid_and_complete(tmp_path: Path) -> None:
    out = write_ssv(MODEL, tmp_path / "axis.ssv")
    read = {p.name: (float(p.value), p.unit) for p in read_ssv(str(out), validate=True).parameters}
    assert read == {v.name: (v.start, v.unit) for v in variables(MODEL) if v.causality == "parameter"}
    assert out.read_bytes() == write_ssv(MODEL, tmp_path / "again.ssv").read_bytes()
    units = {u.get("name") for u in ET.parse(out).iter() if u.tag.endswith("}Unit")}
    assert {unit for _, unit in read.values()} <= units
    with pytest.raises(BadInput, match="is there already"):
        write_ssv(MODEL, out)
    assert write_ssv(model_of(RIGID, offset=0.0), out, force=True).read_text() != (tmp_path / "again.ssv").read_text()
    assert len(list(tmp_path.iterdir())) == 2


def test_system_is_valid_and_closed(parts: tuple[Path, Path], tmp_path: Path) -> None:
    out = write_ssp(tmp_path / "loop.ssp", *parts, MODEL)
    ends = {
        (c.startElement, c.startConnector, c.endElement, c.endConnector)
        for c in read_ssd(str(out), validate=True).system.connections
    }
    assert ends == {
        ("controller", "duty", "axis", "duty"),
        ("axis", "position_measured", "controller", "position_measured"),
    }
    with zipfile.ZipFile(out) as archive:
        assert archive.read("resources/axis.fmu") == parts[0].read_bytes()
        assert set(archive.namelist()) == {
            "SystemStructure.ssd", "resources/identified.ssv", "resources/axis.fmu", "resources/controller.fmu"
        }  # fmt: skip


def test_parts_that_do_not_fit_are_refused(parts: tuple[Path, Path], tmp_path: Path) -> None:
    plant, controller = parts
    with pytest.raises(BadInput, match="no input duty"):
        write_ssp(tmp_path / "a.ssp", controller, None, model_of(Structure.of(("inertia",))))
    with pytest.raises(BadInput, match="no output duty"):
        write_ssp(tmp_path / "a.ssp", plant, plant, MODEL)
    with pytest.raises(BadInput, match="no such FMU"):
        write_ssp(tmp_path / "a.ssp", tmp_path / "none.fmu", None, MODEL)
    assert list(tmp_path.iterdir()) == []


COSIM = """
import json, sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
run = CosimExecution.from_ssp_file(ssp_path=sys.argv[1], step_size=2000000)
eye = CosimObserver.create_last_value()
run.add_observer(eye)
run.step(1000)
axis = run.slave_index_from_instance_name("axis")
print(json.dumps([eye.last_real_values(axis, json.loads(sys.argv[2]))]))
"""
ECOS = """
import json, sys
from ecospy import EcosSimulation
with EcosSimulation(ssp_path=sys.argv[1], step_size=0.002) as run:
    run.init(parameter_set="identified")
    run.step(1000)
    print(json.dumps([[run.get_real(f"axis::{n}") for n in ("position", "coulomb_friction")]]))
"""


@pytest.mark.parametrize("client", ["libcosimpy", "ecospy"])
def test_clients_run_the_loop_with_the_set(parts: tuple[Path, Path], tmp_path: Path, client: str) -> None:
    if importlib.util.find_spec(client) is None:
        pytest.skip(f"the client {client} is not installed")
    out = write_ssp(tmp_path / "loop.ssp", *parts, MODEL)
    reference = {v.name: v.reference for v in variables(MODEL)}
    references = json.dumps([reference["position"], reference["coulomb_friction"]])
    script = {"libcosimpy": COSIM, "ecospy": ECOS}[client]
    done = subprocess.run([sys.executable, "-c", script, str(out), references], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    position, friction = json.loads(next(s for s in done.stdout.splitlines() if s.startswith("[[")))[0]
    assert friction == MODEL.values["coulomb_friction"], "the set's value, not the FMU's own"
    assert 0.5 < position < 1.5, "the loop pulls the link to its reference of 1"
