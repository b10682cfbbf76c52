"""One contract for every effect of the catalogue."""

from __future__ import annotations

import ctypes
import inspect
import re
import shutil
import string
import subprocess
from collections import Counter
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
import sympy
from axis_runs import PAYLOAD, SANE, drive, run, sane, steps
from hypothesis import given
from hypothesis import strategies as st

from twin.codegen import c, python
from twin.codegen.simd_derivatives import FADED
from twin.effects.catalogue import BASE, CANDIDATES, EFFECTS, UNKNOWN
from twin.effects.effect import SLOTS, Effect
from twin.model import equations, stepper
from twin.model.equations import trace
from twin.model.stepper import EVERYTHING, KNOWN, STATES, Structure
from twin.simulation import kernel

every_effect = pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda e: e.id)
TIME = np.arange(600) * 0.002
#: By what share of the largest slope single precision may be off after 120 stamps and a dozen meetings of the teeth.
SINGLE = 3e-5


def around(effect_id: str) -> Structure:
    """The base model with the effect."""
    return Structure.of((*BASE, effect_id))


def own(effect: Effect, rng: np.random.Generator) -> dict[str, float]:
    """Random sizes of the effect's own parameters."""
    return {p.name: float(rng.uniform(*SANE[p.name])) for p in effect.parameters}


def generator(effect_id: str) -> np.random.Generator:
    return np.random.default_rng(sum(map(ord, effect_id)))


@every_effect
def test_page_is_complete(effect):
    stations = {"drive", "motor", "transmission", "friction", "load", "inertia", "sensor", "disturbance"}
    dependences = {"time", "position", "velocity", "acceleration", "input", "load", "direction"}
    names = {p.name for p in effect.parameters}
    fields = {field for _, field, _, _ in string.Formatter().parse(effect.sentence) if field is not None}
    assert effect.station in stations
    assert effect.slot in SLOTS
    assert set(effect.depends_on) <= dependences
    assert effect.promises <= {"dissipative", "odd", "memoryless", "state"}
    brought = {p.name for i in effect.includes for p in EFFECTS[i].parameters}
    assert fields & (names or brought) and fields <= names | brought
    assert set(effect.confused_with) <= set(EFFECTS) - {effect.id}
    assert set(effect.includes) <= set(EFFECTS)
    assert (effect.law is None) == (effect.equation is not None)
    assert effect.title and effect.reference and len(effect.sentence) > 10
    for p in effect.parameters:
        assert p.lower <= p.start <= p.upper
        assert p.neutral is None or p.lower <= p.neutral <= p.upper
    if effect.screen:
        phased = {effect.screen.phase} if effect.screen.phase else set()
        assert {effect.screen.gain, *effect.screen.grid, *phased} <= names


def test_contract_ids_exist():
    promised = """inertia viscous_friction dead_band backlash coulomb_friction stribeck_friction
        friction_asymmetry position_dependent_friction load_dependent_friction constant_offset quadratic_drag
        gravity spring torque_ripple end_stop joint_elasticity motor_lag input_delay drive_saturation supply_sag
        thermal_fade load_change encoder_eccentricity periodic_disturbance viscous_asymmetry friction_run_in
        sticky_sector detent disturbance_pulse presliding_friction flexible_load"""
    assert set(promised.split()) <= set(EFFECTS)
    assert set(promised.split()) - set(BASE) <= set(CANDIDATES)


