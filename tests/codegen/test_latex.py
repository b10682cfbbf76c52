"""The LaTeX of a law, read back and evaluated, gives the law's own numbers."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.codegen import latex
from twin.effects.catalogue import BASE, EFFECTS
from twin.effects.effect import SLOTS
from twin.model.equations import trace
from twin.model.stepper import EVERYTHING, Structure
from twin.report import figures

UNITS = ("rad", "m")
READ = {
    "position": "@", "velocity": r"\dot{@}", "gap": r"\gamma", "time": "t", "command": "u",
    "emf": r"u_{\omega}", "heat": "h", "bend": "z", "tug": "a_{y}",
    "moment": "S_{p}", "payload": "J_{p}", "direction": r"\sigma", "transmitted": r"\lambda",
}  # fmt: skip
WRITTEN_OUT = [e.id for e in EFFECTS.values() if e.law is not None and len(trace(e.id).parameters) <= 6]


def braces(text: str, start: int) -> int:
    """Index of the brace that closes the one at `start`."""
    depth = 0
    for i in range(start, len(text)):
        depth += {"{": 1, "}": -1}.get(text[i], 0)
        if depth == 0:
            return i
    raise ValueError(text)


def as_python(text: str, symbols: dict[str, str]) -> str:
    for symbol, name in sorted(symbols.items(), key=lambda pair: -len(pair[0])):
        text = re.sub(rf"(?<![A-Za-z\\]){re.escape(symbol)}(?![A-Za-z_]|\^\{{-)", f" {name} ", text)
    while (at := text.find(r"\frac{")) >= 0:
        first = braces(text, at + 5)
        second = braces(text, first + 1)
        text = f"{text[:at]}(({text[at + 6 : first]})/({text[first + 2 : second]})){text[second + 1 :]}"
    text = re.sub(r"\\(sin|cos|max|min)\^\{2\}", r" squared(\1) ", text)
    text = text.replace(r"\left|{", "abs(").replace(r"}\right|", ")").replace("e^{", "exp(").replace("^{2}", "**2")
    text = text.replace("}", ")").replace(r"\left[", "float(").replace(r"\right]", ")")
    for word in ("left", "right", "sin", "cos", "max", "min", "pi"):
        text = text.replace(f"\\{word}", f" {word if word not in ('left', 'right') else ''}")
    return text.replace(r"\,", "*")


def evaluate(text: str, symbols: dict[str, str], values: dict[str, float]) -> float:
    names: dict[str, Any] = {
        "sin": math.sin,
        "cos": math.cos,
        "max": max,
        "min": min,
        "abs": abs,
        "exp": math.exp,
        "pi": math.pi,
    }
    names["squared"] = lambda function: lambda *given: function(*given) ** 2
    for piece in text.split(r",\quad "):
        value, _, condition = piece.partition(r"\ \ ")
        condition = condition.removeprefix(r"\mathrm{if}\ ").replace(r"\mathrm{otherwise}", "True")
        if not condition or eval(as_python(condition, symbols), names, values):
            return float(eval(as_python(value, symbols), names, values))
    raise AssertionError("no piece holds")


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("effect", WRITTEN_OUT)
def test_latex_is_the_law(effect, unit):
    page = EFFECTS[effect]
    rng = np.random.default_rng(1)
    coordinate = latex.coordinate(unit)
    symbols = {latex.symbol(p.name, unit): p.name for i in (*page.includes, effect) for p in EFFECTS[i].parameters}
    for name in SLOTS[page.slot][0]:
        symbols[READ[name].replace("@", coordinate)] = name
    text = latex.law(effect, unit)
    for _ in range(50):
        values = {name: float(rng.uniform(-2.0, 2.0)) for name in symbols.values()}
        values |= {p.name: float(rng.uniform(0.1, 2.0)) for p in page.parameters}
        arguments = SimpleNamespace(**{n: values[n] for n in SLOTS[page.slot][0]})
        expected = page.law(arguments, SimpleNamespace(**values))
        assert evaluate(text, symbols, values) == pytest.approx(expected, rel=1e-12, abs=1e-12), text


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("effect", EFFECTS)
def test_every_equation_can_be_set(effect, unit):
    text = latex.equation(effect, unit)
    assert "=" in text
    assert "<code>" not in figures.math_svg(text)
    assert (r"\theta" in text) <= (unit == "rad")
    if effect in WRITTEN_OUT:
        for p in EFFECTS[effect].parameters:
            assert latex.symbol(p.name, unit) in text


@pytest.mark.parametrize("unit", UNITS)
def test_symbols_are_not_shared(unit):
    named = [latex.symbol(p.name, unit) for p in EVERYTHING.parameters]
    assert len(set(named)) == len(named)
    assert not {READ[n].replace("@", latex.coordinate(unit)) for n in READ} & set(named)
    assert all("<code>" not in figures.math_svg(s) for s in named)


def test_structure_contains_every_law_once():
    structure = EVERYTHING
    found = latex.equations(structure)
    terms = [t.effect for e in found for t in e.terms]
    for effect in structure.effects:
        if effect.law is not None:
            assert terms.count(effect.id) >= 1, effect.id
    assert all("<code>" not in figures.math_svg(e.text) for e in found)


def test_base_structure_reads_as_in_the_paper():
    motion = latex.equations(Structure.of(BASE))[0]
    assert motion.text == r"\ddot{\theta} = c\,v - b\,\dot{\theta}"


def test_laws_of_the_drive_hand_on_their_command():
    structure = Structure.of([*BASE, "supply_sag", "drive_saturation", "motor_lag", "input_delay"])
    text = [e.text for e in latex.equations(structure)]
    drive = [t for t in text if t.startswith(("u_{1}", "u_{2}", "v"))]
    assert [t.split(" = ")[0] for t in drive] == ["u_{1}", "u_{2}", "v"]
    assert "u(t - t_d)" in drive[0] and "u_{1}" in drive[1].split(" = ")[1] and "u_{2}" in drive[2].split(" = ")[1]
    kept = r"\lambda_{e}\,\max\left(-\delta_{r}, \min\left(\delta_{f}, u_0\right)\right)"
    assert rf"T_{{e}}\,\dot\ell = v + {kept} - \ell" in text
    forward, reverse = r"\ell - \lambda_{e}\,\delta_{f}", r"\ell + \lambda_{e}\,\delta_{r}"
    assert rf"u_{{e}} = \max\left({forward}, 0\right) + \min\left({reverse}, 0\right)" in text
    assert text[0].startswith(r"\ddot{\theta} = c\,u_{e}")
