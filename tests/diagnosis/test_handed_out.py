"""The first model at its best, so that no improvement is overstated."""

from __future__ import annotations

import numpy as np
from axis_runs import run, steps

from twin.diagnosis import data_split, handed_out
from twin.estimation import optimizer, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.stepper import Structure

PLAIN = Structure.of(["inertia", "viscous_friction"])
TRUE = PLAIN.with_("motor_lag")
VALUES = {"input_gain": 0.4, "viscous_friction": 1.5, "lag_time": 0.05}
COUNT = 2.0 * np.pi / 10000.0


def recorded() -> Recording:
    rng = np.random.default_rng(5)
    time, command = 0.004 * np.arange(5000), steps(rng, 5000, 200, 40.0)
    y, _ = run(TRUE, VALUES, time, command + 0.3 * rng.standard_normal(5000))
    return Recording("made", time, command, np.round(y / COUNT) * COUNT, "%", "rad", resolution=COUNT)


def likeliest(train: list[Recording], structure: Structure) -> tuple[FitProblem, Fit]:
    problem = preparation.prepare_recordings(train, structure)
    values = {p.name: VALUES[p.name] for p in structure.parameters}
    return problem, optimizer.fit_with_process_noise(problem, structure, values, problem.free(structure))


def test_the_first_model_is_shown_at_its_best_free_run() -> None:
    train, held_out = data_split.split([recorded()])
    (problem, first), (_, last) = likeliest(train, PLAIN), likeliest(train, TRUE)
    pair = handed_out.pair((problem, problem), (first, last), train, held_out)
    alone = handed_out.adequacy.measure(problem, held_out, first, last, ())
    assert pair.figures.free_run["train"].before.rmse < 0.9 * alone.free_run["train"].before.rmse
    assert pair.first.model.provenance["horizon"] == "whole recordings"
    # What is complete keeps its likeliest values.
    assert pair.last.fit is last and "horizon" not in pair.last.model.provenance


def test_a_model_that_nothing_was_added_to_is_one_model() -> None:
    train, held_out = data_split.split([recorded()])
    problem, fit = likeliest(train, TRUE)
    pair = handed_out.pair((problem, problem), (fit, fit), train, held_out)
    assert pair.first is pair.last and pair.first.fit is fit
    compared = pair.figures.free_run["holdout"]
    assert compared.before == compared.after