@every_effect
def test_switched_off_it_leaves_no_trace(effect):
    rng = generator(effect.id)
    if effect.id == "inertia":
        pytest.skip("no axis is without it")
    present = Structure.of((*BASE, *effect.includes))
    without = present.without(effect.id)
    values = sane(present, rng)
    command = steps(rng, len(TIME))
    command[:100] = 45.0  # whatever follows, it moves
    plain, _ = run(without, values, TIME, command, longest=0.002)
    strange = values | {p.name: float(rng.uniform(0.3, 0.6)) for p in effect.parameters}
    again, _ = run(without, strange, TIME, command, longest=0.002)
    assert np.array_equal(plain, again)
    if any(p.neutral is not None for p in effect.parameters):
        neutral = {
            p.name: p.neutral if p.neutral is not None else v
            for p, v in zip(effect.parameters, own(effect, rng).values(), strict=True)
        }
        off, _ = run(present.with_(effect.id), values | neutral, TIME, command, longest=0.002)
        # Not bit for bit: a stop that does nothing, or a load of nothing, still ends a piece of the path. That may cost
        # a small part of what steps of half the length change.
        finer, _ = run(without, values, TIME, command, longest=0.001)
        cut = 0.1 * np.abs(finer - plain).max() if effect.id in {"end_stop", "load_change"} else 1e-12
        assert np.allclose(off, plain, rtol=0.0, atol=cut)
        if effect.id != "payload_gravity":
            on, _ = run(present.with_(effect.id), values | own(effect, rng), TIME, command, longest=0.002)
            assert np.abs(on - plain).max() > 1e-6


@pytest.mark.parametrize("effect", [e for e in EFFECTS.values() if e.law is not None], ids=lambda e: e.id)
def test_a_law_along_a_run_is_the_law_at_every_place(effect):
    rng = generator(effect.id)
    states = {n: rng.normal(0.0, 30.0, 40) for n in SLOTS[effect.slot][0]}
    values = sane(around(effect.id), rng)
    each = [
        effect.law(SimpleNamespace(**dict(zip(states, row, strict=True))), SimpleNamespace(**values))
        for row in np.array(list(states.values())).T.tolist()
    ]
    assert equations.along(effect.id, states, values) == pytest.approx(each, rel=1e-9, abs=1e-9)
    assert equations.along(effect.id, {next(iter(states)): np.zeros(3)}, values).shape == (3,)


@every_effect
def test_dissipative_effects_never_feed_energy(effect):
    if "dissipative" not in effect.promises:
        pytest.skip("promises nothing about power")
    rng = generator(effect.id)
    if effect.law is not None:
        for _ in range(500):
            values = {p.name: rng.uniform(max(p.lower, -5.0), min(p.upper, 5.0)) for p in effect.parameters}
            state = dict(zip(SLOTS[effect.slot][0], rng.normal(0.0, 3.0, 5), strict=False))
            size = effect.law(SimpleNamespace(**state), SimpleNamespace(**values))
            assert size >= 0.0 if effect.slot == "grip" else size * state["velocity"] <= 0.0
    # And as the stepper applies it: with no command, the energy of the two bodies only falls.
    structure = around(effect.id)
    values = sane(structure, rng)
    start = kernel.start_state(0.0, 3.0, 0.0)
    start[3] = -2.0
    _, states = run(structure, values, TIME, np.zeros(len(TIME)), start)
    share = values["motor_share"]
    energy = 0.5 * share * states[:, 3] ** 2 + 0.5 * (1.0 - share) * states[:, 1] ** 2
    assert np.diff(energy).max() <= 1e-12
    assert energy[-1] < 0.5 * energy[0]


@pytest.mark.parametrize("effect", [e for e in EFFECTS.values() if e.slot == "drive"], ids=lambda e: e.id)
def test_a_drive_that_gives_more_or_less_on_the_way_is_asked_again_in_the_middle(effect):
    """Or the stepper is of first order in what it reads: `piece` has to name it."""
    reads = {s.name for s in trace(effect.id).expression.free_symbols} & set(SLOTS["drive"][0])
    asked = re.search(r"if (.*):\n\s+varies = 1", inspect.getsource(stepper.piece))
    assert asked is not None
    assert (f"has.{effect.id}" in asked[1].split(" or ")) == (reads != {"command"})


