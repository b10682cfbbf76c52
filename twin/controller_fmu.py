"""A controller as an FMU: the very text that the co-simulation runs, behind the axis' own plumbing."""

from __future__ import annotations

import hashlib
import json
import uuid
import xml.etree.ElementTree as ET
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fmu_src import pack
from twin import description, sampled
from twin.axis import KNOWN, STATES
from twin.controller import Controller, dumps
from twin.native import check_output
from twin.variables import Variable

#: Settings that shape the text's loops, so that no importer may change them.
FIXED = ("sample_time", "pieces", "whole", "part")
_INPUTS = {
    "reference": ("{x}", "where the link should be"),
    "reference_velocity": ("{x}/s", "its velocity"),
    "reference_acceleration": ("{x}/s^2", "its acceleration"),
    "position_measured": ("{x}", "what the position sensor reads"),
}
_SOURCE = Path(pack.__file__).with_name("controller_fmu.py")


def _sizes(controller: Controller) -> list[int]:
    """Observer states, memory, commands on their way."""
    return [len(STATES), len(sampled.MEMORY), int(controller.settings["whole"]) + 2]


def variables(controller: Controller) -> tuple[Variable, ...]:
    """Every variable of the controller's FMU: inputs, output, parameters, hidden memory, in this order."""
    found: list[Variable] = []

    def add(name: str, kind: tuple[str, str, str | None], unit: str, says: str, **numbers: Any) -> None:
        shown = unit.format(x=controller.axis_unit, u=controller.input_unit)
        found.append(Variable(name, len(found), *kind, shown, says, **numbers))

    for name, (unit, says) in _INPUTS.items():
        add(name, ("input", "continuous", None), unit, says, nominal=1.0, start=0.0)
    add(controller.input_name, ("output", "discrete", "calculated"), "{u}", "command to the axis")
    tunable, held = ("parameter", "tunable", "exact"), ("local", "discrete", "calculated")
    for p in controller.structure.parameters:
        low, high = (b if abs(b) < 1e300 else None for b in (p.lower, p.upper))
        add(p.name, tunable, p.unit, p.meaning, min=low, max=high, start=float(controller.values[p.name]))
    for name, (unit, says) in KNOWN.items():
        add(name, tunable, unit, says, start=float(controller.known.get(name, 0.0)))
    for name, (unit, says) in sampled.SETTINGS.items():
        if name not in FIXED:
            add(name, tunable, unit, says, start=float(controller.settings[name]))
    for i in range(3 + sum(_sizes(controller))):
        add(f"memory[{i + 1}]", held, "1", "what the controller remembers")
    return tuple(found)


def interface(controller: Controller) -> dict[str, Any]:
    """What the slave must know of the controller, its numbers apart."""
    names = [p.name for p in controller.structure.parameters]
    shown = variables(controller)
    return {
        "variables": [{k: getattr(v, k) for k in ("name", "reference", "causality", "min", "max")} for v in shown],
        "parameters": names,
        "offset": names.index("offset"),
        "known": list(KNOWN),
        "settings": {name: float(controller.settings[name]) for name in sampled.SETTINGS},
        "memory": "memory[1]",
        "sizes": _sizes(controller),
        "sample_time": controller.sample_time,
    }


def described(controller: Controller, identifier: str, token: str) -> bytes:
    """modelDescription.xml. The output depends on nothing in the same step: no algebraic loop with the plant."""
    shown = variables(controller)
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": "2.0",
            "modelName": "controller",
            "guid": token,
            "description": f"feedback-linearising controller at {controller.bandwidth:.4g} Hz",
            "generationTool": "twin, pythonfmu",
            "license": "MIT",
            "variableNamingConvention": "structured",
        },
    )
    can = (
        "needsExecutionTool",
        "canHandleVariableCommunicationStepSize",
        "canNotUseMemoryManagementFunctions",
        "canGetAndSetFMUstate",
        "canSerializeFMUstate",
    )
    ET.SubElement(root, "CoSimulation", {"modelIdentifier": identifier} | dict.fromkeys(can, "true"))
    description.add_units(root, {v.unit for v in shown})
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="why a call was refused")
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=repr(controller.sample_time))
    listed = ET.SubElement(root, "ModelVariables")
    for v in shown:
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.description}
        attributes |= {"causality": v.causality, "variability": v.variability}
        if v.initial:
            attributes["initial"] = v.initial
        numbers = {k: getattr(v, k) for k in ("min", "max", "nominal", "start")}
        real = {"unit": v.unit} | {k: repr(float(n)) for k, n in numbers.items() if n is not None}
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", attributes), "Real", real)
    structure = ET.SubElement(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        group = ET.SubElement(structure, part)
        for v in shown:
            if v.causality == "output":
                ET.SubElement(group, "Unknown", index=str(v.reference + 1), dependencies="")
    return description.text(root)


def export_controller(controller: Controller, out: Path, force: bool = False) -> Path:
    """Write the controller's FMU (FMI 2.0 co-simulation, through pythonfmu). Raises BadInput."""
    check_output(out, force)
    text = pack.SLAVE.read_text(encoding="utf-8") + _SOURCE.read_text(encoding="utf-8")
    text += sampled.write(controller.structure)
    face = interface(controller)
    listed = [asdict(v) for v in variables(controller)]
    digest = hashlib.sha256((json.dumps([face, listed]) + text).encode()).hexdigest()
    identifier, token = f"controller_{digest[:12]}", f"{{{uuid.UUID(digest[:32])}}}"
    starts = [f"{v.name} {v.start!r}" for v in variables(controller) if v.causality == "parameter"]
    resources = {
        "interface.json": json.dumps(face, indent=1) + "\n",
        "parameters.txt": "\n".join(["# start values", *starts]) + "\n",
        "controller.toml": dumps(controller),
    }
    content = pack.pack(text, identifier, resources, described(controller, identifier, token))
    half = out.with_name(f".{out.name}.part")
    half.write_bytes(content)
    half.replace(out)
    return out
