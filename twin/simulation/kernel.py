"""The compiled kernel: one for all structures (shapes without a name have a second), written from the laws.

Its code and numba's machine code are kept in the user's cache folder (`compile_cache`), under the hash of the files
that they come from. A changed law is another hash is another file.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Lock
from types import ModuleType

import numba
import numpy as np
import sympy
from numpy.typing import NDArray

from twin.codegen import forward_derivative, kalman_loops, likelihood_loops
from twin.codegen.python import Numbering, module, numbering, resolve
from twin.codegen.simd_derivatives import PRECISION, WIDTH
from twin.effects.catalogue import BASE, UNKNOWN
from twin.effects.effect import SLOTS
from twin.model.stepper import EVERYTHING, KNOWN, STATES, Structure
from twin.simulation.compile_cache import module_of

FloatArray = NDArray[np.float64]
Lanes = NDArray[np.float32]
#: Derivative of the initial state (states,) with respect to each parameter, by its name.
Tangents = Mapping[str, FloatArray]
_LOOPS = (
    *kalman_loops.LOOPS,
    likelihood_loops.judging,
    likelihood_loops.normalising,
    likelihood_loops.scaling,
    likelihood_loops.gathering,
)

_HEAD = """import numpy as np
from math import cos, exp, log, sin, sqrt, tanh
from numba import njit
from twin.codegen.simd_derivatives import numbers, put, row, settled, zero
from twin.simulation.compile_cache import kept"""

#: What the commonest structures consist of: the base and any of these. They have a stepper of their own, from the
#: same text, that does not ask for anything else.
COMMON = (*BASE, "tooth_compliance", "coulomb_friction", "friction_asymmetry", "constant_offset", "gravity")

#: The nameless curves take as long to compile as all named effects, and are rarely needed. A kernel of their own holds
#: them, with the same numbering.
NAMED = EVERYTHING.without(*UNKNOWN)

#: The files that the kernel is written from.
_SOURCES = (
    "effects/*.py", "model/stations.py", "model/stepper.py", "model/equations.py", "codegen/python.py",
    "codegen/sections.py", "codegen/forward_derivative.py", "codegen/kalman_loops.py", "codegen/likelihood_loops.py",
    "codegen/simd_derivatives.py", "simulation/kernel.py",
)  # fmt: skip

_LOADING = Lock()

#: Index of every parameter in the kernel's vector; the switches of the effects, of the slots and of the
#: common stepper follow them.
INDEX: dict[str, int] = {p.name: i for i, p in enumerate(EVERYTHING.parameters)}
_UNKNOWN = [len(INDEX) + EVERYTHING.ids.index(i) for i in UNKNOWN]


class _Index(ast.NodeTransformer):
    """index.name -> the parameter's number."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if isinstance(node.value, ast.Name) and node.value.id == "index":
            return ast.Constant(INDEX[node.attr])
        return node


def _stepper(numbers: Numbering, suffix: str = "") -> str:
    """Laws, stepper and their derivative, with a suffix to the name of each function."""
    text = ast.unparse(module(EVERYTHING, numbers=numbers)) + "\n\n\n" + forward_derivative.write(numbers)
    names = "|".join(re.findall(r"^def (\w+)", text, re.MULTILINE))
    return re.sub(rf"\b({names})\(", rf"\1{suffix}(", text)


def kernel_text(offered: Structure) -> str:
    """The whole source that is compiled, for structures made of the effects on offer."""
    every = numbering(EVERYTHING, True)
    numbers = every.offering((), offered.ids)
    steppers = [_stepper(numbers)]
    if offered == NAMED:
        steppers.append(_stepper(numbers.offering(BASE, COMMON), "_common"))
    loops = "\n".join(textwrap.dedent(inspect.getsource(f)) for f in _LOOPS)
    # The steppers become part of the loops.
    inline = "@njit(error_model='numpy', nogil=True, forceinline=True)\ndef "
    inlined = re.sub(r"^def ", inline, "\n\n\n".join(steppers), flags=re.M)
    # Without a common stepper the loops have no switch to it.
    switches = every if len(steppers) > 1 else numbers
    driven = ast.unparse(resolve(ast.unparse(_Index().visit(ast.parse(loops))), switches))
    cached = re.sub(r"^def ", "@kept\n@njit(error_model='numpy', nogil=True)\ndef ", driven, flags=re.M)
    return "\n\n\n".join([_HEAD, inlined, cached]) + "\n"


