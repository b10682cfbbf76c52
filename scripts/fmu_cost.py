"""What a communication step costs: native FMU from a C master, pythonfmu FMU from FMPy; part of `bench.py`.

Processor time of set + step + get, the fastest of several runs. The pythonfmu FMUs run in FMPy, whose own share is
what the same calls on the native FMU take beyond the C master's; it is printed apart and left out of their ratios.
All take the same number of internal steps.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from unittest import mock

import fmpy
from fmpy.fmi2 import FMU2Slave

from twin.effects.catalogue import BASE
from twin.fmi import compilers, native_fmu, python_fmu
from twin.fmi.fmu_instance import release_at_exit
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

SCRIPTS = Path(__file__).resolve().parent
STRUCTURES = {
    "first-order motor": Structure.of(("inertia", "viscous_friction")),
    "two bodies, dry friction, gravity": Structure.of((*BASE, "tooth_compliance", "coulomb_friction", "gravity")),
}
VALUES = {"input_gain": 1.2, "viscous_friction": 3.0, "dead_band_forward": 4.0, "dead_band_reverse": 3.0,
          "backlash_gap": 0.02, "coulomb_friction": 2.0, "gravity_gain": 5.0}  # fmt: skip
PIECES = (1, 10, 100)
COMMANDS = [40.0 + i % 30 for i in range(20000)]


def run(command: list[str], folder: Path, given: str = "") -> str:
    return subprocess.run(command, cwd=folder, input=given, check=True, capture_output=True, text=True).stdout


def bare(model: Model, pieces: int, repeat: int, folder: Path) -> float:
    """Seconds that the physics alone takes."""
    if not (folder / "bare").exists():
        (folder / "model.h").write_text(native_fmu.sources(native_fmu.of_axis(model), 2)["model.h"])
        told = ["cc", *compilers.OPTIONS, f"-I{folder}", "-o", "bare", str(SCRIPTS / "bare_axis.c"), "-lm"]
        run(told, folder)
    told = ["./bare", str(pieces), str(repeat), repr(pieces * model.longest_step)]
    return float(run(told, folder, "\n".join(map(str, COMMANDS))))


def from_c(fmu: Path, model: Model, fmi: int, pieces: int, repeat: int) -> float:
    """Seconds of a native FMU, called from C."""
    folder = fmu.with_suffix("")
    if not folder.exists():
        zipfile.ZipFile(fmu).extractall(folder)
        spec = importlib.util.find_spec("fmpy")
        assert spec is not None and spec.origin is not None
        headers = Path(spec.origin).parent / "c-code"
        run(["cc", "-O2", "-std=c99", f"-I{headers}", "-o", "master", str(SCRIPTS / "master.c"), "-ldl"], folder)
    who = native_fmu.identity(model)
    library = folder / "binaries" / {2: "linux64", 3: "x86_64-linux"}[fmi] / f"{who.identifier}.so"
    resources = (folder / "resources").as_uri() if fmi == 2 else f"{folder / 'resources'}/"
    told = [str(library), str(fmi), who.token, resources, repr(pieces * model.longest_step), str(repeat)]
    return float(run(["./master", *told], folder, "\n".join(map(str, COMMANDS))))


def from_fmpy(fmu: Path, length: float, repeat: int) -> float:
    """Seconds of an FMI 2 FMU, called from FMPy."""
    with tempfile.TemporaryDirectory() as folder:
        fmpy.extract(str(fmu), folder)
        description = fmpy.read_model_description(folder)
        reference = {v.name: v.valueReference for v in description.modelVariables}
        command, outputs = [reference["duty"]], [reference[n] for n in ("position", "velocity", "position_measured")]
        slave = FMU2Slave(
            guid=description.guid, unzipDirectory=folder, instanceName="axis",
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        slave.instantiate()
        release_at_exit(slave.dll._name)
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        clock, best = 0.0, 1e9
        for _ in range(repeat):
            begin = time.process_time()
            for u in COMMANDS[:2000]:
                slave.setReal(command, [u])
                slave.doStep(currentCommunicationPoint=clock, communicationStepSize=length)
                slave.getReal(outputs)
                clock += length
            best = min(best, (time.process_time() - begin) / 2000)
        slave.terminate()
        slave.freeInstance()
    return best


def row(title: str, values: list[float], beside: list[float] | None = None) -> None:
    """Microseconds by number of internal steps, and their ratio to what they are measured against."""
    pairs = zip(values, beside or [0.0] * len(values), strict=True)
    cells = (f"{1e6 * v:9.3f} " + (f"{v / b:6.2f} x" if b else 8 * " ") for v, b in pairs)
    print(f"  {title:43}" + " ".join(cells))


def bench_structure(title: str, model: Model, plain: Path, repeat: int, folder: Path) -> None:
    """Print the table of one structure."""
    fmus = {fmi: native_fmu.export_native(model, folder / f"native{fmi}.fmu", fmi) for fmi in (2, 3)}
    compiled = python_fmu.export(model, folder / "python.fmu")
    with mock.patch.object(compilers, "for_linux", lambda *_: None):
        text = python_fmu.export(model, folder / "text.fmu")
    lengths = [pieces * model.longest_step for pieces in PIECES]
    loop = [bare(model, pieces, repeat, folder) for pieces in PIECES]
    c = {fmi: [from_c(fmus[fmi], model, fmi, pieces, repeat) for pieces in PIECES] for fmi in fmus}
    share = min(from_fmpy(fmus[2], h, repeat) - seconds for h, seconds in zip(lengths, c[2], strict=True))

    def less_fmpy(fmu: Path, steps: list[float]) -> list[float]:
        return [from_fmpy(fmu, h, repeat) - share for h in steps]

    simplest = less_fmpy(plain, [0.002 * pieces for pieces in PIECES])
    print(f"{title}: us a communication step of" + ", ".join(f" {n}" for n in PIECES) + " internal steps")
    row("bare C loop", loop)
    row("native FMI 2, from C", c[2], loop)
    row("native FMI 3, from C", c[3], loop)
    row("FMPy's own share, whatever the steps", [share])
    row("plainest pythonfmu slave, less FMPy", simplest)
    row("pythonfmu FMU, less FMPy", less_fmpy(compiled, lengths), simplest)
    row("  the same where nothing compiled loads", less_fmpy(text, lengths), simplest)


def bench_fmu(repeat: int = 7) -> None:
    """Print what a communication step costs."""
    if not (sys.platform == "linux" and "x86_64" in compilers.compilers()[0].target.machine):
        print("what a step of the FMU costs is measured on Linux x86_64 only")
        return
    # The same compiler and flags for FMU and bare loop.
    with tempfile.TemporaryDirectory() as made, mock.patch.object(compilers, "has_zig", lambda: False):
        run([sys.executable, "-m", "pythonfmu", "build", "-f", str(SCRIPTS / "plain_motor.py")], Path(made))
        for title, structure in STRUCTURES.items():
            model = Model(structure, {p.name: VALUES.get(p.name, p.start) for p in structure.parameters})
            folder = Path(made) / structure.ids[-1]
            folder.mkdir()
            bench_structure(title, model, Path(made) / "PlainMotor.fmu", repeat, folder)