def test_what_counts_the_time_since_the_start_is_known():
    counting = {i for i in EFFECTS if equations.timed(Structure.of([i]))}
    assert counting == {
        "thermal_fade",
        "load_change",
        "friction_run_in",
        "disturbance_pulse",
        "periodic_disturbance",
    } | {
        "unknown_time",
        "unknown_drag",
    }


@every_effect
def test_odd_effects_mirror(effect):
    rng = generator(effect.id)
    structure = Structure.of(("inertia", "viscous_friction", "backlash", effect.id))
    values = sane(structure, rng)
    command = steps(rng, len(TIME))
    start = kernel.start_state(0.1, 0.5, 0.002)
    there, _ = run(structure, values, TIME, command, start)
    mirror = np.array([1.0 if state in ("heat", "time") else -1.0 for state in STATES])
    back, _ = run(structure, values, TIME, -command, start * mirror)
    mirrored = np.allclose(there, -back, rtol=0.0, atol=1e-12)
    assert mirrored if "odd" in effect.promises else True
    # These mirror too, but promise nothing about it.
    evenly = {"backlash", "tooth_compliance", "joint_elasticity", "payload", "load_change"}
    assert mirrored == ("odd" in effect.promises) or effect.id in evenly


@every_effect
def test_memoryless_effects_need_only_the_state_of_motion(effect):
    rng = generator(effect.id)
    structure = Structure.of(("inertia", "viscous_friction", effect.id))
    values = sane(structure, rng)
    command = steps(rng, len(TIME), 37)
    whole, states = run(structure, values, TIME, command)
    half = len(TIME) // 2
    motion = states[half].copy()
    motion[4:-1] = 0.0  # all but the motion and the time: what it would have to remember
    tail, _ = run(structure, values, TIME[half:], command[half:], motion)
    same = np.allclose(tail, whole[half:], rtol=0.0, atol=1e-12)
    twisted = effect.id in {"joint_elasticity", "tooth_compliance"}  # their state is motion, too
    assert same == ("state" not in effect.promises or twisted)


@given(
    command=st.floats(-100.0, 100.0), emf=st.floats(-60.0, 60.0), sag=st.floats(0.0, 0.008),
    switched=st.floats(0.0, 1.0), electric=st.floats(0.0, 1.0),
)  # fmt: skip
def test_a_sagging_supply_gives_what_its_own_current_leaves(command, emf, sag, switched, electric):
    """Independently: the current by the law of Ohm, the voltage that it leaves, the current at that voltage, ..."""
    p = SimpleNamespace(supply_sag=sag, sag_switched=switched, sag_emf=electric, sag_reference=100.0)
    on = 1.0 - switched * (1.0 - abs(command) / 100.0)
    side = 1.0 if command > 0.0 else -1.0
    voltage = 1.0
    for _ in range(400):
        current = max(abs(command) * voltage - electric * emf * side, 0.0)
        voltage += 0.5 * (1.0 - sag * on * current - voltage)
    given_out = EFFECTS["supply_sag"].law(SimpleNamespace(command=command, emf=emf), p)
    assert given_out == pytest.approx(command * max(voltage, 0.1), rel=1e-6, abs=1e-9)


# Units --------------------------------------------------------------------------------------------------

SLOT_UNITS = {
    "command": "{u}", "emf": "{u}", "heat": "1", "bend": "1", "position": "{x}", "velocity": "{x}/s", "gap": "{x}",
    "time": "s", "tug": "{x}/s^2", "direction": "1", "transmitted": "{x}/s^2",
    **{name: unit for name, (unit, _) in KNOWN.items()},
}  # fmt: skip
RETURNS = {
    "drive": "{u}", "load": "{x}/s^2", "shaft": "{x}/s^2", "drag": "{x}/s^2", "bristle": "{x}/s^2", "rider": "{x}/s^2",
    "grip": "{x}/s^2", "mass": "1", "sensor": "{x}",
}  # fmt: skip
#: Numbers in laws that are quantities: standard gravity (inertia being torque per rad/s^2), a turn and a quarter of it.
LITERALS = {9.80665: "{x}*m/s^2", 6.283185307179586: "rad", 1.5707963267948966: "rad"}
#: Laws of the angle itself, which have no counterpart on a linear axis.
ROTARY = {"gravity", "payload_gravity", "encoder_eccentricity", "position_dependent_friction"}


