"""A curve has to help where it was not fitted, also where something is held out in the middle of the recording."""

from __future__ import annotations

import numpy as np
import pytest
from axis_runs import run, steps

from twin.diagnosis import block_validation, data_split, nonparametric
from twin.diagnosis.nonparametric import CurveTerm
from twin.effects.knots import names
from twin.estimation import likelihood, optimizer, preparation
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
    same = problem.at(curve.process_noise)
    wrong = likelihood.evaluate(same, curve.structure, {**curve.values, **upside_down}, first.free)
    assert not block_validation.improves(problem, first, wrong)


def test_blocks_hold_readings_where_the_middle_is_held_out() -> None:
    train, _ = data_split.split([recorded(0.0)], data_split.MIDDLE_PART)
    assert all(part.is_read for part in block_validation.blocks_of(train[0]))


def test_a_free_run_that_noise_leads_astray_refutes_no_name() -> None:
    """Torque noise moves the axis so far that the larger error of two is chance, and not where the law is wrong."""
    rng, time = np.random.default_rng(8), 0.002 * np.arange(10000)
    duty = steps(rng, len(time), 200, 40.0)
    truth = STRUCTURE.with_("constant_offset")
    push = 1.2 * rng.standard_normal(len(time)) / np.sqrt(0.002)
    y, _ = run(truth, VALUES | {"offset": 0.2}, time, duty + push)
    noisy = Recording("made", time, duty, np.round(y / COUNT) * COUNT, "%", "rad", COUNT)
    problem = preparation.prepare_recordings([noisy], truth)
    right = optimizer.fit_with_process_noise(problem, truth, VALUES | {"offset": 0.2}, (*VALUES, "offset"))
    same = problem.at(right.process_noise)
    for offset, refuted in ((0.0, False), (right.values["offset"] - 1.0, True)):
        moved = likelihood.evaluate(same, truth, {**right.values, "offset": offset}, right.free)
        ahead = block_validation.errors_ahead(same, right, moved)[-1]
        assert ahead.ratio > 1.3 and ahead.is_worse == refuted
