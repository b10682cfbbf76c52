"""Meetings of motor and link whose moment noise decides: held against the moments under other noise."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from twin.effects.catalogue import BASE
from twin.estimation import (
    contact_masking,
    filter_memory,
    likelihood,
    multistart,
    optimizer,
    preparation,
    prepared_recording,
)
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording
from twin.model.stepper import Structure
from twin.simulation import kernel

STRUCTURE = Structure.of(BASE)
VALUES = {
    "input_gain": 0.1, "viscous_friction": 1.0, "dead_band_forward": 4.0, "dead_band_reverse": 5.0,
    "backlash_gap": 0.05, "motor_share": 0.3, "friction_share": 0.85,
}  # fmt: skip
TEETH = preparation.with_tooth_compliance(STRUCTURE)
SOFT = {**VALUES, "tooth_frequency": 110.0, "tooth_damping": 0.3}
COUNT = 2.0 * np.pi / 4096.0
STEP = 0.002
SECONDS = 24.0


def slow() -> np.ndarray:
    """Up and down by turns, on ramps along which the motor only just keeps up with the link."""
    time = STEP * np.arange(round(SECONDS / STEP))
    return 30.0 * np.interp(time % 8.0, [0.0, 1.0, 4.0, 5.0, 8.0], [0.0, 1.0, 0.0, -1.0, 0.0])


def quick() -> np.ndarray:
    """The same, without the ramps."""
    return 20.0 * np.sign(slow())


def shaken(duty: np.ndarray, seed: int, size: float = 1.0) -> tuple[PreparedRecording, np.ndarray]:
    """A recording under a noisy drive that nobody knows of, and the moments at which motor and link met."""
    unknown = size * np.random.default_rng(seed).standard_normal(len(duty))
    time = STEP * np.arange(len(duty))
    blank = Recording("made", time, duty + unknown, np.zeros(len(duty)), "%", "rad", COUNT)
    run = kernel.predict(
        prepared_recording.prepare_recording(blank, STRUCTURE).drive, kernel.vector(STRUCTURE, VALUES),
        kernel.start_state(0.0, 0.0, 0.0), keep_states=True,
    )  # fmt: skip
    touching = np.abs(run.states[:, 2]) >= 0.5 * VALUES["backlash_gap"] * (1.0 - 1e-9)
    read = COUNT * np.round(run.reading / COUNT)
    met = time[1:][touching[1:] & ~touching[:-1]]
    return prepared_recording.prepare_recording(replace(blank, input=duty, output=read), STRUCTURE), met


def at_truth(case: PreparedRecording) -> Fit:
    process_noise = optimizer.most_likely_process_noise(FitProblem([case]), STRUCTURE, VALUES)
    return likelihood.evaluate(
        FitProblem([case], process_noise=process_noise), STRUCTURE, VALUES, free_parameters(STRUCTURE)
    )


def test_where_noise_decides_the_moment_nothing_is_judged():
    case, _ = shaken(slow(), 0)
    (judged,) = contact_masking.with_contact_mask(FitProblem([case]), at_truth(case)).recordings
    assert judged.contact_mask is not None and 0.01 < judged.contact_mask.mean() < contact_masking.MAX_MASKED_SHARE
    spread = [shaken(slow(), seed)[1] for seed in range(1, 30)]
    # On the second half of each ramp down the motor lets go; it meets the other flank at about its end.
    for begin, end in ((2.6, 4.0), (6.6, 8.0)):
        first = np.array([m[(m > begin) & (m < end)][0] for m in spread if np.any((m > begin) & (m < end))])
        assert len(first) > 20 and np.std(first) > 3.0 * STEP, "noise does decide them"
        hidden = judged.contact_mask[(first / STEP).astype(int)]
        assert hidden.mean() > 0.8


def test_quick_reversals_are_all_judged():
    case, met = shaken(quick(), 0)
    (judged,) = contact_masking.with_contact_mask(FitProblem([case]), at_truth(case)).recordings
    assert len(met) > 4
    assert judged.contact_mask is None or not judged.contact_mask[(met / STEP).astype(int)].any()


def test_without_a_gap_nothing_is_hidden():
    case, _ = shaken(slow(), 0)
    rigid = STRUCTURE.without("backlash")
    point = replace(at_truth(case), structure=rigid)
    marked = replace(case, contact_mask=np.ones(len(case.drive.time), dtype=bool))
    assert contact_masking.with_contact_mask(FitProblem([marked]), point).recordings[0].contact_mask is None


def test_the_truth_is_as_likely_as_it_should_be_where_only_what_can_be_foreseen_is_judged():
    """Judged throughout, crossings that noise decides speak against the truth by many units; left out, they do not."""
    behind = []
    for seed in range(4):
        case, _ = shaken(slow(), seed)
        point = at_truth(case)
        for cases in ([case], contact_masking.with_contact_mask(FitProblem([case]), point).recordings):
            here = likelihood.evaluate(
                FitProblem(cases, process_noise=point.process_noise), STRUCTURE, VALUES, point.free
            )
            best = optimizer.levenberg_marquardt(
                FitProblem(cases, process_noise=point.process_noise), STRUCTURE, VALUES, point.free
            )
            behind.append(here.deviance - best.deviance)
    # Of so many parameters it is chi-squared: less than three for each in all but one of a thousand.
    assert max(behind[1::2]) < 3.0 * len(VALUES)
    assert max(behind[0::2]) > 5.0 * len(VALUES)


def swept(seconds: float = 12.0, top: float = 8.0) -> Recording:
    """A sine that rises from 0.2 Hz, through the base model with teeth that give."""
    time = STEP * np.arange(round(seconds / STEP))
    rate = np.log(top / 0.2) / time[-1]
    duty = 50.0 * np.sin(2.0 * np.pi * 0.2 * np.expm1(rate * time) / rate)
    blank = Recording("swept", time, duty, np.zeros(len(duty)), "%", "rad", COUNT)
    case = prepared_recording.prepare_recording(blank, TEETH)
    run = kernel.predict(case.drive, kernel.vector(TEETH, SOFT), kernel.start_state(0.0, 0.0, 0.0))
    return replace(blank, output=COUNT * np.round(run.reading / COUNT))


def test_only_between_turns_in_quick_succession_a_motor_rattles() -> None:
    levels = {500: 30.0, 540: -30.0, 600: 30.0, 680: -30.0, 1600: 30.0, 1610: 0.0, 1620: 2.0, 1630: -2.0, 2600: 30.0}
    duty = np.repeat(list(levels.values()), np.diff([0, *levels]))
    blank = Recording("made", STEP * np.arange(len(duty)), duty, np.zeros(len(duty)), "%", "rad", COUNT)
    hidden = contact_masking.find_rattling(prepared_recording.prepare_recording(blank, STRUCTURE))
    # What comes before the first turn and after the last is at rest, and next to nothing is no turn.
    assert hidden is not None and np.array_equal(np.flatnonzero(hidden), np.arange(500, 680))
    for other in (replace(blank, input=-3.0 * duty), replace(blank, input=0.1 * duty)):
        assert np.array_equal(
            contact_masking.find_rattling(prepared_recording.prepare_recording(other, STRUCTURE)), hidden
        )


@pytest.mark.parametrize("wave", [0.0, 1.0])
def test_where_nothing_rattles_or_everything_does_all_is_judged(wave: float) -> None:
    time = STEP * np.arange(5000)
    duty = 30.0 * (np.sign(np.sin(2.0 * np.pi * 5.0 * time)) if wave else np.ones(5000))
    blank = Recording("made", time, duty, np.zeros(5000), "%", "rad", COUNT)
    assert contact_masking.find_rattling(prepared_recording.prepare_recording(blank, STRUCTURE)) is None
    assert preparation.prepare_recordings([swept()], STRUCTURE.without("backlash")).recordings[0].rattle_mask is None


def test_without_its_rattle_a_recording_leads_to_the_truth_from_nearby() -> None:
    (case,) = FitProblem(preparation.prepare_recordings([swept()], TEETH).recordings).stepped(TEETH)
    assert case.rattle_mask is not None and 0.2 < case.rattle_mask.mean() < 0.8
    process_noise, free = filter_memory.process_noise_of(case, 0.1), free_parameters(TEETH)
    rng = np.random.default_rng(0)
    starts = [{n: v * np.exp(0.1 * rng.standard_normal()) for n, v in SOFT.items()} for _ in range(24)]

    def astray(judged: PreparedRecording) -> list[float]:
        """How far above the truth's own maximum the climbs end, in deviance per reading that is judged."""
        readings = np.count_nonzero(np.isfinite(likelihood.innovations(judged, TEETH, SOFT, process_noise).error))
        with ThreadPoolExecutor(2) as pool:
            climbs = pool.map(
                lambda v: optimizer.levenberg_marquardt(
                    FitProblem([judged], process_noise=process_noise), TEETH, v, free
                ),
                (SOFT, *starts),
            )
            ends = [point.deviance for point in climbs]
        return [(end - min(ends)) / readings for end in ends[1:]]

    assert np.median(astray(case)) < 0.3 * np.median(astray(replace(case, rattle_mask=None)))


