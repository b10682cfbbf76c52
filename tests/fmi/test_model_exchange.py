"""Model exchange in hosts that follow the letter of the standard differently, on a recorded duty."""

from __future__ import annotations

import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model
from fmpy.validation import validate_fmu
from native_axis import by_kernel

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import exchange_study
from exchange_study import PERIOD, table

from twin.cli.main import main
from twin.fmi import python_fmu
from twin.fmi.native_fmu import export_native
from twin.model.fitted_model import Model, dumps

#: A tenth of a degree is 1.7e-3 rad: an importer may not be further away than this.
CLOSE = 1e-3


@pytest.fixture(scope="module")
def duty() -> np.ndarray:
    return exchange_study.recorded_duty()


@pytest.fixture(scope="module", params=exchange_study.STRUCTURES)
def axis(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Model, Path]:
    model = exchange_study.axis(request.param)
    with exchange_study.for_this_machine():
        return model, export_native(model, tmp_path_factory.mktemp("fmu") / f"{request.param}.fmu")


def truth(model: Model, duty: np.ndarray, doubled: bool) -> np.ndarray:
    """Positions of the kernel at the stamps; a line between stamps is finely cut into held pieces."""
    parts = 1 if doubled else 16
    fine = np.arange((len(duty) - 1) * parts + 1) / parts
    held = duty[fine.astype(int)] if doubled else np.interp(fine + 0.5 / parts, np.arange(len(duty)), duty)
    return by_kernel(model, held, 0.3, -1.0, PERIOD / parts)[::parts, 0]


def largest_error(axis: tuple[Model, Path], duty: np.ndarray, doubled: bool, **options: object) -> float:
    """Of FMPy's positions at the stamps, rad."""
    model, fmu = axis
    return exchange_study.largest_error(fmu, truth(model, duty, doubled), table(duty, doubled), options)


def test_in_fmpy_with_cvode(axis: tuple[Model, Path], duty: np.ndarray) -> None:
    error = largest_error(axis, duty, True, solver="CVode", output_interval=0.01, relative_tolerance=1e-6)
    assert error < CLOSE


@pytest.mark.parametrize(("fmi", "rows"), [(2, 10001), (3, 2001)])
def test_a_held_input_takes_a_table_without_doubled_rows(
    axis: tuple[Model, Path], duty: np.ndarray, tmp_path: Path, fmi: int, rows: int
) -> None:
    """What was recorded at a stamp acts until the next one, as it does in the model."""
    model, duty = axis[0], duty[:rows]
    with exchange_study.for_this_machine():
        fmu = export_native(model, tmp_path / "held.fmu", fmi)
    python_fmu.hold_input(fmu)
    assert validate_fmu(str(fmu)) == []
    options = {"solver": "CVode", "output_interval": 0.01, "relative_tolerance": 1e-6}
    assert exchange_study.largest_error(fmu, truth(model, duty, True), table(duty, False), options) < CLOSE


def test_a_continuous_input_does_not(axis: tuple[Model, Path], duty: np.ndarray) -> None:
    """The same table is a line from row to row there: that is another command, and it shows."""
    model, duty = axis[0], duty[:2001]
    options = {"solver": "CVode", "output_interval": 0.01, "relative_tolerance": 1e-6}
    assert exchange_study.largest_error(axis[1], truth(model, duty, True), table(duty, False), options) > 2.0 * CLOSE


def test_an_update_keeps_the_input_held(axis: tuple[Model, Path], tmp_path: Path) -> None:
    model, _ = axis
    path, held = tmp_path / "MODEL.toml", tmp_path / "held.fmu"
    path.write_text(dumps(model))
    with exchange_study.for_this_machine():
        assert main(["export", str(path), "--out", str(held), "--target", "native", "--held-input", "--quiet"]) == 0
    python_fmu.update(held, Model(model.structure, dict(model.values) | {"input_gain": 1.5}))
    inputs = [v for v in fmpy.read_model_description(str(held)).modelVariables if v.causality == "input"]
    assert [v.variability for v in inputs] == ["discrete"]


