"""Which of several recordings differs from the others, so that it may hold a fault and not physics."""

from __future__ import annotations

import statistics

from twin.diagnosis import thresholds, verdict
from twin.diagnosis.adequacy import Adequacy


def sentences(figures: Adequacy, unit: str) -> list[str]:
    """A sentence on the fitted recording that carries most of the misfit of the last model, or none.

    Three conditions hold for it. Its free runs err by more than the model's own noise makes. Those through all other
    recordings do not. Its mean square is more than all of theirs together.

    Parameters
    ----------
    figures
        Of the first and the last model, by recording.
    unit
        Of the output.
    """
    rows = [(name, c) for role, name, c in figures.recordings if role == "train"]
    if len(rows) < thresholds.MIN_RECORDINGS:
        return []
    off = [(name, c) for name, c in rows if verdict.is_off(c.after, c.span)]
    others = [c.after.rmse for name, c in rows if name not in {n for n, _ in off}]
    if len(off) != 1 or off[0][1].after.rmse ** 2 <= sum(r**2 for r in others):
        return []
    name, compared = off[0]
    return [
        f"{name} carries most of the misfit: the free run errs {compared.after.rmse:.3g} {unit} in it and "
        f"{statistics.median(others):.3g} {unit} in the median of the other {len(others)} recordings. Check it, and "
        "diagnose without it: an answer that changes then comes from this recording alone."
    ]
