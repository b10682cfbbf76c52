"""The rig's own loop around a model: against a loop written out by hand, through the kernel and through the FMU."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.errors import BadInput
from twin.estimation import likelihood, prepared_recording
from twin.fmi import python_fmu
from twin.io.position_loop import PERIOD, own_loop
from twin.io.recording import Loop, Recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

STRUCTURE = Structure.of(["inertia", "viscous_friction"])
VALUES = {"input_gain": 3.0, "viscous_friction": 20.0}
LOOP = Loop("P", gain=200.0, limit=80.0, reference_rate_limit=4.0, minimum=1.5)


def by_hand(loop: Loop, reference: np.ndarray, step: float, held: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and commands every `held` steps of an axis that decays exactly between commands."""
    b, c = VALUES["viscous_friction"], VALUES["input_gain"]
    decay = np.exp(-b * step)
    place = speed = goal = 0.0
    positions, commands = [], []
    for i, wanted in enumerate(np.repeat(reference, held)[: (len(reference) - 1) * held + 1]):
        most = np.inf if loop.reference_rate_limit is None else loop.reference_rate_limit * step
        goal = wanted if i == 0 else goal + np.clip(wanted - goal, -most, most)
        u = loop.gain * (goal - place) if loop.law == "P" else loop.kv * (loop.kp * (goal - place) - speed)
        if loop.minimum and 0.0 < abs(u) < loop.minimum:
            u = np.sign(u) * loop.minimum
        u = np.clip(u, -loop.limit, loop.limit) if loop.limit else u
        positions.append(place)
        commands.append(u)
        final = c * u / b
        place += final * step + (speed - final) * (1.0 - decay) / b
        speed = final + (speed - final) * decay
    return np.array(positions[::held]), np.array(commands[::held])


def followed(loop: Loop, stamp: float = 0.01) -> Recording:
    time = stamp * np.arange(300)
    reference = np.where(time < 1.0, 0.0, np.where(time < 2.0, 1.0, 0.3))
    return Recording(
        "followed", time, np.zeros(300), np.zeros(300), "%", "rad", loop=loop, optional={"reference": reference}
    )


@pytest.mark.parametrize("loop", [LOOP, replace(LOOP, minimum=None), Loop("P-P", kp=5.0, kv=40.0)], ids=repr)
def test_the_closed_loop_is_the_one_written_by_hand(loop: Loop, tmp_path: Path) -> None:
    recording = followed(loop)
    position, command = by_hand(loop, recording.optional["reference"], PERIOD, 5)
    assert np.ptp(position) > 0.9
    # At rest the smallest command pushes to and fro about the goal, and rounding decides where it begins.
    close, pushing = (1e-3, np.abs(command) > 5.0) if loop.minimum else (2e-4, np.isfinite(command))
    case = prepared_recording.prepare_recording(recording, STRUCTURE, closed=True)
    error = likelihood.innovations(case, STRUCTURE, VALUES, 0.0).error
    assert -error[own_loop(recording).stamps] == pytest.approx(position, abs=close)
    fmu = python_fmu.export(Model(STRUCTURE, VALUES, sample_time=0.01), tmp_path / "axis.fmu")
    seen = python_fmu.replay(fmu, recording, (0.0, 0.0), closed=True)
    assert seen.position == pytest.approx(position, abs=close)
    assert seen.input[pushing] == pytest.approx(command[pushing], abs=0.3)


def test_slopes_through_the_loop_are_those_of_differences() -> None:
    case = prepared_recording.prepare_recording(followed(replace(LOOP, minimum=None)), STRUCTURE, closed=True)
    free = ("input_gain", "viscous_friction")
    exact = likelihood.innovations(case, STRUCTURE, VALUES, 0.0, free).slopes
    for i, name in enumerate(free):
        h = 1e-5 * VALUES[name]
        up, down = (
            likelihood.innovations(case, STRUCTURE, VALUES | {name: VALUES[name] + s * h}, 0.0).error for s in (1, -1)
        )
        at = np.isfinite(up)
        assert exact[at, i] == pytest.approx(((down - up) / (2.0 * h))[at], rel=1e-3, abs=1e-6)


def test_a_counted_reading_is_what_the_loop_acts_on() -> None:
    loop = own_loop(replace(followed(replace(LOOP, minimum=None)), resolution=0.1))
    assert loop.command(0, 0.149, 0.0) == pytest.approx(-20.0)
    assert loop.command(0, 0.151, 0.0) == pytest.approx(-40.0)


def test_without_a_known_loop_it_is_refused() -> None:
    recording = followed(LOOP)
    with pytest.raises(BadInput, match=r"add \[loop\] to the rig file"):
        own_loop(replace(recording, loop=None))
    with pytest.raises(BadInput, match="position loop"):
        own_loop(replace(recording, output_unit="rad/s"))
