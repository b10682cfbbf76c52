"""The FMU made through pythonfmu: same numbers as the kernel, whatever the importer does, and no surprises for it."""

from __future__ import annotations

import ast
import dataclasses
import math
import os
import platform
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import fmpy.validation
import numpy as np
import pytest
from native_axis import EVERYTHING, NAMES, PERIOD, RIGID, by_kernel, command, model_of, without_zig

from fmu_src import pack
from twin.effects.catalogue import BASE
from twin.errors import BadInput
from twin.fmi import python_fmu
from twin.fmi.fmu_archive import open_fmu
from twin.fmi.fmu_instance import Running, running
from twin.io.files import zipped
from twin.io.recording import Recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.model.variables import variables
from twin.simulation import kernel

STRUCTURES = {"rigid": RIGID, "all": EVERYTHING}
EACH = ["rigid", "all", "rigid, no compiler", "all, no compiler"]
SIMPLE = Structure.of((*BASE, "gravity", "coulomb_friction"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("fmus")
    models = {name: model_of(structure) for name, structure in STRUCTURES.items()}
    fmus = {name: python_fmu.export(model, folder / f"{name}.fmu") for name, model in models.items()}
    fmus["simple"] = python_fmu.export(model_of(SIMPLE), folder / "simple.fmu")
    with without_zig(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(shutil, "which", lambda *_: None)
        patch.delenv("CC", raising=False)
        for name, model in models.items():
            fmus[f"{name}, no compiler"] = python_fmu.export(model, folder / f"{name}-plain.fmu")
    return fmus


def recording_of(model: Model, time: np.ndarray, u: np.ndarray, output: np.ndarray | None = None) -> Recording:
    nothing = np.full(len(time), np.nan)
    return Recording("made up", time, u, nothing if output is None else output, "%", "rad", known=model.known)


def drive(instance: Running, u: np.ndarray, first: float = 0.0, pattern: list[int] | None = None) -> np.ndarray:
    """The outputs after every step, (steps + 1, outputs). A step of n periods holds the command at its start."""
    rows = [list(instance.read())]
    at = 0
    for n in pattern or [1] * (len(u) - 1):
        rows.append(list(instance.step(first + at * PERIOD, n * PERIOD, [u[at]])))
        at += n
    return np.array(rows)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of any column, relative to the span of that column."""
    span = np.maximum(np.ptp(b, axis=0), 1e-12)
    return float(np.max(np.abs(a - b) / span))


# ---- what the importer reads before it starts ----


def test_description_is_valid_and_complete(made):
    assert fmpy.validation.validate_fmu(str(made["rigid"])) == []
    root = open_fmu(made["rigid"]).description
    simulation = root.find("CoSimulation")
    assert simulation.get("canGetAndSetFMUstate") == simulation.get("canSerializeFMUstate") == "true"
    defined = {unit.get("name"): unit.find("BaseUnit") for unit in root.iter("Unit")}
    shown = {node.get("name"): node for node in root.find("ModelVariables")}
    assert all(node.get("description") and node[0].get("unit") in defined for node in shown.values())
    assert defined["rad/s^2/%"].attrib == {"rad": "1", "s": "-2", "factor": "100.0"}
    share = shown["motor_share"][0]
    assert [float(share.get(word)) for word in ("min", "max", "nominal", "start")] == [0.02, 0.98, 0.25, 0.25]
    assert all(unknown.get("dependencies") == "" for unknown in root.iterfind("ModelStructure/Outputs/Unknown"))
    index = {name: str(i) for i, name in enumerate(shown, 1)}
    initial = {u.get("index"): u.get("dependencies").split() for u in root.iter("InitialUnknowns").__next__()}
    assert initial[index["velocity"]] == [index["velocity_start"]]
    assert initial[index["position_measured"]] == [
        index[n] for n in ("eccentricity", "eccentricity_angle", "position_start")
    ]


def test_same_model_same_bytes_and_only_the_structure_names_it(made, tmp_path):
    model = model_of(SIMPLE)
    again = python_fmu.export(model, tmp_path / "again.fmu")
    assert again.read_bytes() == made["simple"].read_bytes()
    other = python_fmu.export(model_of(SIMPLE, gravity_gain=2.0), tmp_path / "other.fmu")
    assert open_fmu(other).token == open_fmu(again).token
    less = python_fmu.export(model_of(SIMPLE.without("gravity")), tmp_path / "less.fmu")
    assert open_fmu(less).token != open_fmu(again).token
    assert open_fmu(less).identifier != open_fmu(again).identifier


def test_the_slave_needs_only_the_standard_library_and_pythonfmu():
    tree = ast.parse(pack.SLAVE.read_text(encoding="utf-8"))
    names = [n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    names += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    assert {n.split(".")[0] for n in names} <= {*sys.stdlib_module_names, "pythonfmu"}


def test_the_model_is_inside(made):
    inside = python_fmu.read_model(made["all"])
    assert inside.structure == EVERYTHING
    assert inside.values == model_of(EVERYTHING).values


# ---- same numbers ----


@pytest.mark.parametrize("name", EACH)
def test_same_numbers_as_the_kernel_over_twenty_seconds(made, name):
    model = model_of(STRUCTURES[name.split(",")[0]])
    u = command(int(20.0 / PERIOD))
    truth = by_kernel(model, u, 0.4, -0.2)
    stuck, loose = np.mean(truth[:, 1] == 0.0), np.mean(np.abs(truth[:, 3]) < 0.4999 * model.values["backlash_gap"])
    assert stuck > 0.02 and loose > 0.02, "the motion must stick and cross its gap"
    with running(open_fmu(made[name]), ["duty"], NAMES) as instance:
        instance.start({"position_start": 0.4, "velocity_start": -0.2})
        assert apart(drive(instance, u), truth) < 1e-10


@pytest.mark.parametrize("name", EACH)
def test_any_pattern_of_steps(made, name):
    model, held = model_of(STRUCTURES[name.split(",")[0]]), 4
    inner = [math.ceil(n * PERIOD / model.longest_step) for n in range(1, held + 1)]
    assert inner == [n * inner[0] for n in range(1, held + 1)], "the pattern must keep the internal steps"
    u = command(int(6.0 / PERIOD) // held * held + 1, held)
    truth = by_kernel(model, u, 0.0, 0.0)
    rng = np.random.default_rng(4)
    pattern: list[int] = []
    while sum(pattern) < len(u) - 1:
        cuts = sorted(rng.choice(np.arange(1, held), rng.integers(0, held), replace=False))
        pattern += np.diff([0, *cuts, held]).tolist()
    with running(open_fmu(made[name]), ["duty"], NAMES) as instance:
        instance.start({})
        seen = drive(instance, u, pattern=pattern)
    assert apart(seen, truth[np.cumsum([0, *pattern])]) < 1e-10


def test_replay_equals_the_kernel_at_uneven_stamps_and_any_delay(made, tmp_path):
    model = model_of(RIGID, delay=0.0137)
    rng = np.random.default_rng(7)
    time = np.cumsum(np.concatenate([[0.0], rng.choice([0.001, 0.002, 0.0031, 0.011], 1500)]))
    u = 60.0 * np.sin(2.0 * time) + rng.normal(0.0, 5.0, len(time))
    recording = recording_of(model, time, u)
    fmu = python_fmu.update(made["rigid"], model, tmp_path / "late.fmu")
    seen = python_fmu.replay(fmu, recording, (0.3, 0.0))
    drive_ = kernel.Drive(
        time, u, recording.output, False, kernel.known_vector(model.known), np.zeros(5), model.longest_step
    )
    p = kernel.vector(model.structure, dict(model.values))
    truth = kernel.predict(drive_, p, kernel.start_state(0.3, 0.0, 0.0)).reading
    assert apart(seen.position_measured[:, None], truth[:, None]) < 1e-9
    assert np.array_equal(seen.time, time)


def test_a_full_line_of_commands_keeps_their_mean(made):
    """Steps far shorter than the internal one overflow the line: what is joined must still push as much."""
    model = model_of(RIGID, delay=0.2)
    fine = 16
    time = np.arange(int(1.0 / PERIOD) * fine) * PERIOD / fine
    u = 60.0 * np.sin(5.0 * time) + 20.0 * np.sign(np.sin(300.0 * time))
    drive_ = kernel.Drive(
        time, u, np.full(len(u), np.nan), False, kernel.known_vector(model.known), np.zeros(5), model.longest_step
    )
    p = kernel.vector(model.structure, dict(model.values))
    truth = kernel.predict(drive_, p, kernel.start_state(0.0, 0.0, 0.0)).reading
    with running(open_fmu(made["rigid"]), ["duty"], ["position_measured"]) as instance:
        instance.start({"delay": 0.2})
        seen = np.array([list(instance.step(t, PERIOD / fine, [c])) for t, c in zip(time[:-1], u[:-1], strict=True)])
    assert apart(seen, truth[1:, None]) < 2e-3


def test_the_importers_clock_may_start_anywhere(made):
    u = command(500)
    with running(open_fmu(made["rigid"]), ["duty"], NAMES) as instance:
        instance.start({}, 64.0)
        seen = drive(instance, u, first=64.0)
    assert apart(seen, by_kernel(model_of(RIGID), u, 0.0, 0.0)) < 1e-10


def test_parameters_act_between_steps_and_before_the_start(made):
    u = command(1200)
    first, second = model_of(SIMPLE, gravity_gain=3.0), model_of(SIMPLE, gravity_gain=20.0)
    truth = by_kernel(first, u[:601], 0.1, 0.0)
    x = kernel.start_state(*truth[-1, :2], truth[-1, 3])
    x[3:-1] = truth[-1, 4:]
    rest = kernel.Drive(
        np.arange(600) * PERIOD, u[600:], np.full(600, np.nan), False, kernel.known_vector(second.known), np.zeros(5),
        second.longest_step,
    )  # fmt: skip
    p = kernel.vector(SIMPLE, dict(second.values))
    after = kernel.predict(rest, p, x).reading
    with running(open_fmu(made["simple"]), ["duty"], ["position_measured"]) as instance:
        instance.start({"gravity_gain": 3.0, "position_start": 0.1})
        before = drive(instance, u[:601])[:, 0]
        instance._set({"gravity_gain": 20.0})
        then = drive(instance, u[600:], first=600 * PERIOD)[:, 0]
    assert np.max(np.abs(before - truth[:, 2])) < 1e-10
    assert np.max(np.abs(then - after)) < 1e-10
    assert np.max(np.abs(then - by_kernel(first, u, 0.1, 0.0)[600:, 2])) > 1e-3


@pytest.mark.skipif(sys.platform != "linux" or platform.machine() != "x86_64", reason="compiled for Linux x86_64 only")
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler is installed")
def test_a_compiled_stepper_is_inside_and_python_where_it_does_not_load(made, tmp_path):
    """On another machine the library is a file that cannot be loaded."""
    inside, without = members(made["rigid"]), members(made["rigid, no compiler"])
    (stepper,) = set(inside) - set(without)
    assert all(inside[name] == without[name] for name in without)
    elsewhere = tmp_path / "elsewhere.fmu"
    elsewhere.write_bytes(zipped(inside | {stepper: b"\x7fELF\x02 made for another machine"}))
    u = command(1000)
    rows = []
    for fmu, kind in ((made["rigid"], "ctypes"), (made["rigid, no compiler"], "list"), (elsewhere, "list")):
        script = (
            "import importlib, sys; sys.path.insert(0, sys.argv[1]); slave = importlib.import_module(sys.argv[2])\n"
            "print(type(slave.Axis(instance_name='a', resources=sys.argv[1]).x))"
        )
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(tmp_path / "x")
        told = [str(tmp_path / "x" / "resources"), open_fmu(fmu).identifier]
        done = subprocess.run([sys.executable, "-c", script, *told], capture_output=True, text=True, check=True)
        assert (kind == "list") == ("'list'" in done.stdout), done.stdout
        shutil.rmtree(tmp_path / "x")
        with running(open_fmu(fmu), ["duty"], NAMES) as instance:
            instance.start({"position_start": 0.4})
            rows.append(drive(instance, u))
    assert apart(rows[0], rows[1]) < 1e-12 and np.array_equal(rows[1], rows[2])


# ---- saved states, resets, several at once ----


def test_a_saved_state_continues_identically(made):
    u = command(900)
    at = 300 * PERIOD
    with running(open_fmu(made["all"]), ["duty"], NAMES) as one, running(open_fmu(made["all"]), ["duty"], NAMES) as two:
        one.start({"gravity_gain": 4.0})
        drive(one, u[:301])
        state = one._slave.getFMUState()
        written = one._slave.serializeFMUstate(state)
        straight = drive(one, u[300:], first=at)
        one._set({"gravity_gain": 9.0})
        drive(one, u[::-1], first=899 * PERIOD)
        one._slave.setFMUState(state)
        assert np.array_equal(drive(one, u[300:], first=at), straight)
        two._slave.setFMUState(two._slave.deSerializeFMUstate(written))
        assert np.array_equal(drive(two, u[300:], first=at), straight)


def test_reset_returns_to_the_start(made):
    u = command(400)
    with running(open_fmu(made["rigid"]), ["duty"], NAMES) as instance:
        instance.start({})
        first = drive(instance, u)
        instance._slave.reset()
        instance.start({})
        assert np.array_equal(drive(instance, u), first)


def test_two_exports_side_by_side_do_not_mix(made, tmp_path):
    u = command(400)
    other = python_fmu.export(model_of(SIMPLE, gravity_gain=1.0), tmp_path / "simple.fmu")
    lone = {}
    for path in (made["simple"], other, made["rigid"]):
        with running(open_fmu(path), ["duty"], NAMES) as instance:
            instance.start({"position_start": 0.5})
            lone[path] = drive(instance, u)
    assert apart(lone[other], lone[made["simple"]]) > 1e-3
    with (
        running(open_fmu(made["simple"]), ["duty"], NAMES) as a,
        running(open_fmu(other), ["duty"], NAMES) as b,
        running(open_fmu(made["rigid"]), ["duty"], NAMES) as c,
    ):
        rows: dict[Path, list[list[float]]] = {path: [] for path in lone}
        together = dict(zip(lone, (a, b, c), strict=True))
        for path, instance in together.items():
            instance.start({"position_start": 0.5})
            rows[path].append(list(instance.read()))
        for i in range(len(u) - 1):
            for path, instance in together.items():
                rows[path].append(list(instance.step(i * PERIOD, PERIOD, [u[i]])))
    assert all(np.array_equal(np.array(rows[path]), lone[path]) for path in lone)


# ---- refusals: a sentence, never an exception in the host ----


def refused(instance: Running, *step: float) -> str:
    said = len(instance.said)
    with pytest.raises(BadInput):
        instance.step(step[0], step[1], [step[2]])
    assert len(instance.said) > said, "there must be a logged sentence"
    return instance.said[-1]


def test_what_cannot_be_done_is_refused_and_leaves_the_axis_as_it_was(made):
    u = command(50)
    with running(open_fmu(made["simple"]), ["duty"], NAMES) as instance:
        assert "not initialised" in refused(instance, 0.0, PERIOD, 1.0)
        instance.start({})
        seen = drive(instance, u)
        at = 49 * PERIOD
        for bad in (np.nan, np.inf):
            assert "input duty" in refused(instance, at, PERIOD, bad)
        assert list(instance.step(at, 0.0, [1.0])) == list(seen[-1]), "a step of no length changes nothing"
        assert "goes back" in refused(instance, 0.0, PERIOD, 1.0)
        assert "jumps ahead" in refused(instance, 2 * at, PERIOD, 1.0)
        assert "negative" in refused(instance, at, -PERIOD, 1.0)
        assert "not finite" in refused(instance, at, np.nan, 1.0)
        assert "too long" in refused(instance, at, 1e12, 1.0)
        instance._set({"viscous_friction": -1.0})
        assert "viscous_friction" in refused(instance, at, PERIOD, 1.0)
        instance._set({"viscous_friction": np.nan})
        assert "viscous_friction" in refused(instance, at, PERIOD, 1.0)
        instance._set({"viscous_friction": 3.0})
        assert list(instance.read()) == list(seen[-1])
        more = np.array(instance.step(at, PERIOD, [u[-1]]))
        truth = by_kernel(model_of(SIMPLE), np.append(u, 0.0), 0.0, 0.0)[-1]
        assert np.max(np.abs(more - truth)) < 1e-12


def test_outputs_cannot_be_set_and_other_types_are_answered(made):
    with running(open_fmu(made["simple"]), ["duty"], NAMES) as instance:
        instance.start({})
        instance._set({"position": 5.0, "position_start": 5.0})
        assert sum("cannot be set" in line for line in instance.said) == 2
        assert instance.step(0.0, PERIOD, [0.0])[0] < 1.0
        instance._slave.getInteger([0])
        instance._slave.getString([0])
        instance._slave.setBoolean([0], [True])
        assert sum("type Real only" in line for line in instance.said) == 3
        assert np.isnan(instance._slave.getReal([100000])).all()


def test_a_motion_that_explodes_is_refused(made):
    with running(open_fmu(made["rigid"]), ["duty"], NAMES) as instance:
        instance.start({"input_gain": 1e308})
        with pytest.raises(BadInput, match=r"infinite|Error"):
            for i in range(100):
                instance.step(i * PERIOD, PERIOD, [100.0 * (-1.0) ** i])


def test_a_process_that_ran_one_ends_well(made):
    """pythonfmu's library writes to freed memory when it is unloaded; what other libraries free then shows it."""
    script = (
        "import sys; from pathlib import Path; from twin.simulation import kernel; import numpy as np\n"
        "from twin.fmi.fmu_archive import open_fmu; from twin.fmi.fmu_instance import running\n"
        "kernel.compiled()\n"
        "with running(open_fmu(Path(sys.argv[1])), ['duty'], ['position']) as r:\n"
        "    r.start({}); r.step(0.0, 0.01, [1.0])\n"
        "    names = [n for n in sys.modules if n.startswith('axis_')]\n"
        "    print(len(sys.modules[names[0]]._released))\n"
    )
    root = Path(__file__).resolve().parents[2]
    environment = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run(
        [sys.executable, "-c", script, str(made["simple"])], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr
    if sys.platform.startswith("linux"):
        assert done.stdout.strip() == "1"


# ---- export and update ----


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_update_writes_the_parameters_and_keeps_the_old_ones_aside(made, tmp_path):
    fmu = Path(shutil.copy(made["simple"], tmp_path / "axis.fmu"))
    old, model = members(fmu), model_of(SIMPLE, gravity_gain=2.5, backlash_gap=0.123)
    assert python_fmu.update(fmu, model, None) == fmu
    new = members(fmu)
    changed = {name for name in old if old[name] != new[name]}
    assert changed == {"modelDescription.xml", "resources/model.toml", "resources/parameters.txt"}
    fresh = members(python_fmu.export(model, tmp_path / "fresh.fmu"))
    assert {name: new[name] for name in old} == fresh
    assert all(name.startswith(("extra/", "documentation/fmi-ls-ref")) for name in new.keys() - old.keys())
    starts = {n.get("name"): n[0].get("start") for n in open_fmu(fmu).description.find("ModelVariables")}
    assert float(starts["gravity_gain"]) == 2.5
    u = command(800)
    with running(open_fmu(fmu), ["duty"], NAMES) as instance:
        instance.start({})
        assert apart(drive(instance, u), by_kernel(model, u, 0.0, 0.0)) < 1e-10


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "iso-8859-1"])
def test_update_keeps_the_encoding_of_a_description(made, tmp_path, encoding: str):
    """Other tools that write into an FMU may save its XML in any encoding that XML knows."""
    fmu, again = tmp_path / "axis.fmu", tmp_path / "again.fmu"
    content = members(made["simple"])
    declared = encoding.removesuffix("-sig")
    text = (
        content["modelDescription.xml"].decode("utf-8").replace("UTF-8", declared).replace("motor-driven", "Prüfling")
    )
    fmu.write_bytes(zipped({**content, "modelDescription.xml": text.encode(encoding)}))
    python_fmu.update(fmu, model_of(SIMPLE, gravity_gain=2.5), again)
    updated = members(again)["modelDescription.xml"].decode(encoding)
    assert "Prüfling" in updated and 'start="2.5"' in updated
    starts = {n.get("name"): n[0].get("start") for n in open_fmu(again).description.find("ModelVariables")}
    assert float(starts["gravity_gain"]) == 2.5


def test_update_refuses_a_damaged_archive_and_leaves_it(made, tmp_path):
    """One byte of a member that no update writes anew is another."""
    fmu = tmp_path / "flipped.fmu"
    with zipfile.ZipFile(made["rigid"]) as archive:
        info = max((i for i in archive.infolist() if i.filename.endswith(".py")), key=lambda i: i.compress_size)
    content = bytearray(made["rigid"].read_bytes())
    content[info.header_offset + len(info.filename) + 30 + info.compress_size // 2] ^= 0xFF
    fmu.write_bytes(content)
    with pytest.raises(BadInput, match="damaged"):
        python_fmu.update(fmu, python_fmu.read_model(fmu))
    assert fmu.read_bytes() == bytes(content)


def test_update_refuses_another_structure_and_says_how_it_differs(made, tmp_path):
    fmu = Path(shutil.copy(made["simple"], tmp_path / "axis.fmu"))
    other = model_of(SIMPLE.without("gravity").with_("spring"))
    with pytest.raises(BadInput, match="the FMU has gravity, which the model lacks; the model has spring"):
        python_fmu.update(fmu, other, None)
    with pytest.raises(BadInput, match="axis is in rad, the model's in m"):
        python_fmu.update(fmu, dataclasses.replace(model_of(SIMPLE), axis_unit="m"), None)
    with pytest.raises(BadInput, match="input is in %, the model's in V"):
        python_fmu.update(fmu, dataclasses.replace(model_of(SIMPLE), input_unit="V"), None)
    assert fmu.read_bytes() == made["simple"].read_bytes()


@pytest.mark.parametrize("does", ["export", "update"])
def test_a_write_that_fails_leaves_what_was_there(made, tmp_path, monkeypatch, does):
    fmu = Path(shutil.copy(made["simple"], tmp_path / "axis.fmu"))

    def broken(self: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", broken)
    with pytest.raises(BadInput, match="No space left"):
        if does == "update":
            python_fmu.update(fmu, model_of(SIMPLE, gravity_gain=1.0), None)
        else:
            python_fmu.export(model_of(SIMPLE), fmu, force=True)
    assert [p.name for p in tmp_path.iterdir()] == ["axis.fmu"]
    assert fmu.read_bytes() == made["simple"].read_bytes()


def test_export_overwrites_nothing_unasked(tmp_path):
    there = tmp_path / "axis.fmu"
    there.write_text("precious")
    with pytest.raises(BadInput, match="force=True"):
        python_fmu.export(model_of(SIMPLE), there)
    with pytest.raises(BadInput, match="not a folder"):
        python_fmu.export(model_of(SIMPLE), tmp_path / "nowhere" / "axis.fmu")
    assert there.read_text() == "precious"


def test_paths_with_unusual_characters(made, tmp_path):
    folder = tmp_path / "Übung #1 100% (neu) + Ä"
    folder.mkdir()
    fmu = python_fmu.export(model_of(SIMPLE), folder / "Größe %20 #2.fmu")
    python_fmu.update(fmu, model_of(SIMPLE, gravity_gain=1.0), None)
    seen = python_fmu.replay(fmu, recording_of(model_of(SIMPLE), np.arange(20) * PERIOD, command(20)), (0.0, 0.0))
    assert np.all(np.isfinite(seen.position))


# ---- replay ----


def test_errors_of_a_replay_ignore_what_was_left_out(made):
    model = model_of(SIMPLE)
    u = command(2000)
    truth = by_kernel(model, u, 0.2, 0.0)
    output = truth[:, 2] + 0.01 * np.where(np.arange(2000) % 2, 1.0, -1.0)
    output[500:700] = np.nan
    recording = recording_of(model, np.arange(2000) * PERIOD, u, output)
    seen = python_fmu.replay(made["simple"], recording, (0.2, 0.0))
    assert seen.rmse(recording) == pytest.approx(0.01, rel=1e-6)
    span = np.nanmax(output) - np.nanmin(output)
    assert seen.nrmse_percent(recording) == pytest.approx(100.0 * 0.01 / span, rel=1e-6)
    speed = dataclasses.replace(recording, output=truth[:, 1] + 0.5, output_unit="rad/s")
    assert python_fmu.replay(made["simple"], speed, (0.2, 0.0)).rmse(speed) == pytest.approx(0.5, rel=1e-6)


def test_an_encoder_off_centre_begins_where_it_reads_what_was_read(tmp_path):
    model = model_of(SIMPLE.with_("encoder_eccentricity"), eccentricity=0.03, eccentricity_angle=-1.2)
    fmu = python_fmu.export(model, tmp_path / "off_centre.fmu")
    recording = recording_of(model, np.arange(500) * PERIOD, command(500))
    seen = python_fmu.replay(fmu, recording, (0.4, 0.0))
    assert seen.position_measured[0] - 0.4 > 0.02
    read = dataclasses.replace(recording, output=seen.position_measured, resolution=1e-9)
    again = python_fmu.replay(fmu, read)
    assert again.position_measured[0] == pytest.approx(seen.position_measured[0], abs=1e-4)
    assert again.rmse(read) < 1e-3


def test_the_start_is_read_off_the_recording():
    rng = np.random.default_rng(3)
    time = np.arange(500) * 0.002
    model = model_of(SIMPLE)
    moving = recording_of(model, time, 0.0 * time, 0.7 + 2.0 * time + rng.normal(0.0, 1e-4, 500))
    assert python_fmu.start_of(moving) == pytest.approx((0.7, 2.0), abs=0.03)
    counts = np.round((0.7 + rng.normal(0.0, 1e-4, 500)) / 6e-4) * 6e-4
    resting = dataclasses.replace(recording_of(model, time, 0.0 * time, counts), resolution=6e-4)
    position, velocity = python_fmu.start_of(resting)
    assert velocity == 0.0 and position == pytest.approx(0.7, abs=6e-4)
    setting_off = 0.7 + 0.1 * time + 50.0 * time**2 + rng.normal(0.0, 1e-6, 500)
    found = python_fmu.start_of(recording_of(model, time, 0.0 * time, setting_off))
    assert found == pytest.approx((0.7, 0.1), abs=2e-3)  # a line would say 1.1 per s
    with pytest.raises(BadInput, match="no reading"):
        python_fmu.start_of(recording_of(model, time, 0.0 * time))


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_the_start_between_slow_readings_is_what_the_model_makes_of_them(speed: float):
    """A sensor that is read every 50 ms misses how the axis sets off; its model does not."""
    model = model_of(SIMPLE)
    time = np.arange(1000) * 0.002
    state = kernel.start_state(0.4, speed, 0.0)
    drive = kernel.Drive(
        time,
        np.full(1000, 60.0),
        np.full(1000, np.nan),
        False,
        kernel.known_vector({}),
        np.zeros(5),
        model.longest_step,
    )
    read = kernel.predict(drive, kernel.vector(model.structure, model.values), state).reading
    slow = recording_of(model, time, drive.command, np.where(np.arange(1000) % 25 == 0, read, np.nan))
    assert python_fmu.start_of(slow, model) == pytest.approx((0.4, speed), abs=1e-4)


def test_what_is_no_fmu_of_ours_is_said(made, tmp_path):
    recording = recording_of(model_of(SIMPLE), np.arange(20) * PERIOD, command(20))
    other = tmp_path / "other.fmu"
    kept = {name: content for name, content in members(made["simple"]).items() if "binaries" not in name}
    with zipfile.ZipFile(other, "w") as archive:
        for name, content in kept.items():
            archive.writestr(name, content)
    with pytest.raises(BadInput, match="binary for this machine"):
        python_fmu.replay(other, recording, (0.0, 0.0))
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("modelDescription.xml", kept["modelDescription.xml"])
    with pytest.raises(BadInput, match=r"no resources/model\.toml"):
        python_fmu.read_model(other)
    root = ET.fromstring(kept["modelDescription.xml"])
    root.find("ModelVariables").clear()
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("modelDescription.xml", ET.tostring(root))
    with pytest.raises(BadInput, match="0 inputs"):
        python_fmu.replay(other, recording, (0.0, 0.0))


@pytest.mark.parametrize("unit, name", [("V", "voltage"), ("A", "current"), ("N*m", "torque"), ("N", "force")])
def test_the_input_is_named_by_what_the_rig_records(unit, name):
    model = dataclasses.replace(model_of(SIMPLE), input_unit=unit, axis_unit="m" if unit == "N" else "rad")
    shown = variables(model)
    assert shown[0].name == name and shown[0].unit == unit
    assert {v.unit for v in shown if v.name == "position"} == {model.axis_unit}