def test_rattle_is_judged_in_free_runs_and_cut_with_its_recording() -> None:
    (case,) = preparation.prepare_recordings([swept()], TEETH).recordings
    assert likelihood.with_free_runs(case, 1.0, 2.0).rattle_mask is None
    part = preparation.excerpt(case, TEETH, 3.0, 11.0)
    assert np.array_equal(part.rattle_mask, case.rattle_mask[1500:5501])


@pytest.mark.parametrize(("begun", "after"), [(0.0, 0.0), (1.0, 0.0), (1.0, 2.5)])
def test_until_motor_and_link_have_met_nothing_is_judged(begun: float, after: float) -> None:
    """The first push comes at `begun`; the link moves by itself, or `after` the push."""
    time = STEP * np.arange(5000)
    duty = np.where(time >= begun, 20.0 * np.sign(np.sin(2.0 * np.pi * 0.4 * (time - begun) + 1e-9)), 1.0)
    moving = np.maximum(time - begun - after, 0.0) if after else time
    made = Recording("made", time, duty, COUNT * np.round(moving / COUNT), "%", "rad", COUNT)
    hidden = contact_masking.find_first_contact(prepared_recording.prepare_recording(made, STRUCTURE))
    assert hidden is not None and hidden[0] and not np.any(np.diff(hidden.astype(int)) > 0)
    assert time[hidden][-1] == pytest.approx(begun + after + 0.25, abs=0.01)
    pushed_once = replace(made, input=np.abs(duty))
    assert contact_masking.find_first_contact(prepared_recording.prepare_recording(pushed_once, STRUCTURE)) is None


