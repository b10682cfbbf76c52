"""A search tells its observer each model that it reaches and the rivals of each round, and nobody else."""

from __future__ import annotations

import numpy as np
import pytest

from twin.diagnosis import events, forward_selection, model_comparison
from twin.diagnosis.events import Compared, Event, Reached
from twin.estimation import prepared_recording
from twin.io.recording import Recording
from twin.model.stepper import Structure
from twin.simulation import kernel

FIRST = Structure.of(["inertia", "viscous_friction"])
COUNT = 2.0 * np.pi / 10_000


@pytest.fixture(scope="module")
def rubbing() -> Recording:
    """Ten seconds of an axis with dry friction."""
    truth = FIRST.with_("coulomb_friction")
    time = 0.002 * np.arange(5000)
    duty = np.random.default_rng(3).uniform(-50.0, 50.0, 25).repeat(200)
    blank = Recording("axis", time, duty, np.zeros(5000), "%", "rad", COUNT)
    values = kernel.vector(truth, {"input_gain": 0.4, "viscous_friction": 2.0, "coulomb_friction": 3.0})
    drive = prepared_recording.prepare_recording(blank, truth).drive
    read = kernel.predict(drive, values, kernel.start_state(0.0, 0.0, 0.0)).reading
    return Recording("axis", time, duty, COUNT * np.round(read / COUNT), "%", "rad", COUNT)


def test_the_observer_hears_the_first_model_the_rivals_and_the_last_model(rubbing: Recording) -> None:
    heard: list[Event] = []
    with events.observing(heard.append):
        found = forward_selection.search([rubbing], FIRST, {}, ("coulomb_friction", "constant_offset"))
    models = [e.model for e in heard if isinstance(e, Reached)]
    assert "coulomb_friction" not in models[0].structure
    assert "coulomb_friction" in models[-1].structure and "coulomb_friction" in found.last.structure
    rounds = [e for e in heard if isinstance(e, Compared)]
    gains = {effect: model_comparison.gain(rounds[0].before, fit) for effect, fit in rounds[0].rivals}
    assert max(gains, key=lambda e: gains[e]) == "coulomb_friction"
    first_round = next(i for i, e in enumerate(heard) if isinstance(e, Compared))
    assert isinstance(heard[0], Reached) and first_round > 0


def test_nothing_is_heard_outside_the_block() -> None:
    heard: list[Event] = []
    event = Compared(None, ())  # type: ignore[arg-type]
    with events.observing(heard.append):
        with events.observing(None):
            events.announce(event)
        events.announce(event)
    events.announce(event)
    assert heard == [event]
