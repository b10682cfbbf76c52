"""Which of several recordings differs from the others, so that it may hold a fault and not physics."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from twin.diagnosis import thresholds, verdict
from twin.diagnosis.adequacy import Adequacy
from twin.diagnosis.result import Diagnosis
from twin.display.numbers import number, percent
from twin.io.recording import Recording, to_fit


def odd_one_out(figures: Adequacy) -> int | None:
    """Which of the fitted recordings carries most of the misfit of the last model; None where none does.

    Three conditions hold for it. Its free runs err by more than the model's own noise makes. Those through all other
    recordings do not. Its mean square is more than all of theirs together.

    Parameters
    ----------
    figures
        Of the first and the last model, by recording.
    """
    rows = [c for role, _, c in figures.recordings if role == "train"]
    if len(rows) < thresholds.MIN_RECORDINGS:
        return None
    off = [i for i, c in enumerate(rows) if verdict.is_off(c.after, c.span)]
    others = [c.after.rmse for i, c in enumerate(rows) if i not in off]
    return off[0] if len(off) == 1 and rows[off[0]].after.rmse ** 2 > sum(r**2 for r in others) else None


def without(recordings: Sequence[Recording], odd: int) -> list[Recording]:
    """The recordings but the odd one of those that are fitted."""
    left_out = to_fit(recordings)[odd]
    return [r for r in recordings if r is not left_out]


def sentence(found: Diagnosis, odd: int, other: Diagnosis) -> str:
    """What sets the odd one out of a diagnosis apart, and what is found without it.

    Parameters
    ----------
    found
        The diagnosis of all recordings.
    odd
        Which of those that were fitted is the odd one.
    other
        The diagnosis of the rest.
    """
    name, unit = to_fit(found.recordings)[odd].name, found.recordings[0].output_unit
    errors = [c.after.rmse for role, _, c in found.adequacy.recordings if role == "train"]
    own = errors.pop(odd)
    effects = ", ".join(f"{f.id} ({percent(f.probability)})" for f in other.findings) or "no effect"
    says = f"the verdict is {other.verdict.replace('_', ' ')}, with {effects}, and the free run errs"
    return (
        f"{name} carries most of the misfit: the free run errs {number(own)} {unit} in it and "
        f"{number(statistics.median(errors))} {unit} in the median of the other {len(errors)} recordings. Without it "
        f"{says} {number(other.fit['train']['after'].rmse)} {unit}. What only the first answer names comes from {name} "
        "alone: check that recording."
    )
