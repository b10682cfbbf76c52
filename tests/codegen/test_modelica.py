"""The Modelica package, checked and simulated by a Modelica compiler, against the kernel."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import re

import numpy as np
import pytest
from native_axis import PERIOD, RIGID, VALUES, by_kernel, model_of

from twin.codegen import modelica
from twin.effects.catalogue import BASE, EFFECTS
from twin.model.fitted_model import Model
from twin.model.stepper import EVERYTHING, Structure
from twin.model.variables import variables

rumoca = importlib.import_module("rumoca") if importlib.util.find_spec("rumoca") else None
compiler = pytest.mark.skipif(rumoca is None, reason="the Modelica compiler rumoca is not installed")

#: rumoca 0.10.2 takes `delay(u, t)` for `u`: structures with dead time are checked there, not simulated.
BEYOND = ("input_delay",)
ALONE = [i for i in EFFECTS if i not in (*BASE, *BEYOND)]
STRUCTURES = {
    "one body": Structure.of(("inertia", "viscous_friction")),
    "one body and its load": Structure.of(("inertia", "viscous_friction", "load_dependent_friction", "gravity")),
    "rigid gap": Structure.of(BASE),
    "rigid gap and friction": Structure.of((*BASE, "coulomb_friction")),
    **{i: Structure.of((*BASE, "tooth_compliance", i)) for i in ALONE},
    "all": EVERYTHING.without(*BEYOND),
    "all, rigid": RIGID.without(*BEYOND),
}
EDGES = ((0.0, 60.0), (1.0, -60.0), (2.0, 0.0), (2.5, 30.0), (4.0, 0.0))


def with_input(text: str) -> str:
    """A model that drives the axis with pulses, both ways and with rests."""
    said = "".join(f"if time < {until!r} then {value!r} else " for until, value in pulses())
    return f"{text}\nmodel Run\n  Twin.Axis axis;\nequation\n  axis.duty = {said}{EDGES[-1][1]!r};\nend Run;\n"


def pulses() -> list[tuple[float, float]]:
    return [(until, value) for (_, value), (until, _) in itertools.pairwise(EDGES)]


@compiler
@pytest.mark.parametrize("name", STRUCTURES)
def test_same_motion_as_the_kernel(name: str) -> None:
    model = model_of(STRUCTURES[name])
    text = with_input(modelica.write(model))
    assert rumoca.validate_source(text, model="Run") == []
    config = rumoca.SimConfig(rtol=1e-7, atol=1e-8, dt=8 * PERIOD, solver="bdf")
    run = rumoca.Session().loads(text, model="Run").simulate(t=(0.0, 5.0), config=config)
    time = np.arange(2561) * PERIOD
    u = np.array([EDGES[np.searchsorted([s for s, _ in EDGES], t, side="right") - 1][1] for t in time])
    truth = by_kernel(model, u, 0.0, 0.0)
    at = np.asarray(run.time) / PERIOD
    on_grid = np.abs(at - at.round()) < 1e-9
    assert on_grid.sum() > 300
    where = at[on_grid].round().astype(int)
    for column, output in enumerate(("axis.position", "axis.position_measured")):
        expected = truth[where, 0 if column == 0 else 2]
        assert np.max(np.abs(np.asarray(run[output])[on_grid] - expected)) < 1e-3
    assert np.ptp(truth[:, 0]) > 1.0


@compiler
def test_dead_time_is_checked() -> None:
    text = modelica.write(model_of(Structure.of((*BASE, "tooth_compliance", "motor_lag", "input_delay"))))
    assert "delay(duty, delay_time)" in text
    assert rumoca.validate_source(with_input(text), model="Run") == []


@compiler
def test_a_held_axis_stays() -> None:
    """Gravity below the dry friction: the link gives by the bristle's travel and stays for a minute."""
    structure = Structure.of((*BASE, "tooth_compliance", "coulomb_friction", "constant_offset"))
    text = modelica.write(model_of(structure, coulomb_friction=6.0, offset=4.0, backlash_gap=0.0))
    text += "\nmodel Run\n  Twin.Axis axis;\nequation\n  axis.duty = 0;\nend Run;\n"
    run = rumoca.Session().loads(text, model="Run").simulate(t=(0.0, 60.0), config=rumoca.SimConfig(rtol=1e-8))
    assert np.max(np.abs(run["axis.position"])) < 1e-4


@pytest.mark.parametrize("unit", ["rad", "m"])
def test_names_units_and_pages(unit: str) -> None:
    model = Model(EVERYTHING, dict(model_of(EVERYTHING).values), axis_unit=unit, input_unit="V")
    text = modelica.write(model)
    assert text == modelica.write(model)
    for v in variables(model):
        if v.causality == "local":
            continue
        name = "delay_time" if v.name == "delay" else v.name
        line = re.search(rf"^ +(parameter|input|output) Real {name}\b.*$", text, re.MULTILINE)
        assert line and v.description.split(",")[0] in line.group()
        if v.causality == "parameter" and v.name in VALUES:
            assert f" = {v.start!r} " in line.group()
    assert f'input_gain(unit = "{unit}/(s2.V)"' in text and 'own_inertia(unit = "kg.m2"' in text
    for effect in EVERYTHING.effects:
        assert effect.title in text
