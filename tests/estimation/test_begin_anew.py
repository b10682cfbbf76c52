"""Fits that would end in the wrong optimum: readings that scatter widely, that are coarse, or that nothing drives."""

from __future__ import annotations

import numpy as np
import pytest
from axis_runs import run, steps

import twin
from twin.estimation import horizon
from twin.io.recording import Recording
from twin.model.stepper import Structure

STRUCTURE = Structure.of(["inertia", "viscous_friction", "dead_band", "backlash", "tooth_compliance"])
VALUES = {
    "input_gain": 0.5, "viscous_friction": 4.0, "dead_band_forward": 4.0, "dead_band_reverse": 3.0,
    "backlash_gap": 0.03, "motor_share": 0.25, "friction_share": 0.7, "tooth_frequency": 90.0,
    "tooth_damping": 0.3,
}  # fmt: skip


#: What is fitted: identification knows no teeth unless it is told.
FIRST = STRUCTURE.without("tooth_compliance")


def recorded(noise: float, counts: float, driven: bool = True) -> Recording:
    """10 s at 2 ms; the readings scatter by `noise` (rad) and are rounded to so many counts per revolution."""
    rng = np.random.default_rng(0)
    time, command = 0.002 * np.arange(5000), steps(rng, 5000, 125, 50.0)
    y, _ = run(STRUCTURE, VALUES, time, command)
    if not driven:
        y = 0.01 * np.cumsum(rng.standard_normal(len(y)))
    count = 2.0 * np.pi / counts
    output = np.round((y + noise * rng.standard_normal(len(y))) / count) * count
    return Recording("made", time, command, output, "%", "rad", resolution=count)


@pytest.mark.parametrize(("noise", "counts"), [(0.2, 10000.0), (0.0, 20.0)], ids=["scattered", "coarse"])
def test_gain_and_friction_are_those_of_the_axis(noise: float, counts: float) -> None:
    """The way from a short memory alone gives a friction ten times too large, with a small error."""
    found = twin.identify(recorded(noise, counts), FIRST)
    assert found.values["input_gain"] == pytest.approx(VALUES["input_gain"], rel=0.05)
    assert found.values["viscous_friction"] == pytest.approx(VALUES["viscous_friction"], rel=0.1)


def test_what_nothing_drives_is_no_estimate() -> None:
    """Each reading is told by the last ones: no value is well known, and the model says why it has these."""
    found = twin.identify(recorded(0.0, 10000.0, driven=False), STRUCTURE)
    assert found.provenance[horizon.LACKING] in (horizon.FOLLOWS, "the likeliest values make up for missing physics")
    assert found.std("input_gain") > 0.5 * abs(found.values["input_gain"])
