"""The laws between the stations: the formula of each is what its text computes."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from functools import cache

import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.codegen import python
from twin.effects.catalogue import BASE
from twin.model import stations
from twin.model.equations import argument, expression, parameter
from twin.model.stepper import Structure

TEETH = Structure.of((*BASE, "tooth_compliance", "supply_sag", "thermal_fade", "motor_lag"))
STRUCTURES = {
    "one body": Structure.of(("inertia", "viscous_friction", "thermal_fade", "motor_lag")),
    "teeth": TEETH,
    "joint": TEETH.with_("joint_elasticity"),
}
#: Those that ask no slot's laws, in these structures.
ALONE = [f for f in stations.STATIONS if f is not stations.dry_friction]
NUMBERS = st.lists(st.floats(-10.0, 10.0).filter(lambda v: abs(v) > 1e-3), min_size=6, max_size=6)


@cache
def texts(structure: Structure) -> dict[str, Callable[..., float]]:
    """The functions of the generated Python text."""
    names: dict = {}
    exec(python.write(structure), names)
    return names


def as_text(station: Callable, structure: Structure, given: list[float], values: dict[str, float]) -> float:
    """What the generated Python text gives."""
    flat = [[values[p.name] for p in structure.parameters]] if "p" in inspect.signature(station).parameters else []
    return float(texts(structure)[station.__name__](*given, *flat))


@pytest.mark.parametrize("name", STRUCTURES)
@pytest.mark.parametrize("station", ALONE, ids=lambda f: f.__name__)
@settings(max_examples=8, deadline=None)
@given(numbers=NUMBERS, size=st.floats(0.1, 3.0), side=st.sampled_from([-1, 1, 2]))
def test_the_formula_is_what_the_text_computes(
    station, name: str, numbers: list[float], size: float, side: int
) -> None:
    structure = STRUCTURES[name]
    values = {p.name: size * (1.0 + 0.1 * i) for i, p in enumerate(structure.parameters)}
    names = [n for n in inspect.signature(station).parameters if n != "p"]
    # Which flank touches decides the way; all others are symbols.
    at = {n: float(side) if n == "side" else v for n, v in zip(names, numbers, strict=False)}
    formula = expression(station, structure, *(side if n == "side" else argument(n) for n in names))
    filled = {argument(n): v for n, v in at.items()} | {parameter(n): v for n, v in values.items()}
    expected = as_text(station, structure, list(at.values()), values)
    assert math.isclose(float(formula.subs(filled)), expected, rel_tol=1e-9, abs_tol=1e-9)


def test_the_laws_of_a_slot_stand_in_the_formula_as_what_they_come_to() -> None:
    structure = Structure.of((*BASE, "constant_offset", "presliding_friction", "coulomb_friction"))
    torque, turn, held = sympy.symbols("torque turn held", real=True)
    slots = {"shaft": turn, "bristle": held, "grip": turn}
    pushed = expression(stations.on_motor, structure, torque, 0, 0, 0, 1, sympy.Rational(1, 2), slots=slots)
    assert sympy.expand(pushed - torque - held - turn / 2) == 0
    size = expression(stations.dry_friction, structure, 0, 0, 1.0, 0, 0, slots=slots)
    assert size.subs(turn, -1).is_zero and size.subs(turn, 2) == 2
