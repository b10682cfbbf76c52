"""What a given model holds, and what is told of one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import twin
from twin.effects.catalogue import BASE
from twin.effects.end_stop import NOWHERE
from twin.errors import BadInput
from twin.estimation import estimate, preparation, two_stage
from twin.estimation.problem import free_parameters
from twin.estimation.two_stage import NAMES, TwoStage
from twin.io import recording
from twin.io.recording import Recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure


def test_held_is_what_a_model_has_without_a_standard_error() -> None:
    structure = Structure.of([*BASE, "end_stop"])
    values = preparation.complete_values(structure, {"stop_lower": -1.5, "stop_upper": NOWHERE["stop_upper"]})
    assert estimate.held_parameters(Model(structure, values)) == {}
    free = tuple(n for n in free_parameters(structure) if n not in ("motor_share", "stop_lower", "stop_upper"))
    made = Model(structure, values, free, np.eye(len(free)))
    # A stop that nothing met stands nowhere; the next recording may meet it.
    assert estimate.held_parameters(made) == {"motor_share": values["motor_share"], "stop_lower": -1.5}
    noted = replace(made, notes={"motor_share": "not estimated: nothing reverses"})
    assert estimate.held_parameters(noted) == {"stop_lower": -1.5}


def test_what_the_two_stage_method_does_not_look_for_is_not_held() -> None:
    """A gap of nothing that is held would have to be explained by something else."""
    steady = TwoStage("speeds", 5.0, 5.0, 4.0, 2.0, 0.4, np.eye(len(NAMES)), (), (), "made", True)
    still = Recording("made", 0.002 * np.arange(9), np.arange(9.0), np.arange(9.0), "%", "rad", 1e-4)
    assert estimate.held_parameters(two_stage.to_model(steady, [still])) == {}


@pytest.mark.parametrize("horizon", [0.02, np.inf])
def test_no_horizon_is_longer_than_what_was_recorded(horizon: float) -> None:
    still = Recording("made", 0.002 * np.arange(9), np.arange(9.0), np.arange(9.0), "%", "rad", 1e-4)
    with pytest.raises(BadInput, match=r"lasts 0.016 s"):
        estimate.identify(still, horizon=horizon)


def test_no_horizon_is_shorter_than_a_sample() -> None:
    still = Recording("made", 0.002 * np.arange(9), np.arange(9.0), np.arange(9.0), "%", "rad", 1e-4)
    with pytest.raises(BadInput, match=r"less than one sample of 0.002 s"):
        estimate.identify(still, horizon=0.001)


def test_a_loop_that_is_not_known_is_told() -> None:
    still = Recording("made", 0.002 * np.arange(9), np.arange(9.0), np.arange(9.0), "%", "rad", 1e-4)
    with pytest.raises(BadInput, match="loop"):
        estimate.identify(still, horizon=0.01, closed_loop=True)


@pytest.mark.parametrize(("unit", "known", "says"), [("rad", "inertia", "(0.06 N m)"), ("m", "mass", "(0.06 N)")])
def test_where_the_inertia_is_known_torques_are_told(unit: str, known: str, says: str) -> None:
    count = np.arange(9.0)
    still = Recording("made", 0.002 * count, count, count, "%", unit, 1e-4, known={known: 0.02})
    other = replace(still, known={"payload_mass": 0.02})
    assert recording.told_of(still) == {"inertia": 0.02} and recording.told_of(other) == {}
    structure = Structure.of([*BASE, "coulomb_friction"])
    values = preparation.complete_values(structure, {"coulomb_friction": 3.0, "viscous_friction": 2.0})
    made = Model(structure, values, axis_unit=unit, known=recording.told_of(still))
    assert f"({made.torque('coulomb_friction')})" == says
    assert made.torque("viscous_friction") == "" and replace(made, known={}).torque("coulomb_friction") == ""
    assert says in made.says("coulomb_friction")


def test_readings_that_come_faster_than_an_axis_moves_are_no_evidence_of_their_own():
    """Half a second at 100 kHz: a hundred readings in each count round alike, and are no hundred errors."""
    gain, friction, step = 0.5, 4.0, 1e-5
    time = step * np.arange(50_000)
    duty = 35.0 * np.sin(2 * np.pi * 1.7 * time) + 33.0 * np.sin(2 * np.pi * 0.4 * time) ** 2
    decay = math.exp(-friction * step)
    speed = lfilter([0.0, gain / friction * (1.0 - decay)], [1.0, -decay], duty)
    count = 2 * math.pi / 10_000
    read = np.round(step * np.concatenate(([0.0], np.cumsum(speed)[:-1])) / count) * count
    recording = Recording("fast", time, duty, read, "%", "rad", count)
    found = twin.identify(recording, twin.first_structure(recording, (), ["backlash", "dead_band"]))
    for name, truth in (("input_gain", gain), ("viscous_friction", friction)):
        assert abs(found.values[name] - truth) < min(4.0 * found.std(name), 0.01 * truth)
