"""A model as a user asks for one: its effects by name, its values by either method."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from twin.effects.catalogue import EFFECTS, UNKNOWN
from twin.effects.end_stop import NOWHERE
from twin.errors import BadInput
from twin.estimation import maximum_likelihood, preparation, two_stage
from twin.io.position_loop import own_loop
from twin.io.recording import Recording, Rig, to_fit
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.simulation import kernel

Progress = Callable[[str, float], None]


def _known_effect(name: str, where: str) -> str:
    """An effect id. Raises BadInput, with the id that may have been meant."""
    if name in EFFECTS:
        return name
    close = get_close_matches(name.replace("-", "_").lower(), EFFECTS, 1, 0.5)
    meant = f"did you mean {close[0]}?" if close else f"known are {', '.join(i for i in EFFECTS if i not in UNKNOWN)}"
    raise BadInput(f"{where}: there is no effect {name!r}; {meant}")


def first_structure(
    rig: Rig, more: Iterable[str] = (), fewer: Iterable[str] = (), given: Structure | None = None
) -> Structure:
    """What the first model contains: `given`, or the base and the rig file's effects; then the user's changes.

    Raises BadInput.
    """
    named = [_known_effect(e, f"{rig.name} [structure]") for e in rig.effects]
    structure = preparation.base_structure().with_(*named) if given is None else given
    structure = structure.with_(*(_known_effect(e, "--with") for e in more))
    for effect in fewer:
        if _known_effect(effect, "--without") == "inertia":
            raise BadInput("--without inertia: every model has an input gain; leave that out")
        if effect not in structure:
            raise BadInput(f"--without {effect}: the first model has no such effect; it has {', '.join(structure.ids)}")
        leaning = [e.id for e in structure.effects if effect in e.includes]
        structure = structure.without(effect, *leaning)
    return structure


def compile_kernel(tell: Progress) -> None:
    """Compile where this machine has not yet; that takes half a minute, once."""
    loaded = kernel.compiled()
    if not any(kernel.cache_folder().glob(f"**/{loaded.__name__}*.nbi")):
        tell("compiling the kernel, once on this machine (half a minute)", 0.0)
    kernel.warm(preparation.base_structure())


def with_largest_command(found: Model, recordings: Sequence[Recording]) -> Model:
    """The model, with the largest command of its recordings as the limit for a controller to keep."""
    largest = max(float(np.max(np.abs(r.input))) for r in recordings)
    return replace(found, provenance={**found.provenance, "largest_command": f"{largest:.6g}"})


def held_parameters(found: Model) -> dict[str, float]:
    """The parameters that a model holds fixed: those without a standard error in a model that has some, but not what a
    note says was never looked for, nor a stop that stands nowhere, which the next recording may meet.
    """
    if not found.fitted:
        return {}
    known = [p.name for p in found.structure.parameters if p.estimated and p.name not in {*found.fitted, *found.notes}]
    return {name: found.values[name] for name in known if found.values[name] != NOWHERE.get(name)}


def estimate(
    recordings: Sequence[Recording], structure: Structure, method: str, tell: Progress, horizon: float | None = None,
    closed: bool = False,
) -> Model:  # fmt: skip
    """A model by either method, with the values that predict best over a horizon (s) if one is given, from the recorded
    input or, `closed`, under the rig's own loop.

    Raises BadInput where the recordings do not allow it.
    """
    if horizon is not None and method != "joint":
        raise BadInput(f"--horizon goes with --method joint, not {method}: leave one of them out")
    if horizon is not None and not horizon > 0.0:
        raise BadInput(f"the horizon is {horizon:g} s: give a time above 0")
    longest = max(float(r.time[-1]) for r in recordings)
    if horizon is not None and horizon > longest:
        raise BadInput(f"the horizon is {horizon:g} s, the longest recording lasts {longest:g} s: give a shorter one")
    if closed and horizon is None:
        raise BadInput("--closed says how to predict over a horizon: add --horizon SECONDS")
    for recording in recordings if closed else ():
        own_loop(recording)  # or the user is told after the fit
    if method == "joint":
        compile_kernel(tell)
        found = maximum_likelihood.identify(recordings, structure, progress=lambda s, x: tell(s, 0.05 + 0.85 * x))
        if horizon is not None:
            tell(f"the best values over {horizon:g} s", 0.9)
            found = maximum_likelihood.for_horizon(found, recordings, horizon, closed)
    else:
        tell("steady states and transients", 0.1)
        train = to_fit(recordings)
        simple = two_stage.two_stage(train)
        if not simple.ok:
            raise BadInput(f"{train[0].name}: no two-stage estimate: {simple.says}; or use --method joint")
        found = two_stage.to_model(simple, train)
    return with_largest_command(found, recordings)