def dimension(unit: str, axis: str) -> Counter:
    """Exponents of a unit's symbols: "rad/s^2" -> {rad: 1, s: -2}."""
    found: Counter = Counter()
    for i, factor in enumerate(unit.format(x=axis, u="V").replace("Hz", "1/s").split("/")):
        for part in factor.split("*"):
            symbol, _, power = part.partition("^")
            assert symbol in {"1", "rad", "m", "s", "kg", "V"}, f"unknown unit {symbol!r}"
            if symbol != "1":
                found[symbol] += (1 if i == 0 else -1) * int(power or 1)
    return Counter({s: n for s, n in found.items() if n})


def dimension_of(node: sympy.Basic, units: dict[str, Counter], axis: str) -> Counter | None:
    """Dimension of an expression; None for zero, which fits anywhere. Raises AssertionError where units clash."""

    def of(inner: sympy.Basic) -> Counter | None:
        return dimension_of(inner, units, axis)

    if node.is_Number:
        literal = next((u for v, u in LITERALS.items() if abs(abs(float(node)) - v) < 1e-9), "1")
        return None if node.is_zero else dimension(literal, axis)
    if node.is_Symbol:
        return units[node.name]
    if isinstance(node, sympy.Mul):
        total: Counter = Counter()
        for factor in node.args:
            total.update(of(factor) or Counter())
        return Counter({s: n for s, n in total.items() if n})
    if isinstance(node, sympy.Pow):
        base = of(node.base) or Counter()
        return Counter({s: n * int(node.exp) for s, n in base.items()})
    if isinstance(node, (sympy.Add, sympy.Min, sympy.Max)):
        found = [d for d in map(of, node.args) if d is not None]
        assert all(d == found[0] for d in found), f"units clash in {node}"
        return found[0]
    if isinstance(node, sympy.Abs):
        return of(node.args[0])
    if isinstance(node, sympy.Piecewise):
        found = [d for d in (of(value) for value, _ in node.args) if d is not None]
        assert all(d == found[0] for d in found), f"units clash in {node}"
        return found[0] if found else None
    if isinstance(node, (sympy.sin, sympy.cos, sympy.exp, sympy.tanh)):
        inner = of(node.args[0])
        assert not inner or (inner == Counter({"rad": 1}) and isinstance(node, (sympy.sin, sympy.cos))), node
        return Counter()
    raise AssertionError(f"no dimension for {node.func}")


@pytest.mark.parametrize("axis", ["rad", "m"])
@every_effect
def test_units_fit(effect, axis):
    units = {f"p.{p.name}": dimension(p.unit, axis) for e in EFFECTS.values() for p in e.parameters}
    units |= {name: dimension(unit, axis) for name, unit in SLOT_UNITS.items()}
    if effect.law is not None and not (axis == "m" and effect.id in ROTARY):
        assert dimension_of(trace(effect.id).expression, units, axis) == dimension(RETURNS[effect.slot], axis)


def test_unit_checker_sees_a_wrong_unit():
    x, y = sympy.symbols("x y", real=True)
    units = {"x": dimension("rad", "rad"), "y": dimension("rad/s", "rad")}
    for wrong in (x + y, sympy.exp(x), sympy.Max(x, y), x + 1):
        with pytest.raises(AssertionError):
            dimension_of(wrong, units, "rad")


# Tongues ------------------------------------------------------------------------------------------------


