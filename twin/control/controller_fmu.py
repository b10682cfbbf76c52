"""A controller as an FMU: the very text that the co-simulation runs, behind the axis' own plumbing."""

from __future__ import annotations

import hashlib
import json
import uuid
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fmu_src import pack
from twin.codegen import control_law
from twin.control.controller import Controller, dumps
from twin.fmi import model_description, native_fmu
from twin.io.files import check_free, put
from twin.model.stepper import KNOWN, STATES
from twin.model.variables import Variable, numbered

#: Settings that shape the text's loops, so that no importer may change them.
FIXED = ("sample_time", "pieces", "whole", "part")
_INPUTS = {
    "reference": ("{x}", "where the link should be"),
    "reference_velocity": ("{x}/s", "its velocity"),
    "reference_acceleration": ("{x}/s^2", "its acceleration"),
    "position_measured": ("{x}", "what the position sensor reads"),
}
_CLOCK = 3  # time since the start, ticks, the command that goes out at the next: they head what is remembered
_SOURCE = Path(pack.__file__).with_name("controller_fmu.py")


def _sizes(controller: Controller) -> list[int]:
    """Observer states, memory, commands on their way."""
    return [len(STATES), len(control_law.MEMORY), int(controller.settings["whole"]) + 2]


def variables(controller: Controller) -> tuple[Variable, ...]:
    """Every variable of the controller's FMU: inputs, output, parameters, hidden memory, in this order."""
    tunable, held = ("parameter", "tunable", "exact"), ("local", "discrete", "calculated")
    found = [
        Variable(name, "input", "continuous", None, unit, says, nominal=1.0, start=0.0)
        for name, (unit, says) in _INPUTS.items()
    ]
    found.append(Variable(controller.input_name, "output", "discrete", "calculated", "{u}", "command to the axis"))
    for p in controller.structure.parameters:
        low, high = (b if abs(b) < 1e300 else None for b in (p.lower, p.upper))
        found.append(Variable(p.name, *tunable, p.unit, p.meaning, low, high, start=float(controller.values[p.name])))
    for name, (unit, says) in KNOWN.items():
        found.append(Variable(name, *tunable, unit, says, start=float(controller.known.get(name, 0.0))))
    for name, (unit, says) in control_law.SETTINGS.items():
        if name not in FIXED:
            found.append(Variable(name, *tunable, unit, says, start=float(controller.settings[name])))
    for i in range(_CLOCK + sum(_sizes(controller))):
        found.append(Variable(f"memory[{i + 1}]", *held, "1", "what the controller remembers"))
    return numbered(found, controller.axis_unit, controller.input_unit)


def interface(controller: Controller) -> dict[str, Any]:
    """What the slave must know of the controller, its numbers apart."""
    names = [p.name for p in controller.structure.parameters]
    shown = variables(controller)
    return {
        "variables": [{k: getattr(v, k) for k in ("name", "reference", "causality", "min", "max")} for v in shown],
        "parameters": names,
        "offset": names.index("offset"),
        "known": list(KNOWN),
        "settings": {name: float(controller.settings[name]) for name in control_law.SETTINGS},
        "memory": "memory[1]",
        "sizes": _sizes(controller),
        "sample_time": controller.sample_time,
    }


def _identity(controller: Controller, digest: str, token: str) -> model_description.Identity:
    says = f"feedback-linearising controller at {controller.bandwidth:.4g} Hz"
    return model_description.Identity(f"controller_{digest}", token, "controller", says, controller.sample_time)


def _resources(controller: Controller) -> dict[str, str]:
    starts = [f"{v.name} {v.start!r}" for v in variables(controller) if v.causality == "parameter"]
    return {
        "parameters.txt": "\n".join(["# start values", *starts]) + "\n",
        "controller.toml": dumps(controller),
    }


