"""One recording that is unlike all others is named, and none where all are alike."""

from __future__ import annotations

import pytest

from twin.diagnosis import suspect
from twin.diagnosis.adequacy import Adequacy, Comparison, FreeRun, TorqueFigures


def figures(*errors: float) -> Adequacy:
    """Recordings whose own noise makes 0.01 rad, over a range of 2 rad."""
    runs = [FreeRun(e, 0.01, 0.5 if e < 0.02 else 0.0) for e in errors]
    rows = tuple(("train", f"run {i}", Comparison(r, r, 2.0)) for i, r in enumerate(runs))
    return Adequacy({}, rows, TorqueFigures())


@pytest.mark.parametrize("at", [0, 2])
def test_the_recording_that_carries_most_of_the_misfit_is_named(at: int) -> None:
    errors = [0.01, 0.012, 0.009]
    errors[at] = 0.5
    (said,) = suspect.sentences(figures(*errors), "rad")
    assert said.startswith(f"run {at} carries most") and "0.5 rad in it" in said and "other 2 recordings" in said


@pytest.mark.parametrize("errors", [(0.01, 0.012, 0.009), (0.5, 0.5, 0.01), (0.4, 0.5, 0.6), (0.01, 0.5), ()])
def test_no_recording_is_named_where_none_or_several_are_unlike(errors: tuple[float, ...]) -> None:
    assert suspect.sentences(figures(*errors), "rad") == []
