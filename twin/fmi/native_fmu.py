"""The native FMU: C from the writer, our plumbing, the standard's headers; compiled, packed.

Needs no Python in the host. With ziglang (the extra `native`) it is compiled for five platforms, otherwise by
the local C compiler for this one.
"""

from __future__ import annotations

import hashlib
import html
import importlib.resources
import importlib.util
import math
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from twin.codegen import c, model_exchange
from twin.errors import BadInput
from twin.fmi import model_description
from twin.fmi.compilers import compilers, universal
from twin.fmi.model_description import Derivative, Identity, Margin, Solver
from twin.io.files import check_free, put, zipped
from twin.model.fitted_model import Model, dumps
from twin.model.stepper import KNOWN, STATES, Structure
from twin.model.variables import ROUND, STATE_NAMES, Variable, delay_capacity, parameters_text, variables

#: States that the plumbing starts and shows, and margins that it looks at.
_NAMED_STATES = ("position", "velocity", "gap", "motor_velocity", "time", "margin_motor", "margin_link")
_SOURCES = {2: ("fmi2.c",), 3: ("fmi3.c",)}
_HEADERS = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}


@dataclass(frozen=True)
class Export:
    """What becomes a native FMU: an axis, or the controller of one."""

    identity: Identity
    variables: tuple[Variable, ...]
    solver: Solver
    header: str  # the text of model.h
    motion: str  # the plumbing that goes through a communication step: axis.h or controller.h
    resources: Mapping[str, str]
    effects: Structure  # that its page lists


# ---- C ----


def _slots(model: Model) -> dict[str, int]:
    """Where the value of each variable stands: what the stepper takes as an array stands together."""
    shown = variables(model)
    names = [model.input_name, *(p.name for p in model.structure.parameters), *KNOWN]
    names += ["position_start", "velocity_start", "time_start", *STATE_NAMES, *_behind(model)]
    names += [v.name for v in shown if v.name not in set(names)]
    return {name: i for i, name in enumerate(names)}


def _behind(model: Model) -> tuple[str, ...]:
    return model_exchange.BEHIND if model_exchange.offered(model.structure) else ()


def offers(structure: Structure) -> str:
    """The kinds of FMI that a native FMU of this structure offers, and why not the other."""
    if model_exchange.offered(structure):
        return "co-simulation and model exchange"
    what = "dead time" if "input_delay" in structure else "rigid contact across a gap"
    return f"co-simulation only: {what} is not for an outside solver"


def solver(model: Model) -> Solver:
    """What model exchange adds behind the variables, nothing where it is not offered; slopes are there always."""
    if not model_exchange.offered(model.structure):
        return Solver((), (), directional_derivatives=True)
    shown = {v.name: v for v in variables(model)}
    states = [shown[name] for name in model_exchange.continuous(model.structure)]
    watched = model_exchange.margins(model.structure)
    first = len(shown) + len(states)
    return Solver(
        tuple(Derivative(state, len(shown) + i) for i, state in enumerate(states)),
        tuple(Margin(name, first + i) for i, name in enumerate(watched)),
        directional_derivatives=True,
    )


def _solver_tables(model: Model) -> list[str]:
    """What an outside solver integrates and watches, as places behind the first state."""
    order, outside = (*STATES, *model_exchange.BEHIND), solver(model)
    states = [d.state.name for d in outside.derivatives]
    rates = [f"rate_{name}" for name in states]
    lists = {"continuous": states, "derivative": rates, "indicator": [m.name for m in outside.margins]}
    # C has no empty arrays.
    tables = [
        f"static const size_t {name}[] = {{{', '.join(str(order.index(n)) for n in names) or '0'}}};"
        for name, names in lists.items()
    ]
    nominal = ", ".join(repr(d.state.nominal or 1.0) for d in outside.derivatives)
    return [*tables, f"static const double nominal[] = {{{nominal or '1.0'}}};"]


def _differentiable(model: Model) -> set[str]:
    """What derivatives can be taken with respect to: input, states, start values and parameters."""
    names = {model.input_name, "position_start", "velocity_start", *STATE_NAMES} - {"time_since_start"}
    return names | {p.name for p in model.structure.parameters}


def _c_number(value: float | None, absent: str = "0.0") -> str:
    return absent if value is None or not math.isfinite(value) else repr(float(value))


