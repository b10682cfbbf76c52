"""Whatever the units of stamps, counts and inputs are: an answer, or a refusal; never a number that is none."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

import twin
from twin.errors import BadInput
from twin.io.recording import Recording
from twin.model.fitted_model import dumps

STEP, GAIN, FRICTION = 0.005, 6.0, 5.0
TIME = STEP * np.arange(3000)
VOLTS = np.repeat([6.0, 12.0, -6.0, -12.0, 0.0, 9.0, -9.0, 6.0, -12.0, 12.0], 300)


def moved(volts: np.ndarray) -> np.ndarray:
    """The position (N,) of an axis under volts that are held for STEP s each."""
    decay = math.exp(-FRICTION * STEP)
    speed = lfilter([0.0, GAIN / FRICTION * (1.0 - decay)], [1.0, -decay], volts)
    way = GAIN / FRICTION * volts * STEP - np.diff(speed, append=speed[-1]) / FRICTION
    return np.concatenate(([0.0], np.cumsum(way)[:-1]))


POSITION = moved(VOLTS)
EXPONENT = st.floats(-15.0, 15.0)
STAMPS = st.one_of(st.floats(-1.0, 1.0), EXPONENT)


@settings(max_examples=20, deadline=None)
@given(STAMPS, EXPONENT, EXPONENT)
def test_thirty_decades_of_scale_change_nothing_but_the_scale(stamps: float, counts: float, inputs: float) -> None:
    time, output, drive = TIME * 10.0**stamps, POSITION * 10.0**counts, VOLTS * 10.0**inputs
    recording = Recording("scaled", time, drive, np.round(output / 10.0**counts, 4) * 10.0**counts, "V", "rad")
    try:
        model = twin.identify(recording, method="two-stage")
    except BadInput as refused:
        assert "nan" not in str(refused)
        assert abs(stamps) > 1.5 or "steady" in str(refused)
        return
    assert not re.search(r"= *-?nan", dumps(model))
    assert model.values["viscous_friction"] * 10.0**stamps == pytest.approx(FRICTION, rel=0.05)
    scale = 10.0 ** (inputs - counts + 2.0 * stamps)
    assert model.values["input_gain"] * scale == pytest.approx(GAIN, rel=0.05)


def test_a_recording_too_short_for_a_gap_says_what_helps() -> None:
    volts = np.repeat([6.0, -9.0, 12.0, -6.0, 9.0, -12.0, 6.0, 12.0, -9.0, -6.0], 150)
    quick = Recording("quick", TIME[:1500] / 50.0, volts, np.round(moved(volts), 4), "V", "rad", 1e-4)
    with pytest.raises(BadInput, match=r"record for longer.*or name backlash in `exclude`"):
        twin.identify(quick)
    model = twin.identify(quick, twin.first_structure(quick, (), ["backlash"]))
    assert model.values["viscous_friction"] == pytest.approx(50.0 * FRICTION, rel=0.01)
    assert model.values["input_gain"] == pytest.approx(2500.0 * GAIN, rel=0.01)
