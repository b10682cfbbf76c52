"""The native FMU against the kernel, against the standard's rules, and under sanitizers."""

from __future__ import annotations

import itertools
import math
import shutil
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from native_axis import (
    EVERYTHING,
    NAMES,
    PERIOD,
    RIGID,
    abuse,
    by_kernel,
    command,
    has_thread_sanitizer,
    in_two_threads,
    model_of,
)

from twin.effects.catalogue import BASE
from twin.errors import BadInput
from twin.fmi import native_fmu, python_fmu
from twin.fmi.native_fmu import export_native
from twin.io.files import zipped
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.model.variables import parameters_text


class Host:
    """An importer: one instance of an unpacked FMU in FMPy, FMI 2 or 3."""

    def __init__(self, fmu: Path, folder: Path, instance: str = "one") -> None:
        fmpy.extract(str(fmu), str(folder))
        description = fmpy.read_model_description(str(folder))
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.command = description.modelVariables[0].name
        self.fmi = int(description.fmiVersion[0])
        self.said: list[str] = []
        made = {2: FMU2Slave, 3: FMU3Slave}[self.fmi]
        self.slave = made(
            guid=description.guid or description.instantiationToken, unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier, instanceName=instance,
        )  # fmt: skip
        if self.fmi == 2:
            self.slave.instantiate(callbacks=self._callbacks())
        else:
            self.slave.instantiate(logMessage=self._log_message())

    def _callbacks(self) -> fmpy.fmi2.fmi2CallbackFunctions:
        def heard(_: object, __: bytes, ___: int, ____: bytes, message: bytes) -> None:
            self.said.append(message.decode())

        self.kept = fmpy.fmi2.fmi2CallbackFunctions()
        self.kept.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(heard)
        return self.kept

    def _log_message(self) -> object:
        return lambda _, __, ___, message: self.said.append(message.decode())

    def start(self, time: float = 0.0, **values: float) -> None:
        if self.fmi == 2:
            self.slave.setupExperiment(startTime=time)
            self.slave.enterInitializationMode()
        else:
            self.slave.enterInitializationMode(startTime=time)
        for name, value in values.items():
            self.set(name, value)
        self.slave.exitInitializationMode()

    def set(self, name: str, value: float) -> None:
        setter = self.slave.setReal if self.fmi == 2 else self.slave.setFloat64
        setter([self.reference[name]], [value])

    def get(self, *names: str) -> list[float]:
        getter = self.slave.getReal if self.fmi == 2 else self.slave.getFloat64
        return list(getter([self.reference[n] for n in names]))

    def step(self, time: float, length: float) -> None:
        self.slave.doStep(currentCommunicationPoint=time, communicationStepSize=length)

    def replay(self, u: np.ndarray, held: int = 1) -> np.ndarray:
        """What every name reads at the communication points, (N, names) at every `held`-th sample."""
        rows = [self.get(*NAMES)]
        for i in range(0, len(u) - 1, held):
            self.set(self.command, u[i])
            steps = min(held, len(u) - 1 - i)
            self.step(i * PERIOD, steps * PERIOD)
            rows.append(self.get(*NAMES))
        return np.array(rows)


FMI = (2, 3)
#: Everything that an outside solver can be given, and a small axis of that kind.
SOLVED = EVERYTHING.without("input_delay")
TEETH = Structure.of((*BASE, "tooth_compliance", "coulomb_friction", "gravity"))
OFFSET = Structure.of(("inertia", "viscous_friction", "constant_offset"))


@pytest.fixture
def local(native_fmu_of: Callable[[Structure, int], Path]) -> dict[tuple[str, int], Path]:
    """FMUs for this machine only: the compilers for others have their own test."""
    axes = {"elastic": EVERYTHING, "rigid": RIGID}
    return {(name, fmi): native_fmu_of(axis, fmi) for name, axis in axes.items() for fmi in FMI}


