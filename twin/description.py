"""modelDescription.xml of the native FMU, written from the one list of variables."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

from twin.model import Model
from twin.variables import Variable, base_unit, variables

_DEGREES_PER_RADIAN = 57.29577951308232


@dataclass(frozen=True)
class Identity:
    """What ties a description to its binaries."""

    identifier: str  # name of the binaries, a C identifier
    token: str  # FMI 2's GUID, FMI 3's instantiation token
    title: str


def _number(value: float) -> str:
    return repr(float(value))


def text(root: ET.Element) -> bytes:
    """An element as a file: the same element gives the same bytes."""
    ET.indent(root)
    body: bytes = ET.tostring(root, encoding="utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + body + b"\n"


def add_units(parent: ET.Element, shown: tuple[Variable, ...]) -> None:
    """UnitDefinitions for every unit in use; the attributes are the same in FMI 2 and FMI 3."""
    units = ET.SubElement(parent, "UnitDefinitions")
    for name in sorted({v.unit for v in shown}):
        unit = ET.SubElement(units, "Unit", name=name)
        factor, exponents = base_unit(name)
        attributes = {base: str(exponent) for base, exponent in exponents.items()}
        if factor != 1.0:
            attributes["factor"] = _number(factor)
        ET.SubElement(unit, "BaseUnit", attributes)
        if name == "rad":
            ET.SubElement(unit, "DisplayUnit", name="deg", factor=_number(_DEGREES_PER_RADIAN))


def _quantity(v: Variable) -> dict[str, str]:
    """Unit, bounds and start: attributes that FMI 2 and FMI 3 name alike, in the schema's order."""
    given = {"unit": v.unit}
    for key, value in (("min", v.min), ("max", v.max), ("nominal", v.nominal), ("start", v.start)):
        if value is not None:
            given[key] = _number(value)
    return given


def _root(model: Model, identity: Identity, version: str, token_name: str) -> ET.Element:
    said = "; ".join(e.title for e in model.structure.effects)
    return ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": identity.title,
            token_name: identity.token,
            "description": f"motor-driven axis with {said}",
            "generationTool": "twin",
            "license": "MIT",
            "variableNamingConvention": "structured",
        },
    )


def _experiment(root: ET.Element, model: Model) -> None:
    ET.SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=_number(model.sample_time))


def fmi2(model: Model, identity: Identity, sources: tuple[str, ...]) -> bytes:
    """modelDescription.xml of FMI 2.0 co-simulation."""
    shown = variables(model)
    root = _root(model, identity, "2.0", "guid")
    simulation = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identity.identifier,
        canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    files = ET.SubElement(simulation, "SourceFiles")
    for name in sources:
        ET.SubElement(files, "File", name=name)
    add_units(root, shown)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="why a call was refused")
    _experiment(root, model)
    listed = ET.SubElement(root, "ModelVariables")
    for v in shown:
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.description}
        attributes |= {"causality": v.causality, "variability": v.variability}
        if v.initial:
            attributes["initial"] = v.initial
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", attributes), "Real", _quantity(v))
    index = {v.name: str(v.reference + 1) for v in shown}
    structure = ET.SubElement(root, "ModelStructure")
    outputs = ET.SubElement(structure, "Outputs")
    initial = ET.SubElement(structure, "InitialUnknowns")
    for v in shown:
        if v.causality == "output":
            # Nothing feeds through: a step's result depends on states only.
            ET.SubElement(outputs, "Unknown", index=index[v.name], dependencies="")
            needs = " ".join(sorted((index[n] for n in v.initially_from), key=int))
            ET.SubElement(initial, "Unknown", index=index[v.name], dependencies=needs)
    return text(root)


def fmi3(model: Model, identity: Identity) -> bytes:
    """modelDescription.xml of FMI 3.0 co-simulation."""
    shown = variables(model)
    root = _root(model, identity, "3.0", "instantiationToken")
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identity.identifier,
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        canHandleVariableCommunicationStepSize="true",
    )
    add_units(root, shown)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="why a call was refused")
    _experiment(root, model)
    listed = ET.SubElement(root, "ModelVariables")
    for v in shown:
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.description}
        attributes |= {"causality": v.causality, "variability": v.variability}
        if v.initial:
            attributes["initial"] = v.initial
        ET.SubElement(listed, "Float64", attributes | _quantity(v))
    clock = {"name": "time", "valueReference": str(len(shown)), "description": "the importer's time"}
    clock |= {"causality": "independent", "variability": "continuous", "unit": "s"}
    ET.SubElement(listed, "Float64", clock)
    reference = {v.name: str(v.reference) for v in shown}
    structure = ET.SubElement(root, "ModelStructure")
    for v in shown:
        if v.causality == "output":
            ET.SubElement(structure, "Output", valueReference=reference[v.name], dependencies="")
    for v in shown:
        if v.causality == "output":
            needs = " ".join(sorted((reference[n] for n in v.initially_from), key=int))
            ET.SubElement(structure, "InitialUnknown", valueReference=reference[v.name], dependencies=needs)
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