def random_cases(structure: Structure, count: int, seed: int):
    rng = np.random.default_rng(seed)
    for case in range(count):
        p = np.array(list(sane(structure, rng).values()))
        x = rng.normal(size=len(STATES))
        half = 0.5 * sane(structure, rng).get("backlash_gap", 0.0)
        if case % 2:
            x[3], x[2] = x[1], half
        if case % 3 == 0:
            x[1] = x[3] = 0.0
        x[[5, 7]] = np.abs(x[[5, 7]])  # heat and time
        x[6] = np.tanh(x[6])  # bend, either way
        yield p, x, rng.uniform(0.0, 0.1, 2), float(rng.uniform(-50.0, 50.0))


@pytest.mark.parametrize("ids", [BASE, tuple(EFFECTS)], ids=["base", "everything"])
def test_python_numba_and_c_agree(ids, tmp_path):
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler here")
    structure = Structure.of(ids)
    source, library = tmp_path / "axis.c", tmp_path / "axis.so"
    entry = "double go(double *x, double *p, double *k, double u, double h) { return step(x, p, k, u, h); }\n"
    used = "double look(double position, double *p) { return sensor(position, 0.0, p); }\n"
    source.write_text(c.write(structure) + "\n" + entry + used)
    flags = ["-O2", "-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-ffp-contract=off"]
    subprocess.run([compiler, *flags, "-o", library, source, "-lm"], check=True)
    native = ctypes.CDLL(str(library))
    numbers = ctypes.POINTER(ctypes.c_double)
    native.go.argtypes = [numbers, numbers, numbers, ctypes.c_double, ctypes.c_double]
    plain: dict = {}
    exec(python.write(structure), plain)
    for p, x, k, u in random_cases(structure, 600, 1):
        in_c, in_python = x.copy(), list(x)
        # Dead time is the driver's, not the step's.
        values = {**dict(zip((q.name for q in structure.parameters), p, strict=True)), "delay": 0.0}
        held = replace(drive(np.array([0.0, 0.002]), np.array([u, u])), known=k)
        in_numba = kernel.predict(held, kernel.vector(structure, values), x, keep_states=True).states[1]
        native.go(*(a.ctypes.data_as(numbers) for a in (in_c, p, k)), u, 0.002)
        plain["step"](in_python, list(p), list(k), u, 0.002)
        assert np.allclose(in_c, in_python, rtol=1e-12, atol=1e-12)
        assert np.allclose(in_numba, in_python, rtol=1e-12, atol=1e-12)


# Derivative ---------------------------------------------------------------------------------------------

#: Numbers that bear a difference, their functions, and by what share a parameter is moved: what the processor has
#: beyond double precision is 25 times as fast as 40 digits.
if np.finfo(np.longdouble).eps < 1e-18:
    EXACT, MATHS, NUDGE = np.longdouble, np, "3e-6"
else:
    mpmath.mp.dps = 40
    EXACT, MATHS, NUDGE = mpmath.mpf, mpmath, "1e-14"


def in_high_precision(structure: Structure, values: dict, command: np.ndarray) -> list:
    """Readings from the plain Python text, run with numbers of more digits than any kernel has."""
    text = python.write(structure).replace("from math import cos, exp, sin, sqrt, tanh", "")
    space: dict = {n: getattr(MATHS, n) for n in ("cos", "exp", "sin", "sqrt", "tanh")}
    exec(text, space)
    p = list(values.values())
    k = [EXACT(v) for v in PAYLOAD.values()]
    x = [EXACT(0)] * len(STATES)
    delay = values.get("delay", 0)
    sample = EXACT("0.002")
    readings = []
    for i in range(len(command)):
        readings.append(x[0] + space["sensor"](x[0], x[2], p))
        late = min(delay / sample, i + 1) if delay else 0
        whole = int(late)
        earlier = command[i - whole - 1] if i > whole else 0.0
        held = command[i - whole] if i >= whole else 0.0
        if late > whole:
            space["step"](x, p, k, EXACT(earlier), (late - whole) * sample)
            space["step"](x, p, k, EXACT(held), sample - (late - whole) * sample)
        else:
            space["step"](x, p, k, EXACT(held), sample)
    return readings