def differ(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference, relative to the largest value of each column."""
    return float(np.max(np.abs(a - b) / np.maximum(np.max(np.abs(b), axis=0), 1e-3)))


@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize("name", ["elastic", "rigid"])
def test_same_numbers_as_the_kernel(local: dict, tmp_path: Path, name: str, fmi: int) -> None:
    u = command(10241)
    expected = by_kernel(model_of(EVERYTHING if name == "elastic" else RIGID), u, 0.3, -1.0)
    moving, gap = expected[:, 1], expected[:, 3]
    assert (moving == 0.0).sum() > 100, "the run must hold stick"
    if name == "rigid":
        assert (np.abs(gap) < 0.0249).sum() > 100, "and free play"
        assert (np.abs(gap) == 0.025).sum() > 100, "and contact"
    host = Host(local[name, fmi], tmp_path / "x")
    host.start(position_start=0.3, velocity_start=-1.0)
    assert differ(host.replay(u), expected) < 1e-10


@pytest.mark.parametrize("fmi", FMI)
def test_parameters_set_by_the_importer(local: dict, tmp_path: Path, fmi: int) -> None:
    changed = {
        "coulomb_friction": 2.0,
        "delay": 2.0**-6,
        "backlash_gap": 0.2,
        "eccentricity": 0.3,
        "payload": 0.0,
    }
    u = command(2001)
    model = model_of(RIGID, **{k: v for k, v in changed.items() if k != "payload"})
    expected = by_kernel(Model(RIGID, model.values, known={"moment": 0.005}), u, 0.0, 0.0)
    host = Host(local["rigid", fmi], tmp_path / "x")
    host.start(**changed)
    assert differ(host.replay(u), expected) < 1e-10


@pytest.mark.parametrize("fmi", FMI)
def test_reset_returns_to_the_start(local: dict, tmp_path: Path, fmi: int) -> None:
    u = command(501)
    host = Host(local["rigid", fmi], tmp_path / "x")
    host.start()
    first = host.replay(u)
    host.slave.reset()
    host.start()
    assert np.array_equal(host.replay(u), first)


@pytest.mark.parametrize("fmi", FMI)
def test_valid_description_with_units_and_same_bytes(local: dict, tmp_path: Path, no_zig: None, fmi: int) -> None:
    for name in ("elastic", "rigid"):
        assert validate_fmu(str(local[name, fmi])) == []
    made = {}
    for name, offset in (("one", 0.0), ("again", 0.0), ("other", 0.1)):
        fmu = export_native(model_of(OFFSET, offset=offset), tmp_path / f"{name}.fmu", fmi)
        with zipfile.ZipFile(fmu) as archive:
            made[name] = archive.read("modelDescription.xml")
    assert made["one"] == made["again"] != made["other"]
    token = "guid" if fmi == 2 else "instantiationToken"
    assert ET.fromstring(made["one"]).get(token) == ET.fromstring(made["other"]).get(token)
    with zipfile.ZipFile(local["rigid", fmi]) as archive:
        description = ET.fromstring(archive.read("modelDescription.xml"))
    units = {u.get("name") for u in description.iter("Unit")}
    assert {"rad", "rad/s", "%", "rad/s^2/%", "kg*m^2", "Hz"} <= units


@pytest.mark.parametrize("fmi", FMI)
def test_refusals_are_sentences(local: dict, tmp_path: Path, fmi: int) -> None:
    host = Host(local["rigid", fmi], tmp_path / "x")

    def refused(what: str, call: object, *arguments: float) -> None:
        host.said.clear()
        with pytest.raises(fmpy.fmi1.FMICallException):
            call(*arguments)
        assert len(host.said) == 1 and what in host.said[0], host.said

    refused("before the end of initialization", host.step, 0.0, 0.002)
    host.start()
    refused("finite", host.set, "duty", math.nan)
    refused("finite", host.set, "offset", math.inf)
    refused("outside [0, inf]", host.set, "coulomb_friction", -1.0)
    refused("cannot be set", host.set, "heat", 1.0)
    refused("before the simulation starts", host.set, "position_start", 1.0)
    host.step(0.0, 0.002)
    refused("goes back", host.step, 0.0, 0.002)
    refused("jumps", host.step, 0.5, 0.002)
    refused("positive", host.step, 0.002, -0.001)
    refused("finite", host.step, 0.002, math.nan)
    host.set("duty", 250.0)  # beyond the drive's range is no error: the drive saturates
    host.step(0.002, 0.002)
    assert host.get("time_since_start") == [pytest.approx(0.004)]


@pytest.mark.parametrize("fmi", FMI)
def test_saved_state_continues_identically(local: dict, tmp_path: Path, fmi: int) -> None:
    u = command(3001)
    host = Host(local["rigid", fmi], tmp_path / "x")
    host.start()
    whole = host.replay(u)
    host.slave.reset()
    host.start()
    for i in range(1000):
        host.set("duty", u[i])
        host.step(i * PERIOD, PERIOD)
    slave = host.slave
    word = "state" if fmi == 2 else "State"
    unpack = slave.deSerializeFMUstate if fmi == 2 else slave.deserializeFMUState
    saved = getattr(slave, f"getFMU{word}")()
    packed = getattr(slave, "serializeFMUstate" if fmi == 2 else "serializeFMUState")(saved)
    host.set("coulomb_friction", 50.0)
    host.set("duty", -80.0)
    for i in range(1000, 1200):
        host.step(i * PERIOD, PERIOD)
    for packing in (False, True):
        state = unpack(packed) if packing else saved
        getattr(slave, f"setFMU{word}")(state)
        rows = [host.get(*NAMES)]
        for i in range(1000, 3000):
            host.set("duty", u[i])
            host.step(i * PERIOD, PERIOD)
            rows.append(host.get(*NAMES))
        assert np.array_equal(np.array(rows), whole[1000:])
        getattr(slave, f"freeFMU{word}")(state)
    damaged = bytearray(packed)
    damaged[3] ^= 1
    with pytest.raises(fmpy.fmi1.FMICallException):
        unpack(bytes(damaged))


def pack(folder: Path, fmu: Path) -> None:
    files = {f.relative_to(folder).as_posix(): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
    fmu.write_bytes(zipped(files))


@pytest.mark.parametrize("fmi", FMI)
def test_start_values_come_from_the_resources(local: dict, tmp_path: Path, fmi: int) -> None:
    """What twin update relies on: binaries stay, the text of start values changes; odd paths do no harm."""
    folder = tmp_path / "größe #1 (50%) + x"
    fmpy.extract(str(local["rigid", fmi]), str(folder))
    values = folder / "resources" / "parameters.txt"
    values.write_text(parameters_text(model_of(RIGID, offset=-2.5)))
    fmu = tmp_path / "changed.fmu"
    pack(folder, fmu)
    host = Host(fmu, tmp_path / "ä #2 (50%) + y")
    assert host.get("offset") == [-2.5]
    values.write_text("offset nan\n")
    bad = tmp_path / "bad.fmu"
    pack(folder, bad)
    with pytest.raises(Exception, match="nstantiat"):
        Host(bad, tmp_path / "z")


@pytest.mark.parametrize("fmi", FMI)
def test_an_update_is_seen_by_every_importer_and_touches_no_code(local: dict, tmp_path: Path, fmi: int) -> None:
    model = model_of(RIGID, gravity_gain=2.5, delay=2.0**-7, eccentricity=0.1)
    before = local["rigid", fmi].read_bytes()
    fmu = python_fmu.update(local["rigid", fmi], model, tmp_path / "new.fmu")
    assert local["rigid", fmi].read_bytes() == before
    with zipfile.ZipFile(local["rigid", fmi]) as a, zipfile.ZipFile(fmu) as b:
        more = set(b.namelist()) - set(a.namelist())
        assert all(name.startswith(("extra/", "documentation/fmi-ls-ref")) for name in more)
        changed = {name for name in a.namelist() if a.read(name) != b.read(name)}
    assert changed == {"modelDescription.xml", "resources/model.toml", "resources/parameters.txt"}
    assert validate_fmu(str(fmu)) == []
    shown = {v.name: v.start for v in fmpy.read_model_description(str(fmu)).modelVariables}
    assert {name: float(shown[name]) for name in model.values} == dict(model.values)
    u = command(1001)
    host = Host(fmu, tmp_path / "x")
    host.start()
    assert differ(host.replay(u), by_kernel(model, u, 0.0, 0.0)) < 1e-10
    with pytest.raises(BadInput, match="the FMU has gravity, which the model lacks"):
        python_fmu.update(fmu, model_of(RIGID.without("gravity")))
    assert python_fmu.read_model(fmu).values == model.values


@pytest.mark.parametrize("fmi", FMI)
def test_two_exports_side_by_side(local: dict, tmp_path: Path, no_zig: None, fmi: int) -> None:
    other = export_native(model_of(RIGID, gravity_gain=0.0), tmp_path / "other.fmu", fmi)
    u = command(1001)
    hosts = [Host(local["rigid", fmi], tmp_path / "a", "a"), Host(other, tmp_path / "b", "b")]
    for host in hosts:
        host.start()
    got = [np.array(host.replay(u)) for host in hosts]
    assert differ(got[0], by_kernel(model_of(RIGID), u, 0.0, 0.0)) < 1e-10
    assert differ(got[1], by_kernel(model_of(RIGID, gravity_gain=0.0), u, 0.0, 0.0)) < 1e-10
    assert differ(got[0], got[1]) > 0.01


def test_no_overwriting_and_no_half_file(tmp_path: Path, no_zig: None, monkeypatch: pytest.MonkeyPatch) -> None:
    model = model_of(Structure.of(("inertia",)))
    out = tmp_path / "a.fmu"
    out.write_text("mine")
    with pytest.raises(BadInput, match="is there already"):
        export_native(model, out)
    with pytest.raises(BadInput, match="is not a folder"):
        export_native(model, tmp_path / "no" / "a.fmu")
    monkeypatch.setattr(shutil, "which", lambda *_: None)
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(BadInput, match=r"pip install ziglang"):
        export_native(model, out, force=True)
    assert out.read_text() == "mine" and list(tmp_path.iterdir()) == [out]


def write_sources(model: Model, fmi: int, folder: Path) -> None:
    for name, text in native_fmu.sources(native_fmu.of_axis(model), fmi).items():
        (folder / name).write_text(text)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize(
    ("structure", "fmi"),
    [(EVERYTHING, 2), (RIGID.without("input_delay"), 3), (SOLVED, 3), (TEETH, 2)],
    ids=["all-2", "rigid-3", "solved-3", "teeth-2"],
)
def test_abuse_under_sanitizers(tmp_path: Path, structure: Structure, fmi: int) -> None:
    """No undefined behaviour, no leak, no memory taken after instantiation, whatever an importer calls."""
    model = model_of(structure)
    write_sources(model, fmi, tmp_path)
    (tmp_path / "parameters.txt").write_text(parameters_text(model))
    done = abuse(tmp_path, fmi)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert len(done.stdout.split()) == 2


@pytest.mark.parametrize(("structure", "fmi"), [(EVERYTHING, 2), (TEETH, 3)], ids=["all-2", "teeth-3"])
def test_two_instances_in_two_threads_do_not_meet(tmp_path: Path, structure: Structure, fmi: int) -> None:
    """No data race by the thread sanitizer, and the same motion in both."""
    if not has_thread_sanitizer(tmp_path):
        pytest.skip("no compiler with a thread sanitizer is installed")
    model = model_of(structure)
    write_sources(model, fmi, tmp_path)
    (tmp_path / "parameters.txt").write_text(parameters_text(model))
    done = in_two_threads(tmp_path, fmi)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]


def test_the_thread_sanitizer_sees_a_state_that_instances_share(tmp_path: Path) -> None:
    """The same sources with one variable of the plumbing made common to all instances."""
    if not has_thread_sanitizer(tmp_path):
        pytest.skip("no compiler with a thread sanitizer is installed")
    model = model_of(TEETH)
    write_sources(model, 3, tmp_path)
    (tmp_path / "parameters.txt").write_text(parameters_text(model))
    plumbing = (tmp_path / "axis.h").read_text()
    shared = plumbing.replace("        double left;\n", "        static double left;\n        left = span;\n", 1)
    assert shared != plumbing
    (tmp_path / "axis.h").write_text(shared)
    done = in_two_threads(tmp_path, 3)
    assert done.returncode != 0 and "data race" in done.stderr


ALONE = {
    "motor": Structure.of(("inertia", "viscous_friction")),
    "friction": Structure.of(("inertia", "viscous_friction", "coulomb_friction", "stribeck_friction")),
    "teeth": TEETH,
    "all": SOLVED,
}
EDGES = ((0.0, 60.0), (1.0, -60.0), (2.0, 0.0), (2.5, 30.0), (4.0, 0.0))


@pytest.mark.parametrize("fmi", FMI)
@pytest.mark.parametrize("name", ALONE)
def test_model_exchange_moves_as_the_kernel(tmp_path: Path, no_zig: None, name: str, fmi: int) -> None:
    model = model_of(ALONE[name], load_time=3.2) if "load_change" in ALONE[name] else model_of(ALONE[name])
    fmu = export_native(model, tmp_path / "axis.fmu", fmi)
    assert validate_fmu(str(fmu)) == []
    time = np.arange(2561) * PERIOD
    u = np.array([EDGES[np.searchsorted([s for s, _ in EDGES], t, side="right") - 1][1] for t in time])
    rows = [(t, u) for (start, u), (end, _) in itertools.pairwise((*EDGES, (9.0, 0.0))) for t in (start, end)]
    run = fmpy.simulate_fmu(
        str(fmu), fmi_type="ModelExchange", stop_time=5.0, output_interval=4 * PERIOD, relative_tolerance=1e-8,
        input=np.array(rows, dtype=[("time", float), ("duty", float)]),
        start_values={"position_start": 0.3, "velocity_start": -1.0}, output=["position", "position_measured"],
    )  # fmt: skip
    at = run["time"] / PERIOD
    grid = np.abs(at - at.round()) < 1e-9
    truth = by_kernel(model, u, 0.3, -1.0)[at[grid].round().astype(int)]
    assert grid.sum() > 600 and np.ptp(truth[:, 0]) > 1.0
    assert np.max(np.abs(run["position"][grid] - truth[:, 0])) < 1e-3
    assert np.max(np.abs(run["position_measured"][grid] - truth[:, 2])) < 1e-3


@pytest.mark.parametrize("fmi", FMI)
def test_model_exchange_holds_exactly(tmp_path: Path, no_zig: None, fmi: int) -> None:
    """A link on a slope that friction holds does not creep, not by one bit, in an hour."""
    structure = Structure.of(("inertia", "viscous_friction", "coulomb_friction", "gravity"))
    fmu = export_native(model_of(structure, coulomb_friction=6.0, gravity_gain=5.0), tmp_path / "axis.fmu", fmi)
    run = fmpy.simulate_fmu(str(fmu), fmi_type="ModelExchange", stop_time=3600.0, start_values={"position_start": 1.5})
    assert np.all(run["position"] == 1.5) and np.all(run["velocity"] == 0.0)


@pytest.mark.parametrize("fmi", FMI)
def test_model_exchange_only_where_it_can_be_said(local: dict, fmi: int) -> None:
    for structure, why in ((EVERYTHING, "dead time"), (Structure.of(BASE), "rigid contact")):
        assert native_fmu.offers(structure).startswith(f"co-simulation only: {why}")
    assert native_fmu.offers(SOLVED) == "co-simulation and model exchange"
    for name in ("elastic", "rigid"):  # dead time; dead time and rigid contact
        description = fmpy.read_model_description(str(local[name, fmi]))
        assert description.modelExchange is None and description.coSimulation is not None
