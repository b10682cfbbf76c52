"""The binaries of the native FMU for every platform: what they are, and what a host without Python makes of them."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import struct
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest
from controlled_axis import EFFECTS, ENDS, INPUTS, axis
from native_axis import EVERYTHING, PERIOD, by_kernel, command, model_of

from twin.control import controller_fmu
from twin.control.cosimulation import Runner
from twin.control.design import design
from twin.fmi import compilers
from twin.fmi.fmu_archive import open_fmu
from twin.fmi.fmu_instance import running
from twin.fmi.native_fmu import export_native
from twin.model.stepper import BASE, Structure

MASTER = Path(__file__).resolve().parents[2] / "scripts" / "master.c"
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")
FOLDERS = {
    2: {"linux": "linux64", "aarch64": "aarch64-linux", "windows": "win64"},
    3: {"linux": "x86_64-linux", "aarch64": "aarch64-linux", "windows": "x86_64-windows"},
}
pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("ziglang") is None, reason="the extra `native` (ziglang) is not installed"
)


#: All effects in the one and a few in the other, which is compiled five times as fast.
AXES = {2: EVERYTHING, 3: Structure.of((*BASE, "coulomb_friction", "gravity", "motor_lag"))}


@pytest.fixture(scope="module", params=AXES)
def unpacked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    fmi = request.param
    folder = tmp_path_factory.mktemp(f"fmi{fmi}")
    fmu = export_native(model_of(AXES[fmi]), folder / "axis.fmu", fmi)
    zipfile.ZipFile(fmu).extractall(folder / "x")
    return folder / "x", fmi


def library(folder: Path, place: str) -> Path:
    (found,) = (folder / "binaries" / place).iterdir()
    return found


def test_each_is_what_its_folder_says(unpacked: tuple[Path, int]) -> None:
    folder, fmi = unpacked
    for place, machine in ((FOLDERS[fmi]["linux"], 62), (FOLDERS[fmi]["aarch64"], 183)):
        elf = library(folder, place).read_bytes()
        assert elf[:5] == b"\x7fELF\x02" and struct.unpack_from("<HH", elf, 16) == (3, machine)
        assert max(int(v) for v in re.findall(rb"GLIBC_2\.(\d+)", elf)) <= 17
    dll = library(folder, FOLDERS[fmi]["windows"])
    pe = dll.read_bytes()
    header = struct.unpack_from("<I", pe, 0x3C)[0]
    assert pe[header : header + 6] == b"PE\0\0\x64\x86"
    needed = {name.lower() for name in re.findall(rb"[\w.-]+\.dll", pe)} - {dll.name.encode()}
    assert needed and all(name == b"kernel32.dll" or name.startswith(b"api-ms-win-crt-") for name in needed)
    machines = {0x01000007: "x86_64", 0x0100000C: "aarch64"}
    if fmi == 3:
        for kind, name in machines.items():
            macho = library(folder, f"{name}-darwin").read_bytes()
            assert struct.unpack_from("<II", macho) == (0xFEEDFACF, kind)
    else:
        fat = library(folder, "darwin64").read_bytes()
        assert struct.unpack_from(">II", fat) == (0xCAFEBABE, 2)
        for i, kind in enumerate(machines):
            said, _, offset, size, align = struct.unpack_from(">5I", fat, 8 + 20 * i)
            assert said == kind and offset % (1 << align) == 0 and offset + size <= len(fat)
            assert struct.unpack_from("<II", fat, offset) == (0xFEEDFACF, kind)


def host(target: str, folder: Path) -> Path:
    """The small C master, compiled for a target."""
    fmpy = importlib.util.find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None
    headers = Path(fmpy.origin).parent / "c-code"
    out = folder / "master.exe"
    # Without symbols and not beside zig, as the libraries: for each such choice it makes Windows' C library anew, in a
    # minute and a half.
    zig = [sys.executable, "-m", "ziglang", "cc", "-s", "-target", target, "-O2", "-std=c99", "-I", str(headers)]
    more = [] if "windows" in target else ["-ldl"]
    subprocess.run([*zig, "-o", str(out), str(MASTER), *more], check=True, cwd=folder)
    return out


#: Words that the headers of Windows define, so that no source may use them as names.
TAKEN = ("far=", "near=", "pascal=", "IN=", "OUT=", "interface=struct", "small=char", "DELETE=1", "ERROR=0")


def test_sources_are_read_in_the_dialect_of_microsofts_compiler(unpacked: tuple[Path, int]) -> None:
    folder, _ = unpacked
    dialect = ["-std=c99", "-fms-compatibility", "-fms-extensions", *(f"-D{word}" for word in TAKEN)]
    # The constant is that of this machine's headers, and brackets too many do no harm.
    allowed = ["-Wno-unused-parameter", "-Wno-literal-range", "-Wno-parentheses-equality"]
    strict = ["-Wall", "-Wextra", "-Werror", *allowed, "-c"]
    sources = sorted((folder / "sources").glob("*.c"))
    assert sources
    for source in sources:
        clang = [sys.executable, "-m", "ziglang", "cc", *dialect, *strict, str(source), "-o", str(folder / "read.o")]
        read = subprocess.run(clang, capture_output=True, text=True)
        assert read.returncode == 0, read.stderr


@pytest.fixture(scope="module")
def wine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where wine keeps its Windows: making one takes it longer than all the rest."""
    return tmp_path_factory.mktemp("wine")


