"""C compilers: zig, which compiles for every platform, and the local one, which compiles for this."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from twin.errors import BadInput, install

#: Nothing that changes a number: no fused operations; a root is an instruction, since nobody asks for errno.
OPTIONS = (
    "-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
    "-Werror=implicit-function-declaration",
)  # fmt: skip


@dataclass(frozen=True)
class Target:
    """A platform: zig's name for it, FMI's names for its folder, and the ending of its libraries."""

    zig: str
    machine: str
    system: str
    folders: Mapping[int, str]
    suffix: str

    @property
    def name(self) -> str:
        """As people say it."""
        return f"{'macOS' if self.system == 'Darwin' else self.system} {self.machine}"


#: glibc 2.17 is older than any distribution still in use, so the Linux binaries load on all of them.
TARGETS: tuple[Target, ...] = (
    Target("x86_64-linux-gnu.2.17", "x86_64", "Linux", {2: "linux64", 3: "x86_64-linux"}, ".so"),
    Target("aarch64-linux-gnu.2.17", "aarch64", "Linux", {2: "aarch64-linux", 3: "aarch64-linux"}, ".so"),
    Target("x86_64-windows-gnu", "x86_64", "Windows", {2: "win64", 3: "x86_64-windows"}, ".dll"),
    Target("x86_64-macos", "x86_64", "Darwin", {2: "darwin64", 3: "x86_64-darwin"}, ".dylib"),
    Target("aarch64-macos", "aarch64", "Darwin", {2: "darwin64", 3: "aarch64-darwin"}, ".dylib"),
)


@dataclass(frozen=True)
class Compiler:
    """A command that compiles for one platform."""

    command: tuple[str, ...]
    target: Target

    def library(self, sources: Sequence[str], folder: Path, name: str) -> bytes:
        """The shared library of C files in a folder. Raises BadInput with what the compiler said."""
        place = Path(f"{self.target.machine}{self.target.system}") / f"{name}{self.target.suffix}"
        (folder / place.parent).mkdir(exist_ok=True)
        options = OPTIONS if self.target.system == "Windows" else (*OPTIONS, "-fPIC")
        told = [*self.command, *options, "-shared", "-o", str(place), *sources, "-lm"]
        done = subprocess.run(told, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            lines = done.stderr.strip().splitlines() or ["no message"]
            reason = next((line for line in lines if "error" in line), lines[0])
            compiler = "zig" if "ziglang" in self.command else self.command[0]
            where = f"{self.target.system} on {self.target.machine}"
            raise BadInput(f"the C compiler {compiler} failed for {where} ({reason}): can it build a shared library?")
        return (folder / place).read_bytes()


def has_zig() -> bool:
    return importlib.util.find_spec("ziglang") is not None


def _here() -> Target:
    name = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(name, name)
    for target in TARGETS:
        if (target.machine, target.system) == (machine, platform.system()):
            # Importers of FMI 2 look for any 64-bit Linux in linux64.
            return replace(target, folders={**target.folders, 2: "linux64"}) if target.system == "Linux" else target
    raise BadInput(
        f"no FMI name is known for {platform.system()} on {machine}: "
        f"{install('native', 'ziglang')}, and export for the platform of the importer"
    )


def compilers() -> tuple[Compiler, ...]:
    """One for every platform that can be compiled for, at least one. Raises BadInput where there is none."""
    if has_zig():
        zig = (sys.executable, "-m", "ziglang", "cc", "-s", "-target")
        return tuple(Compiler((*zig, target.zig), target) for target in TARGETS)
    local = os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if local is None:
        raise BadInput(
            "a native FMU needs a C compiler and none was found: "
            f"for one that serves all platforms {install('native', 'ziglang')}"
        )
    return (Compiler(tuple(local.split()), _here()),)


def for_linux(text: str, name: str) -> bytes | None:
    """C text as a shared library for Linux x86_64; None where nothing here compiles it."""
    with tempfile.TemporaryDirectory(prefix="twin-") as made, suppress(BadInput):
        folder = Path(made)
        (folder / f"{name}.c").write_text(text, encoding="utf-8")
        for compiler in compilers():
            if (compiler.target.machine, compiler.target.system) == ("x86_64", "Linux"):
                return compiler.library([f"{name}.c"], folder, name)
    return None


def universal(thin: Mapping[str, bytes]) -> bytes:
    """One macOS library from one for each machine (Mach-O "fat" file; its header is big-endian)."""
    kinds = {"x86_64": (0x01000007, 3), "aarch64": (0x0100000C, 0)}
    page = 14  # 16 KiB, what arm64 asks for
    offset, entries, body = 1 << page, b"", b""
    for machine, library in thin.items():
        entries += struct.pack(">5I", *kinds[machine], offset, len(library), page)
        padding = -len(library) % (1 << page)
        body += library + bytes(padding)
        offset += len(library) + padding
    head = struct.pack(">2I", 0xCAFEBABE, len(thin)) + entries
    return head.ljust(1 << page, b"\0") + body
