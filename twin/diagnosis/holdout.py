"""What no fit and no choice may see: which part of the recordings that is, and what it says about a model.

Of a lone recording it is the last part. What acts in that part alone cannot be learned from the data before it: an end
stop that is reached late, or a load that changes late. Where the held-out part shows that, the middle is held out
instead, and the whole search is repeated.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from twin.diagnosis import nonparametric, residual_torque, thresholds
from twin.diagnosis.data_split import RecordingPart, lead_of
from twin.diagnosis.residual_torque import MissingTorque
from twin.diagnosis.result import Trace
from twin.estimation import likelihood, preparation, prepared_recording
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.fmi import python_fmu
from twin.io.position_loop import own_loop
from twin.io.recording import Recording
from twin.model.equations import timed
from twin.model.fitted_model import Model


def _free_run(fmu: Path, part: RecordingPart, lead: float, closed: bool) -> np.ndarray:
    """What the FMU says the sensor reads in the part, started there from the recorded state.

    It starts `lead` seconds earlier, in the fitted data. So lag, gap and delay line are filled, and an error of the
    first speed has decayed when the part begins. The run is then moved to the recorded position where the part begins,
    because only what happens afterwards is judged.
    """
    recording = part.recording
    begin = max(part.begin - lead, 0.0)
    ran = python_fmu.replay(fmu, recording.part(begin, part.end), closed=closed)
    seen = np.asarray(ran.velocity if recording.is_speed else ran.position_measured)[-int(part.inside.sum()) :]
    if part.begin > 0.0 and not recording.is_speed:
        recorded = recording.output[part.inside]
        read = np.flatnonzero(np.isfinite(recorded))
        seen = seen + (recorded[read[0]] - seen[read[0]] if len(read) else 0.0)
    return seen


def simulate_recording(model: Model, recording: Recording, closed: bool = False) -> np.ndarray:
    """What the sensor reads (N,) over the whole recording, by the kernel. The run is free from its start or, with
    `closed`, under the rig's own loop. Raises BadInput where that loop is not known.
    """
    case = prepared_recording.prepare_recording(recording, model.structure, closed)
    case = replace(case, start=python_fmu.start_of(recording, model))
    seen = likelihood.filtered_states(case, model.structure, model.values, 0.0).reading
    return seen[own_loop(recording).stamps] if closed else seen


def traces(
    before: Model, after: Model, parts: Sequence[tuple[str, RecordingPart]], closed: bool = False
) -> list[Trace]:
    """Both models beside each part, whose role comes first. They run freely from the recorded input or, with `closed`,
    under the rig's own loop. Held-out parts run through the models' FMUs. Fitted parts run through the kernel, which
    gives the same result.
    """
    clocked = any(timed(m.structure) for m in (before, after))
    # Physics that depends on the time since the start must run from the start.
    lead = math.inf if clocked else lead_of(after.values)
    out = []
    with tempfile.TemporaryDirectory() as folder:
        fmus = [python_fmu.export(m, Path(folder) / f"{i}.fmu") for i, m in enumerate((before, after))]
        for role, part in parts:
            recording, inside = part.recording, part.inside
            if role == "train":
                runs = [simulate_recording(m, recording, closed) for m in (before, after)]
            else:
                runs = [_free_run(fmu, part, lead, closed) for fmu in fmus]
            out.append(Trace(recording.name, role, recording.time[inside], recording.output[inside], *runs))
    return out


def _acceleration_ratio(here: MissingTorque, there: MissingTorque) -> float:
    """How many times as large the acceleration is here as there, in the root mean square."""
    return here.acceleration_rms / max(there.acceleration_rms, 1e-300)


def _least_share(missing: MissingTorque) -> float:
    """What is no physics that held-out data show alone, however little the fitted data leave: a torque this small."""
    return thresholds.HOLDOUT_MIN_SHARE * missing.acceleration_rms


def _least_size(
    missing: MissingTorque,
    left: nonparametric.RemainingDependence,
    fitted: Sequence[tuple[MissingTorque, nonparametric.RemainingDependence]],
) -> float:
    """The size from which on a dependence in held-out data is one that the fitted data do not have. What goes with the
    acceleration is less where the axis accelerates less.
    """
    if left.variables == ("acceleration",):
        return thresholds.HOLDOUT_EXCESS * max(
            own.size * min(_acceleration_ratio(missing, there), 1.0) for there, own in fitted
        )
    return max(thresholds.HOLDOUT_EXCESS * max(own.size for _, own in fitted), _least_share(missing))


def physics_only_in_holdout(problem: FitProblem, point: Fit, held_out: Sequence[RecordingPart]) -> list[str]:
    """What the last model lacks in held-out data alone. Physics that did not act before cannot be known.

    Either a torque that depends on something, or one that is larger than all before, as at an end stop.
    """

    def lacks(case: PreparedRecording, part: RecordingPart) -> tuple[MissingTorque, nonparametric.RemainingDependence]:
        missing = residual_torque.missing_torque(case, point.structure, point.values).between(part.begin, part.end)
        return missing, nonparametric.examine_dependence(missing, case.recording.lever)

    fitted = [lacks(c, RecordingPart(c.recording)) for c in problem.recordings]
    loud = max(missing.rms for missing, _ in fitted)
    said = []
    for part in held_out:
        (case,) = preparation.prepare_recordings([part.recording], point.structure).recordings
        missing, left = lacks(case, part)
        if nonparametric.is_dependence_left(left) and left.size > _least_size(missing, left, fitted):
            size, goes = left.size, f"that goes with {' and '.join(left.variables)}"
        elif missing.rms > max(thresholds.HOLDOUT_EXCESS * loud, _least_share(missing)):
            size, goes = missing.rms, f"in the mean, the most at {missing.time_of_largest:.3g} s"
        else:
            continue
        since = "" if part.whole else f" from {part.begin:.3g} s on"
        unit = part.recording.output_unit.removesuffix("/s")
        said.append(
            f"{part.recording.name}: held-out data{since} show something that what was fitted does not: a torque of "
            f"{size:.2g} {unit}/s^2 {goes}."
        )
    return said