@cache
def interpreted() -> SimpleNamespace:
    """The kernel of all laws as plain Python: what is compiled in single precision, in double."""

    def plain(**options):
        return lambda function: function

    lanes = {
        "numbers": lambda array: array,
        "row": lambda array, i: array.reshape(-1, kernel.WIDTH)[i].copy(),
        "settled": lambda value: np.where(np.abs(value) < FADED, 0.0, value),
        "zero": lambda: np.zeros(kernel.WIDTH),
    }

    def put(array, i, value):
        array.reshape(-1, kernel.WIDTH)[i] = value

    space = {"njit": plain, "kept": lambda function: function, "put": put, **lanes}
    _, text = kernel.kernel_text(EVERYTHING).split("import kept\n")
    exec("import numpy as np\nfrom math import cos, exp, log, sin, sqrt, tanh\n" + text, space)
    return SimpleNamespace(**space)


@every_effect
def test_derivative_is_that_of_the_computed_trajectory(effect, monkeypatch):
    rng = generator(effect.id)
    structure = around(effect.id)
    values = sane(structure, rng)
    if "load_time" in values:
        values["load_time"] = 0.0805  # within the run
    count = 120
    command = steps(rng, count, 30)
    command[0:30], command[30:60] = 45.0, -30.0
    # Of a curve's many values, all in the same law, every third.
    looked = [p for p in effect.parameters if p.name in values and p.estimated][:: 3 if effect.id in UNKNOWN else 1]
    looked += [p for p in structure.parameters if p.acts_on == effect.slot]
    names = tuple(dict.fromkeys([*(p.name for p in looked), "viscous_friction"]))
    recording = drive(0.002 * np.arange(count), command, 0.0021)
    vector, start = kernel.vector(structure, values), kernel.start_state(0.0, 0.0, 0.0)
    compiled = kernel.predict_with_slopes(recording, vector, start, kernel.fixed_start(names))
    assert np.allclose(compiled.reading, kernel.predict(recording, vector, start).reading, rtol=0.0, atol=1e-13)
    monkeypatch.setattr(kernel, "PRECISION", np.float64)
    monkeypatch.setattr(kernel, "_serving", lambda p: interpreted())
    written = kernel.predict_with_slopes(recording, vector, start, kernel.fixed_start(names))
    assert np.allclose(written.reading, compiled.reading, rtol=0.0, atol=1e-13)
    exact = {n: EXACT(v) for n, v in values.items()}
    for j, name in enumerate(names):
        tiny = EXACT(NUDGE) * max(abs(exact[name]), EXACT("0.01"))
        up = in_high_precision(structure, exact | {name: exact[name] + tiny}, command)
        down = in_high_precision(structure, exact | {name: exact[name] - tiny}, command)
        oracle = np.array([float((a - b) / (2 * tiny)) for a, b in zip(up, down, strict=True)])
        scale = max(np.abs(oracle).max(), 1e-6)
        assert np.abs(written.slopes[:, j] - oracle).max() < 1e-7 * scale, name
        assert np.abs(compiled.slopes[:, j] - oracle).max() < SINGLE * scale, name


def test_derivative_with_respect_to_the_start():
    rng = np.random.default_rng(4)
    structure = around("gravity")
    values = sane(structure, rng)
    recording = drive(TIME[:200], steps(rng, 200))
    vector = kernel.vector(structure, values)
    start = kernel.start_state(0.2, 0.4, 0.5 * values["backlash_gap"])
    slope = np.zeros((len(STATES), 2))
    slope[0, 0] = slope[1, 1] = slope[3, 1] = 1.0
    slopes = kernel.predict_with_slopes(recording, vector, start, dict(zip("ab", slope.T, strict=True))).slopes
    for j in range(2):
        up, down = (kernel.predict(recording, vector, start + s * 1e-6 * slope[:, j]).reading for s in (1, -1))
        assert np.allclose((up - down) / 2e-6, slopes[:, j], rtol=0.0, atol=1e-5)
