"""What is held out: what may be fitted, what held-out data alone show, and free runs through it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from axis_runs import run, steps

from twin import extend, hold_out, identify, likelihood, ready
from twin.axis import Structure
from twin.effects.catalogue import BASE
from twin.errors import BadInput
from twin.model import Model
from twin.recording import Recording

STRUCTURE = Structure.of(("inertia", "viscous_friction", "dead_band"))
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
COUNT = 2.0 * np.pi / 16384


def recorded(supply: float = 0.0) -> Recording:
    """Half a minute, with a logged supply that goes up and down by this share."""
    time = 0.002 * np.arange(15000)
    duty = steps(np.random.default_rng(3), len(time), 300, 40.0)
    volts = 12.0 * (1.0 + supply * np.sin(0.7 * time))
    y, _ = run(STRUCTURE, VALUES, time, duty * volts / float(np.median(volts)))
    more = {"supply": volts} if supply else {}
    return Recording("made", time, duty, np.round(y / COUNT) * COUNT, "%", "rad", COUNT, optional=more)


def fitted(recording: Recording) -> tuple[list[likelihood.Case], likelihood.Point, list[hold_out.Part]]:
    train, held_out = hold_out.split([recording])
    cases = ready.prepare(train, STRUCTURE)
    return cases, likelihood.fit(cases, STRUCTURE, VALUES, tuple(VALUES)), held_out


@pytest.mark.parametrize("supply", [0.0, 0.1])
def test_a_supply_that_is_logged_acts_once_in_what_is_held_out(supply: float) -> None:
    assert hold_out.unseen(*fitted(recorded(supply))) == []


def test_a_supply_that_nobody_told_of_is_seen_there() -> None:
    """The same truth, so that the test above can fail: what is held out goes by another supply than what was fitted."""
    recording = recorded(0.1)
    cases, point, held_out = fitted(recording)
    volts = np.where(recording.time > held_out[0].begin, 0.5, 1.0) * recording.optional["supply"]
    (part,) = [replace(p, recording=replace(recording, optional={"supply": volts})) for p in held_out]
    assert len(hold_out.unseen(cases, point, [part])) == 1


def test_where_every_recording_is_held_out_there_is_nothing_to_fit() -> None:
    recording = replace(recorded(), role="holdout")
    for fit in (hold_out.split, lambda r: identify.identify(r, STRUCTURE), lambda r: extend.diagnose(r, STRUCTURE)):
        with pytest.raises(BadInput, match="at least one to fit"):
            fit([recording])


def test_a_held_out_part_in_which_nothing_was_read_is_run_all_the_same() -> None:
    recording = recorded()
    blind = replace(recording, output=np.where(recording.time > 20.0, np.nan, recording.output))
    cases, point, held_out = fitted(blind)
    model: Model = identify.to_model(cases, point, [recording], {})
    (shown,) = hold_out.traces(model, model, [("holdout", held_out[0])])
    assert np.isnan(shown.recorded).all() and np.isfinite(shown.after).all()


@pytest.mark.parametrize("speed", [False, True])
def test_an_unknown_loop_is_refused_before_the_search_begins(monkeypatch, speed: bool) -> None:
    monkeypatch.setattr(extend.search, "find", None)
    recording = recorded()
    recording = replace(recording, output_unit="rad/s") if speed else recording
    with pytest.raises(BadInput, match="loop"):
        extend.diagnose([recording], Structure.of(BASE), closed=True)
