"""A recording that is too long for its slopes to be held at once: piece by piece, the same numbers."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps

from twin.estimation import filter_memory, likelihood, preparation, prepared_recording
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.io.recording import Loop, Recording
from twin.model.stepper import Structure
from twin.simulation import kernel

STRUCTURE = Structure.of(
    ["inertia", "viscous_friction", "dead_band", "backlash", "coulomb_friction", "motor_lag", "input_delay"]
)
VALUES = {
    "input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 4.0, "dead_band_reverse": 5.0,
    "backlash_gap": 0.02, "motor_share": 0.3, "friction_share": 0.6, "coulomb_friction": 0.5, "lag_time": 0.02,
    "delay": 0.013,
}  # fmt: skip
FREE = tuple(VALUES)


def made(count: int = 6000) -> Recording:
    rng = np.random.default_rng(2)
    time, command = 0.002 * np.arange(count), steps(rng, count, 250, 40.0)
    y, _ = run(STRUCTURE, VALUES, time, command + 0.3 * rng.standard_normal(count))
    output = np.round(y / 6e-4) * 6e-4
    output[1500:1800] = np.nan
    return Recording("made", time, command, output, "%", "rad", resolution=6e-4)


@pytest.mark.parametrize("most", [1, 7, 1600, 5999, 6000, 10**6])
@pytest.mark.parametrize("closed", [False, True])
def test_slopes_in_pieces_are_those_of_the_whole(most: int, closed: bool) -> None:
    loop = Loop("P", gain=150.0, limit=60.0)
    recording = replace(made(), loop=loop, optional={"reference": np.sin(np.arange(6000) / 500.0)})
    case = prepared_recording.prepare_recording(recording, STRUCTURE, closed=closed)
    p = kernel.vector(STRUCTURE, VALUES)
    noise = filter_memory.filter_noise(case, filter_memory.process_noise_of(case, 0.1))
    given = (case.drive, p, kernel.start_state(*case.start, 0.0), kernel.fixed_start(FREE), noise)
    whole = kernel.predict_with_slopes(*given)
    parts = list(kernel.in_pieces(*given, most))
    assert [at.start for at, _ in parts] == list(range(0, 6000, most))
    assert np.array_equal(np.concatenate([one.reading for _, one in parts]), whole.reading, equal_nan=True)
    assert np.flatnonzero(np.isnan(whole.reading)).tolist() == [1800]
    assert np.array_equal(np.concatenate([one.spread for _, one in parts]), whole.spread)
    assert np.array_equal(np.concatenate([one.slopes for _, one in parts]), whole.slopes)
    assert np.ptp(whole.slopes) > 0.0 and np.ptp(whole.spread) > 0.0


@pytest.mark.parametrize("ahead", [False, True])
def test_a_point_is_the_same_in_pieces(monkeypatch: pytest.MonkeyPatch, ahead: bool) -> None:
    def found(cases: Sequence[PreparedRecording]) -> list[np.ndarray]:
        point = likelihood.evaluate(FitProblem(cases, process_noise=process_noise), STRUCTURE, VALUES, FREE)
        spread = likelihood.jackknife_covariance(FitProblem(cases), point)
        return [np.array([point.deviance, point.scale]), point.information, point.gradient, spread]

    cases = preparation.prepare_recordings([made(), made(3000)], STRUCTURE).recordings
    process_noise = filter_memory.process_noise_of(cases[0], 0.05)
    if ahead:
        cases = [likelihood.with_free_runs(c, process_noise, 1.0) for c in cases]
    whole = found(cases)
    monkeypatch.setattr(likelihood, "MAX_STAMPS_AT_ONCE", 777)
    monkeypatch.setattr(likelihood, "_CACHE", OrderedDict())
    for one, other in zip(found(cases), whole, strict=True):
        assert np.abs(one - other).max() <= 1e-9 * np.abs(other).max()
