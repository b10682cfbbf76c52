"""What a modelling error costs the controller, and what the extended model gives back.

    python scripts/control_table.py [--bandwidth HZ] [--seed N]

One rig with gravity, dry friction and a gap, simulated. It is recorded; the first model (the four base effects)
and the extended one are identified from the recording; each gets a controller of the same bandwidth, as do the
truth and a PID tuned by Skogestad's rule. All are tried on the rig: a smooth move and steps. The second table is
of hunting across the gap, where neither load nor friction stops it: predicted, without and with the gap-aware mode.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import control
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from excitations import FREE, rich

from twin.control.controller import Controller
from twin.control.cosimulation import Hunting, ModelPlant, Sampler, Tracking, close, simulate
from twin.control.design import design
from twin.control.reference import make_reference
from twin.effects.catalogue import BASE
from twin.errors import BadInput
from twin.estimation.maximum_likelihood import identify
from twin.io.recording import Recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.simulation.kernel import Drive, known_vector, predict, start_state, vector

COUNT = 2.0 * math.pi / 10000
EFFECTS = ("gravity", "coulomb_friction")


def rig() -> Model:
    """The truth."""
    structure = Structure.of([*BASE, *EFFECTS])
    values = {p.name: p.start for p in structure.parameters} | {
        "input_gain": 0.3,
        "viscous_friction": 1.5,
        "dead_band_forward": 6.0,
        "dead_band_reverse": 4.0,
        "backlash_gap": 0.01,
        "gravity_gain": 6.0,
        "gravity_angle": 0.4,
        "coulomb_friction": 1.5,
    }
    return Model(structure, values, resolution=COUNT, torque_density=1e-4)


def record(model: Model, seed: int, seconds: float) -> Recording:
    """A while on the rig: rich excitation, encoder counts."""
    rng = np.random.default_rng(seed)
    time, duty = rich(seconds, rng, FREE)
    nothing = np.full(len(time), math.nan)
    drive = Drive(time, duty, nothing, False, known_vector({}), np.zeros(5), model.longest_step)
    p = vector(model.structure, dict(model.values))
    position = predict(drive, p, start_state(0.4, 0.0, 0.0)).reading
    return Recording("rig", time, duty, COUNT * np.round(position / COUNT), "%", "rad", COUNT)


class Pid(Sampler):
    """PID on the encoder, filtered derivative, integral held in saturation; tuned by Skogestad's SIMC rule.

    Skogestad, J. Process Control 13, 2003: for k e^(-T s) / (s (t s + 1)), series PID with gain 1 / (k (r + T)),
    integral time 4 (r + T) and derivative time t, r being the closed loop's time constant.
    """

    def __init__(self, model: Model, bandwidth: float) -> None:
        c, b = model.values["input_gain"], model.values["viscous_friction"]
        late, wanted = 1.5 * model.sample_time, 1.0 / (2.0 * math.pi * bandwidth)
        gain, integral, derivative = b / c / (wanted + late), 4.0 * (wanted + late), 1.0 / b
        s = control.tf("s")
        loop = gain * (1 + 1 / (integral * s)) * (1 + derivative * s) * c / (s * (s + b))
        margin = float(control.stability_margins(loop)[1])
        if margin < 30.0:
            raise BadInput(f"the PID has a phase margin of {margin:.0f} deg: lower the bandwidth")
        # Series to parallel.
        self.proportional = gain * (1.0 + derivative / integral)
        self.integral, self.derivative = gain / integral, gain * derivative
        self.filter = 0.1 * wanted
        self.period, self.limit = model.sample_time, 100.0
        self.sum, self.slope, self.before = 0.0, 0.0, math.nan

    def sample(self, reference: float, velocity: float, acceleration: float, measured: float) -> float:
        position = COUNT * round(measured / COUNT)
        if math.isnan(self.before):
            self.before = position
        share = self.period / (self.filter + self.period)
        self.slope += share * ((position - self.before) / self.period - self.slope)
        self.before = position
        error = reference - position
        wanted = self.proportional * error + self.sum + self.derivative * (velocity - self.slope)
        if abs(wanted) <= self.limit or wanted * error < 0.0:
            self.sum += self.period * self.integral * error
        return min(max(wanted, -self.limit), self.limit)


def table(bandwidth: float, seed: int, seconds: float) -> dict[str, tuple[Tracking, Tracking]]:
    """Tracking on the smooth move and on the steps, by controller."""
    true = rig()
    recording = record(true, seed, seconds)
    first = identify([recording], Structure.of(BASE))
    extended = identify([recording], Structure.of([*BASE, *EFFECTS]))
    best = design(true, bandwidth)
    references = make_reference("minimum-jerk", best), make_reference("step", best)

    def tried(controller: Controller, sampler: type[Pid] | None = None) -> tuple[Tracking, Tracking]:
        smooth, steps = (
            close(ModelPlant(true, 0.0), controller, r, sampler(first, bandwidth) if sampler else None)
            for r in references
        )
        return smooth, steps

    return {
        "first model": tried(design(first, bandwidth)),
        "extended model": tried(design(extended, bandwidth)),
        "true model": tried(best),
        "PID (SIMC)": tried(best, Pid),
    }


def overshoot(steps: Tracking) -> float:
    """Furthest beyond the step and beyond the way back."""
    goal, start = float(np.max(steps.reference)), float(np.min(steps.reference))
    return max(float(np.max(steps.position)) - goal, start - float(np.min(steps.position)), 0.0)


def free_axis(rings: float, damping: float, gap: float) -> Model:
    """A horizontal link without dry friction behind a gap; `rings` in Hz, 0 for rigid teeth."""
    structure = Structure.of([*BASE, *(["tooth_compliance"] if rings else [])])
    values = {p.name: p.start for p in structure.parameters} | {
        "input_gain": 0.3, "viscous_friction": 1.5, "dead_band_forward": 6.0, "dead_band_reverse": 4.0,
        "backlash_gap": gap,
    }  # fmt: skip
    values |= {"tooth_frequency": rings, "tooth_damping": damping} if rings else {}
    return Model(structure, values, resolution=COUNT, torque_density=1e-4)


def hunting(rings: float, damping: float, gap: float) -> Hunting:
    """The limit cycle at rest on such an axis."""
    model = free_axis(rings, damping, gap)
    made = design(model)
    found = simulate(model, made, make_reference("minimum-jerk", made)).hunting
    assert found is not None, "a gap without friction is predicted to hunt"
    return found


TEETH = ((0.0, 0.0), (235.0, 1.3), (60.0, 1.3), (60.0, 0.3), (60.0, 0.1), (25.0, 0.1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bandwidth", type=float, default=2.5, help="Hz, of every controller")
    parser.add_argument("--seed", type=int, default=1, help="draws the excitation")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the recording")
    given = parser.parse_args()
    print("| controller | smooth: RMS | peak (mrad) | effort (%) | steps: RMS | peak | overshoot (mrad) | effort (%) |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (smooth, steps) in table(given.bandwidth, given.seed, given.seconds).items():
        print(
            f"| {name} | {1e3 * smooth.rms:.2f} | {1e3 * smooth.peak:.2f} | {smooth.effort:.1f} | "
            f"{1e3 * steps.rms:.0f} | {1e3 * steps.peak:.0f} | {1e3 * overshoot(steps):.2f} | {steps.effort:.1f} |"
        )
    print("\n| teeth | predicted | without gap-aware mode | with it (mrad at Hz) |\n|---|---|---|---|")
    for rings, damping in TEETH:
        found = hunting(rings, damping, 0.02)
        cells = (
            "none" if c is None else f"{1e3 * c.amplitude:.2f} at {c.frequency:.1f}"
            for c in (found.predicted, found.unaware, found.aware)
        )
        print(f"| {f'{rings:.0f} Hz, damping {damping}' if rings else 'rigid'} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
