"""Directional derivatives of the native FMU: against central differences, and against the kernel's sensitivities."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Slave
from native_axis import PERIOD, command, model_of

from twin.effects.catalogue import BASE
from twin.fmi.native_fmu import export_native
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.simulation import kernel

OUTPUTS = ("position", "velocity", "position_measured")
RICH = Structure.of((*BASE, "joint_elasticity", "coulomb_friction", "gravity", "motor_lag", "thermal_fade",
                     "encoder_eccentricity"))  # fmt: skip
LATE = Structure.of(("inertia", "viscous_friction", "gravity", "input_delay"))
PLAIN = Structure.of(("inertia", "viscous_friction", "gravity", "quadratic_drag"))

pytestmark = pytest.mark.usefixtures("no_zig")


class Axis:
    """An instance and the value references of its variables, with setting, getting and slopes alike in FMI 2 and 3."""

    def __init__(self, fmu: Path, folder: Path, exchange: bool = False) -> None:
        fmpy.extract(str(fmu), str(folder))
        self.described = fmpy.read_model_description(str(folder))
        two = self.described.fmiVersion == "2.0"
        kind = (FMU2Model if exchange else FMU2Slave) if two else FMU3Slave
        self.fmu = kind(
            guid=self.described.guid or self.described.instantiationToken, unzipDirectory=str(folder),
            modelIdentifier=self.described.coSimulation.modelIdentifier, instanceName="axis",
        )  # fmt: skip
        self.reference = {v.name: v.valueReference for v in self.described.modelVariables}
        self.fmu.instantiate()
        if two:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self._set, self._get = (
            (self.fmu.setReal, self.fmu.getReal) if two else (self.fmu.setFloat64, self.fmu.getFloat64)
        )

    def references(self, *names: str) -> list[int]:
        return [self.reference[name] for name in names]

    def set(self, name: str, value: float) -> None:
        self._set(self.references(name), [value])

    def get(self, *names: str) -> np.ndarray:
        return np.array(self._get(self.references(*names)))

    def slopes(self, unknowns: tuple[str, ...], known: str) -> np.ndarray:
        return np.array(self.fmu.getDirectionalDerivative(self.references(*unknowns), self.references(known), [1.0]))


def central(at: Callable[[float], np.ndarray], value: float) -> np.ndarray:
    """The derivative from two values on either side, of the fourth order."""
    h = 1e-3 * max(abs(value), 0.1)
    near, far = (at(value + n * h) - at(value - n * h) for n in (1.0, 2.0))
    return (8.0 * near - far) / (12.0 * h)


@pytest.mark.parametrize(("structure", "fmi"), [(RICH, 2), (LATE, 2), (LATE, 3)])
def test_of_a_communication_step(structure: Structure, fmi: int, tmp_path: Path) -> None:
    """With respect to the input, to the states at the step's beginning and to every parameter, at four moments."""
    model = model_of(structure, **({"delay": 0.0037} if structure is LATE else {}))
    axis = Axis(export_native(model, tmp_path / "axis.fmu", fmi), tmp_path / "x")
    save, restore = (
        (axis.fmu.getFMUstate, axis.fmu.setFMUstate) if fmi == 2 else (axis.fmu.getFMUState, axis.fmu.setFMUState)
    )
    known = ("duty", *(p.name for p in structure.parameters))
    compared = 0
    for i, u in enumerate(command(901)):
        axis.set("duty", u)
        if i in (150, 420, 600, 900):
            state = save()

            def after(name: str, value: float, i: int = i, state: object = state) -> np.ndarray:
                restore(state)
                axis.set(name, value)
                axis.fmu.doStep(i * PERIOD, PERIOD)
                return axis.get(*OUTPUTS)

            for name in known:
                restore(state)
                value = float(axis.get(name)[0])
                # Within bounds on both sides, and away from the edges at which a law has two slopes.
                if value == 0.0 or name.endswith(("_frequency", "backlash_gap")):
                    continue
                numeric = central(lambda v, name=name: after(name, v), value)
                after(name, value)
                np.testing.assert_allclose(axis.slopes(OUTPUTS, name), numeric, rtol=1e-6, atol=1e-8, err_msg=name)
                compared += bool(np.any(numeric != 0.0))
            restore(state)
        axis.fmu.doStep(i * PERIOD, PERIOD)
    assert compared > 4 * 4
    with pytest.raises(Exception, match="irectional"):
        axis.slopes(OUTPUTS, "time_since_start")


def test_of_the_rates_under_an_outside_solver(tmp_path: Path) -> None:
    axis = Axis(export_native(model_of(RICH), tmp_path / "axis.fmu"), tmp_path / "x", exchange=True)
    states = [v.derivative.name for v in axis.described.modelVariables if v.derivative]
    unknowns = (*(f"der({name})" for name in states), *OUTPUTS)
    x = np.array([0.3, 1.1, 0.01, 1.4, 12.0, 0.2])
    assert len(states) == len(x)
    axis.fmu.newDiscreteStates()
    axis.fmu.enterContinuousTimeMode()
    axis.set("duty", 30.0)

    def put(values: np.ndarray) -> None:
        axis.fmu.setContinuousStates((ctypes.c_double * len(x))(*values), len(x))

    put(x)
    axis.fmu.enterEventMode()
    axis.fmu.newDiscreteStates()
    axis.fmu.enterContinuousTimeMode()

    def rates(name: str, value: float) -> np.ndarray:
        if name in states:
            put(np.where(np.array(states) == name, value, x))
        else:
            axis.set(name, value)
        return axis.get(*unknowns)

    for name in (*states, "duty", "input_gain", "gravity_gain", "lag_time", "fade", "eccentricity", "coulomb_friction"):
        value = float(axis.get(name)[0])
        numeric = central(lambda v, name=name: rates(name, v), value)
        rates(name, value)
        np.testing.assert_allclose(axis.slopes(unknowns, name), numeric, rtol=1e-6, atol=1e-6, err_msg=name)


def test_steps_chained_are_the_sensitivities_of_the_kernel(tmp_path: Path) -> None:
    """S_(k+1) = (dx'/dx) S_k + dx'/dp, over a second, is what the kernel carries beside its states."""
    model = model_of(PLAIN)
    axis = Axis(export_native(model, tmp_path / "axis.fmu"), tmp_path / "x")
    names, states = tuple(p.name for p in PLAIN.parameters), ("position", "velocity")
    u = command(513)
    chained = np.zeros((2, len(names)))
    for i, duty in enumerate(u[:-1]):
        axis.set("duty", duty)
        axis.fmu.doStep(i * PERIOD, PERIOD)
        through = np.column_stack([axis.slopes(states, name) for name in states])
        chained = through @ chained + np.column_stack([axis.slopes(states, name) for name in names])
    np.testing.assert_allclose(chained[0], sensitivities(model, u, names), rtol=1e-6, atol=1e-6)


def sensitivities(model: Model, u: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """What the kernel says of the last position; it carries derivatives in single precision."""
    count = len(u)
    drive = kernel.Drive(
        np.arange(count) * PERIOD, u, np.full(count, np.nan), False, kernel.known_vector(model.known), np.zeros(5),
        model.longest_step,
    )  # fmt: skip
    x = kernel.start_state(0.0, 0.0, 0.0)
    p = kernel.vector(model.structure, dict(model.values))
    run = kernel.predict_with_slopes(drive, p, x, kernel.fixed_start(names))
    return np.array(run.slopes[-1]).reshape(-1)[: len(names)]
