"""The design: what is cancelled, what is promised, and the file that holds it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from twin import controller as files
from twin import linear
from twin.axis import Structure
from twin.control import design
from twin.effects.catalogue import BASE, EFFECTS
from twin.errors import BadInput
from twin.model import Model


def axis(*effects: str, **values: float) -> Model:
    """A lively axis; named values replace the effects' start values."""
    structure = Structure.of([*BASE, *effects])
    usual = {"input_gain": 0.3, "viscous_friction": 1.5, "dead_band_forward": 6.0, "dead_band_reverse": 4.0}
    start = {p.name: p.start for p in structure.parameters} | usual | {"backlash_gap": 0.0} | values
    return Model(structure, start, resolution=2 * math.pi / 10000, torque_density=1e-4)


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_gets_a_controller_with_margins(effect: str) -> None:
    model = axis(effect)
    model = model.with_values(
        {p.name: min(p.start or 0.3, p.upper, 0.5) for p in EFFECTS[effect].parameters if p.neutral == 0.0}
    )
    made = design(model)
    assert made.margins.phase > math.radians(25)
    assert made.margins.delay > 2 * made.sample_time
    assert files.dumps(files.loads(files.dumps(made))) == files.dumps(made)


def test_drive_is_inverted_whatever_it_holds() -> None:
    made = design(axis("supply_sag", "drive_saturation", "thermal_fade", supply_sag=0.002, fade=0.2))
    law, p = linear.laws(made), made.parameter_list
    for target in np.linspace(-40, 40, 23):
        command = law.answer(target, 3.0, 0.5, 100.0, p)
        assert law.drive(command, 3.0, 0.5, p) == pytest.approx(target, abs=1e-6)


def test_unreachable_command_gives_the_strongest_one() -> None:
    made = design(axis("supply_sag", supply_sag=0.02))
    law, p = linear.laws(made), made.parameter_list
    tried = [law.drive(u, 0.0, 0.0, p) for u in np.linspace(0, 100, 1001)]
    strongest = law.answer(1000.0, 0.0, 0.0, 100.0, p)
    assert law.drive(strongest, 0.0, 0.0, p) == pytest.approx(max(tried), rel=0.02)


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, math.nan, math.inf, 1e4])
def test_absurd_bandwidth_is_refused(bandwidth: float) -> None:
    with pytest.raises(BadInput, match="bandwidth"):
        design(axis(), bandwidth)


def test_delay_margin_is_where_the_loop_turns_unstable() -> None:
    made = design(axis(), 2.0)
    period = made.sample_time
    samples = made.margins.delay / period
    for extra, holds in ((math.floor(samples) - 1, True), (math.ceil(samples) + 1, False)):
        late = replace(made, settings={**made.settings, "whole": float(extra)})
        true = linear.plant_system(linear.linearise(made), late)
        open_loop = -linear.controller_system(linear.linearise(made), made) * true
        assert linear.stable(open_loop) is holds
