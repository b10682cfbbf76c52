"""A gap that a recording does not show is no part of the model, and one that it shows is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.diagnosis import forward_selection, law_tolerance
from twin.effects.catalogue import BASE
from twin.estimation import fit, prepared_recording
from twin.io.recording import Recording
from twin.model.stepper import Structure
from twin.simulation import kernel

RIGID = {
    "input_gain": 0.4, "viscous_friction": 3.0, "dead_band_forward": 5.0, "dead_band_reverse": 6.0,
    "gravity_gain": 6.0, "gravity_angle": 0.4,
}  # fmt: skip
GEARED = {**RIGID, "backlash_gap": 0.05, "motor_share": 0.25, "friction_share": 0.6}
COUNT = 2.0 * np.pi / 20000.0


def command(seconds: float) -> NDArray[np.float64]:
    """Steps (N,) of random size and length, percent."""
    rng, duty = np.random.default_rng(4), np.zeros(round(seconds / 0.002))
    at = 0
    while at < len(duty):
        length = int(rng.uniform(50, 400))
        duty[at : at + length] = rng.uniform(-60.0, 60.0)
        at += length
    return duty


def recorded(truth: Structure, values: dict[str, float]) -> Recording:
    """What an encoder reads of the rig over 12 s."""
    duty = command(12.0)
    blank = Recording("made", 0.002 * np.arange(len(duty)), duty, np.zeros(len(duty)), "%", "rad", COUNT)
    drive = prepared_recording.prepare_recording(blank, truth).drive
    read = kernel.predict(drive, kernel.vector(truth, values), kernel.start_state(0.0, 0.0, 0.0)).reading
    return replace(blank, output=COUNT * np.round(read / COUNT))


@pytest.mark.parametrize("geared", [False, True])
def test_gravity_is_found_and_a_gap_only_where_there_is_one(geared: bool) -> None:
    truth = Structure.of([*BASE, "gravity"] if geared else ["inertia", "viscous_friction", "dead_band", "gravity"])
    made = recorded(truth, GEARED if geared else RIGID)
    found = forward_selection.search([made], Structure.of(BASE), {}, ("gravity", "spring"))
    assert found.last.structure.named == ("gravity",)
    assert ("backlash" in found.last.structure) is geared
    assert found.first.structure.without("tooth_compliance") == Structure.of(BASE), "what the user began with"
    for name in ("input_gain", "gravity_gain", *(["backlash_gap"] if geared else [])):
        assert found.last.values[name] == pytest.approx(GEARED[name], rel=0.05)


def test_what_a_law_may_leave_is_its_error_squared_of_what_it_took() -> None:
    """A law that errs by s leaves s^2 (v0 - v1) of the variance that it took from v0 to v1."""
    nothing = np.eye(0)

    def fitted(count: int, variance: float) -> fit.Fit:
        return fit.Fit(
            Structure.of(BASE), {}, 1.0, (), count * np.log(variance), variance, nothing, np.zeros(0), nothing
        )

    for before in (1.01, 3.0, 400.0):
        doubt = law_tolerance.doubt(fitted(700, before), fitted(700, 1.0))
        assert doubt == pytest.approx(700 * np.log(1.0 + 0.05**2 * (before - 1.0)), rel=1e-9)
    assert law_tolerance.doubt(fitted(700, 1.0), fitted(700, 1.0)) == 0.0
    assert law_tolerance.doubt(fitted(700, 1.0), fitted(700, 2.0)) == 0.0


@pytest.mark.parametrize(("effect", "name", "late"), [("motor_lag", "lag_time", 0.1), ("input_delay", "delay", 0.08)])
def test_a_gap_that_stood_for_a_lag_is_looked_for_again_beside_it(effect: str, name: str, late: float) -> None:
    """Late torque looks like a gap as wide as any. Once the lag is known, the gap that is there shows."""
    values = {**GEARED, "backlash_gap": 0.03, name: late}
    made = recorded(Structure.of([*BASE, effect]), values)
    found = forward_selection.search([made], Structure.of(BASE), {}, ("motor_lag", "input_delay", "spring"))
    assert found.last.structure.named == (effect,)
    assert found.last.values["backlash_gap"] == pytest.approx(0.03, rel=0.1)
    assert found.last.values[name] == pytest.approx(late, rel=0.05)
