"""modelDescription.xml of an FMU, written from its one list of variables."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from twin.model.fitted_model import Model
from twin.model.variables import Variable, base_unit

_DEGREES_PER_RADIAN = 57.29577951308232


@dataclass(frozen=True)
class Identity:
    """What an FMU is called, and what ties its description to its binaries."""

    identifier: str  # name of the binaries, a C identifier
    token: str  # FMI 2's GUID, FMI 3's instantiation token
    title: str
    says: str  # what it is, in a line
    sample_time: float  # s, the communication step that suits it


def of_axis(model: Model, identifier: str, token: str) -> Identity:
    """An axis under these names."""
    said = "; ".join(e.title for e in model.structure.effects)
    return Identity(identifier, token, "axis", f"motor-driven axis with {said}", model.sample_time)


@dataclass(frozen=True)
class Derivative:
    """The rate of a state, shown after the model's own variables."""

    state: Variable
    reference: int

    @property
    def name(self) -> str:
        return f"der({self.state.name})"

    @property
    def says(self) -> str:
        return f"rate of {self.state.name}"

    @property
    def unit(self) -> str:
        return "1/s" if self.state.unit == "1" else f"{self.state.unit}/s"


@dataclass(frozen=True)
class Margin:
    """An event indicator: how far the axis is from a change of mode."""

    name: str
    reference: int

    @property
    def says(self) -> str:
        return f"{self.name.replace('_', ' ')}: zero where the mode of motion changes"


@dataclass(frozen=True)
class Solver:
    """What an outside solver is given: model exchange only with derivatives, and whether slopes can be asked for."""

    derivatives: tuple[Derivative, ...]
    margins: tuple[Margin, ...]
    directional_derivatives: bool = False


NO_SOLVER = Solver((), ())


def _number(value: float) -> str:
    return repr(float(value))


