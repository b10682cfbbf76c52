"""The compiled kernel: one for all structures, written from the laws, compiled once and kept.

The text is written to the user's cache folder under the hash of its content and compiled there by numba, which
keeps the machine code beside it. A changed law is a changed text is another file.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import os
import sys
import tempfile
import textwrap
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.axis import EVERYTHING, KNOWN, STATES, Structure
from twin.effects.catalogue import UNKNOWN
from twin.effects.effect import SLOTS
from twin.lanes import WIDTH
from twin.writers import drivers, tangent
from twin.writers.python import module, numbering, resolve

FloatArray = NDArray[np.float64]
_LOOPS = (drivers.predict, drivers.predict_t, drivers.riccati)

#: Index of every parameter in the kernel's vector; the switches of the effects and of the slots follow them.
INDEX: dict[str, int] = {p.name: i for i, p in enumerate(EVERYTHING.parameters)}

#: The shapes without a name take as long to compile as all that has one and are rarely asked for: a kernel of their
#: own holds them, with the same numbering.
NAMED = EVERYTHING.without(*UNKNOWN)
_UNKNOWN = [len(INDEX) + EVERYTHING.ids.index(i) for i in UNKNOWN]


def cache_folder() -> Path:
    """Where compiled kernels are kept: $TWIN_CACHE, or the platform's cache folder."""
    if chosen := os.environ.get("TWIN_CACHE"):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", tempfile.gettempdir())) / "twin"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "twin"


class _Index(ast.NodeTransformer):
    """index.name -> the parameter's number."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if isinstance(node.value, ast.Name) and node.value.id == "index":
            return ast.Constant(INDEX[node.attr])
        return node


def kernel_text(laws: Structure = EVERYTHING) -> str:
    """The whole source that is compiled, with the laws of these effects."""
    numbers = numbering(EVERYTHING, True)
    loops = "\n".join(textwrap.dedent(inspect.getsource(f)) for f in _LOOPS)
    text = "\n\n\n".join(
        [
            "import numpy as np\nfrom math import cos, exp, sin, sqrt, tanh\nfrom numba import njit\n"
            "from twin.lanes import put, row, zero",
            ast.unparse(module(EVERYTHING, True, laws)),
            tangent.write(laws),
            ast.unparse(resolve(ast.unparse(_Index().visit(ast.parse(loops))), numbers)),
        ]
    )
    return text.replace("\ndef ", "\n@njit(cache=True, error_model='numpy', nogil=True)\ndef ") + "\n"


@cache
def compiled(laws: Structure = NAMED) -> ModuleType:
    """The kernel's module; compiles on the first call on a machine."""
    text = kernel_text(laws)
    name = "twin_kernel_" + hashlib.sha256(text.encode()).hexdigest()[:16]
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = tempfile.NamedTemporaryFile(dir=folder, suffix=".py", delete=False)  # noqa: SIM115
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="twin-"))
        probe = tempfile.NamedTemporaryFile(dir=folder, suffix=".py", delete=False)  # noqa: SIM115
    path = folder / f"{name}.py"
    with probe:
        probe.write(text.encode())
    if path.exists():
        Path(probe.name).unlink()
    else:
        Path(probe.name).replace(path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[name] = loaded
    spec.loader.exec_module(loaded)
    return loaded


def _serving(p: FloatArray) -> ModuleType:
    """The kernel that has the laws which `p` switches on."""
    return compiled(EVERYTHING) if p[_UNKNOWN].any() else compiled()


def vector(structure: Structure, values: dict[str, float]) -> FloatArray:
    """Parameters and switches in the kernel's order; parameters of absent effects at their start value."""
    switches = [i in structure for i in EVERYTHING.ids] + [slot in structure.slots for slot in SLOTS]
    p = np.array([q.start for q in EVERYTHING.parameters] + [float(on) for on in switches])
    for name, value in values.items():
        p[INDEX[name]] = value
    return p


@dataclass(frozen=True, eq=False)
class Drive:
    """What the kernel needs of one recording, beside the parameters."""

    time: FloatArray  # (N,) s
    command: FloatArray  # (N,) input's unit; the reference where the loop is closed
    measured: FloatArray  # (N,) output's unit, NaN where left out
    speed: bool  # the output is a speed
    known: FloatArray  # (len(KNOWN),)
    law: FloatArray  # (4,) gains on reference, output, velocity and the limit; all zero where open
    longest: float  # s, longest internal step

    @property
    def closed(self) -> bool:
        return bool(self.law.any())


def start_state(position: float, velocity: float, gap: float) -> FloatArray:
    """States at the start: motor and link at one speed, the motor `gap` ahead of the link."""
    x = np.zeros(len(STATES))
    x[0], x[1], x[2], x[3] = position, velocity, gap, velocity
    return x


def free_gains(count: int) -> FloatArray:
    return np.zeros((count, 2))


def predict(
    drive: Drive, p: FloatArray, x: FloatArray, gains: FloatArray, keep_states: bool = False
) -> tuple[FloatArray, FloatArray]:
    """What the sensor should read (N,), and the states (N, 7) or (0, 7). `x` (7,) is left as it was."""
    predicted = np.empty(len(drive.time))
    states = np.empty((len(drive.time) if keep_states else 0, len(STATES)))
    _serving(p).predict(
        drive.time, drive.command.copy() if drive.closed else drive.command, drive.measured, gains, drive.speed,
        drive.closed, drive.law, x.copy(), p, drive.known, drive.longest, predicted, states,
    )  # fmt: skip
    return predicted, states


def predict_with_slopes(
    drive: Drive, p: FloatArray, x: FloatArray, slope: FloatArray, names: tuple[str, ...], gains: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """As `predict`, with the derivative (N, n) with respect to the named parameters.

    `slope` (7, n) is the derivative of the initial state.
    """
    n, count = len(names), len(drive.time)
    blocks = max(-(-n // WIDTH), 1)
    seed = np.zeros((len(INDEX), blocks * WIDTH))
    for j, name in enumerate(names):
        if name in INDEX:
            seed[INDEX[name], j] = 1.0
    start = np.zeros((len(STATES), blocks * WIDTH))
    start[:, :n] = slope
    predicted, slopes = np.empty(count), np.empty((count, blocks, WIDTH))
    for block in range(blocks):
        columns = slice(block * WIDTH, (block + 1) * WIDTH)
        _serving(p).predict_t(
            drive.time, drive.command.copy() if drive.closed else drive.command, drive.measured, gains, drive.speed,
            drive.closed, drive.law, x.copy(), start[:, columns].copy(), p, seed[:, columns].copy(), drive.known,
            drive.longest, predicted, slopes, block, np.zeros((count if drive.closed else 1, WIDTH)),
        )  # fmt: skip
    return predicted, slopes.reshape(count, -1)[:, :n]


def kalman(
    drive: Drive, damping: float, density: float, start: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Gains (N, 2) and innovation variances (N,), in units of the reading's variance."""
    gains, spread = np.empty((len(drive.time), 2)), np.empty(len(drive.time))
    compiled().riccati(
        drive.time, drive.measured, damping, density, drive.speed, np.array(start), gains, spread
    )
    return gains, spread


def known_vector(known: dict[str, float] | Any) -> FloatArray:
    """The recording's known quantities in the kernel's order; absent ones are zero."""
    return np.array([float(known.get(name, 0.0)) for name in KNOWN])
