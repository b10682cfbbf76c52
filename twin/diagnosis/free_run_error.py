"""How far a fitted model's free run ends from the recordings that it was fitted to, and whether it lacks physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.diagnosis import data_split, holdout, model_comparison, nonparametric
from twin.estimation import horizon as best_over
from twin.estimation import maximum_likelihood, multistart, optimizer, preparation, prepared_recording
from twin.io.recording import Recording
from twin.model.fitted_model import Model


@dataclass(frozen=True)
class FreeRunError:
    """The error of one free run, and what the missing torque depends on, if on anything.

    Parameters
    ----------
    recording
        Name of the recording.
    rmse
        Root mean square error, in the unit of the output.
    nrmse_percent
        The same in percent of the recorded range.
    depends_on
        The variables that predict the missing torque on blocks that were left out; empty where nothing is left.
    """

    recording: str
    rmse: float
    nrmse_percent: float
    depends_on: tuple[str, ...]


def free_run_errors(model: Model, recordings: Sequence[Recording], closed: bool = False) -> list[FreeRunError]:
    """The error of each free run from the recorded start.

    Parameters
    ----------
    model
        A fitted model.
    recordings
        What to compare it with.
    closed
        Whether to simulate under the rig's own position loop, from its reference.

    Returns
    -------
    list of FreeRunError
        One for each recording.

    Raises
    ------
    BadInput
        Where `closed` is asked for and the loop is not known.
    """
    out = []
    for recording in recordings:
        seen = holdout.simulate_recording(model, recording, closed)
        rmse, percent = model_comparison.rmse(recording.output, seen)
        case = prepared_recording.prepare_recording(recording, model.structure)
        left = nonparametric.remaining_dependence(case, model.structure, model.values)
        depends = left.variables if nonparametric.is_dependence_left(left) else ()
        out.append(FreeRunError(recording.name, rmse, percent, depends))
    return out


def sentences(errors: Sequence[FreeRunError], model: Model, unit: str) -> list[str]:
    """What the errors of a model say: one line for each recording, and a warning where physics is missing."""
    said = [
        f"free run of {e.recording}: error {e.rmse:.3g} {unit}, {e.nrmse_percent:.3g} % of the range" for e in errors
    ]
    lacking = [e for e in errors if e.depends_on]
    if model.provenance.get(best_over.LACKING) == best_over.FOLLOWS:
        said.append(
            "warning: the likeliest values follow each reading from the last one and say little about the axis. The "
            "readings are too coarse, or the input does not drive the output, or physics is missing. These are the "
            "values of the best free run instead: look at its error."
        )
    elif best_over.LACKING in model.provenance:
        said.append(
            "warning: the model lacks physics, and its likeliest values make up for that. These are the values of the "
            "best free run instead. Run twin diagnose to find what is missing."
        )
    elif lacking:
        worst = max(lacking, key=lambda e: e.nrmse_percent)
        other = "" if "horizon" in model.provenance else "; until then a fit over a horizon serves long runs better"
        said.append(
            f"warning: the model lacks physics: in {worst.recording} the missing torque depends on "
            f"{' and '.join(worst.depends_on)}. Its parameters make up for that. "
            f"Run twin diagnose{other}."
        )
    return said


@dataclass(frozen=True)
class HorizonComparison:
    """RMSE of free runs through held-out data (output unit) of the likeliest values and of those for a horizon.

    Both were fitted without that data, for this comparison alone.
    """

    likeliest: float
    for_horizon: float

    def sentence(self, horizon: float, unit: str) -> str:
        """Which values run better on held-out data, with both errors."""
        better = "those for the horizon" if self.for_horizon < self.likeliest else "the likeliest, without --horizon,"
        return (
            f"on data held out for this comparison the free run errs {self.likeliest:.3g} {unit} with the likeliest "
            f"values and {self.for_horizon:.3g} {unit} with those for {horizon:g} s: {better} are better there"
        )


def compare_horizon(model: Model, recordings: Sequence[Recording], horizon: float, closed: bool) -> HorizonComparison:
    """Fit both kinds of values without the held-out part, and run both through it.

    Parameters
    ----------
    model
        A model of all training recordings: both fits begin at its values.
    recordings
        The same recordings; those with the role "holdout" are held out, or the end of each if there are none.
    horizon
        s.
    closed
        Whether to predict under the rig's own position loop over the horizon.

    Raises
    ------
    BadInput
        Where nothing is to be fitted.
    """
    train, held_out = data_split.split(recordings)
    problem = preparation.prepare_recordings(train, model.structure)
    problem = multistart.choose_initial_contacts(problem, model.structure, model.values)
    density = model.torque_density / model.reading_std**2
    fit = optimizer.levenberg_marquardt(problem.at(density), model.structure, model.values, model.fitted)
    likeliest = maximum_likelihood.to_model(problem, fit, train)
    longest = min(horizon, max(float(r.time[-1]) for r in train))
    ahead = best_over.for_horizon(likeliest, train, longest, closed)
    traces = holdout.traces(likeliest, ahead, [("holdout", p) for p in held_out], closed)
    recorded = np.concatenate([t.recorded for t in traces])
    errors = [np.concatenate([getattr(t, when) for t in traces]) for when in ("before", "after")]
    return HorizonComparison(*(model_comparison.rmse(recorded, e)[0] for e in errors))
