"""What a communication step costs: native FMU from a C master, from FMPy, and the Python FMU, as ratios.

Figures are the fastest of several runs; on a busy machine read the ratios.
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

from twin import native
from twin.axis import Structure
from twin.effects.catalogue import BASE
from twin.model import Model
from twin.native import OPTIONS, export_native, identity
from twin.package import export

MASTER = Path(__file__).with_name("master.c")
STRUCTURES = {
    "first-order motor": Structure.of(("inertia", "viscous_friction")),
    "two bodies, dry friction, gravity": Structure.of((*BASE, "tooth_compliance", "coulomb_friction", "gravity")),
}
VALUES = {"input_gain": 1.2, "viscous_friction": 3.0, "dead_band_forward": 4.0, "dead_band_reverse": 3.0,
          "backlash_gap": 0.02, "coulomb_friction": 2.0, "gravity_gain": 5.0}  # fmt: skip
COMMANDS = "\n".join(str(40 + i % 30) for i in range(20000))

BARE = """
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <math.h>
typedef enum { NEVER, BEFORE_START, ANY_TIME } Settable;
typedef struct { const char *name; size_t slot; double least, most; Settable settable; } Variable;
#include "model.h"
static double command[100000];
static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return t.tv_sec + 1e-9 * t.tv_nsec; }
int main(int argc, char **argv)
{
    int count = 0, pieces = atoi(argv[1]), repeat = atoi(argv[2]);
    (void)argc, (void)variables;
    while (count < 100000 && scanf("%lf", &command[count]) == 1) ++count;
    double h = atof(argv[3]) / pieces, best = 1e9, last = 0.0;
    for (int r = 0; r < repeat; ++r) {
        double slot[SLOTS];
        for (int i = 0; i < SLOTS; ++i) slot[i] = compiled_in[i];
        double begin = now();
        for (int i = 0; i < count; ++i)
            for (int j = 0; j < pieces; ++j)
                step(slot + FIRST_STATE, slot + FIRST_PARAMETER, slot + FIRST_KNOWN, command[i], h);
        double took = (now() - begin) / count;
        if (took < best) best = took;
        last = slot[FIRST_STATE] + sensor(slot[FIRST_STATE], slot + FIRST_PARAMETER);
    }
    fprintf(stderr, "%g\\n", last);
    printf("%.17g\\n", best);
    return 0;
}
"""

PLAIN = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Plain(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.duty, self.position, self.velocity, self.position_measured = 0.0, 0.0, 0.0, 0.0
        self.c, self.b = 1.2, 3.0
        self.register_variable(Real("duty", causality=Fmi2Causality.input, start=0.0))
        for name in ("position", "velocity", "position_measured"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        for name in ("c", "b"):
            tunable = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
            self.register_variable(Real(name, **tunable))

    def do_step(self, time, length):
        n = max(1, int(length / 0.002 + 0.999999))
        h = length / n
        for _ in range(n):
            self.velocity += h * (self.c * self.duty - self.b * self.velocity)
            self.position += h * self.velocity
        self.position_measured = self.position
        return True
"""


def run(command: list[str], folder: Path, given: str = "") -> str:
    return subprocess.run(command, cwd=folder, input=given, check=True, capture_output=True, text=True).stdout


def bare(model: Model, pieces: int, repeat: int, folder: Path) -> float:
    """Seconds that the physics alone takes for one communication step."""
    (folder / "model.h").write_text(native.sources(native.of_axis(model), 2)["model.h"])
    (folder / "bare.c").write_text(BARE)
    run(["cc", *OPTIONS, "-D_POSIX_C_SOURCE=200809L", "-o", "bare", "bare.c", "-lm"], folder)
    return float(run(["./bare", str(pieces), str(repeat), repr(pieces * model.longest_step)], folder, COMMANDS))


def from_c(model: Model, fmi: int, pieces: int, repeat: int, folder: Path) -> float:
    """Seconds for set + step + get, called from C."""
    fmu = export_native(model, folder / f"axis{fmi}.fmu", fmi, force=True)
    zipfile.ZipFile(fmu).extractall(folder / f"x{fmi}")
    who = identity(model)
    place = {2: "linux64", 3: "x86_64-linux"}[fmi]
    library = folder / f"x{fmi}" / "binaries" / place / f"{who.identifier}.so"
    resources = folder / f"x{fmi}" / "resources"
    spec = importlib.util.find_spec("fmpy")
    assert spec is not None and spec.origin is not None
    headers = Path(spec.origin).parent / "c-code"
    run(["cc", "-O2", "-std=c99", "-I", str(headers), "-o", "master", str(MASTER), "-ldl"], folder)
    told = [str(library), str(fmi), who.token, resources.as_uri() if fmi == 2 else f"{resources}/"]
    return float(run(["./master", *told, repr(pieces * model.longest_step), str(repeat)], folder, COMMANDS))


def from_fmpy(fmu: Path, length: float, repeat: int, folder: Path) -> float:
    """Seconds for set + step + get of an FMI 2 FMU, called from FMPy."""
    fmpy.extract(str(fmu), str(folder))
    description = fmpy.read_model_description(str(folder))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    outputs = [reference[n] for n in ("position", "velocity", "position_measured")]
    slave = FMU2Slave(
        guid=description.guid, unzipDirectory=str(folder), instanceName="axis",
        modelIdentifier=description.coSimulation.modelIdentifier,
    )  # fmt: skip
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    count, clock, best = 2000, 0.0, 1e9
    for _ in range(repeat):
        begin = time.perf_counter()
        for i in range(count):
            slave.setReal([reference["duty"]], [40.0 + i % 30])
            slave.doStep(currentCommunicationPoint=clock, communicationStepSize=length)
            slave.getReal(outputs)
            clock += length
        best = min(best, (time.perf_counter() - begin) / count)
    slave.terminate()
    slave.freeInstance()
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=7)
    repeat = parser.parse_args().repeat
    native._has_zig = lambda: False  # the same compiler and flags for both sides
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "plain.py").write_text(PLAIN)
        run([sys.executable, "-m", "pythonfmu", "build", "-f", "plain.py"], folder)
        for title, structure in STRUCTURES.items():
            model = Model(structure, {p.name: VALUES.get(p.name, p.start) for p in structure.parameters})
            python = export(model, folder / "python.fmu", force=True)
            print(f"{title}: microseconds a communication step (set + step + get)")
            for pieces in (1, 10, 100):
                length = pieces * model.longest_step
                loop = bare(model, pieces, repeat, folder)
                c2, c3 = (from_c(model, fmi, pieces, repeat, folder) for fmi in (2, 3))
                key = f"{structure.ids[-1]}{pieces}"
                by_fmpy = from_fmpy(folder / "axis2.fmu", length, repeat, folder / f"n{key}")
                slave = from_fmpy(python, length, repeat, folder / f"p{key}")
                plain = from_fmpy(folder / "Plain.fmu", pieces * 0.002, repeat, folder / f"q{key}")
                print(f"  {pieces:3d} internal steps: bare C {1e6 * loop:.3f}; native FMI 2 {1e6 * c2:.3f}"
                      f" ({c2 / loop:.2f} x), FMI 3 {1e6 * c3:.3f} ({c3 / loop:.2f} x);"
                      f" FMPy adds {1e6 * (by_fmpy - c2):.2f}")  # fmt: skip
                print(f"      through pythonfmu {1e6 * slave:.2f}, plainest slave {1e6 * plain:.2f}"
                      f" ({slave / plain:.2f} x)")  # fmt: skip


if __name__ == "__main__":
    main()
