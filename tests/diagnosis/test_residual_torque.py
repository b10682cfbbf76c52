"""The missing torque, read off what a filter has to add to the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run

from twin.diagnosis import residual_torque
from twin.diagnosis.residual_torque import MissingTorque
from twin.estimation.prepared_recording import prepare_recording
from twin.io.recording import Recording
from twin.model.stepper import Structure

FIRST = Structure.of(["inertia", "viscous_friction"])
VALUES = {"input_gain": 0.4, "viscous_friction": 0.3}
DRY = 3.0


def recorded() -> Recording:
    """20 s of a rig with dry friction, read at each row to a ten-thousandth of a radian."""
    time = 0.005 * np.arange(4000)
    command = 30.0 * np.sin(0.2 * 2.0 * np.pi * time)
    y, _ = run(FIRST.with_("coulomb_friction"), VALUES | {"coulomb_friction": DRY}, time, command)
    return Recording("made", time, command, np.round(y / 1e-4) * 1e-4, "%", "rad", resolution=1e-4)


def missing(recording: Recording) -> MissingTorque:
    return residual_torque.missing_torque(prepare_recording(recording, FIRST), FIRST, VALUES)


@pytest.mark.parametrize("every", [1, 2, 4])
def test_a_sensor_that_is_read_slowly_shows_the_torque_too(every: int) -> None:
    recording = recorded()
    seen = np.where(np.arange(len(recording.time)) % every == 0, recording.output, np.nan)
    found = missing(replace(recording, output=seen))
    means = found.averages()
    known = np.isfinite(means["torque"])
    assert known.mean() > 0.9
    steady = known & (np.abs(means["velocity"]) > 1.0)
    assert np.median(-means["torque"][steady] * np.sign(means["velocity"][steady])) == pytest.approx(DRY, rel=0.1)


def test_nothing_is_known_of_the_torque_in_a_silence() -> None:
    recording = recorded()
    silent = (recording.time > 8.0) & (recording.time < 9.0)
    found = missing(replace(recording, output=np.where(silent, np.nan, recording.output)))
    inside = (found.time > 8.05) & (found.time < 8.9)
    assert np.isnan(found.torque[inside]).all()
    assert np.isfinite(found.torque).mean() > 0.85


def test_a_recording_without_readings_shows_no_torque() -> None:
    recording = recorded()
    case = prepare_recording(recording, FIRST)
    blind = replace(case, drive=replace(case.drive, measured=np.full(len(recording.time), np.nan)))
    found = residual_torque.missing_torque(blind, FIRST, VALUES)
    assert np.isnan(found.torque).all() and found.rms == 0.0
