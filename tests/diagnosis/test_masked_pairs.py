"""Effects that mask each other: whichever is concealed, it is named first and its mask is not named at all.

The recordings are MuJoCo's, which shares no code with the model: one drawn rig, on which every effect of `SIZE` changes
at least ten times as much as noise does, and the protocol that was made to separate what others mix up. Dead-band and
backlash are in every model from the start, so that of a wide dead-band the answer is that nothing is missing.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from excitations import rich
from mujoco_rig import TURN, draw_effect, draw_rig, simulate

from twin.diagnosis import diagnose
from twin.diagnosis.result import Diagnosis
from twin.io.recording import Recording
from twin.model.stepper import BASE, Structure

SEED, SECONDS, SIZE = 3, 20.0, 0.15
MASKS = (
    ("dead_band", "coulomb_friction"),
    ("motor_lag", "input_delay", "joint_elasticity"),
    ("quadratic_drag", "thermal_fade", "drive_saturation"),
    ("spring", "end_stop"),
    ("torque_ripple", "encoder_eccentricity"),
    ("load_change", "thermal_fade"),
)
MEMBERS = tuple(dict.fromkeys(i for group in MASKS for i in group))


def diagnosed(*effects: str) -> Diagnosis:
    """What the tool says of a recording of the rig with these effects, starting from the base model."""
    rng = np.random.default_rng(SEED)
    rig = draw_rig(rng)
    if "dead_band" in effects:
        rig = replace(rig, dead_band_forward=14.0, dead_band_backward=12.0)
    concealed = [draw_effect(rng, i, rig, SIZE, SECONDS) for i in effects if i != "dead_band"]
    run = simulate(rig, concealed, *rich(SECONDS, rng), SEED)
    count = TURN / rig.counts_per_revolution
    return diagnose.diagnose(
        [Recording("masked", run.time, run.duty, run.counts * count, "%", "rad", count)], Structure.of(BASE)
    )


@pytest.mark.parametrize("effect", MEMBERS)
def test_the_true_one_is_named_and_its_mask_is_not(effect):
    found = diagnosed(effect)
    named = [f.id for f in found.findings]
    assert found.telling == "masked"
    masks = {i for group in MASKS if effect in group for i in group} - {effect}
    assert not masks & set(named)
    if effect == "dead_band":
        assert found.verdict == "nothing_missing" and not named
    else:
        assert named[0] == effect and found.findings[0].probability > 0.9
        assert not masks & {i for u in found.undecided for i in u.ids}


def test_two_that_mask_each_other_are_both_named():
    assert {f.id for f in diagnosed("quadratic_drag", "drive_saturation").findings} == {
        "quadratic_drag",
        "drive_saturation",
    }


def test_dry_friction_is_named_beside_a_wide_dead_band():
    found = diagnosed("coulomb_friction", "dead_band")
    assert found.findings[0].id == "coulomb_friction" and found.findings[0].probability > 0.9
    assert found.after.values["dead_band_forward"] == pytest.approx(14.0, abs=0.5)
    assert found.after.values["dead_band_reverse"] == pytest.approx(12.0, abs=0.5)
