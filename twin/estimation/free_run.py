"""A model driven by a recorded input from its initial state alone, beside what was recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.display.numbers import number, unit_text
from twin.display.table import DisplayTable, Tabular
from twin.errors import BadInput
from twin.estimation import likelihood
from twin.estimation.prepared_recording import prepare_recording
from twin.fmi import python_fmu
from twin.io.position_loop import own_loop
from twin.io.recording import Recording, as_told, check_units
from twin.model.fitted_model import Model
from twin.model.stepper import STATES

FloatArray = NDArray[np.float64]

_VELOCITY = list(STATES).index("velocity")


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Tabular):
    """A free run of a model at the stamps of a recording. Arrays have shape (N,).

    Attributes
    ----------
    time : ndarray
        s, from 0.
    position, velocity : ndarray
        Of the link, in the axis' unit and in that per second.
    output : ndarray
        What the sensor reads, in the output's unit of the recording.
    residual : ndarray
        Recorded minus simulated output; NaN where a reading is left out.
    """

    recording: Recording
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    output: FloatArray

    @property
    def residual(self) -> FloatArray:
        """Recorded minus simulated output (N,); NaN where a reading is left out."""
        return self.recording.output - self.output

    @property
    def rmse(self) -> float:
        """Root mean square of the residual, in the output's unit."""
        return float(np.sqrt(np.nanmean(self.residual**2)))

    @property
    def nrmse_percent(self) -> float:
        """`rmse` in percent of the range of the recorded output."""
        span = float(np.nanmax(self.recording.output) - np.nanmin(self.recording.output))
        return 100.0 * self.rmse / span if span > 0.0 else math.inf

    def table(self) -> DisplayTable:
        unit = unit_text(self.recording.output_unit)
        worst = int(np.nanargmax(np.abs(self.residual)))
        rows = (
            ("RMSE", f"{number(self.rmse)} {unit}"),
            ("in percent of the recorded range", number(self.nrmse_percent)),
            ("largest error", f"{number(float(abs(self.residual[worst])))} {unit} at {number(self.time[worst])} s"),
        )
        return DisplayTable(f"free run over {number(self.time[-1])} s of {self.recording.name}", ("", ""), rows)


def simulate(model: Model, recording: Recording, closed_loop: bool = False) -> Simulation:
    """Run a model freely over a recording: from its initial state and the recorded input alone.

    Parameters
    ----------
    model
        The model, from `identify`, `diagnose` or ``Model.read``.
    recording
        The recording that gives the input, and the position and speed at the start.
    closed_loop
        Simulate the rig's own position loop (``[loop]`` in the rig file) from the recorded reference, in the place of
        the recorded input.

    Returns
    -------
    Simulation
        Arrays of shape (N,), one value a stamp of the recording.

    Raises
    ------
    BadInput
        The model and the recording are in different units, or `closed_loop` is asked for and the rig file describes no
        loop.
    """
    check_units(recording, "the model", model.input_unit, model.axis_unit)
    recording = as_told(recording, model.known)
    case = replace(
        prepare_recording(recording, model.structure, closed_loop), start=python_fmu.start_of(recording, model)
    )
    ran = likelihood.filtered_states(case, model.structure, model.values, 0.0)
    if not np.isfinite(ran.states).all():
        at = case.drive.time[int(np.argmin(np.isfinite(ran.states).all(axis=1)))]
        raise BadInput(f"the simulation of {recording.name} is no longer a number at {at:g} s: check the parameters")
    stamps = own_loop(recording).stamps if closed_loop else slice(None)
    states = ran.states[stamps]
    return Simulation(recording, recording.time, states[:, 0], states[:, _VELOCITY], ran.reading[stamps])
