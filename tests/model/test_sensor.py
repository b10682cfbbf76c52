"""A recording begins with a reading; where the axis was then its sensor decides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.estimation import estimate, likelihood, optimizer, prepared_recording
from twin.estimation.problem import FitProblem, free_parameters
from twin.io.recording import Recording
from twin.model import sensor
from twin.model.stepper import Structure

PLAIN = Structure.of(("inertia", "viscous_friction", "dead_band"))
OFF_CENTRE = PLAIN.with_("encoder_eccentricity")
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
COUNT = 2.0 * np.pi / 16384


@settings(deadline=None)
@given(st.floats(-20.0, 20.0), st.floats(0.0, 0.5), st.floats(-7.0, 7.0))
def test_the_sensor_reads_there_what_was_read(reading: float, size: float, angle: float) -> None:
    values = {**VALUES, "eccentricity": size, "eccentricity_angle": angle}
    position = sensor.position(OFF_CENTRE, values, reading)
    assert position + size * np.sin(position - angle) == pytest.approx(reading, abs=1e-9)
    # The derivative of what defines it: dx + sin(x - a) de + e cos(x - a) (dx - da) = 0.
    lean = 1.0 + size * np.cos(position - angle)
    by_hand = {"eccentricity": -np.sin(position - angle), "eccentricity_angle": size * np.cos(position - angle)}
    for name, value in by_hand.items():
        assert sensor.slope(OFF_CENTRE, values, reading, name) == pytest.approx(value / lean, abs=1e-5)


@given(st.floats(-20.0, 20.0))
def test_a_sensor_that_errs_by_nothing_reads_where_the_axis_is(reading: float) -> None:
    assert sensor.position(PLAIN, VALUES, reading) == reading and sensor.parameters(PLAIN) == ()


@pytest.mark.parametrize("angle", [1.0, -2.2])
def test_an_encoder_off_centre_is_estimated_wherever_a_recording_begins(angle: float) -> None:
    """The error at the first reading is none of the model's: it is tens of counts here."""
    rng = np.random.default_rng(2)
    time = 0.002 * np.arange(8000)
    command = steps(rng, len(time), 300, 25.0)
    true = {**VALUES, "eccentricity": 0.01, "eccentricity_angle": angle}
    y, _ = run(OFF_CENTRE, true, time, command + 0.3 * rng.standard_normal(len(time)))
    recording = Recording("made", time, command, np.round(y / COUNT) * COUNT, "%", "rad", COUNT)
    assert abs(recording.output[0]) > 15.0 * COUNT
    case = prepared_recording.prepare_recording(recording, OFF_CENTRE)
    begun = {**true, "eccentricity": 0.004, "eccentricity_angle": angle + 0.5}
    found = optimizer.fit_with_process_noise(FitProblem([case]), OFF_CENTRE, begun, free_parameters(OFF_CENTRE))
    assert found.values["eccentricity"] == pytest.approx(0.01, rel=0.1)
    assert found.values["eccentricity_angle"] == pytest.approx(angle, abs=0.1)

    def error(values: dict[str, float]) -> np.ndarray:
        return likelihood.innovations(case, OFF_CENTRE, values, found.process_noise).error

    free = ("eccentricity", "eccentricity_angle")
    slopes = likelihood.innovations(case, OFF_CENTRE, found.values, found.process_noise, free).slopes
    for i, name in enumerate(free):
        up, down = ({**found.values, name: found.values[name] + s} for s in (1e-6, -1e-6))
        np.testing.assert_allclose(-slopes[:, i], (error(up) - error(down)) / 2e-6, rtol=1e-3, atol=1e-4)


GEARED = Structure.of(("inertia", "viscous_friction", "dead_band", "backlash"))
ON_MOTOR = GEARED.with_("motor_sensor")
GEAR = VALUES | {"backlash_gap": 0.05, "motor_share": 0.3, "friction_share": 0.6}


def test_a_sensor_on_the_motor_reads_the_motor() -> None:
    rng = np.random.default_rng(2)
    time = 0.002 * np.arange(3000)
    y, states = run(ON_MOTOR, GEAR, time, steps(rng, len(time), 300, 40.0))
    assert np.array_equal(y, states[:, 0] + states[:, 2]) and np.ptp(states[:, 2]) > 0.04
    assert sensor.position(ON_MOTOR, GEAR, 1.0, 0.02) == pytest.approx(0.98)
    assert sensor.gap_slope(ON_MOTOR, GEAR, 1.0, 0.02) == pytest.approx(-1.0)


def test_the_rig_file_says_where_the_sensor_sits() -> None:
    time = np.arange(0.0, 1.0, 0.01)
    one = Recording("made", time, time, time, "%", "rad", COUNT)
    assert "motor_sensor" not in estimate.first_structure([one])
    assert "motor_sensor" in estimate.first_structure([replace(one, location="motor")])


@pytest.mark.parametrize("speed", [False, True])
def test_the_gap_behind_a_sensor_on_the_motor_is_estimated(speed: bool) -> None:
    """The motor is alone in the gap and speeds up sooner: what it reads there says how wide the gap is."""
    rng = np.random.default_rng(2)
    time = 0.002 * np.arange(8000)
    command = steps(rng, len(time), 150, 40.0)
    _, states = run(ON_MOTOR, GEAR, time, command + 0.3 * rng.standard_normal(len(time)))
    read = states[:, 3] + 0.01 * rng.standard_normal(len(time)) if speed else states[:, 0] + states[:, 2]
    count = 1e-3 if speed else COUNT
    recording = Recording(
        "made", time, command, np.round(read / count) * count, "%", "rad/s" if speed else "rad", count
    )
    case = prepared_recording.prepare_recording(recording, ON_MOTOR)
    found = optimizer.fit_with_process_noise(FitProblem([case]), ON_MOTOR, GEAR, free_parameters(ON_MOTOR))
    assert found.values["backlash_gap"] == pytest.approx(0.05, rel=0.1)
    assert found.values["motor_share"] == pytest.approx(0.3, abs=0.05)
    assert found.values["input_gain"] == pytest.approx(0.4, rel=0.02)
    seen_at_link = optimizer.fit_with_process_noise(FitProblem([case]), GEARED, GEAR, free_parameters(GEARED))
    assert seen_at_link.deviance > found.deviance + 50.0

    def error(values: dict[str, float]) -> np.ndarray:
        return likelihood.innovations(case, ON_MOTOR, values, found.process_noise).error

    slopes = likelihood.innovations(case, ON_MOTOR, found.values, found.process_noise, ("viscous_friction",)).slopes
    up, down = ({**found.values, "viscous_friction": found.values["viscous_friction"] + s} for s in (1e-6, -1e-6))
    apart = -slopes[:, 0] - (error(up) - error(down)) / 2e-6
    assert np.median(np.abs(apart)) < 0.01 * np.abs(slopes[:, 0]).max()