RUNNERS = {
    "linux": ("x86_64-linux-gnu.2.17", ()),
    "aarch64": ("aarch64-linux-gnu.2.36", ("qemu-aarch64", "-L", str(ARM_LIBRARIES))),
    "windows": ("x86_64-windows-gnu", ("wine",)),
}


@pytest.mark.skipif(sys.platform != "linux", reason="the emulators run on Linux")
@pytest.mark.parametrize("where", RUNNERS)
def test_runs_in_a_host_without_python(where: str, unpacked: tuple[Path, int], wine: Path, tmp_path: Path) -> None:
    folder, fmi = unpacked
    target, runner = RUNNERS[where]
    if runner and shutil.which(runner[0]) is None:
        pytest.skip(f"{runner[0]} is not installed")
    if where == "aarch64" and not ARM_LIBRARIES.is_dir():
        pytest.skip("the C library for aarch64 (libc6-arm64-cross) is not installed")
    description = ET.parse(folder / "modelDescription.xml").getroot()
    token = description.get("guid" if fmi == 2 else "instantiationToken")
    place = ("Z:" if where == "windows" else "") + str(folder / "resources")
    resources = f"file://{'/' if where == 'windows' else ''}{place}" if fmi == 2 else f"{place}/"
    u = command(1025)
    done = subprocess.run(
        [*runner, str(host(target, tmp_path)), str(library(folder, FOLDERS[fmi][where])), str(fmi), token, resources,
         repr(PERIOD)],
        input="\n".join(map(repr, u[:-1].tolist())), capture_output=True, text=True,
        env={**os.environ, "WINEDEBUG": "-all", "WINEPREFIX": str(wine)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    got = np.array([[float(v) for v in line.split()] for line in done.stdout.splitlines()])
    expected = by_kernel(model_of(AXES[fmi]), u, 0.0, 0.0)[1:, :3]
    assert np.max(np.abs(got - expected) / np.max(np.abs(expected), axis=0)) < 1e-10


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_controller_is_compiled_for_every_platform(tmp_path: Path, fmi: int) -> None:
    made = design(axis(*ENDS, **EFFECTS))
    fmu = controller_fmu.export_native(made, tmp_path / "controller.fmu", fmi)
    folders = {name.split("/")[1] for name in zipfile.ZipFile(fmu).namelist() if name.startswith("binaries/")}
    assert folders == {target.folders[fmi] for target in compilers.TARGETS}
    with running(open_fmu(fmu), INPUTS, ["duty"]) as ruler:
        ruler.start({})
        wanted = [0.001, 0.0, 0.0]
        got = [ruler.step(i * made.sample_time, made.sample_time, [*wanted, 0.0])[0] for i in range(20)]
    text = Runner(made)
    np.testing.assert_allclose(got, [text.sample(*wanted, 0.0) for _ in range(20)], rtol=1e-9)