def text(root: ET.Element) -> bytes:
    """An element as a file: the same element gives the same bytes."""
    ET.indent(root)
    body: bytes = ET.tostring(root, encoding="utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + body + b"\n"


def in_base_units(name: str) -> dict[str, str]:
    """A unit's exponents of the base units and its factor, as attributes that FMI 2, FMI 3 and SSP name alike."""
    factor, exponents = base_unit(name)
    attributes = {base: str(exponent) for base, exponent in exponents.items()}
    return attributes | ({} if factor == 1.0 else {"factor": _number(factor)})


def _add_units(parent: ET.Element, names: set[str]) -> None:
    """UnitDefinitions for every unit in use."""
    units = ET.SubElement(parent, "UnitDefinitions")
    for name in sorted(names):
        unit = ET.SubElement(units, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", in_base_units(name))
        if name == "rad":
            ET.SubElement(unit, "DisplayUnit", name="deg", factor=_number(_DEGREES_PER_RADIAN))


def _named(v: Variable) -> dict[str, str]:
    """What a variable is: attributes that FMI 2 and FMI 3 name alike."""
    given = {"name": v.name, "valueReference": str(v.reference), "description": v.description}
    given |= {"causality": v.causality, "variability": v.variability}
    return given | ({"initial": v.initial} if v.initial else {})


def _quantity(v: Variable, solver: Solver) -> dict[str, str]:
    """Unit, bounds, start and whether it may jump under a solver: alike as well, in the schema's order."""
    given = {"unit": v.unit}
    for key, value in (("min", v.min), ("max", v.max), ("nominal", v.nominal), ("start", v.start)):
        if value is not None:
            given[key] = _number(value)
    jumps = v.name in ("velocity", "motor_velocity") and any(d.state.name == v.name for d in solver.derivatives)
    return given | ({"reinit": "true"} if jumps else {})


def _calculated(part: Derivative | Margin) -> dict[str, str]:
    kind = {"causality": "local", "variability": "continuous", "initial": "calculated"}
    return {"name": part.name, "valueReference": str(part.reference), "description": part.says} | kind


def built_at() -> str:
    """SOURCE_DATE_EPOCH in ISO 8601, UTC; empty where it is not set, so that the same input gives the same bytes."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    return datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ") if epoch.isdigit() else ""


def _root(identity: Identity, version: str, token_name: str) -> ET.Element:
    made = {"generationDateAndTime": at} if (at := built_at()) else {}
    return ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": identity.title,
            token_name: identity.token,
            "description": identity.says,
            "generationTool": "twin",
            "license": "MIT",
            **made,
            "variableNamingConvention": "structured",
        },
    )


def with_origin(described: bytes, origin: Mapping[str, str]) -> bytes:
    """The description with other attributes of its root: `author`, `version`, `license`, `copyright`."""
    root = ET.fromstring(described)
    for name, value in origin.items():
        root.set(name, value)
    return text(root)


def with_held_input(described: bytes) -> bytes:
    """The description with a discrete input: under an outside solver the importer holds it between events."""
    root = ET.fromstring(described)
    for variable in root.findall("ModelVariables/*"):
        if variable.get("causality") == "input":
            variable.set("variability", "discrete")
    return text(root)


def _add_common(root: ET.Element, identity: Identity, shown: Sequence[Variable], solver: Solver) -> None:
    """What stands between the kinds of simulation and the variables, alike in FMI 2 and FMI 3."""
    _add_units(root, {v.unit for v in shown} | {d.unit for d in solver.derivatives})
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="why a call was refused")
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=_number(identity.sample_time))


def fmi2(identity: Identity, shown: Sequence[Variable], sources: tuple[str, ...], solver: Solver) -> bytes:
    """modelDescription.xml of FMI 2.0: co-simulation, and model exchange where there are derivatives."""
    root = _root(identity, "2.0", "guid")
    if solver.derivatives:
        root.set("numberOfEventIndicators", str(len(solver.margins)))
    can = {
        "modelIdentifier": identity.identifier,
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
    }
    if solver.directional_derivatives:
        can["providesDirectionalDerivative"] = "true"
    kinds = [ET.SubElement(root, "ModelExchange", can)] if solver.derivatives else []
    kinds.append(ET.SubElement(root, "CoSimulation", can | {"canHandleVariableCommunicationStepSize": "true"}))
    for kind in kinds:
        files = ET.SubElement(kind, "SourceFiles")
        for name in sources:
            ET.SubElement(files, "File", name=name)
    _add_common(root, identity, shown, solver)
    listed = ET.SubElement(root, "ModelVariables")
    for v in shown:
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", _named(v)), "Real", _quantity(v, solver))
    for d in solver.derivatives:
        real = {"unit": d.unit, "derivative": str(d.state.reference + 1)}
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", _calculated(d)), "Real", real)
    for m in solver.margins:
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", _calculated(m)), "Real", unit="1")
    index = {v.name: str(v.reference + 1) for v in shown}
    structure = ET.SubElement(root, "ModelStructure")
    outputs = ET.SubElement(structure, "Outputs")
    rates = ET.SubElement(structure, "Derivatives") if solver.derivatives else structure
    initial = ET.SubElement(structure, "InitialUnknowns")
    states = {d.state.name for d in solver.derivatives}
    for v in shown:
        if v.causality == "output":
            # Nothing feeds through: a step's result depends on states only.
            on = "position" if v.name == "position_measured" else v.name
            ET.SubElement(outputs, "Unknown", index=index[v.name], dependencies=index[on] if states else "")
        if v.causality == "output" or v.name in states:
            needs = " ".join(sorted((index[n] for n in v.initially_from), key=int))
            ET.SubElement(initial, "Unknown", index=index[v.name], dependencies=needs)
    for d in solver.derivatives:
        # Without the attribute a rate may depend on everything.
        ET.SubElement(rates, "Unknown", index=str(d.reference + 1))
        ET.SubElement(initial, "Unknown", index=str(d.reference + 1))
    return text(root)


def fmi3(identity: Identity, shown: Sequence[Variable], solver: Solver) -> bytes:
    """modelDescription.xml of FMI 3.0: co-simulation, and model exchange where there are derivatives."""
    root = _root(identity, "3.0", "instantiationToken")
    can = {"modelIdentifier": identity.identifier, "canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
    if solver.directional_derivatives:
        can["providesDirectionalDerivatives"] = "true"
    if solver.derivatives:
        ET.SubElement(root, "ModelExchange", can)
    ET.SubElement(root, "CoSimulation", can | {"canHandleVariableCommunicationStepSize": "true"})
    _add_common(root, identity, shown, solver)
    listed = ET.SubElement(root, "ModelVariables")
    for v in shown:
        ET.SubElement(listed, "Float64", _named(v) | _quantity(v, solver))
    for d in solver.derivatives:
        ET.SubElement(listed, "Float64", _calculated(d) | {"unit": d.unit, "derivative": str(d.state.reference)})
    for m in solver.margins:
        ET.SubElement(listed, "Float64", _calculated(m) | {"unit": "1"})
    after = str(len(shown) + len(solver.derivatives) + len(solver.margins))
    clock = {"name": "time", "valueReference": after, "description": "the importer's time"}
    clock |= {"causality": "independent", "variability": "continuous", "unit": "s"}
    ET.SubElement(listed, "Float64", clock)
    reference = {v.name: str(v.reference) for v in shown}
    structure = ET.SubElement(root, "ModelStructure")
    states = {d.state.name for d in solver.derivatives}
    for v in shown:
        if v.causality == "output":
            on = "position" if v.name == "position_measured" else v.name
            needs = reference[on] if states else ""
            ET.SubElement(structure, "Output", valueReference=reference[v.name], dependencies=needs)
    for d in solver.derivatives:
        ET.SubElement(structure, "ContinuousStateDerivative", valueReference=str(d.reference))
    for v in shown:
        if v.causality == "output" or v.name in states:
            needs = " ".join(sorted((reference[n] for n in v.initially_from), key=int))
            ET.SubElement(structure, "InitialUnknown", valueReference=reference[v.name], dependencies=needs)
    for d in solver.derivatives:
        ET.SubElement(structure, "InitialUnknown", valueReference=str(d.reference))
    for m in solver.margins:
        ET.SubElement(structure, "EventIndicator", valueReference=str(m.reference))
    return text(root)


def through_python(described: bytes) -> bytes:
    """FMI 2's description of an FMU that pythonfmu runs: it needs Python in the host, and has no C."""
    root = ET.fromstring(described)
    root.set("generationTool", "twin, pythonfmu")
    for simulation in root.iter("CoSimulation"):
        simulation.set("needsExecutionTool", "true")
        for files in simulation.findall("SourceFiles"):
            simulation.remove(files)
    return text(root)


def fmi3_build(identity: Identity, sources: tuple[str, ...]) -> bytes:
    """sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identity.identifier)
    files = ET.SubElement(build, "SourceFileSet", language="C99", compilerOptions="-ffp-contract=off")
    for name in sources:
        ET.SubElement(files, "SourceFile", name=name)
    ET.SubElement(build, "Library", name="m")
    return text(root)