@pytest.mark.parametrize("stands", [-1.0, -0.47, 0.3, 1.0])
def test_where_in_its_gap_the_motor_stood_at_the_start_misleads_nobody(stands: float) -> None:
    time = STEP * np.arange(4000)
    duty = np.where(time > 0.4, 20.0 * np.sign(np.sin(2.0 * np.pi * 0.5 * time)), 0.0)
    blank = Recording("made", time, duty, np.zeros(4000), "%", "rad", COUNT)
    x = kernel.start_state(0.0, 0.0, 0.5 * stands * SOFT["backlash_gap"])
    run = kernel.predict(prepared_recording.prepare_recording(blank, TEETH).drive, kernel.vector(TEETH, SOFT), x)
    recording = replace(blank, output=COUNT * np.round(run.reading / COUNT))
    cases = FitProblem(preparation.prepare_recordings([recording], TEETH).recordings).stepped(TEETH)
    (chosen,) = multistart.choose_initial_contacts(FitProblem(cases), TEETH, SOFT).recordings
    assert chosen.contact == pytest.approx(stands, abs=0.13)
    process_noise, free = filter_memory.process_noise_of(chosen, 0.1), free_parameters(TEETH)
    point = optimizer.levenberg_marquardt(FitProblem([chosen], process_noise=process_noise), TEETH, SOFT, free)
    truth = likelihood.evaluate(FitProblem([chosen], process_noise=process_noise), TEETH, SOFT, free)
    assert truth.deviance - point.deviance < 3.0 * len(free)
