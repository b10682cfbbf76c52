"""A designed controller: what it runs with, what it promises, and the TOML file that holds both."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from twin.codegen import control_law
from twin.display import numbers
from twin.display.table import DisplayTable, Tabular
from twin.errors import BadInput
from twin.io.files import check_free, put
from twin.io.toml import finite, load, number, pairs, parse, quoted, real, section, size, texts
from twin.model.fitted_model import INPUT_NAMES, read_structure, read_units
from twin.model.stepper import KNOWN, Structure

FORMAT = "twin-controller/1"
_TABLES = ("axis", "structure", "parameters", "settings", "known", "margins", "limit_cycle", "remarks")
_AXIS = ("unit", "input_unit", "reachable_speed", "reachable_acceleration", "lower_end", "upper_end")
_NO_ENDS = {"lower": -math.inf, "upper": math.inf}


@dataclass(frozen=True)
class Margins:
    """Of the linearised, sampled loop, broken at the plant's input. NaN: the loop never crosses."""

    gain: float  # factor by which the loop gain may rise
    phase: float  # rad
    delay: float  # s
    sensitivity: float  # largest amplification of a disturbance


@dataclass(frozen=True)
class LimitCycle:
    amplitude: float  # of the link, axis unit
    frequency: float  # Hz


@dataclass(frozen=True, eq=False, repr=False)
class Controller(Tabular):
    """What runs (`structure`, `values`, `settings`, `known`) and what was found at the design."""

    plant: Structure  # of the model that it was designed for
    structure: Structure  # what its observer and its inverse contain
    values: Mapping[str, float]
    settings: Mapping[str, float]  # by the names of sampled.SETTINGS
    known: Mapping[str, float] = field(default_factory=dict)
    axis_unit: str = "rad"
    input_unit: str = "%"
    bandwidth: float = 1.0  # Hz, of the closed loop's poles
    reachable_speed: float = math.inf  # axis_unit/s
    reachable_acceleration: float = math.inf  # axis_unit/s^2
    ends: tuple[float, float] = (-math.inf, math.inf)  # positions of the stops, axis_unit
    command_noise: float = 0.0  # standard deviation of the command by noise alone, input's unit
    margins: Margins = Margins(math.nan, math.nan, math.nan, math.nan)
    limit_cycle: LimitCycle | None = None  # predicted; None: none
    remarks: tuple[str, ...] = ()  # what is not cancelled, and what else a user must know

    @property
    def input_name(self) -> str:
        return INPUT_NAMES[self.input_unit]

    @property
    def sample_time(self) -> float:
        return self.settings["sample_time"]

    @property
    def latency(self) -> float:
        """From a reading to its effect on the torque, s: one period and the input delay."""
        return self.sample_time * (1.0 + self.settings["whole"]) + self.settings["part"]

    @property
    def parameter_list(self) -> list[float]:
        """The law's parameters in the order of the text's `p`."""
        return [float(self.values[p.name]) for p in self.structure.parameters]

    @property
    def settings_list(self) -> list[float]:
        """The design in the order of the text's `g`."""
        return [float(self.settings[name]) for name in control_law.SETTINGS]

    @property
    def laws(self) -> SimpleNamespace:
        """The text that runs, as Python functions: `sample`, `step`, `drive`, `load`, `drag`, `grip`, ..."""
        return control_law.functions(self.structure)

    @property
    def known_list(self) -> list[float]:
        return [float(self.known.get(name, 0.0)) for name in KNOWN]

    @property
    def summary(self) -> str:
        """Bandwidth, plant and margins in one line."""
        return (
            f"controller at {self.bandwidth:.3g} Hz for {self.plant}: phase margin "
            f"{math.degrees(self.margins.phase):.0f} deg, delay margin {1e3 * self.margins.delay:.3g} ms"
        )

    def table(self) -> DisplayTable:
        """What the design promises, and its remarks."""
        m = self.margins
        rows = [
            ("bandwidth", f"{numbers.number(self.bandwidth)} Hz"),
            ("largest command", f"{numbers.number(self.settings['limit'])} {numbers.unit_text(self.input_unit)}"),
            ("gain margin", numbers.number(m.gain)),
            ("phase margin", f"{numbers.number(math.degrees(m.phase))} deg"),
            ("delay margin", f"{numbers.number(1e3 * m.delay)} ms"),
            ("largest sensitivity", numbers.number(m.sensitivity)),
        ]
        if self.limit_cycle is not None:
            amplitude, frequency = (numbers.number(v) for v in vars(self.limit_cycle).values())
            cycle = f"{amplitude} {self.axis_unit} at {frequency} Hz"
            rows.append(("predicted limit cycle", cycle))
        return DisplayTable(f"controller for {self.plant}", ("", ""), rows, self.remarks)

    @classmethod
    def read(cls, path: str | Path) -> Controller:
        """Read a CONTROLLER.toml. Raises BadInput."""
        return read(Path(path))

    def write(self, path: str | Path, force: bool = False) -> Path:
        """Write the controller as TOML; `force` overwrites what is there. Raises BadInput."""
        check_free(Path(path), force)
        put(Path(path), dumps(self))
        return Path(path)


