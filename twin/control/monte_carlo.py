"""The loop over everything that the identified parameters may be: compiled, by the hundred.

The plant is drawn from the model's covariance; the controller stays. One kernel serves all structures: laws, stepper
and controller with every effect behind a switch, compiled once per machine and kept. Where there are shapes
without a name there is one with these.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import math
import textwrap
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.codegen import control_law
from twin.codegen.python import numbering, resolve
from twin.control.controller import Controller
from twin.control.reference import Reference, check, make_reference
from twin.effects.catalogue import UNKNOWN
from twin.errors import BadInput
from twin.model.fitted_model import Model
from twin.model.stepper import EVERYTHING, STATES, Structure
from twin.simulation.compile_cache import module_of
from twin.simulation.kernel import NAMED, known_vector, start_state, vector

FloatArray = NDArray[np.float64]
DRAWS = 200
ENOUGH = 0.95  # share of the draws that must meet the specification


class _Plant(ast.NodeTransformer):
    """on.effect and late.name -> places in the plant's own vector."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        holder = node.value.id if isinstance(node.value, ast.Name) else ""
        names = [p.name for p in EVERYTHING.parameters]
        if holder == "on":
            place = len(names) + EVERYTHING.ids.index(node.attr)
            return ast.parse(f"plant[{place}] != 0.0", mode="eval").body
        if holder == "late":
            return ast.parse(f"plant[{names.index(node.attr)}]", mode="eval").body
        return node


def kernel_text(offered: Structure) -> str:
    """The whole source that is compiled, for structures made of the effects on offer."""
    loop = _Plant().visit(ast.parse(textwrap.dedent(inspect.getsource(control_law.follow))))
    text = control_law.write_switched(offered) + "\n\n"
    text += ast.unparse(resolve(ast.unparse(ast.fix_missing_locations(loop)), numbering(EVERYTHING, True)))
    text = text.replace("\ndef ", "\n@kept\n@njit(nogil=True, error_model='numpy')\ndef ")
    return "from numba import njit\nfrom twin.simulation.compile_cache import kept\n" + text + "\n"


@cache
def compiled(offered: Structure) -> ModuleType:
    """The kernel's module; compiles on the first call on a machine."""
    text = kernel_text(offered)
    return module_of("twin_loop_" + hashlib.sha256(text.encode()).hexdigest()[:16], lambda: text)


def serving(model: Model, controller: Controller) -> ModuleType:
    """The kernel that has the laws of both: shapes without a name, which take long to compile, only where they are."""
    return compiled(NAMED.with_(*(i for i in UNKNOWN if i in model.structure or i in controller.structure)))


def trial(model: Model, controller: Controller, reference: Reference) -> tuple[FloatArray, FloatArray]:
    """Positions and commands (N,) of the compiled loop; NaN from where it ran away."""
    n = len(reference.time)
    position, command = np.full(n, math.nan), np.full(n, math.nan)
    states = len(STATES)
    start = start_state(float(reference.position[0]), 0.0, 0.0)
    start[-1] = model.time_start
    serving(model, controller).follow(
        reference.time,
        reference.position,
        reference.velocity,
        reference.acceleration,
        start,
        vector(model.structure, dict(model.values)),
        known_vector(model.known),
        model.longest_step,
        np.zeros(states),
        np.zeros(states),
        np.zeros(len(control_law.MEMORY)),
        np.zeros(int(controller.settings["whole"]) + 2),
        vector(controller.structure, dict(controller.values)),
        np.array(controller.settings_list),
        np.array(controller.known_list),
        position,
        command,
    )
    return position, command


@dataclass(frozen=True, eq=False)
class Robustness:
    """Tracking over draws of the plant. Errors (N,) in the axis' unit; infinite where the loop ran away."""

    rms: FloatArray
    peak: FloatArray
    specification: float  # largest peak error that is acceptable
    share: float  # of the draws within it
    learn: str | None  # the parameter whose uncertainty costs most, where the share is too small
    says: tuple[str, ...]

    @property
    def median(self) -> float:
        return float(np.median(self.peak))

    @property
    def worst(self) -> float:
        return float(np.max(self.peak))


