"""A curve has to help where it was not fitted, also where something is held out in the middle of the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps

from twin.diagnosis import block_validation, data_split, nonparametric
from twin.diagnosis.nonparametric import CurveTerm
from twin.effects.knots import names
from twin.estimation import optimizer, preparation
from twin.io.recording import Recording
from twin.model.stepper import Structure

STRUCTURE = Structure.of(("inertia", "viscous_friction", "dead_band"))
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
COUNT = 2.0 * np.pi / 16384


def recorded(spring: float) -> Recording:
    """An axis that a spring draws back, or none."""
    time = 0.002 * np.arange(10000)
    duty = steps(np.random.default_rng(4), len(time), 200, 40.0)
    truth = STRUCTURE.with_("spring")
    y, _ = run(truth, VALUES | {"spring_stiffness": spring, "spring_rest": 0.3}, time, duty)
    return Recording("made", time, duty, np.round(y / COUNT) * COUNT, "%", "rad", COUNT)


@pytest.mark.parametrize("where", [data_split.END_PART, data_split.MIDDLE_PART])
def test_a_curve_helps_where_it_is_right_and_not_where_it_is_wrong(where: data_split.Intervals) -> None:
    train, _ = data_split.split([recorded(6.0)], where)
    problem = preparation.prepare_recordings(train, STRUCTURE)
    first = optimizer.fit_with_process_noise(problem, STRUCTURE, VALUES, tuple(VALUES))
    curve = nonparametric.sketch_curve(problem, first, CurveTerm("position"))
    assert block_validation.improves(problem, first, curve)
    # The same curve upside down is as flexible, and wrong.
    upside_down = {n: -curve.values[n] for n in names("unknown_position")}
    wrong = replace(curve, values={**curve.values, **upside_down}, free=first.free)
    assert not block_validation.improves(problem, first, wrong)


def test_blocks_hold_readings_where_the_middle_is_held_out() -> None:
    train, _ = data_split.split([recorded(0.0)], data_split.MIDDLE_PART)
    assert all(part.is_read for part in block_validation.blocks_of(train[0]))