def _code(text: str) -> str:
    """What a file does: its text without comments and docstrings."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body[0] = ast.Pass()
    return ast.dump(tree)


def _fingerprint(offered: Structure) -> str:
    """Hash of the code that the kernel is written from, and of what is on offer in it.

    Comments and docstrings do not count: a better sentence is no reason to compile for a minute.
    """
    digest = hashlib.sha256(f"{numba.__version__} {sympy.__version__} {offered!r}".encode())
    root = Path(__file__).parents[1]
    for path in (file for pattern in _SOURCES for file in sorted(root.glob(pattern))):
        digest.update(_code(path.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()[:16]


@cache
def _loaded(offered: Structure) -> ModuleType:
    return module_of(f"twin_kernel_{_fingerprint(offered)}", lambda: kernel_text(offered))


def compiled(offered: Structure = NAMED) -> ModuleType:
    """The kernel's module; writes it on the first call on a machine, which the first of several threads does.

    Python 3.11 counts the depth of syntax trees for all threads together, and fails where two of them make one.
    """
    with _LOADING:
        return _loaded(offered)


def _serving(p: FloatArray) -> ModuleType:
    """The kernel that has the laws which `p` switches on."""
    return compiled(EVERYTHING) if p[_UNKNOWN].any() else compiled()


@cache
def _unset(structure: Structure) -> FloatArray:
    """The vector of a structure whose parameters all have their start value."""
    common = set(BASE) <= set(structure.ids) <= set(COMMON)
    switches = [*(i in structure for i in EVERYTHING.ids), *(slot in structure.slots for slot in SLOTS), common]
    return np.array([q.start for q in EVERYTHING.parameters] + [float(on) for on in switches])


def vector(structure: Structure, values: dict[str, float]) -> FloatArray:
    """Parameters and switches in the kernel's order; parameters of absent effects at their start value."""
    p = _unset(structure).copy()
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
    law: FloatArray  # (5,) gains on reference, output, velocity, largest and smallest command; all zero where open
    longest: float  # s, longest internal step

    @property
    def closed(self) -> bool:
        return bool(self.law.any())


def start_state(position: float, velocity: float, gap: float) -> FloatArray:
    """States at the start: motor and link at one speed, the motor `gap` ahead of the link."""
    x = np.zeros(len(STATES))
    x[0], x[1], x[2], x[3] = position, velocity, gap, velocity
    return x


@dataclass(frozen=True)
class Noise:
    """What a filter believes, in units of the variance of a reading."""

    density: float  # of the torque noise: 1/s^3 (positions) or 1/s (speeds)
    position: float = 1.0  # variance at the start
    velocity: float = 1.0
    silence: float = math.inf  # s without a reading, after which it begins anew

    @property
    def vector(self) -> FloatArray:
        return np.array([self.density, self.position, self.velocity, self.silence])


#: No noise: a free run from the initial state.
FREE = Noise(0.0)


@dataclass(frozen=True, eq=False)
class Prediction:
    """One recording through the model; what was not asked for has no rows."""

    reading: FloatArray  # (N,) what the sensor should read, NaN where a filter begins anew
    spread: FloatArray  # (N,) variance to expect of an innovation, in units of the reading's
    pull: FloatArray  # (N,) velocity (1/s) of the mass centre that a unit of innovation adds
    states: FloatArray  # (N, states)
    slopes: FloatArray  # (N, n) of the reading


def predict(drive: Drive, p: FloatArray, x: FloatArray, noise: Noise = FREE, keep_states: bool = False) -> Prediction:
    """Run a recording through the model from the state `x` (states,), which is left as it was."""
    count = len(drive.time)
    kept = count if keep_states else 0
    predicted, spread, pull, states = np.empty(count), np.empty(count), np.zeros(kept), np.empty((kept, len(STATES)))
    _serving(p).predict(
        drive.time, drive.command.copy() if drive.closed else drive.command, drive.measured, noise.vector, drive.speed,
        drive.closed, drive.law, x.copy(), p, drive.known, drive.longest, predicted, spread, pull, states,
    )  # fmt: skip
    return Prediction(predicted, spread, pull, states, np.zeros((count, 0)))


