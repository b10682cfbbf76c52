"""The errors of an FMU on a recording: of its free run, and of the prediction so far ahead."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.errors import BadInput
from twin.fmi.misfit import misfit
from twin.fmi.python_fmu import Replay
from twin.io.recording import Recording

TIME = 0.002 * np.arange(2001)


def pair(error: np.ndarray, recorded: np.ndarray | None = None) -> tuple[Recording, Replay]:
    """A recording, and a run that is off by that error."""
    output = np.sin(TIME) if recorded is None else recorded
    nothing = np.zeros(len(TIME))
    ran = Replay(TIME, nothing, output + error, nothing, output + error)
    return Recording("r", TIME, nothing, output, "%", "rad"), ran


@given(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(0.002, 3.9))
def test_an_offset_is_no_error_ahead_and_a_drift_is_the_time_ahead(offset: float, drift: float, ahead: float) -> None:
    found = misfit(*pair(offset + drift * TIME), ahead)
    steps = np.ceil(ahead / 0.002 - 1e-3)
    assert found.error == pytest.approx(np.full(len(found.error), drift * 0.002 * steps), abs=1e-9)
    assert len(found.error) == len(TIME) - steps
    free = misfit(*pair(offset + drift * TIME))
    assert free.peak == pytest.approx(max(abs(offset), abs(offset + 4.0 * drift)), abs=1e-9)


def test_the_range_is_that_of_what_is_predicted() -> None:
    error = np.full(len(TIME), 0.1)
    assert misfit(*pair(error)).nrmse_percent == pytest.approx(100.0 * 0.1 / np.ptp(np.sin(TIME)))
    moved = np.sin(TIME[50:]) - np.sin(TIME[:-50])
    assert misfit(*pair(error * TIME), 0.1).span == pytest.approx(np.ptp(moved))


def test_readings_that_are_left_out_count_nowhere() -> None:
    recorded = np.sin(TIME)
    recorded[500:600] = np.nan
    found = misfit(*pair(0.1 * TIME, recorded), 0.1)
    assert found.rmse == pytest.approx(0.01) and np.isnan(found.error).sum() == 150
    late = misfit(*pair(0.1 * TIME, recorded), since=2.0)
    assert late.time[0] == pytest.approx(2.0) and late.peak == pytest.approx(0.2)
    with pytest.raises(BadInput, match="no readings are left"):
        misfit(*pair(TIME, np.where(TIME < 0.05, 1.0, np.nan)), 0.1)


def test_the_worst_second_holds_the_largest_errors() -> None:
    error = np.where((TIME > 1.2) & (TIME < 1.6), 0.3, 0.01)
    begin, end = misfit(*pair(error)).worst()
    assert begin <= 1.2 and end >= 1.6 and end - begin == pytest.approx(1.0)
    late = misfit(*pair(np.where(TIME > 3.9, 1.0, 0.0))).worst()
    assert late == pytest.approx((3.0, 4.0))


@pytest.mark.parametrize("ahead", [0.0, -0.1, 5.0, float("nan")])
def test_a_time_ahead_that_the_recording_has_not_is_refused(ahead: float) -> None:
    with pytest.raises(BadInput, match="`ahead` is"):
        misfit(*pair(TIME), ahead)
