"""A twin of a rig whose load changed during its recording: it starts after the change, and replays it where asked."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest

from twin.codegen import modelica
from twin.control.cosimulation import ModelPlant
from twin.fmi import python_fmu
from twin.fmi.native_fmu import export_native
from twin.io.recording import Recording
from twin.model.fitted_model import Model, dumps, loads
from twin.model.stepper import Structure
from twin.model.variables import variables

GAIN, DAMPING, ADDED, DUTY, STEP = 0.4, 1.5, 2.0, 20.0, 0.01
TIME = STEP * np.arange(101)


def model_of(*effects: str, **values: float) -> Model:
    structure = Structure.of(("inertia", "viscous_friction", *effects))
    given = {"input_gain": GAIN, "viscous_friction": DAMPING, **values}
    told = {p.name: given.get(p.name, p.start) for p in structure.parameters}
    return Model(structure, told, recorded_time=10.0, provenance={"recordings": "first, second (without 4 blocks)"})


LOADED = model_of("load_change", load_added=ADDED, load_time=0.5)


def speed(time: float, inertia: float, before: float = 0.0) -> float:
    """Of a first-order axis under the constant duty, in closed form."""
    final = GAIN * DUTY / DAMPING
    return final + (before - final) * math.exp(-DAMPING * time / inertia)


AFTER = speed(1.0, 1.0 + ADDED)
AGAIN = speed(0.5, 1.0 + ADDED, speed(0.5, 1.0))


def end_speed(fmu: Path, kind: str, **start: float) -> float:
    duty = np.array([(0.0, DUTY), (2.0, DUTY)], dtype=[("time", float), ("duty", float)])
    run = fmpy.simulate_fmu(
        str(fmu), fmi_type=kind, stop_time=1.0, output_interval=STEP, relative_tolerance=1e-8, input=duty,
        start_values=start, output=["velocity"],
    )  # fmt: skip
    return float(run["velocity"][-1])


@pytest.mark.parametrize("kind", ["python", "CoSimulation", "ModelExchange"])
def test_the_twin_starts_where_the_recording_ended(tmp_path: Path, no_zig: None, kind: str) -> None:
    if kind == "python":
        fmu, kind = python_fmu.export(LOADED, tmp_path / "axis.fmu"), "CoSimulation"
    else:
        fmu = export_native(LOADED, tmp_path / "axis.fmu", 2)
    assert end_speed(fmu, kind) == pytest.approx(AFTER, rel=1e-4)
    assert end_speed(fmu, kind, time_start=0.0) == pytest.approx(AGAIN, rel=1e-4)


def test_the_loop_without_an_fmu_starts_there_too() -> None:
    plant = ModelPlant(LOADED, 0.0)
    for t in TIME[:-1].tolist():
        plant.advance(t, DUTY, STEP)
    ran = ModelPlant(replace(LOADED, values={**LOADED.values, "load_time": -1.0}), 0.0)
    for t in TIME[:-1].tolist():
        ran.advance(t, DUTY, STEP)
    assert plant.read()[0] == pytest.approx(ran.read()[0], rel=1e-9)


@pytest.mark.parametrize(("name", "expected"), [("first", AGAIN), ("second", AGAIN), ("third", AFTER)])
def test_a_recording_of_its_own_is_played_again(tmp_path: Path, name: str, expected: float) -> None:
    """What happened in a recording that the model was fitted to happens in its replay, and in no other."""
    fmu = python_fmu.export(LOADED, tmp_path / "axis.fmu")
    made = Recording(name, TIME, np.full(len(TIME), DUTY), np.zeros(len(TIME)), "%", "rad")
    ran = python_fmu.replay(fmu, made, (0.0, 0.0))
    assert ran.velocity[-1] == pytest.approx(expected, rel=1e-4)


def test_no_other_model_has_such_a_start() -> None:
    """A ripple or friction that is run in is there again from every start."""
    for effects in ((), ("torque_ripple",), ("friction_run_in",), ("thermal_fade",)):
        assert "time_start" not in {v.name for v in variables(model_of(*effects))}
    pulsed = model_of("disturbance_pulse")
    assert [v.start for v in variables(pulsed) if v.name == "time_start"] == [10.0]
    assert "time + time_start" in modelica.write(pulsed)


def test_the_file_of_a_model_holds_how_long_its_recording_was() -> None:
    assert loads(dumps(LOADED)).recorded_time == 10.0
    assert "recorded_time" not in dumps(replace(LOADED, recorded_time=0.0))