def dumps(controller: Controller) -> str:
    """The controller as TOML text; the same controller gives the same text."""
    c = controller
    lines = [
        f"format = {quoted(FORMAT)}",
        f"bandwidth = {number(c.bandwidth)}  # Hz",
        "",
        "[axis]",
        f"unit = {quoted(c.axis_unit)}",
        f"input_unit = {quoted(c.input_unit)}",
        f"reachable_speed = {number(c.reachable_speed)}",
        f"reachable_acceleration = {number(c.reachable_acceleration)}",
        f"lower_end = {number(c.ends[0])}",
        f"upper_end = {number(c.ends[1])}",
        "",
        "[structure]",
        f"plant = {texts(c.plant.ids)}",
        f"controller = {texts(c.structure.ids)}",
        "",
        "[parameters]",
        *pairs({p.name: c.values[p.name] for p in c.structure.parameters}),
        "",
        "[settings]",
    ]
    for name, (unit, meaning) in control_law.SETTINGS.items():
        unit = unit.format(x=c.axis_unit, u=c.input_unit)
        lines.append(f"{name} = {number(c.settings[name])}  # {unit}: {meaning}")
    if c.known:
        lines += ["", "[known]", *pairs(c.known)]
    lines += ["", "[margins]", *pairs(vars(c.margins)), f"command_noise = {number(c.command_noise)}"]
    if c.limit_cycle is not None:
        lines += ["", "[limit_cycle]", *pairs(vars(c.limit_cycle))]
    lines += ["", "[remarks]", "says = [", *(f"    {quoted(r)}," for r in c.remarks), "]"]
    return "\n".join(lines) + "\n"


def _values(where: str, table: Mapping[str, Any], structure: Structure) -> dict[str, float]:
    values = {}
    for p in structure.parameters:
        if p.name not in table:
            raise BadInput(f"{where}: [parameters] has no {p.name}, which the structure needs: add it")
        value = finite(f"{where}: [parameters] {p.name}", table[p.name])
        if not p.lower <= value <= p.upper:
            raise BadInput(f"{where}: {p.name} = {value:g} is outside [{p.lower:g}, {p.upper:g}]: correct it")
        values[p.name] = value
    for name in table:
        if name not in values:
            raise BadInput(f"{where}: [parameters] {name} belongs to no effect of the structure: remove it")
    return values