def test_in_fmpy_with_a_table_without_doubled_rows(axis: tuple[Model, Path], duty: np.ndarray) -> None:
    """A continuous input: FMPy's CVode evaluates rates with the input of its last step, so it is of the first order."""
    coarse, fine = (
        largest_error(axis, duty[:1501], False, solver="CVode", output_interval=PERIOD / parts) for parts in (1, 4)
    )
    assert fine < 0.4 * coarse and fine < 0.01


def test_in_fmpy_with_euler(axis: tuple[Model, Path], duty: np.ndarray) -> None:
    """Of the first order, too: no event is lost, and the distance is that of the method."""
    coarse, fine = (
        largest_error(axis, duty[:1001], True, solver="Euler", output_interval=h, step_size=h) for h in (4e-4, 1e-4)
    )
    assert fine < 0.6 * coarse and fine < 0.01


def fixed_step(fmu: Path, folder: Path, duty: np.ndarray, parts: int) -> np.ndarray:
    """Positions at the stamps by a fixed-step master of the second order that takes the FMU at its word.

    It keeps the states itself and reads them again only where it is told that they have changed. It enters an event
    where an indicator changes its sign or the end of a step asks for one. It sets the input at the stamps without any.
    """
    described = fmpy.read_model_description(str(fmu))
    fmpy.extract(str(fmu), str(folder))
    axis = FMU2Model(
        guid=described.guid, unzipDirectory=str(folder), modelIdentifier=described.modelExchange.modelIdentifier,
        instanceName="axis",
    )  # fmt: skip
    reference = {v.name: v.valueReference for v in described.modelVariables}
    axis.instantiate()
    axis.setupExperiment(startTime=0.0)
    axis.setReal([reference["position_start"], reference["velocity_start"]], [0.3, -1.0])
    axis.enterInitializationMode()
    axis.exitInitializationMode()
    states, marks = described.numberOfContinuousStates, described.numberOfEventIndicators
    x, rate, sign = ((fmpy.fmi2.fmi2Real * n)() for n in (states, states, marks))

    def settle() -> None:
        changed = axis.newDiscreteStates()[3]
        axis.enterContinuousTimeMode()
        if changed:
            axis.getContinuousStates(x, states)

    settle()
    h, before, positions = PERIOD / parts, np.zeros(marks), [0.3]
    for i in range((len(duty) - 1) * parts):
        if i % parts == 0:
            axis.setReal([reference["duty"]], [duty[i // parts]])
        begun = np.array(x)
        axis.getDerivatives(rate, states)
        first = np.array(rate)
        x[:] = begun + h * first
        axis.setTime((i + 1) * h)
        axis.setContinuousStates(x, states)
        axis.getDerivatives(rate, states)
        x[:] = begun + 0.5 * h * (first + np.array(rate))
        axis.setContinuousStates(x, states)
        asked, _ = axis.completedIntegratorStep()
        axis.getEventIndicators(sign, marks)
        if asked or np.any(np.sign(sign) * np.sign(before) < 0.0):
            axis.enterEventMode()
            settle()
            axis.getEventIndicators(sign, marks)
        before = np.array(sign)
        if (i + 1) % parts == 0:
            positions.append(x[0])
    axis.terminate()
    axis.freeInstance()
    return np.array(positions)


def test_in_a_fixed_step_master_that_resets_only_where_it_is_told(
    axis: tuple[Model, Path], duty: np.ndarray, tmp_path: Path
) -> None:
    """Where an event falls between two of its steps it is a step late, so they are short."""
    model, fmu = axis
    duty = duty[:1001]
    error = np.max(np.abs(fixed_step(fmu, tmp_path / "x", duty, 50) - truth(model, duty, True)))
    assert error < CLOSE
