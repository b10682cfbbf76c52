"""The filter that knows whether motor and link touch: held against textbook matrices, and against noise put in."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from twin.effects.catalogue import BASE
from twin.estimation import filter_memory, likelihood, optimizer, prepared_recording
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.stepper import Structure
from twin.simulation import kernel
from twin.simulation.kernel import Noise

STRUCTURE = Structure.of(BASE)
VALUES = {
    "input_gain": 0.3, "viscous_friction": 2.0, "dead_band_forward": 4.0, "dead_band_reverse": 5.0,
    "backlash_gap": 0.06, "motor_share": 0.25, "friction_share": 0.7,
}  # fmt: skip
FREE = tuple(VALUES)
COUNT = 2e-4
STEP = 0.002


def made(speed: bool = False, shaken: float = 0.0, duration: float = 12.0) -> PreparedRecording:
    """Quick reversals of the base model, read in counts; `shaken` is the noise of the duty, unknown to the reader."""
    rng = np.random.default_rng(4)
    count = round(duration / STEP)
    duty = 40.0 * np.repeat(rng.uniform(-1.0, 1.0, count // 100 + 1), 100)[:count]
    unknown = shaken * rng.standard_normal(count)
    unit = "rad/s" if speed else "rad"
    blank = Recording("made", STEP * np.arange(count), duty + unknown, np.zeros(count), "%", unit, COUNT)
    p = kernel.vector(STRUCTURE, VALUES)
    read = kernel.predict(
        prepared_recording.prepare_recording(blank, STRUCTURE).drive, p, kernel.start_state(0.0, 0.0, 0.0)
    ).reading
    read = COUNT * np.round(read / COUNT)
    read[count // 2 : count // 2 + 40] = np.nan
    return prepared_recording.prepare_recording(replace(blank, input=duty, output=read), STRUCTURE)


def van_loan(friction: float, link: float, motor: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise of (link position, velocity, motor position, velocity) over one step, apart."""
    body = np.array([[0.0, 1.0], [0.0, -friction]])
    a = np.kron(np.eye(2), body)
    q = np.diag([0.0, link, 0.0, motor])
    both = expm(np.block([[-a, q], [np.zeros((4, 4)), a.T]]) * STEP)
    transition = both[4:, 4:].T
    return transition, transition @ both[:4, 4:]


@pytest.mark.parametrize("speed", [False, True])
def test_the_filter_is_the_one_of_the_textbook(speed: bool) -> None:
    case = made(speed)
    noise = Noise(3e3 if speed else 3e5, 2.0, 7.0)
    run = kernel.predict(case.drive, kernel.vector(STRUCTURE, VALUES), kernel.start_state(0.0, 0.0, 0.0), noise, True)
    share, half = VALUES["motor_share"], 0.5 * VALUES["backlash_gap"]
    transition, _ = van_loan(VALUES["viscous_friction"], 0.0, 0.0)
    # What friction does within a step to the noise of that step is left out.
    _, apart = van_loan(0.0, noise.density, 0.5 * noise.density / share**2)
    _, one = van_loan(0.0, noise.density, 0.0)
    weights = np.array([1.0 - share, share])
    merge = np.kron(np.outer(np.ones(2), weights), np.eye(2))
    joined = np.kron(np.outer(np.ones(2), [1.0, 0.0]), np.eye(2))
    # What is noted at a stamp is the state before it is corrected; whether link and motor touch is decided then.
    touching = np.abs(run.states[:, 2]) >= half * (1.0 - 1e-9)
    assert 0.1 < np.mean(touching) < 0.9
    seen = np.zeros(4)
    seen[1 if speed else 0] = 1.0
    c = np.kron(np.ones((2, 2)), np.diag([noise.position, noise.velocity]))
    spread, pull = np.empty(len(touching)), np.empty(len(touching))
    for i, together in enumerate(touching):
        if i > 0:
            c = transition @ c @ transition.T
            c = merge @ c @ merge.T + joined @ one @ joined.T if together else c + apart
        spread[i] = seen @ c @ seen + 1.0
        gain = c @ seen / spread[i]
        pull[i] = weights @ gain[1::2]
        if np.isfinite(case.drive.measured[i]):
            c = c - np.outer(gain, gain) * spread[i]
    assert np.allclose(run.spread, spread, rtol=1e-6)
    assert np.allclose(run.pull, pull, rtol=1e-6, atol=1e-9 * np.abs(pull).max())


