"""An axis for a controller to move, and what a controller's FMU is made from and asked for."""

from __future__ import annotations

import math

from twin.control import design, monte_carlo
from twin.control.reference import make_reference
from twin.effects.catalogue import BASE
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

#: Values of the effects that a controller has to deal with.
EFFECTS = {
    "gravity_gain": 3.0, "coulomb_friction": 1.0, "delay": 0.005, "lag_time": 0.01, "backlash_gap": 0.01,
    "ripple_torque": 0.5,
}  # fmt: skip
#: The inputs of a controller's FMU.
INPUTS = ("reference", "reference_velocity", "reference_acceleration", "position_measured")
#: The ids of these effects.
ENDS = ["gravity", "coulomb_friction", "input_delay", "motor_lag", "torque_ripple"]


def axis(*effects: str, **values: float) -> Model:
    """A lively axis; named values replace the effects' start values."""
    structure = Structure.of([*BASE, *effects])
    usual = {"input_gain": 0.3, "viscous_friction": 1.5, "dead_band_forward": 6.0, "dead_band_reverse": 4.0}
    start = {p.name: p.start for p in structure.parameters} | usual | {"backlash_gap": 0.0} | values
    return Model(structure, start, resolution=2 * math.pi / 10000, torque_density=1e-4)


def run_loop() -> None:
    """Have the compiled loop made where this machine has not yet."""
    model = axis()
    made = design.design(model, 2.0)
    monte_carlo.trial(model, made, make_reference("step", made))
