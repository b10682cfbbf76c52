"""The controller as an FMU of every kind: beside the plant's it gives the loop of the co-simulation, everywhere."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from controlled_axis import EFFECTS, ENDS, INPUTS, axis
from native_axis import abuse

from twin.cli.main import main
from twin.control import controller_fmu
from twin.control.controller import Controller, dumps
from twin.control.cosimulation import make_reference, simulate
from twin.control.design import design
from twin.control.reference import Reference
from twin.errors import BadInput
from twin.fmi import native_fmu, python_fmu
from twin.fmi.fmu_archive import open_fmu
from twin.fmi.fmu_instance import running
from twin.fmi.ssp import write_ssp
from twin.model.fitted_model import Model
from twin.model.fitted_model import dumps as model_text

KINDS: dict[str, Callable[[Controller, Path], Path]] = {
    "python": controller_fmu.export_controller,
    "native 2": lambda made, out: controller_fmu.export_native(made, out, 2),
    "native 3": lambda made, out: controller_fmu.export_native(made, out, 3),
}

pytestmark = pytest.mark.usefixtures("no_zig")


@pytest.fixture(scope="module")
def loop() -> tuple[Model, Controller, Reference]:
    model = axis(*ENDS, **EFFECTS)
    made = design(model)
    return model, made, make_reference("minimum-jerk", made, duration=4.0)


def columns(reference: Reference) -> list[list[float]]:
    """Position, velocity and acceleration wanted, one row a sample."""
    return np.column_stack([reference.position, reference.velocity, reference.acceleration]).tolist()


@pytest.mark.parametrize("kind", KINDS)
def test_beside_the_plant_fmu_it_gives_the_same_loop(
    loop: tuple[Model, Controller, Reference], tmp_path: Path, kind: str
) -> None:
    model, made, reference = loop
    ruler = KINDS[kind](made, tmp_path / "controller.fmu")
    plant = python_fmu.export(model, tmp_path / "axis.fmu")
    position, period = [], made.sample_time
    with (
        running(open_fmu(ruler), INPUTS, ["duty"]) as left,
        running(open_fmu(plant), ["duty"], ["position", "position_measured"]) as right,
    ):
        left.start({})
        right.start({})
        for time, wanted in zip(reference.time.tolist(), columns(reference), strict=True):
            (place, measured), (command,) = right.read(), left.read()
            position.append(place)
            # Half steps of the controller change nothing: it keeps its own ticks.
            left.step(time, 0.5 * period, [*wanted, measured])
            left.step(time + 0.5 * period, 0.5 * period, [*wanted, measured])
            right.step(time, period, [command])
    np.testing.assert_allclose(position, simulate(model, made, reference).position, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_valid_and_refuses_to_be_overwritten(
    loop: tuple[Model, Controller, Reference], tmp_path: Path, kind: str
) -> None:
    from fmpy.validation import validate_fmu

    made = loop[1]
    fmu = KINDS[kind](made, tmp_path / "controller.fmu")
    assert validate_fmu(str(fmu)) == []
    with zipfile.ZipFile(fmu) as archive:
        assert archive.read("resources/controller.toml").decode() == dumps(made)
    with pytest.raises(BadInput, match="already"):
        KINDS[kind](made, fmu)


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_set_by_the_importer_act_and_what_was_learnt_stays(tmp_path: Path, kind: str) -> None:
    """A new nominal offset replaces the old one; a saved state brings all back."""
    made = design(axis("constant_offset", offset=1.0), 2.0)
    fmu = KINDS[kind](made, tmp_path / "controller.fmu")
    period = made.sample_time
    with running(open_fmu(fmu), [*INPUTS, "offset"], ["duty", "offset"]) as ruler:
        ruler.start({})
        for i in range(200):  # the link does not follow: a torque is learnt
            command, _ = ruler.step(i * period, period, [0.02, 0.0, 0.0, 0.0, 1.0])
        before = command
        for i in range(200, 203):
            command, shown = ruler.step(i * period, period, [0.02, 0.0, 0.0, 0.0, 2.0])
    gain = made.values["input_gain"]
    assert shown == 2.0, "what was learnt does not show in the parameter"
    assert command - before == pytest.approx(-1.0 / gain, rel=0.1)


SSP = {
    "libcosimpy": """