def _aligned(*shape: int) -> Lanes:
    """Room for derivatives whose rows of `WIDTH` begin where the processor likes vectors to begin."""
    count = int(np.prod(shape))
    room = np.empty(count + WIDTH, dtype=PRECISION)
    first = -(room.ctypes.data // room.itemsize) % WIDTH
    return room[first : first + count].reshape(shape)


def fixed_start(names: Iterable[str]) -> dict[str, FloatArray]:
    """The tangents of parameters that do not move the initial state."""
    return {name: np.zeros(len(STATES)) for name in names}


def in_pieces(
    drive: Drive, p: FloatArray, x: FloatArray, tangents: Tangents, noise: Noise, most: int
) -> Iterator[tuple[slice, Prediction]]:
    """As `predict`, with the derivative with respect to some parameters, at most so many stamps at a time.

    Yields the stamps and what holds there. Raises ValueError where a parameter is named that is never fitted.
    """
    names, slope = tuple(tangents), np.array(list(tangents.values())).reshape(-1, len(STATES)).T
    if never := forward_derivative.NEVER.intersection(names):
        raise ValueError(f"no derivative was written for what is never fitted: {', '.join(sorted(never))}")
    n, count = len(names), len(drive.time)
    blocks = max(-(-n // WIDTH), 1)
    carried = []
    for block in range(blocks):
        here = names[block * WIDTH : (block + 1) * WIDTH]
        seed, start = _aligned(len(INDEX), WIDTH), _aligned(len(STATES), WIDTH)
        seed[:], start[:] = 0.0, 0.0
        start[:, : len(here)] = slope[:, block * WIDTH : block * WIDTH + len(here)]
        for j, name in enumerate(here):
            if name in INDEX:
                seed[INDEX[name], j] = 1.0
        command = drive.command.copy() if drive.closed else drive.command
        carried.append((x.copy(), start, seed, np.empty(11), command, _aligned(count if drive.closed else 1, WIDTH)))
    serving = _serving(p)
    for begin in range(0, count, most):
        room = min(most, count - begin)
        # Every block fills the same numbers in; of its own it has the slopes.
        predicted, slopes = np.empty((blocks, 2, room)), _aligned(room, blocks, WIDTH)

        def run(block: int, begin: int = begin, predicted: FloatArray = predicted, slopes: Lanes = slopes) -> None:
            state, d_state, seed, covariance, command, d_command = carried[block]
            serving.predict_t(
                drive.time, command, drive.measured, noise.vector, drive.speed, drive.closed, drive.law, state,
                d_state, p, seed, drive.known, drive.longest, begin, covariance, predicted[block, 0],
                predicted[block, 1], slopes, block, d_command,
            )  # fmt: skip

        if blocks == 1:
            run(0)
        else:
            with ThreadPoolExecutor(2) as pool:
                list(pool.map(run, range(blocks)))
        reading, spread = predicted[0]
        none = np.zeros(0)
        own = slopes.reshape(room, -1)[:, :n].astype(float)
        yield slice(begin, begin + room), Prediction(reading, spread, none, np.zeros((0, len(STATES))), own)


def predict_with_slopes(
    drive: Drive, p: FloatArray, x: FloatArray, tangents: Tangents, noise: Noise = FREE
) -> Prediction:
    """All of `in_pieces` at once."""
    return next(in_pieces(drive, p, x, tangents, noise, len(drive.time)))[1]


def warm(structure: Structure) -> None:
    """Have the kernel that serves the structure compiled where this machine has not yet."""
    time = np.arange(8, dtype=float)
    drive = Drive(time, time, time.copy(), False, known_vector({}), np.zeros(5), 0.5)
    p = vector(structure, {})
    start = start_state(0.0, 0.0, 0.0)
    predict_with_slopes(drive, p, start, fixed_start(["input_gain"]))
    predict(drive, p, start)


def known_vector(known: Mapping[str, float]) -> FloatArray:
    """The recording's known quantities in the kernel's order; absent ones are zero."""
    return np.array([float(known.get(name, 0.0)) for name in KNOWN])
