"""A model as a user asks for one: its effects by name, its values by either method."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from difflib import get_close_matches

import numpy as np

from twin.effects.catalogue import EFFECTS, UNKNOWN
from twin.effects.end_stop import NOWHERE
from twin.errors import BadInput
from twin.estimation import horizon as best_over
from twin.estimation import maximum_likelihood, preparation, two_stage
from twin.estimation.fit import Fit
from twin.io.api import as_list
from twin.io.position_loop import own_loop
from twin.io.recording import Recording, to_fit
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.simulation import compile_cache, kernel

Progress = Callable[[str, float], None]

METHODS = ("joint", "two-stage")


def _known_effect(name: str, where: str) -> str:
    """An effect id. Raises BadInput, with the id that may have been meant."""
    if name in EFFECTS:
        return name
    close = get_close_matches(name.replace("-", "_").lower(), EFFECTS, 1, 0.5)
    meant = f"did you mean {close[0]}? " if close else ""
    known = ", ".join(i for i in EFFECTS if i not in UNKNOWN)
    raise BadInput(f"{where}: there is no effect {name!r}; {meant}known are {known}")


def first_structure(
    recordings: Recording | Sequence[Recording] = (), include: Iterable[str] = (), exclude: Iterable[str] = ()
) -> Structure:
    """What a first model contains.

    Parameters
    ----------
    recordings
        The recordings, whose rig file may name effects (``[structure]``).
    include
        Ids of effects to add, such as ``["gravity"]``; `twin.EFFECTS` lists them.
    exclude
        Ids of effects to leave out. What cannot be without them goes, too.

    Returns
    -------
    Structure
        The four base effects, those of the rig file, a sensor on the motor where it says so, and the changes that were
        asked for.

    Raises
    ------
    BadInput
        There is no effect of this name, or the structure has none to leave out.
    """
    rigs = [r.rig for r in as_list(recordings) if r.rig is not None]
    named = [_known_effect(e, f"{rigs[0].name} [structure]") for e in rigs[0].effects] if rigs else []
    if any(r.location == "motor" for r in as_list(recordings)):
        named.append("motor_sensor")
    return changed_structure(preparation.base_structure().with_(*named), include, exclude)


def changed_structure(structure: Structure, include: Iterable[str] = (), exclude: Iterable[str] = ()) -> Structure:
    """The structure with some effects more and some fewer. Raises BadInput."""
    structure = structure.with_(*(_known_effect(e, "`include`") for e in include))
    for effect in exclude:
        if _known_effect(effect, "`exclude`") == "inertia":
            raise BadInput("`exclude` names inertia, but every model has an input gain: keep it")
        if effect not in structure:
            has = ", ".join(structure.ids)
            raise BadInput(f"`exclude` names {effect}: the first model has no such effect; it has {has}")
        leaning = [e.id for e in structure.effects if effect in e.includes]
        structure = structure.without(effect, *leaning)
    return structure


def compile_kernel(tell: Progress) -> None:
    """Compile where this machine has not yet; that takes half a minute, once."""
    loaded = kernel.compiled()
    if not compile_cache.is_compiled(loaded.__name__):
        tell("compiling the kernel, once on this machine (half a minute)", 0.0)
    kernel.warm(preparation.base_structure())


def with_largest_command(found: Model, recordings: Sequence[Recording]) -> Model:
    """The model, with the largest command of its recordings as the limit for a controller to keep."""
    largest = max(float(np.max(np.abs(r.input))) for r in recordings)
    return replace(found, provenance={**found.provenance, "largest_command": f"{largest:.6g}"})


def held_parameters(found: Model) -> dict[str, float]:
    """The parameters that a model holds fixed: those without a standard error, in a model that has some. A parameter
    that was never estimated, as a note says, is not held. Nor is an end stop that stands nowhere, which the next
    recording may reach.
    """
    if not found.fitted:
        return {}
    known = [p.name for p in found.structure.parameters if p.estimated and p.name not in {*found.fitted, *found.notes}]
    return {name: found.values[name] for name in known if found.values[name] != NOWHERE.get(name)}


def identify(
    recordings: Recording | Sequence[Recording], structure: Structure | None = None, method: str = "joint",
    horizon: float | None = None, closed_loop: bool = False, progress: Progress | None = None,
) -> Model:  # fmt: skip
    """Find the parameters of a model, with standard errors.

    The likeliest values may only make up for physics that the model lacks. Its values are then those of the best free
    run through the whole recordings, and its provenance says so ("horizon").

    Parameters
    ----------
    recordings
        One recording of the axis, or several. Those with the role "holdout" are not fitted.
    structure
        What the model contains; by default `first_structure` of the recordings.
    method
        "joint": maximum likelihood of all readings (default). "two-stage": steady states first, then transients; for
        comparison.
    horizon
        s; find the values that predict best so far ahead. For a model that lacks something these differ from the
        likeliest, which are the default.
    closed_loop
        Predict over the horizon under the rig's own position loop, from the recorded reference.
    progress
        Is called with what is being done and the share of the work that is done, 0 to 1.

    Returns
    -------
    Model
        Values, standard errors and covariance; `Model.notes` says of a parameter what the recording cannot tell.

    Raises
    ------
    BadInput
        The recordings do not allow an estimate, or arguments contradict each other.
    """
    recordings, tell = as_list(recordings), progress or (lambda sentence, share: None)
    structure = first_structure(recordings) if structure is None else structure
    _check_request(recordings, method, horizon, closed_loop)
    if method == "joint":
        compile_kernel(tell)
        found = _joint(recordings, structure, lambda s, x: tell(s, 0.05 + 0.85 * x))
        if horizon is not None:
            tell(f"the best values over {horizon:g} s", 0.9)
            found = best_over.for_horizon(found, recordings, horizon, closed_loop)
    else:
        tell("steady states and transients", 0.1)
        train = to_fit(recordings)
        simple = two_stage.two_stage(train)
        if not simple.ok:
            raise BadInput(f'{train[0].name}: no two-stage estimate: {simple.says}; or use `method="joint"`')
        found = two_stage.to_model(simple, train)
    return with_largest_command(found, recordings)


def _joint(recordings: Sequence[Recording], structure: Structure, tell: Progress) -> Model:
    """The likeliest model; where its values say little about the axis, the one that runs freely best."""
    problem, likeliest = maximum_likelihood.likeliest(recordings, structure, progress=tell)
    if best_over.lacks_physics(problem, likeliest) or best_over.follows_readings(problem, likeliest):
        tell("the best free run", 0.85)
        train = to_fit(recordings)
        return best_over.in_place_of_likeliest(problem, likeliest, train, _steady_values(likeliest, train))
    tell("profiles of the likelihood", 0.85)
    return maximum_likelihood.with_intervals(problem, likeliest, recordings)


def _steady_values(likeliest: Fit, recordings: Sequence[Recording]) -> list[dict[str, float]]:
    """Gain and frictions of the two-stage estimate, where there is one: it needs no filter."""
    simple = two_stage.two_stage(recordings)
    if not simple.ok:
        return []
    found = two_stage.to_model(simple, recordings)
    return [{n: found.values[n] for n in found.fitted if n in likeliest.free}]


def _check_request(recordings: Sequence[Recording], method: str, horizon: float | None, closed_loop: bool) -> None:
    """Raises BadInput for arguments of `identify` that contradict each other or the recordings."""
    if method not in METHODS:
        raise BadInput(f"`method` is {method!r}: use one of {', '.join(METHODS)}")
    if horizon is not None and method != "joint":
        raise BadInput(f'`horizon` goes with `method="joint"`, not {method}: leave one of them out')
    if horizon is not None and not horizon > 0.0:
        raise BadInput(f"the horizon is {horizon:g} s: give a time above 0")
    longest = max((float(r.time[-1]) for r in recordings), default=0.0)
    if horizon is not None and horizon > longest:
        raise BadInput(f"the horizon is {horizon:g} s, the longest recording lasts {longest:g} s: give a shorter one")
    step = min((float(np.median(np.diff(r.time))) for r in recordings), default=0.0)
    if horizon is not None and horizon < (1.0 - 1e-6) * step:
        raise BadInput(f"the horizon is {horizon:g} s, less than one sample of {step:.3g} s: give a longer one")
    if closed_loop and horizon is None:
        raise BadInput("`closed_loop` says how to predict over a horizon: give `horizon`, in s")
    for recording in recordings if closed_loop else ():
        own_loop(recording)  # or the user is told after the fit