def draw(model: Model, count: int, seed: int = 0) -> list[Model]:
    """Models whose fitted parameters are drawn from the joint covariance, within their bounds."""
    if not model.fitted:
        raise BadInput("the model has no covariance to draw from: identify it from a recording")
    rng = np.random.default_rng(seed)
    mean = np.array([model.values[n] for n in model.fitted])
    # What left no trace where it was looked for keeps its value.
    told = np.isfinite(np.diag(model.covariance))
    drawn = np.tile(mean, (count, 1))
    drawn[:, told] = rng.multivariate_normal(mean[told], model.covariance[np.ix_(told, told)], count, method="eigh")
    low = np.array([model.parameter(n).lower for n in model.fitted])
    high = np.array([model.parameter(n).upper for n in model.fitted])
    # A gain at its lower bound of zero would be no axis at all.
    low = np.where([n == "input_gain" for n in model.fitted], 0.05 * mean, low)
    drawn = np.clip(drawn, low, high)
    return [model.with_values(dict(zip(model.fitted, map(float, row), strict=True))) for row in drawn]


def robustness(
    model: Model,
    controller: Controller,
    reference: Reference | None = None,
    draws: int = DRAWS,
    specification: float | None = None,
    progress: Callable[[int], Any] | None = None,
) -> Robustness:
    """Tracking over `draws` plants drawn from the model's covariance, on two threads.

    `specification` is the peak error that is acceptable (2 % of the reference's travel unless given).
    `progress` is told after each draw how many are done. Raises BadInput without a covariance.
    """
    wanted = make_reference("minimum-jerk", controller) if reference is None else reference
    check(wanted, controller)
    if draws < 2:
        raise BadInput(f"{draws} draws say nothing: ask for 2 or more")
    plants = draw(model, draws, seed=0)
    rms, peak = np.empty(draws), np.empty(draws)
    serving(model, controller)

    def one(i: int) -> None:
        position, _ = trial(plants[i], controller, wanted)
        error = position - wanted.position
        good = bool(np.all(np.isfinite(error)))
        rms[i] = math.sqrt(float(np.mean(error**2))) if good else math.inf
        peak[i] = float(np.max(np.abs(error))) if good else math.inf

    with ThreadPoolExecutor(2) as pool:
        for done, _ in enumerate(pool.map(one, range(draws)), start=1):
            if progress:
                progress(done)
    limit = 0.02 * wanted.travel if specification is None else specification
    share = float(np.mean(peak <= limit))
    position, _ = trial(model, controller, wanted)
    nominal = float(np.max(np.abs(position - wanted.position)))
    # What fails with the parameters as they stand is not for want of knowing them.
    learn = _culprit(model, plants, peak) if share < ENOUGH and nominal <= limit else None
    says = _sentences(model, controller, peak, limit, share, learn)
    if share < ENOUGH and not nominal <= limit:
        says = (
            *says,
            f"Even with the parameters as they stand it is {nominal:.3g} {controller.axis_unit}: the bandwidth of "
            f"{controller.bandwidth:.3g} Hz does not give this specification; allow more, or slow the reference down.",
        )
    return Robustness(rms, peak, limit, share, learn, says)


def _culprit(model: Model, plants: list[Model], peak: FloatArray) -> str | None:
    """The fitted parameter that explains most of the spread of the peak error, alone and squared."""
    size = np.log(np.minimum(peak, 1e3 * np.min(peak)) + 1e-300)
    size -= size.mean()
    explained = {}
    for name in model.fitted:
        z = np.array([m.values[name] for m in plants])
        if np.std(z) > 0.0:
            z = (z - z.mean()) / np.std(z)
            basis = np.column_stack([np.ones_like(z), z, z**2])
            left = size - basis @ np.linalg.lstsq(basis, size, rcond=None)[0]
            explained[name] = 1.0 - float(left @ left) / float(size @ size)
    return max(explained, key=lambda n: explained[n], default=None)


def _sentences(
    model: Model, controller: Controller, peak: FloatArray, limit: float, share: float, learn: str | None
) -> tuple[str, ...]:
    unit = controller.axis_unit
    says = [
        f"Over {len(peak)} axes that the recording allows, the peak error is {np.median(peak):.3g} {unit} in the "
        f"median and {np.max(peak):.3g} {unit} at worst; {100 * share:.0f} % stay within {limit:.3g} {unit}."
    ]
    if learn:
        says.append(
            f"The parameters are too uncertain for {controller.bandwidth:.3g} Hz: learn {learn} better "
            f"({model.values[learn]:.3g} ± {model.std(learn):.2g} {model.unit(learn)})."
        )
    return tuple(says)