import json, sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
path, period, position = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
run = CosimExecution.from_ssp_file(ssp_path=path, step_size=round(period * 1e9))
hand, eye = CosimManipulator.create_override(), CosimObserver.create_last_value()
run.add_manipulator(hand)
run.add_observer(eye)
axis, ruler = (run.slave_index_from_instance_name(n) for n in ("axis", "controller"))
rows = []
for wanted in json.load(sys.stdin):
    hand.slave_real_values(ruler, [0, 1, 2], wanted)
    run.step(1)
    rows.append(eye.last_real_values(axis, [position]))
print(json.dumps(rows))
""",
    "ecospy": """
import json, sys
from ecospy import EcosSimulation
names = ("reference", "reference_velocity", "reference_acceleration")
rows = []
with EcosSimulation(ssp_path=sys.argv[1], step_size=float(sys.argv[2])) as run:
    run.init(parameter_set="identified")
    for wanted in json.load(sys.stdin):
        for name, value in zip(names, wanted):
            run.set_real(f"controller::{name}", value)
        run.step(1)
        rows.append([run.get_real("axis::position")])
print(json.dumps(rows))
""",
}


@pytest.mark.parametrize(
    ("client", "kind"),
    [("libcosimpy", "python"), ("libcosimpy", "native 2"), ("ecospy", "native 2"), ("ecospy", "native 3")],
)
def test_the_exported_system_runs_in_clients_and_gives_the_same_loop(
    loop: tuple[Model, Controller, Reference], tmp_path: Path, client: str, kind: str
) -> None:
    if importlib.util.find_spec(client) is None:
        pytest.skip(f"the client {client} is not installed")
    model, made, reference = loop
    (tmp_path / "MODEL.toml").write_text(model_text(model))
    (tmp_path / "CONTROLLER.toml").write_text(dumps(made))
    told = {"python": [], "native 2": ["--target", "native"], "native 3": ["--target", "native", "--fmi", "3"]}[kind]
    files = ["--out", str(tmp_path / "axis.fmu"), "--ssp", str(tmp_path / "loop.ssp")]
    ruler = ["--controller", str(tmp_path / "CONTROLLER.toml"), "--quiet"]
    assert main(["export", str(tmp_path / "MODEL.toml"), *files, *ruler, *told]) == 0
    position = open_fmu(tmp_path / "axis.fmu").references()["position"]
    done = subprocess.run(
        [sys.executable, "-c", SSP[client], str(tmp_path / "loop.ssp"), repr(made.sample_time), str(position)],
        input=json.dumps(columns(reference)), capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    got = np.array(json.loads(next(s for s in done.stdout.splitlines() if s.startswith("[["))))[:, 0]
    expected = simulate(model, made, reference).position
    assert np.ptp(expected) > 0.9
    np.testing.assert_allclose(got[:-1], expected[1:], atol=1e-9)


def test_it_is_exported_by_itself(
    loop: tuple[Model, Controller, Reference], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "CONTROLLER.toml", tmp_path / "controller.fmu"
    path.write_text(dumps(loop[1]))
    assert main(["export", str(path), "--out", str(out), "--target", "native", "--fmi", "3"]) == 0
    assert open_fmu(out).version == 3
    for option in ("--ssp", "--ssv", "--modelica"):
        told = ["export", str(path), "--out", str(tmp_path / "b.fmu"), option, str(tmp_path / "b")]
        capsys.readouterr()
        assert main(told) == 2
        assert "needs the MODEL.toml" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["CONTROLLER.toml", "controller.fmu"]


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("fmi", [2, 3])
def test_abuse_under_sanitizers(loop: tuple[Model, Controller, Reference], tmp_path: Path, fmi: int) -> None:
    """No undefined behaviour and no leak, whatever an importer calls; the axis is held to the same."""
    made = controller_fmu.compilable(loop[1])
    for name, text in {**native_fmu.sources(made, fmi), "parameters.txt": made.resources["parameters.txt"]}.items():
        (tmp_path / name).write_text(text)
    done = abuse(tmp_path, fmi)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]


def test_the_system_connects_both(loop: tuple[Model, Controller, Reference], tmp_path: Path) -> None:
    from fmpy.ssp.ssd import read_ssd

    model, made, _ = loop
    plant = native_fmu.export_native(model, tmp_path / "axis.fmu")
    ruler = controller_fmu.export_native(made, tmp_path / "controller.fmu")
    out = write_ssp(tmp_path / "loop.ssp", plant, ruler, model)
    ends = {
        (c.startElement, c.startConnector, c.endElement) for c in read_ssd(str(out), validate=True).system.connections
    }
    assert ends == {("controller", "duty", "axis"), ("axis", "position_measured", "controller")}
