"""A designed controller: what it runs with, what it promises, and the TOML file that holds both."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twin import sampled
from twin.axis import KNOWN, Structure
from twin.effects.catalogue import EFFECTS
from twin.errors import BadInput
from twin.model import INPUT_NAMES

FORMAT = "twin-controller/1"


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


@dataclass(frozen=True, eq=False)
class Controller:
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
        return [float(self.settings[name]) for name in sampled.SETTINGS]

    @property
    def known_list(self) -> list[float]:
        return [float(self.known.get(name, 0.0)) for name in KNOWN]

    def __repr__(self) -> str:
        return (
            f"controller at {self.bandwidth:.3g} Hz for {self.plant}: phase margin "
            f"{math.degrees(self.margins.phase):.0f} deg, delay margin {1e3 * self.margins.delay:.3g} ms"
        )


def _number(value: float) -> str:
    return repr(float(value))


def _text(value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c >= " " else f"\\u{ord(c):04x}" for c in escaped) + '"'


def _pairs(table: Mapping[str, float]) -> list[str]:
    return [f"{_text(k) if not k.isidentifier() else k} = {_number(v)}" for k, v in table.items()]


def dumps(controller: Controller) -> str:
    """The controller as TOML text; the same controller gives the same text."""
    c = controller
    lines = [
        f"format = {_text(FORMAT)}",
        f"bandwidth = {_number(c.bandwidth)}  # Hz",
        "",
        "[axis]",
        f"unit = {_text(c.axis_unit)}",
        f"input_unit = {_text(c.input_unit)}",
        f"reachable_speed = {_number(c.reachable_speed)}",
        f"reachable_acceleration = {_number(c.reachable_acceleration)}",
        "",
        "[structure]",
        f"plant = [{', '.join(map(_text, c.plant.ids))}]",
        f"controller = [{', '.join(map(_text, c.structure.ids))}]",
        "",
        "[parameters]",
        *_pairs({p.name: c.values[p.name] for p in c.structure.parameters}),
        "",
        "[settings]",
    ]
    for name, (unit, meaning) in sampled.SETTINGS.items():
        unit = unit.format(x=c.axis_unit, u=c.input_unit)
        lines.append(f"{name} = {_number(c.settings[name])}  # {unit}: {meaning}")
    if c.known:
        lines += ["", "[known]", *_pairs(c.known)]
    lines += ["", "[margins]", *_pairs(vars(c.margins)), f"command_noise = {_number(c.command_noise)}"]
    if c.limit_cycle is not None:
        lines += ["", "[limit_cycle]", *_pairs(vars(c.limit_cycle))]
    lines += ["", "[remarks]", "says = [", *(f"    {_text(r)}," for r in c.remarks), "]"]
    return "\n".join(lines) + "\n"


def _real(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadInput(f"{where} is {value!r}, which is not a number: give one")
    return float(value)


def _finite(where: str, value: Any) -> float:
    number = _real(where, value)
    if not math.isfinite(number):
        raise BadInput(f"{where} is {value!r}, which is not a finite number: give one")
    return number


def _table(where: str, document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    table = document.get(key, {})
    if not isinstance(table, dict):
        raise BadInput(f"{where}: {key} is {table!r}, which is not a table: write it as [{key}]")
    return table


def _structure(where: str, table: Mapping[str, Any], key: str) -> Structure:
    ids = table.get(key)
    if not isinstance(ids, list) or not ids:
        raise BadInput(f'{where}: [structure] has no list `{key}`: add one, such as ["inertia"]')
    for i in ids:
        if not isinstance(i, str) or i not in EFFECTS:
            raise BadInput(f"{where}: unknown effect {i!r} in [structure]; known are {', '.join(EFFECTS)}")
    return Structure.of(ids)


def _values(where: str, table: Mapping[str, Any], structure: Structure) -> dict[str, float]:
    values = {}
    for p in structure.parameters:
        if p.name not in table:
            raise BadInput(f"{where}: [parameters] has no {p.name}, which the structure needs: add it")
        value = _finite(f"{where}: [parameters] {p.name}", table[p.name])
        if not p.lower <= value <= p.upper:
            raise BadInput(f"{where}: {p.name} = {value:g} is outside [{p.lower:g}, {p.upper:g}]: correct it")
        values[p.name] = value
    for name in table:
        if name not in values:
            raise BadInput(f"{where}: [parameters] {name} belongs to no effect of the structure: remove it")
    return values


def _settings(where: str, table: Mapping[str, Any]) -> dict[str, float]:
    for name in table:
        if name not in sampled.SETTINGS:
            known = ", ".join(sampled.SETTINGS)
            raise BadInput(f"{where}: [settings] {name} is unknown: remove it; known are {known}")
    settings = {}
    for name in sampled.SETTINGS:
        if name not in table:
            raise BadInput(f"{where}: [settings] has no {name}: add it, or design anew with twin control")
        settings[name] = _finite(f"{where}: [settings] {name}", table[name])
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
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{where}: {error}; it is not valid TOML: mend that line") from None
    if document.get("format") != FORMAT:
        raise BadInput(
            f"{where}: format is {document.get('format')!r}, not {FORMAT!r}: "
            "give a CONTROLLER.toml that twin control wrote"
        )
    axis, structures = _table(where, document, "axis"), _table(where, document, "structure")
    axis_unit, input_unit = axis.get("unit", "rad"), axis.get("input_unit", "%")
    if axis_unit not in ("rad", "m"):
        raise BadInput(f'{where}: [axis] unit is {axis_unit!r}: use "rad" or "m"')
    if input_unit not in tuple(INPUT_NAMES):
        raise BadInput(f"{where}: [axis] input_unit is {input_unit!r}: use one of {', '.join(INPUT_NAMES)}")
    structure = _structure(where, structures, "controller")
    if "constant_offset" not in structure:
        raise BadInput(f"{where}: [structure] controller lacks constant_offset, the integral action: add it")
    margins, cycle = _table(where, document, "margins"), _table(where, document, "limit_cycle")
    remarks = _table(where, document, "remarks").get("says", [])
    if not isinstance(remarks, list):
        raise BadInput(f"{where}: [remarks] says is {remarks!r}: give a list of sentences")

    def margin(name: str) -> float:
        return _real(f"{where}: [margins] {name}", margins.get(name, math.nan))

    limit_cycle = None
    if cycle:
        amplitude, frequency = (
            _finite(f"{where}: [limit_cycle] {n}", cycle.get(n)) for n in ("amplitude", "frequency")
        )
        limit_cycle = LimitCycle(amplitude, frequency)
    return Controller(
        plant=_structure(where, structures, "plant"),
        structure=structure,
        values=_values(where, _table(where, document, "parameters"), structure),
        settings=_settings(where, _table(where, document, "settings")),
        known={k: _finite(f"{where}: [known] {k}", v) for k, v in _table(where, document, "known").items()},
        axis_unit=axis_unit,
        input_unit=input_unit,
        bandwidth=_finite(f"{where}: bandwidth", document.get("bandwidth", 1.0)),
        reachable_speed=_real(f"{where}: [axis] reachable_speed", axis.get("reachable_speed", math.inf)),
        reachable_acceleration=_real(
            f"{where}: [axis] reachable_acceleration", axis.get("reachable_acceleration", math.inf)
        ),
        command_noise=_real(f"{where}: [margins] command_noise", margins.get("command_noise", 0.0)),
        margins=Margins(margin("gain"), margin("phase"), margin("delay"), margin("sensitivity")),
        limit_cycle=limit_cycle,
        remarks=tuple(map(str, remarks)),
    )


def read(path: Path) -> Controller:
    """Read CONTROLLER.toml. Raises BadInput."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadInput(
            f"{path}: there is no such controller file: check the name, or make one with twin control"
        ) from None
    except IsADirectoryError:
        raise BadInput(f"{path} is a folder, not a controller file: name the CONTROLLER.toml in it") from None
    except UnicodeDecodeError:
        raise BadInput(f"{path} is not UTF-8 text, so not a controller file: give a CONTROLLER.toml") from None
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): check its permissions") from None
    return loads(text, str(path))