def row(v: Variable, slot: int, differentiable: bool = False) -> str:
    """A variable's row in the table of model.h."""
    settable = {"input": "ANY_TIME", "parameter": "BEFORE_START" if v.variability == "fixed" else "ANY_TIME"}
    # The bounds of the input are for the importer's information: a saturated command is no error.
    low, high = (None, None) if v.causality == "input" else (v.min, v.max)
    bounds = f"{_c_number(low, '-HUGE_VAL')}, {_c_number(high, 'HUGE_VAL')}"
    when = settable.get(v.causality, "NEVER")
    return f'    {{"{v.name}", {slot}, {bounds}, {when}, {int(differentiable)}}},'


def header(model: Model, token: str) -> str:
    """model.h of an axis: sizes, the table of variables, the compiled-in start values, and the physics."""
    shown, slots, outside = variables(model), _slots(model), solver(model)
    behind = [(d.name, f"rate_{d.state.name}") for d in outside.derivatives]
    behind += [(m.name, m.name) for m in outside.margins]
    constants: dict[str, object] = {
        "MOTION": '"axis.h"',
        "TOKEN": f'"{token}"',
        "VARIABLES": len(shown) + len(behind),
        "SLOTS": len(slots),
        "STATES": len(STATES),
        "LONGEST_STEP": repr(model.longest_step),
        "ROUND": repr(ROUND),
        "EXCHANGE": int(bool(behind)),
        "DERIVATIVES": 1,
        "CONTINUOUS_STATES": len(outside.derivatives),
        "INDICATORS": len(outside.margins),
        "TIMED": int("load_change" in model.structure),
        "EVENT_TIME": slots.get("load_time", 0),
        "CLOCK_REFERENCE": len(shown) + len(behind),
        "COMMAND": slots[model.input_name],
        "FIRST_PARAMETER": 1,
        "FIRST_KNOWN": slots[next(iter(KNOWN))],
        "FIRST_STATE": slots[STATE_NAMES[0]],
        "POSITION_START": slots["position_start"],
        "VELOCITY_START": slots["velocity_start"],
        "TIME_START": slots["time_start"],
        "MEASURED": slots["position_measured"],
        **{s.upper(): i for i, s in enumerate((*STATES, *_behind(model))) if s in _NAMED_STATES},
        "DELAY_CAPACITY": delay_capacity(model),
    }
    if delay_capacity(model):
        constants |= {
            "DELAY": slots["delay"],
            "ACTING": slots["acting_command"],
            "DELAY_COUNT": slots["delay_count"],
            "DELAY_TIME": slots["delay_time[1]"],
            "DELAY_VALUE": slots["delay_value[1]"],
        }
    starts = {v.name: v.start for v in shown} | {k: float(model.known.get(k, 0.0)) for k in KNOWN}
    differentiable = _differentiable(model)
    rows = [
        *(row(v, slots[v.name], v.name in differentiable) for v in shown),
        *(f'    {{"{name}", {slots[place]}, -HUGE_VAL, HUGE_VAL, NEVER, 0}},' for name, place in behind),
    ]
    text = [*_solver_tables(model), "", c.write(model.structure)]
    text += [model_exchange.write(model.structure)] if behind else []
    text += [model_exchange.write_derivatives(model.structure)]
    return header_text(constants, rows, {name: starts.get(name) for name in slots}, text)


def header_text(
    constants: Mapping[str, object], rows: Sequence[str], starts: Mapping[str, float | None], text: Sequence[str]
) -> str:
    """model.h of constants, rows of the table of variables, start values by slot, and what else it brings."""
    return "\n".join(
        [
            "/* Written for one model: its variables, its start values and its functions. */",
            *(f"#define {name} {value}" for name, value in constants.items()),
            "",
            "static const Variable variables[VARIABLES] = {",
            *rows,
            "};",
            "",
            "static const double compiled_in[SLOTS] = {",
            *(f"    {_c_number(value)}, /* {name} */" for name, value in starts.items()),
            "};",
            "",
            *text,
        ]
    )


def digest_of(physics: str, shown: Iterable[Variable], motion: str) -> str:
    """Tells exports apart, but not those that differ in start values only, so that these can be set."""
    listed = [replace(v, start=None) for v in shown]
    content = "\n".join([physics, repr(listed), *(plumbing(n) for n in ("instance.h", motion, "fmi2.c", "fmi3.c"))])
    return hashlib.sha256(content.encode()).hexdigest()


def token_of(digest: str) -> str:
    """A GUID made of a digest."""
    return "{" + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])) + "}"


def identity(model: Model) -> Identity:
    """Name and token: the same for models that differ in parameter values only."""
    outside = model_exchange.write(model.structure) if model_exchange.offered(model.structure) else ""
    slopes = model_exchange.write_derivatives(model.structure)
    digest = digest_of(f"{c.write(model.structure)}\n{outside}\n{slopes}", variables(model), "axis.h")
    return model_description.of_axis(model, f"axis_{digest[:8]}", token_of(digest))


