"""The study's arithmetic on numbers of known meaning, and one rig of the whole."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from experiment_study import Row, main, median_interval, ratio, repeated, standard_error, summary

from twin.diagnosis.result import Experiment


def test_the_interval_of_a_median_holds_it_as_often_as_it_says():
    rng = np.random.default_rng(1)
    intervals = [median_interval(rng.exponential(size=12)) for _ in range(2000)]
    held = [low <= math.log(2.0) <= high for _, low, high in intervals]
    assert 0.94 < np.mean(held) < 0.995


def test_infinite_ratios_only_count_as_large():
    middle, low, high = median_interval([0.2, 0.3, 0.5, math.inf, 0.4, 0.1, 0.6])
    assert (middle, low) == (0.4, 0.1) and math.isinf(high)


@pytest.mark.parametrize(("repeats", "wider"), [(1, 1.0), (9, 3.0)])
def test_a_standard_error_is_that_of_least_squares_and_larger_where_errors_repeat_each_other(repeats, wider):
    rng = np.random.default_rng(2)
    ratios = []
    for _ in range(30):
        slopes = np.repeat(rng.standard_normal((60, 10, 3)), repeats, axis=1)
        errors = np.repeat(rng.standard_normal((60, 10)), repeats, axis=1)
        pulls = np.einsum("krn,kr->kn", slopes, errors)
        infos = np.einsum("krn,krm->knm", slopes, slopes)
        plain = math.sqrt(np.linalg.inv(infos.sum(axis=0))[1, 1])
        ratios.append(standard_error(pulls, infos, 1) / plain)
    assert np.mean(ratios) == pytest.approx(wider, rel=0.12)


def test_seconds_are_compared_as_they_are_printed():
    rows = [Row("gap", 2.0, 2.0, (8.0, math.inf), (0.01, 0.03, 0.02)), Row("a, not b", 2.0, math.inf, (4.0, math.inf))]
    assert [ratio(rows[0], k) for k in (0, 1)] == [0.25, 0.0]
    assert math.isinf(ratio(rows[1], 0)) and math.isnan(ratio(rows[1], 1))
    said = summary([*rows, Row("gap", 2.0, 2.0, (1.0, 1.0), (0.02, 0.02, 0.02), (0.0, 0.0, 0.1))])
    assert "parameter: seconds designed over seconds by paper: median 1.12 (0.25 to 2.00), fewer in 1 of 2" in said
    assert "two rivals: seconds designed over seconds by paper: median inf" in said
    assert "two rivals: seconds designed over seconds by rich" not in said
    assert "travel: beyond the limit in 1 of 3, at most by 10.0 %" in said


def test_a_design_is_played_over_and_over():
    time, duty = repeated(Experiment("", np.array([0.0, 0.1, 0.2]), np.array([5.0, -5.0, 0.0])), 0.7)
    assert np.allclose(time, np.arange(7) * 0.1) and duty.tolist() == [5.0, -5.0, 0.0, 5.0, -5.0, 0.0, 5.0]


def test_one_rig(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--rigs", "1", "--seed", "5"])
    printed = capsys.readouterr().out
    assert "worst-known parameter: seconds designed over seconds by rich" in printed
    for limit in ("duty", "seconds", "travel"):
        assert f"{limit}: beyond the limit in 0 of 1" in printed