def export_controller(controller: Controller, out: Path, force: bool = False) -> Path:
    """Write the controller's FMU (FMI 2.0 co-simulation, through pythonfmu). Raises BadInput."""
    check_free(out, force)
    text = pack.SLAVE.read_text(encoding="utf-8") + _SOURCE.read_text(encoding="utf-8")
    text += control_law.write(controller.structure)
    face, shown = interface(controller), variables(controller)
    digest = hashlib.sha256((json.dumps([face, [asdict(v) for v in shown]]) + text).encode()).hexdigest()
    who = _identity(controller, digest[:12], f"{{{uuid.UUID(digest[:32])}}}")
    described = model_description.through_python(model_description.fmi2(who, shown, (), model_description.NO_SOLVER))
    resources = _resources(controller) | {"interface.json": json.dumps(face, indent=1) + "\n"}
    put(out, pack.pack(text, who.identifier, resources, described))
    return out


# ---- native ----


def _header(controller: Controller, token: str) -> str:
    """model.h: sizes, the table of variables, the start values, and the controller's text in C."""
    shown, parameters = variables(controller), controller.structure.parameters
    observer, memory, queue = _sizes(controller)
    # What the text takes as an array stands together, so the settings that nobody may change have a place, too.
    names = [*_INPUTS, controller.input_name, *(p.name for p in parameters), *KNOWN, *control_law.SETTINGS]
    names += [v.name for v in shown if v.causality == "local"]
    slots = {name: i for i, name in enumerate(names)}
    constants: dict[str, object] = {
        "MOTION": '"controller.h"',
        "TOKEN": f'"{token}"',
        "VARIABLES": len(shown),
        "SLOTS": len(slots),
        "FIRST_INPUT": 0,
        "OUTPUT": slots[controller.input_name],
        "FIRST_PARAMETER": slots[parameters[0].name],
        "PARAMETERS": len(parameters),
        "OFFSET": [p.name for p in parameters].index("offset"),
        "FIRST_KNOWN": slots[next(iter(KNOWN))],
        "FIRST_SETTING": slots["sample_time"],
        "SAMPLE_TIME": repr(controller.sample_time),
        "FIRST_STATE": slots["memory[1]"],
        "STATES": _CLOCK + observer + memory + queue,
        "OBSERVER_STATES": observer,
        "MEMORY": memory,
        **{name.upper(): control_law.MEMORY.index(name) for name in ("started", "nominal", "disturbance")},
        "EXCHANGE": 0,
        "DERIVATIVES": 0,
        "CONTINUOUS_STATES": 0,
        "INDICATORS": 0,
        "CLOCK_REFERENCE": len(shown),
    }
    starts = dict.fromkeys(names, 0.0) | dict(controller.settings) | {v.name: v.start for v in shown}
    fixed = ", ".join(str(slots[name]) for name in FIXED)
    text = [
        *(f"static const size_t {name}[] = {{0}};" for name in ("continuous", "derivative", "indicator")),
        "static const double nominal[] = {1.0};",
        f"static const size_t fixed[] = {{{fixed}}};",
        "",
        control_law.write_c(controller.structure, queue),
    ]
    return native_fmu.header_text(constants, [native_fmu.row(v, slots[v.name]) for v in shown], starts, text)


def compilable(controller: Controller) -> native_fmu.Export:
    """The controller, ready to be compiled."""
    shown, queue = variables(controller), _sizes(controller)[-1]
    settled = repr([controller.settings[name] for name in FIXED])
    digest = native_fmu.digest_of(control_law.write_c(controller.structure, queue) + settled, shown, "controller.h")
    who = _identity(controller, digest[:8], native_fmu.token_of(digest))
    header, resources = _header(controller, who.token), _resources(controller)
    return native_fmu.Export(
        who, shown, model_description.NO_SOLVER, header, "controller.h", resources, controller.structure
    )  # fmt: skip


def export_native(controller: Controller, out: Path, fmi: int = 2, force: bool = False) -> Path:
    """Write the controller as a native FMU of FMI 2 or 3 and return its path. Raises BadInput."""
    return native_fmu.write(compilable(controller), out, fmi, force)
