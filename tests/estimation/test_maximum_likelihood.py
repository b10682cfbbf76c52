"""The way to the maximum: parts of long recordings, a memory that grows, intervals that hold the valleys beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps

from twin.estimation import maximum_likelihood, multistart, optimizer, parameter_bounds, preparation
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording

STRUCTURE, COUNT = preparation.base_structure(), 6e-4
VALUES = {
    "input_gain": 0.3, "viscous_friction": 3.0, "dead_band_forward": 5.0, "dead_band_reverse": 6.0,
    "backlash_gap": 0.03, "motor_share": 0.3, "friction_share": 0.6, "tooth_frequency": 80.0, "tooth_damping": 0.25,
}  # fmt: skip


def made(count: int) -> Recording:
    """Steps of random duty on the model, read in counts."""
    time, duty = 0.002 * np.arange(count), steps(np.random.default_rng(3), count, 200, 40.0)
    read = COUNT * np.round(run(STRUCTURE, VALUES, time, duty)[0] / COUNT)
    return Recording("made", time, duty, read, "%", "rad", COUNT)


def test_a_long_recording_is_looked_at_in_parts_from_its_beginning_to_its_end() -> None:
    whole = preparation.prepare_recordings([made(30000)], STRUCTURE).recordings
    parts = multistart.excerpts(FitProblem(whole), STRUCTURE).recordings
    assert len(parts) == 3 and {p.reading_variance for p in parts} == {whole[0].reading_variance}
    assert all(p.drive.time[0] == 0.0 and p.drive.time[-1] == pytest.approx(12.0, abs=0.003) for p in parts)
    first, last, output = parts[0].recording.output, parts[-1].recording.output, whole[0].recording.output
    np.testing.assert_array_equal(first, output[: len(first)])
    np.testing.assert_array_equal(last, output[-len(last) :])
    short = preparation.prepare_recordings([made(7000)], STRUCTURE).recordings
    assert multistart.excerpts(FitProblem(short), STRUCTURE).recordings == [*short]
    assert multistart.excerpts(FitProblem(whole), STRUCTURE.with_("thermal_fade")).recordings == whole


def test_no_part_lies_in_a_pause() -> None:
    """Somebody went for lunch: what was read before and after is looked at."""
    recording = made(20000)
    late = recording.time > 5.0
    paused = replace(recording, time=recording.time + np.where(late, 600.0, 0.0))
    # Nothing but a few seconds at the end.
    lone = replace(paused, output=np.where(recording.time < 37.0, np.nan, recording.output))
    for shown, least in ((paused, 900), (lone, 700)):
        parts = multistart.excerpts(
            FitProblem(preparation.prepare_recordings([shown], STRUCTURE).recordings), STRUCTURE
        ).recordings
        assert len(parts) == 3 and all(np.isfinite(p.drive.measured).sum() > least for p in parts)


@pytest.mark.parametrize("gap", [0.018, 0.1])
def test_a_memory_that_grows_leads_from_another_gap_and_other_teeth_to_the_truth(gap: float) -> None:
    """A climb with the memory at which all ends gets no further than a valley nearby."""
    cases = FitProblem(preparation.prepare_recordings([made(10000)], STRUCTURE).recordings).stepped(STRUCTURE)
    free = free_parameters(STRUCTURE)
    apart = {"backlash_gap": gap, "motor_share": 0.3 * 0.03 / gap, "tooth_frequency": 80.0, "tooth_damping": 0.4}
    point = multistart._fit_by_lengthening_memory(FitProblem(cases), STRUCTURE, VALUES | apart, free)
    assert point.values["backlash_gap"] == pytest.approx(VALUES["backlash_gap"], rel=0.03)
    assert point.values["tooth_frequency"] == pytest.approx(VALUES["tooth_frequency"], rel=0.05)
    direct = optimizer.levenberg_marquardt(
        FitProblem(cases, process_noise=point.process_noise), STRUCTURE, VALUES | apart, free
    )
    assert direct.deviance > point.deviance + 100.0


def test_the_way_is_found_in_parts_and_ends_with_all_of_a_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multistart, "_EXCERPT_LENGTH", 1.5)
    cases, begun = multistart.coarse_starts([made(10000)], STRUCTURE, {})
    ways = []
    monkeypatch.setattr(
        multistart,
        "_fit_by_lengthening_memory",
        lambda seen, *more, way=multistart._fit_by_lengthening_memory: ways.append(seen) or way(seen, *more),
    )
    point = multistart.fit_from_starts(cases, STRUCTURE, begun)
    assert all(len(seen.recordings) == 3 and seen.recordings[0].drive.time[-1] < 1.6 for seen in ways)
    assert point.values["input_gain"] == pytest.approx(VALUES["input_gain"], rel=1e-3)
    assert point.values["backlash_gap"] == pytest.approx(VALUES["backlash_gap"], rel=0.02)


def test_a_linear_axis_is_the_same_rig_seen_at_a_pinion() -> None:
    turning = made(7000)
    radius = replace(turning, output_unit="m").lever
    sled = replace(turning, output=radius * turning.output, output_unit="m", resolution=radius * COUNT)
    rigid, found = STRUCTURE.without("tooth_compliance"), []
    for recording, length in ((turning, 1.0), (sled, radius)):
        cases, points = multistart.coarse_starts([recording], rigid, {})
        known = VALUES | {"input_gain": 0.3 * length, "backlash_gap": 0.03 * length}
        bred = multistart._evolved_starts(
            cases,
            replace(points[0], structure=STRUCTURE, values=known),
        )
        gaps = [v["backlash_gap"] for v in (*(p.values for p in points), *bred)]
        gains = [p.values["input_gain"] for p in points]
        found.append([*(x / length for x in (*gaps, *gains)), *(p.values["motor_share"] for p in points)])
    assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_from_where_no_slope_leads_to_the_truth_breeding_does() -> None:
    cases = FitProblem(preparation.prepare_recordings([made(7000)], STRUCTURE).recordings).stepped(STRUCTURE)
    free = free_parameters(STRUCTURE)
    apart = {"backlash_gap": 0.012, "motor_share": 0.75, "tooth_frequency": 120.0, "tooth_damping": 0.4}
    astray = multistart._fit_by_lengthening_memory(FitProblem(cases), STRUCTURE, VALUES | apart, free)
    assert astray.values["backlash_gap"] < 0.5 * VALUES["backlash_gap"]
    bred = multistart._evolved_starts(FitProblem(cases), astray)
    for i, one in enumerate(bred):
        assert parameter_bounds.within_bounds(one)
        assert all(
            max(abs(np.log(one[n] / other[n])) for n in multistart._EVOLUTION_RANGES) > 0.09 for other in bred[:i]
        )
    found = min(
        (multistart._fit_by_lengthening_memory(FitProblem(cases), STRUCTURE, v, free) for v in bred),
        key=lambda p: p.deviance,
    )
    assert found.deviance < astray.deviance - 100.0
    assert found.values["backlash_gap"] == pytest.approx(VALUES["backlash_gap"], rel=0.05)


def test_the_intervals_hold_the_truth_and_the_share_goes_with_the_gap() -> None:
    model = maximum_likelihood.identify([made(7000)], STRUCTURE)
    for name in (*maximum_likelihood.PROFILED, "motor_share"):
        low, high = model.intervals[name]
        assert low < model.values[name] < high
        assert low <= VALUES[name] <= high, name
    (thin, wide), (light, heavy) = model.intervals["backlash_gap"], model.intervals["motor_share"]
    product = model.values["backlash_gap"] * model.values["motor_share"]
    assert light <= product / wide and product / thin <= heavy


def test_a_parameter_without_a_trace_may_be_anything_within_its_bounds() -> None:
    time, duty = 0.002 * np.arange(1800), np.repeat([20.0, 35.0, 50.0, 30.0, 45.0, 25.0], 300)
    read = COUNT * np.round(run(STRUCTURE, VALUES, time, duty)[0] / COUNT)
    model = maximum_likelihood.identify([Recording("one way", time, duty, read, "%", "rad", COUNT)], STRUCTURE)
    assert model.intervals["dead_band_reverse"] == parameter_bounds.bounds_of("dead_band_reverse")
    low, high = model.intervals["dead_band_forward"]
    assert low <= VALUES["dead_band_forward"] <= high < low + 0.1
    assert not np.any(np.isnan(list(model.intervals.values())))


@pytest.mark.parametrize(("limit", "found"), [(40.0, 40.0), (80.0, 100.0)])
def test_a_limit_of_the_drive_that_is_reached_is_found_and_another_clips_nothing(limit: float, found: float) -> None:
    """From beyond the largest command no slope leads to it."""
    rng, structure = np.random.default_rng(7), STRUCTURE.with_("drive_saturation").without("backlash")
    time = 0.002 * np.arange(3000)
    duty, truth = steps(rng, len(time)), {**VALUES, "saturation_limit": limit}
    values = preparation.complete_values(structure, truth)
    reading, _ = run(structure, values, time, duty)
    read = COUNT * np.round(reading / COUNT)
    model = maximum_likelihood.identify([Recording("made", time, duty, read, "%", "rad", COUNT)], structure)
    assert model.values["saturation_limit"] == pytest.approx(found, rel=0.01)
    assert model.values["input_gain"] == pytest.approx(VALUES["input_gain"], rel=0.01)
    assert ("saturation_limit" in model.undetermined) is (limit > 60.0)


@pytest.mark.parametrize(
    ("name", "end", "says"),
    [("tooth_frequency", 1, "too stiff to show"), ("tooth_frequency", 0, "missing"), ("backlash_gap", 1, "missing")],
)
def test_what_a_bound_means_is_said_of_the_end_at_which_it_was_met(name: str, end: int, says: str) -> None:
    """Teeth may be stiffer than a recording shows; softer ones are a joint, and wider gaps are something else."""
    problem = preparation.prepare_recordings([made(600)], STRUCTURE)
    values = {**VALUES, name: parameter_bounds.bounds_of(name)[end]}
    free = problem.free(STRUCTURE)
    point = optimizer.levenberg_marquardt(problem.at(1.0), STRUCTURE, values, free, rounds=0)
    said = maximum_likelihood.notes(point, np.zeros((len(free), len(free))))
    assert "ends at its bound" in said[name] and says in said[name]
