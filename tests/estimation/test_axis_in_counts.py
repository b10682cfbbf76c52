"""An axis whose encoder is not known moves in counts: the same axis in rad, by the factor between the two."""

import math
from pathlib import Path

import numpy as np
import pytest

import twin
from twin.control.reference import TRAVEL
from twin.io.recording import Recording

STEP, GAIN, FRICTION, DEAD_BAND = 0.005, 6.0, 5.0, 8.0
PER_RADIAN = 4.096 / (2 * math.pi)  # thousands of counts


def recording(per_unit: float, unit: str) -> Recording:
    """Steps of either sign through a dead-band, counted by an encoder of 4096 and kept as `per_unit` times rad."""
    time = STEP * np.arange(6000)
    duty = np.repeat(np.random.default_rng(2).choice([-60.0, -35.0, -18.0, 0.0, 18.0, 35.0, 60.0], 60), 100)
    drive = GAIN * np.sign(duty) * np.maximum(np.abs(duty) - DEAD_BAND, 0.0)
    speed, position = np.zeros(time.size), np.zeros(time.size)
    decay = math.exp(-FRICTION * STEP)
    for k in range(time.size - 1):
        speed[k + 1] = decay * speed[k] + (1.0 - decay) / FRICTION * drive[k]
        position[k + 1] = position[k] + drive[k] / FRICTION * STEP - (speed[k + 1] - speed[k]) / FRICTION
    read = np.round(1e3 * position * PER_RADIAN) * 1e-3 * per_unit / PER_RADIAN
    return Recording("steps", time, duty, read, "%", unit, 1e-3 * per_unit / PER_RADIAN)


def test_parameters_scale_with_the_unit() -> None:
    in_rad = twin.identify(recording(1.0, "rad"), method="two-stage")
    in_counts = twin.identify(recording(PER_RADIAN, "kcount"), method="two-stage")
    assert in_counts.axis_unit == "kcount" and in_counts.unit("input_gain") == "kcount/s^2/%"
    assert in_counts.values["input_gain"] == pytest.approx(GAIN * PER_RADIAN, rel=0.02)
    for name in in_rad.fitted:
        factor = PER_RADIAN if in_rad.unit(name).startswith("rad") else 1.0
        assert in_counts.values[name] == pytest.approx(factor * in_rad.values[name], rel=1e-3, abs=1e-6)


def test_a_model_in_counts_goes_all_the_way(tmp_path: Path) -> None:
    model = twin.identify(recording(PER_RADIAN, "kcount"), method="two-stage")
    assert twin.Model.read(model.write(tmp_path / "m.toml")).axis_unit == "kcount"
    fmu = twin.export_fmu(model, tmp_path / "arm.fmu")
    controller = twin.design_controller(model, bandwidth=1.0)
    tracked = twin.cosimulate(fmu, controller)
    assert tracked.peak < 0.1 * TRAVEL["kcount"]