@pytest.mark.parametrize("silence", [math.inf, 0.05])
def test_slopes_of_the_filtered_reading_are_differences(silence: float) -> None:
    case = made()
    x, noise = (
        kernel.start_state(*case.start, 0.0),
        filter_memory.filter_noise(case, filter_memory.process_noise_of(case, 0.05)),
    )
    noise = replace(noise, silence=silence)
    names = ("input_gain", "dead_band_forward")
    run = kernel.predict_with_slopes(case.drive, kernel.vector(STRUCTURE, VALUES), x, kernel.fixed_start(names), noise)
    for j, name in enumerate(names):
        h = 1e-7 * VALUES[name]
        up, down = (
            kernel.predict(case.drive, kernel.vector(STRUCTURE, {**VALUES, name: VALUES[name] + s * h}), x, noise)
            for s in (1.0, -1.0)
        )
        numeric = (up.reading - down.reading) / (2.0 * h)
        seen = np.isfinite(run.reading)
        assert seen.all() == (silence == math.inf)
        wrong = np.abs(numeric - run.slopes[:, j])[seen] > 1e-3 * np.abs(run.slopes[:, j]).max()
        # Where a small change moves a landing from one stamp to the next the gains jump.
        assert np.mean(wrong) < 0.02


@pytest.mark.parametrize("speed", [False, True])
def test_after_a_silence_the_filter_begins_anew_where_it_reads_the_axis(speed: bool) -> None:
    """As if the recording began there, but for the motion that the model has gone on with."""
    case, silence, back = made(speed), 0.5, 1000
    measured = case.drive.measured.copy()
    measured[back - 400 : back] = np.nan
    measured[back:] += 0.7
    noise = replace(filter_memory.filter_noise(case, filter_memory.process_noise_of(case, 0.05)), silence=silence)
    p, x = kernel.vector(STRUCTURE, VALUES), kernel.start_state(*case.start, 0.0)
    run = kernel.predict(replace(case.drive, measured=measured), p, x, noise, True)
    assert np.flatnonzero(np.isnan(run.reading)).tolist() == [back]
    state = run.states[back].copy()
    if speed:
        state[[1, 3]] += measured[back] - state[1]
    else:
        state[0] = measured[back]
    late = {n: getattr(case.drive, n)[back:] for n in ("time", "command")}
    anew = kernel.predict(replace(case.drive, measured=measured[back:], **late), p, state, noise)
    assert np.allclose(run.reading[back + 1 :], anew.reading[1:], rtol=1e-12)
    assert np.allclose(run.spread[back:], anew.spread, rtol=1e-12)
    patient = kernel.predict(replace(case.drive, measured=measured), p, x, replace(noise, silence=1.0))
    assert np.isfinite(patient.reading).all()
    error = [np.abs(measured - r.reading)[back + 1 : back + 50].max() for r in (run, patient)]
    # A speed is one reading from being known, in either way.
    assert error[0] < (1.1 if speed else 0.1) * error[1]


def test_noise_is_found_as_strong_as_it_is_in_a_loose_gap() -> None:
    shaken = 1.0
    case = made(shaken=shaken, duration=30.0)
    found = optimizer.most_likely_process_noise(FitProblem([case]), STRUCTURE, VALUES)
    planted = (VALUES["input_gain"] * shaken) ** 2 * STEP / case.reading_variance
    assert 0.3 < found / planted < 3.0
    point = likelihood.evaluate(FitProblem([case], process_noise=found), STRUCTURE, VALUES, FREE)
    assert 0.7 < point.scale < 1.5
    # A stretch for each parameter is used up by the maximum: what is left is taken for the more.
    stretches = 30.0 / 0.5
    assert point.overdispersion < 2.0 * stretches / (stretches - len(FREE))


def test_without_noise_nothing_is_corrected() -> None:
    case = made()
    p, x = kernel.vector(STRUCTURE, VALUES), kernel.start_state(*case.start, 0.0)
    free = kernel.predict(case.drive, p, x)
    blind = replace(case.drive, measured=np.full(len(case.drive.time), np.nan))
    assert np.array_equal(free.reading, kernel.predict(blind, p, x, Noise(1e5)).reading)
    assert np.all(free.spread == 1.0)


def test_a_link_that_weighs_nothing_is_not_followed_without_memory() -> None:
    """In the gap the filter knows of the link what it knows where motor and link are one, however light it is."""
    case = made()
    noise = filter_memory.filter_noise(case, filter_memory.process_noise_of(case, 0.1))
    start = kernel.start_state(*case.start, 0.0)
    loose = kernel.predict(case.drive, kernel.vector(STRUCTURE, {**VALUES, "motor_share": 0.98}), start, noise, True)
    rigid = Structure.of([i for i in BASE if i != "backlash"])
    tight = kernel.predict(case.drive, kernel.vector(rigid, VALUES), start, noise)
    apart = np.abs(loose.states[:, 2]) < 0.5 * VALUES["backlash_gap"] * (1.0 - 1e-9)
    assert 0.1 < np.mean(apart) < 0.9
    assert np.all(loose.spread < 1.3 * tight.spread.max())
