"""The result of a search that was ended early: its first model and its best one so far, beside the recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.diagnosis import coverage, data_split, holdout, localization, model_comparison, residual_torque
from twin.diagnosis.adequacy import Adequacy
from twin.diagnosis.data_split import RecordingPart
from twin.diagnosis.result import Diagnosis, Fitness, Trace
from twin.effects.catalogue import EFFECTS
from twin.estimation import prepared_recording
from twin.io.recording import Recording, to_fit
from twin.model.fitted_model import Model

_SAYS = "The search was stopped before its checks: nothing is claimed of what the first model lacks."


def unfinished(recordings: Sequence[Recording], before: Model, after: Model) -> Diagnosis:
    """Two models beside the recordings, with the verdict "stopped" and no claim.

    Parameters
    ----------
    recordings
        What was searched.
    before, after
        The first model and the best one so far.

    Returns
    -------
    Diagnosis
        ``.fit``, ``.traces`` and the missing torque are as after a whole search; there are no findings and no ranking.
    """
    train, held_out = data_split.split(recordings, coverage.choose(recordings).where)
    parts = [*(("train", RecordingPart(r)) for r in train), *(("holdout", p) for p in held_out)]
    traces = holdout.traces(before, after, parts)
    longest = max(train, key=lambda r: float(r.time[-1]))
    case = prepared_recording.prepare_recording(longest, before.structure)
    missing = [residual_torque.missing_torque(case, m.structure, m.values) for m in (before, after)]
    new = [EFFECTS[i].title for i in after.structure.named if i not in before.structure]
    held = f"The best model so far also holds {' and '.join(new)}." if new else ""
    return Diagnosis(
        verdict="stopped",
        findings=(),
        ranking=(),
        station="",
        depends_on=(),
        telling=to_fit(recordings)[train.index(longest)].name,
        segments=tuple(localization.segments(localization.without_base(missing[0]))),
        before=before,
        after=after,
        fit={role: _fitness([t for t in traces if t.role == role]) for role in ("train", "holdout")},
        traces=tuple(traces),
        missing_before=missing[0],
        missing_after=missing[1],
        shapes_before=tuple(residual_torque.torque_shapes(missing[0])),
        shapes_after=tuple(residual_torque.torque_shapes(missing[1])),
        recordings=tuple(recordings),
        remarks=(held,) if held else (),
        adequacy=Adequacy(says=_SAYS),
    )


def _fitness(traces: Sequence[Trace]) -> dict[str, Fitness]:
    """The errors of both free runs; whiteness was not looked at."""
    if not traces:
        return {which: Fitness(math.nan, math.nan, math.nan) for which in ("before", "after")}
    recorded = np.concatenate([t.recorded for t in traces])
    runs = {which: np.concatenate([getattr(t, which) for t in traces]) for which in ("before", "after")}
    return {which: Fitness(*model_comparison.rmse(recorded, run), math.nan) for which, run in runs.items()}