def of_axis(model: Model) -> Export:
    """A model, ready to be compiled."""
    who = identity(model)
    resources = {"model.toml": dumps(model), "parameters.txt": parameters_text(model)}
    text = header(model, who.token)
    return Export(who, variables(model), solver(model), text, "axis.h", resources, model.structure)


def plumbing(name: str) -> str:
    """A file of fmu_src/native."""
    return importlib.resources.files("fmu_src").joinpath("native", name).read_text(encoding="utf-8")


def _standard_header(name: str) -> str:
    spec = importlib.util.find_spec("fmpy")
    assert spec is not None and spec.origin is not None
    return (Path(spec.origin).parent / "c-code" / name).read_text(encoding="utf-8")


def sources(made: Export, fmi: int) -> dict[str, str]:
    """Every C file of the FMU, by name."""
    files = {name: plumbing(name) for name in (*_SOURCES[fmi], "instance.h", made.motion)}
    files |= {name: _standard_header(name) for name in _HEADERS[fmi]}
    return files | {"model.h": made.header}


# ---- binaries ----


def _binaries(name: str, fmi: int, folder: Path) -> dict[str, bytes]:
    """Path in the archive -> library of this name, for every platform that can be compiled for."""
    found: dict[str, dict[str, bytes]] = {}
    every = compilers()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        libraries = pool.map(lambda compiler: compiler.library(_SOURCES[fmi], folder, name), every)
        for target, library in zip((c.target for c in every), libraries, strict=True):
            path = f"binaries/{target.folders[fmi]}/{name}{target.suffix}"
            found.setdefault(path, {})[target.machine] = library
    return {path: next(iter(thin.values())) if len(thin) == 1 else universal(thin) for path, thin in found.items()}


def platforms() -> tuple[str, ...]:
    """What a native FMU made here runs on. Raises BadInput where nothing compiles one."""
    return tuple(compiler.target.name for compiler in compilers())


# ---- archive ----


def _page(made: Export) -> str:
    """documentation/index.html: what it contains and what its variables are."""
    rows = "\n".join(
        f"<tr><td>{html.escape(v.name)}</td><td>{html.escape(v.unit)}</td><td>{html.escape(v.description)}</td></tr>"
        for v in made.variables
        if v.causality != "local"
    )
    effects = "\n".join(f"<li>{html.escape(e.title)} ({html.escape(e.reference)})</li>" for e in made.effects.effects)
    title, says = html.escape(made.identity.title.capitalize()), html.escape(made.identity.says)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title></head><body>\n'
        f"<h1>{title}</h1>\n<p>{says}</p>\n<ul>\n{effects}\n</ul>\n"
        f"<table>\n<tr><th>variable</th><th>unit</th><th>meaning</th></tr>\n{rows}\n</table>\n</body></html>\n"
    )


def export_native(model: Model, out: Path, fmi: int = 2, force: bool = False) -> Path:
    """Write the model as a native FMU of FMI 2 or 3 and return its path. Raises BadInput."""
    return write(of_axis(model), out, fmi, force)


def write(made: Export, out: Path, fmi: int, force: bool) -> Path:
    """Compile and pack for every platform that can be compiled for; the path. Raises BadInput."""
    if fmi not in (2, 3):
        raise BadInput(f"FMI version {fmi} is not offered: use 2 or 3")
    check_free(out, force)
    who = made.identity
    c_files = sources(made, fmi)
    with tempfile.TemporaryDirectory(prefix="twin-") as built:
        folder = Path(built)
        for name, content in c_files.items():
            (folder / name).write_text(content, encoding="utf-8")
        binaries = _binaries(who.identifier, fmi, folder)
    if fmi == 2:
        files = {"modelDescription.xml": model_description.fmi2(who, made.variables, _SOURCES[fmi], made.solver)}
    else:
        files = {"modelDescription.xml": model_description.fmi3(who, made.variables, made.solver)}
        files["sources/buildDescription.xml"] = model_description.fmi3_build(who, _SOURCES[fmi])
    files |= {f"sources/{name}": content.encode() for name, content in c_files.items()}
    files |= {f"resources/{name}": content.encode() for name, content in made.resources.items()}
    files["documentation/index.html"] = _page(made).encode()
    files["documentation/licenses/LICENSE.txt"] = plumbing("LICENSE.txt").encode()
    put(out, zipped(files | binaries))
    return out
