"""A constant torque beside dead-bands, on a drive that always pushes: only what both make together shows."""

from __future__ import annotations

import numpy as np
import pytest
from axis_runs import run

from twin.diagnosis import diagnose
from twin.io.recording import Recording
from twin.model.stepper import Structure

FIRST = Structure.of(["inertia", "viscous_friction", "dead_band"])
TRUE = {"input_gain": 0.4, "viscous_friction": 3.0, "dead_band_forward": 6.0, "dead_band_reverse": 6.0}
COUNT = 2.0 * np.pi / 20000.0


def pushed(offset: float) -> Recording:
    """A rig with a constant torque (rad/s^2), driven to and fro for 24 s."""
    rng = np.random.default_rng(3)
    time = 0.002 * np.arange(12000)
    piece = (time // 1.2).astype(int)
    duty = rng.uniform(24.0, 34.0, 20)[piece] * (-1.0) ** piece
    shaken = duty + 0.3 * rng.standard_normal(len(time))
    read, _ = run(FIRST.with_("constant_offset"), TRUE | {"offset": offset}, time, shaken)
    return Recording("made", time, duty, COUNT * np.round(read / COUNT), "%", "rad", COUNT)


@pytest.mark.parametrize("offset", [4.4, -4.4])
def test_a_torque_that_leaves_one_dead_band_negative_is_named_at_equal_ones(offset: float) -> None:
    """No dead-band is negative, so there is a torque; of all that there may be, it is given that of equal ones."""
    found = diagnose.diagnose([pushed(offset)], FIRST, {}, ("constant_offset", "spring"))
    (finding,) = found.findings
    assert finding.id == "constant_offset" and found.verdict == "explained"
    assert finding.parameters["offset"].value == pytest.approx(offset, rel=0.01)
    for side in ("dead_band_forward", "dead_band_reverse"):
        assert found.model.values[side] == pytest.approx(6.0, abs=0.1)
    (said,) = (r for r in found.remarks if "dead-bands" in r)
    assert "about equal" in said and "seconds without a command" in said


def test_a_torque_that_unequal_dead_bands_may_be_is_listed_beside_them() -> None:
    found = diagnose.diagnose([pushed(1.2)], FIRST, {}, ("constant_offset", "spring"))
    assert found.verdict == "nothing_missing" and [set(u.ids) for u in found.undecided] == [
        {"dead_band", "constant_offset"}
    ]