def _settings(where: str, table: Mapping[str, Any]) -> dict[str, float]:
    settings = {}
    for name in control_law.SETTINGS:
        if name not in table:
            raise BadInput(f"{where}: [settings] has no {name}: add it, or design anew with twin control")
        settings[name] = size(f"{where}: [settings] {name}", table[name])
    for name in ("sample_time", "pieces", "limit", "velocity_gain", "rest_speed", "blur"):
        if settings[name] <= 0.0:
            raise BadInput(f"{where}: [settings] {name} is {settings[name]:g}: give a value above 0")
    for name, most in (("whole", 1000.0), ("part", settings["sample_time"]), ("pieces", 10000.0)):
        if not 0.0 <= settings[name] <= most:
            raise BadInput(f"{where}: [settings] {name} is {settings[name]:g}: give a value from 0 to {most:g}")
    for name in ("whole", "pieces"):
        if settings[name] != int(settings[name]):
            raise BadInput(f"{where}: [settings] {name} is {settings[name]:g}: give a whole number")
    return settings


def loads(text: str, where: str = "controller") -> Controller:
    """A controller from TOML text. `where` names it in messages. Raises BadInput."""
    advice = "give a CONTROLLER.toml that twin control wrote"
    document = parse(text, where, FORMAT, advice, ("bandwidth", *_TABLES))
    axis = section(where, document, "axis", _AXIS)
    structures = section(where, document, "structure", ("plant", "controller"))
    axis_unit, input_unit = read_units(where, axis)
    structure = read_structure(where, structures, "controller")
    if "constant_offset" not in structure:
        raise BadInput(f"{where}: [structure] controller lacks constant_offset, the integral action: add it")
    margins = section(where, document, "margins", (*(f.name for f in fields(Margins)), "command_noise"))
    cycle = section(where, document, "limit_cycle", [f.name for f in fields(LimitCycle)])
    remarks = section(where, document, "remarks", ("says",)).get("says", [])
    if not isinstance(remarks, list):
        raise BadInput(f"{where}: [remarks] says is {remarks!r}: give a list of sentences")

    def margin(name: str) -> float:
        return real(f"{where}: [margins] {name}", margins.get(name, math.nan))

    limit_cycle = None
    if cycle:
        amplitude, frequency = (finite(f"{where}: [limit_cycle] {n}", cycle.get(n)) for n in ("amplitude", "frequency"))
        limit_cycle = LimitCycle(amplitude, frequency)
    lower, upper = (real(f"{where}: [axis] {n}_end", axis.get(f"{n}_end", e)) for n, e in _NO_ENDS.items())
    if not lower < upper:
        raise BadInput(f"{where}: [axis] lower_end {lower:g} is not below upper_end {upper:g}: correct them")
    bandwidth = finite(f"{where}: bandwidth", document.get("bandwidth", 1.0))
    if bandwidth <= 0.0:
        raise BadInput(f"{where}: bandwidth is {bandwidth:g} Hz: give a value above 0")
    return Controller(
        plant=read_structure(where, structures, "plant"),
        structure=structure,
        values=_values(where, section(where, document, "parameters"), structure),
        settings=_settings(where, section(where, document, "settings", control_law.SETTINGS)),
        known={k: finite(f"{where}: [known] {k}", v) for k, v in section(where, document, "known").items()},
        axis_unit=axis_unit,
        input_unit=input_unit,
        bandwidth=bandwidth,
        reachable_speed=real(f"{where}: [axis] reachable_speed", axis.get("reachable_speed", math.inf)),
        reachable_acceleration=real(
            f"{where}: [axis] reachable_acceleration", axis.get("reachable_acceleration", math.inf)
        ),
        ends=(lower, upper),
        command_noise=real(f"{where}: [margins] command_noise", margins.get("command_noise", 0.0)),
        margins=Margins(margin("gain"), margin("phase"), margin("delay"), margin("sensitivity")),
        limit_cycle=limit_cycle,
        remarks=tuple(map(str, remarks)),
    )


def read(path: Path) -> Controller:
    """Read CONTROLLER.toml. Raises BadInput."""
    return loads(load(path, "controller", "CONTROLLER.toml", "twin control"), str(path))
