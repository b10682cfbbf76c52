"""What `import twin` offers for finding what a model leaves out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from twin.diagnosis import diagnose as search
from twin.diagnosis import holdout, model_comparison, thresholds
from twin.diagnosis.change import changes_sentence, compare_models
from twin.diagnosis.result import Diagnosis, Fitness
from twin.diagnosis.tracking import FALSE_ALARMS, Track
from twin.diagnosis.tracking import track as judge
from twin.display.numbers import time_left
from twin.errors import BadInput
from twin.estimation import estimate, local_optima, maximum_likelihood
from twin.io.api import as_list
from twin.io.recording import Recording, as_told, check_units
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

Progress = Callable[[str, float], None]


def diagnose(
    recordings: Recording | Sequence[Recording], first: Structure | Model | None = None, closed_loop: bool = False,
    progress: Progress | None = None, include: Iterable[str] = (), exclude: Iterable[str] = (),
) -> Diagnosis:  # fmt: skip
    """Find what a first model leaves out: locate it, name it, model it, and check it on data that no fit has seen.

    Parameters
    ----------
    recordings
        One recording of the axis, or several. A part of each, or the recordings with the role "holdout", is kept for
        the check.
    first
        The first model: a structure, whose parameters are fitted; or a model, whose known parameters are kept. By
        default `first_structure` of the recordings.
    closed_loop
        Simulate the rig's own position loop from the recorded reference in the check.
    progress
        Is called with what is being done and the share of the work that is done, 0 to 1.
    include
        Ids of effects to add to the first model; `twin.EFFECTS` lists them.
    exclude
        Ids of effects to leave out of it.

    Returns
    -------
    Diagnosis
        ``.verdict``, ``.findings``, ``.ranking``, ``.fit`` and ``.model``, the model with what was found. Where a model
        was given: ``.given_fit``, how it runs freely as it is, and ``.changes`` of its parameters.

    Raises
    ------
    BadInput
        The recordings do not allow a diagnosis, or `first` is in other units than they are. There is no effect of a
        name that is given, or the first model has none to leave out.
    """
    recordings, tell = as_list(recordings), progress or (lambda sentence, share: None)
    given = first if isinstance(first, Model) else None
    if given is not None:
        for r in recordings:
            check_units(r, "`first`", given.input_unit, given.axis_unit)
        recordings = [as_told(r, given.known) for r in recordings]
    if first is None:
        structure = estimate.first_structure(recordings, include, exclude)
    else:
        structure = first.structure if isinstance(first, Model) else first
        structure = estimate.changed_structure(structure, include, exclude)
    held = {} if given is None else estimate.held_parameters(given)
    estimate.compile_kernel(tell)
    found = search.diagnose(
        recordings, structure, held, progress=lambda s, x: tell(s, 0.05 + 0.95 * x), closed=closed_loop
    )
    before, after = (estimate.with_largest_command(m, recordings) for m in (found.before, found.after))
    found = replace(found, before=before, after=after)
    return found if given is None else _against_given(found, given, closed_loop)


def _against_given(found: Diagnosis, given: Model, closed_loop: bool) -> Diagnosis:
    """The diagnosis, with how a model that was given runs freely as it is, and which of its parameters changed.

    Where the first model of the diagnosis has other effects than the given one, no parameters can be compared.
    """
    fits = {}
    for r in found.recordings:
        rmse, percent = model_comparison.rmse(r.output, holdout.simulate_recording(given, r, closed_loop))
        fits[r.name] = Fitness(rmse, percent, math.nan)
    worst = max(fits, key=lambda name: fits[name].nrmse_percent)
    unit = found.recordings[0].output_unit
    said = (
        f"The given model as it is runs freely with an error of {fits[worst].rmse:.3g} {unit}, "
        f"{fits[worst].nrmse_percent:.3g} % of the range{f', in {worst}' if len(fits) > 1 else ''}."
    )
    rest = "All else is said of its structure, with values fitted to these recordings."
    found = replace(found, given_fit=fits, since=(said, rest))
    if given.structure.named != found.before.structure.named or not given.fitted:
        return found
    later = fit_again(given, found.recordings)
    if not later.fitted:
        return found
    changes = compare_models(given, later)
    return replace(found, changes=changes.found, since=(said, changes_sentence(changes), rest))


def fit_again(model: Model, recordings: Recording | Sequence[Recording]) -> Model:
    """Fit a model's structure to later recordings of its axis; what the model holds fixed stays.

    A likelihood behind a gap has several maxima. The one near the model's own values is taken, unless another is
    likelier by the gain that a new effect would need. Otherwise parameters would seem to change from one maximum to
    another. Where the search went astray, its noise is so large that the filter forgets at once, and the model's values
    need not move. So they are also followed at the model's own noise, and from there at the search's.

    Raises
    ------
    BadInput
        The recordings do not allow a fit, or are in other units than the model.
    """
    given = as_list(recordings)
    for r in given:
        check_units(r, "the model", model.input_unit, model.axis_unit)
    told = [as_told(r, model.known) for r in given]
    problem, likeliest = maximum_likelihood.likeliest(told, model.structure, estimate.held_parameters(model))
    at_found = problem.at(likeliest.process_noise)
    close = [local_optima.refit(at_found, model.structure, model.values)]
    if model.torque_density > 0.0 and model.reading_std > 0.0:
        own = problem.at(model.torque_density / model.reading_std**2)
        followed = local_optima.refit(own, model.structure, model.values)
        close += [followed, local_optima.refit(at_found, model.structure, followed.values)]
    near = min(close, key=lambda p: p.deviance)
    farther = model_comparison.criterion_difference(likeliest, near) > thresholds.MIN_GAIN
    return maximum_likelihood.with_intervals(problem, likeliest if farther else near, told)


def track(
    model: Model, recordings: Sequence[Recording], false_alarms: float = FALSE_ALARMS, progress: Progress | None = None
) -> Track:
    """Follow an axis through recordings made since its model was: which parameters changed, when, by how much.

    Parameters
    ----------
    model
        The twin, with standard errors.
    recordings
        In the order in which they were made, the oldest first. Each is fitted by itself.
    false_alarms
        Alarms per recording of an axis that does not change.
    progress
        Is called with what is being done and the share of the work that is done, 0 to 1.

    Returns
    -------
    Track
        ``.alarms``, each with the first recording after the change, and the changes; ``.standardised`` for each
        recording; ``.latest``, the model of what the axis is now.

    Raises
    ------
    BadInput
        There is no recording, one does not allow a fit, or is in other units than the model.
    """
    if not recordings:
        raise BadInput("there is no recording to follow: give at least one")
    tell = progress or (lambda sentence, share: None)
    estimate.compile_kernel(tell)
    fits, began = [], time.perf_counter()
    for i, r in enumerate(recordings):
        left = time_left(time.perf_counter() - began, i, len(recordings))
        tell(f"fitting {r.name}, {i + 1} of {len(recordings)}{left}", i / len(recordings))
        fits.append(fit_again(model, r))
    return judge(model, fits, [r.name for r in recordings], false_alarms)
