"""The study's arithmetic on errors of known size, and a small run of the whole."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import estimator_study
from estimator_study import METHODS, Outcome, cell, main
from simulators import SIMULATORS

from twin.estimation.preparation import base_structure
from twin.estimation.problem import free_parameters


def outcome(estimate: float, std: float, bound: float, parameter: str = "input_gain") -> Outcome:
    return Outcome(0, "rich", METHODS[2], parameter, 2.0, estimate, std, bound, 1.0)


@pytest.mark.parametrize(("scale", "coverage"), [(1.0, 95.0), (0.5, 67.3)])
def test_normal_errors_of_the_bound_give_ratio_one_and_the_coverage_of_their_intervals(
    scale: float, coverage: float
) -> None:
    errors = 0.02 * np.random.default_rng(0).standard_normal(20000)
    median, high, ratio, held = cell(outcome(2.0 + e, 0.02 * scale, 0.02) for e in errors).split()
    assert float(median) == pytest.approx(0.6745, rel=0.03)  # percent of 2.0
    assert float(high) == pytest.approx(1.96, rel=0.03)
    assert float(ratio) == pytest.approx(1.0, rel=0.03)
    assert float(held.rstrip("%")) == pytest.approx(coverage, abs=1.0)


def test_dead_band_errors_are_in_duty_and_missing_estimates_are_left_out() -> None:
    found = [outcome(2.5, 1.0, 0.5, "dead_band_forward"), outcome(math.nan, math.nan, 0.5, "dead_band_forward")]
    assert cell(found).split()[0] == "0.5"
    assert set(cell(found[1:]).split()) == {"-"}


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_every_estimated_parameter_has_a_truth(simulator: str) -> None:
    rig = SIMULATORS[simulator].draw_rig(np.random.default_rng(0))
    assert set(rig.model_values()) == set(free_parameters(base_structure()))


def test_two_rigs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "study.json"
    main(["--rigs", "2", "--duration", "12", "--excitation", "paper", "--processes", "1", "--out", str(out)])
    printed = capsys.readouterr().out
    outcomes = [Outcome(**entry) for entry in json.loads(out.read_text(encoding="utf-8"))]
    assert len(outcomes) == 2 * len(METHODS) * len(free_parameters(base_structure()))
    assert all(method in printed for method in METHODS) and "backlash_gap" in printed
    for o in outcomes:
        assert 0.0 < o.bound < math.inf
        if o.method == "joint" and o.parameter in ("input_gain", "viscous_friction"):
            assert o.error < 10.0, o
    assert estimator_study.table(outcomes) in printed
