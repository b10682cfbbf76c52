"""SSP 1.0: a model's parameters as a set (.ssv), and plant, controller and parameters as one system (.ssp)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from twin.errors import BadInput
from twin.fmi.fmu_archive import Fmu, open_fmu
from twin.fmi.model_description import in_base_units, text
from twin.io.files import check_free, put, zipped
from twin.model.fitted_model import Model
from twin.model.variables import variables

_ROOT = "http://ssp-standard.org/SSP1/SystemStructure"
_PREFIXES = {"ssc": "Common", "ssd": "Description", "ssv": "ParameterValues"}
_PLANT, _CONTROLLER = "axis", "controller"


def _add(parent: ET.Element | None, name: str, attributes: dict[str, str] | None = None) -> ET.Element:
    """An element named as in the standard's text, such as "ssd:System"."""
    prefix, local = name.split(":")
    tag = f"{{{_ROOT}{_PREFIXES[prefix]}}}{local}"
    return ET.Element(tag, attributes or {}) if parent is None else ET.SubElement(parent, tag, attributes or {})


def _file(root: ET.Element) -> bytes:
    for prefix, name in _PREFIXES.items():
        ET.register_namespace(prefix, _ROOT + name)
    return text(root)


def _units(parent: ET.Element, prefix: str, names: set[str]) -> None:
    units = _add(parent, f"{prefix}:Units")
    for name in sorted(names):
        _add(_add(units, "ssc:Unit", {"name": name}), "ssc:BaseUnit", in_base_units(name))


def parameter_set(model: Model) -> bytes:
    """The model's parameters with their units, as the text of a .ssv file."""
    shown = [v for v in variables(model) if v.causality == "parameter"]
    root = _add(None, "ssv:ParameterSet", {"version": "1.0", "name": "identified"})
    listed = _add(root, "ssv:Parameters")
    for v in shown:
        parameter = _add(listed, "ssv:Parameter", {"name": v.name, "description": v.description})
        _add(parameter, "ssv:Real", {"value": repr(v.start), "unit": v.unit})
    _units(root, "ssv", {v.unit for v in shown})
    return _file(root)


def write_ssv(model: Model, out: Path, force: bool = False) -> Path:
    """Write the model's parameters as an SSP parameter set. Raises BadInput."""
    check_free(out, force)
    put(out, parameter_set(model))
    return out


def _ports(fmu: Fmu) -> dict[str, tuple[str, str]]:
    """Name -> (causality, unit) of inputs, outputs and parameters."""
    found = {}
    for node in fmu.description.findall("ModelVariables/*"):
        causality = node.get("causality", "local")
        if causality in ("input", "output", "parameter"):
            real = node if node.tag == "Float64" else node.find("Real")
            if real is not None:
                found[node.get("name", "")] = (causality, real.get("unit", ""))
    return found


def _component(elements: ET.Element, name: str, ports: dict[str, tuple[str, str]], with_set: bool) -> None:
    kind = {"name": name, "type": "application/x-fmu-sharedlibrary", "source": f"resources/{name}.fmu"}
    component = _add(elements, "ssd:Component", kind)
    connectors = _add(component, "ssd:Connectors")
    for port, (causality, unit) in ports.items():
        connector = _add(connectors, "ssd:Connector", {"name": port, "kind": causality})
        _add(connector, "ssc:Real", {"unit": unit} if unit else {})
    if with_set:
        bindings = _add(component, "ssd:ParameterBindings")
        _add(bindings, "ssd:ParameterBinding", {"source": "resources/identified.ssv"})


def _connect(parent: ET.Element, start: str, end: str, port: str) -> None:
    ends = {"startElement": start, "startConnector": port, "endElement": end, "endConnector": port}
    _add(parent, "ssd:Connection", ends)


def system(plant: Fmu, controller: Fmu | None, model: Model) -> bytes:
    """SystemStructure.ssd: ports of the same name are connected; what is left over is set by name.

    The system has no connectors of its own: libcosim and ecos cannot read connections to those.
    """
    parts = {_PLANT: _ports(plant)} | ({_CONTROLLER: _ports(controller)} if controller else {})
    outputs = {p: n for n in parts for p, (kind, _) in parts[n].items() if kind == "output"}
    if parts[_PLANT].get(model.input_name, ("",))[0] != "input":
        raise BadInput(f"{plant.path} has no input {model.input_name}: give the FMU of this model")
    if controller and model.input_name not in outputs:
        raise BadInput(f"{controller.path} has no output {model.input_name}, which drives the axis: give another")
    root = _add(None, "ssd:SystemStructureDescription", {"version": "1.0", "name": "axis"})
    top = _add(root, "ssd:System", {"name": "system"})
    elements, connections = _add(top, "ssd:Elements"), _add(top, "ssd:Connections") if controller else None
    for name, ports in parts.items():
        _component(elements, name, ports, with_set=name == _PLANT)
        for port, (kind, _) in ports.items():
            if connections is not None and kind == "input" and port in outputs:
                _connect(connections, outputs[port], name, port)
    _units(root, "ssd", {unit for ports in parts.values() for _, unit in ports.values() if unit})
    _add(root, "ssd:DefaultExperiment", {"startTime": "0.0", "stopTime": "10.0"})
    return _file(root)


def write_ssp(out: Path, plant_fmu: Path, controller_fmu: Path | None, model: Model, force: bool = False) -> Path:
    """Pack plant, controller and the model's parameters as one system. Raises BadInput."""
    check_free(out, force)
    plant = open_fmu(plant_fmu)
    controller = open_fmu(controller_fmu) if controller_fmu else None
    files = {
        "SystemStructure.ssd": system(plant, controller, model),
        "resources/identified.ssv": parameter_set(model),
        f"resources/{_PLANT}.fmu": plant_fmu.read_bytes(),
    }
    if controller_fmu:
        files[f"resources/{_CONTROLLER}.fmu"] = controller_fmu.read_bytes()
    put(out, zipped(files))
    return out
