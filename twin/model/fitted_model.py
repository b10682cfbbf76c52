"""A fitted axis: structure, values, their covariance, and where they come from. One TOML file each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.display.numbers import measure
from twin.display.table import DisplayTable, Tabular
from twin.effects.catalogue import EFFECTS, ONCE, pages
from twin.effects.end_stop import NOWHERE
from twin.effects.parameter import Parameter
from twin.errors import BadInput
from twin.io.files import check_free, put
from twin.io.toml import check_keys, finite, load, number, parse, quoted, real, section, size, texts
from twin.model.stepper import Structure

FORMAT = "twin-model/1"
_TABLES = ("axis", "structure", "parameters", "noise", "known", "covariance", "provenance")
_ENTRY = ("value", "std", "interval", "unit", "meaning", "note")  # of a parameter
INPUT_NAMES = {"%": "duty", "V": "voltage", "A": "current", "N*m": "torque", "N": "force"}


@dataclass(frozen=True, eq=False, repr=False)
class Model(Tabular):
    """A structure with numbers.

    `values` holds every parameter of the structure; `covariance` (n, n) belongs to `fitted`, in that order: what left
    no trace in the recordings has an infinite variance, and none with others.
    `intervals` are 95 % profile-likelihood intervals of bounded and kinked parameters; `notes` says of a
    parameter what a reader must know ("the recording cannot fix it: ...").
    """

    structure: Structure
    values: Mapping[str, float]
    fitted: tuple[str, ...] = ()
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    axis_unit: str = "rad"
    input_unit: str = "%"
    sample_time: float = 0.002
    resolution: float = 0.0  # axis_unit (or axis_unit/s where only speed is logged) per count
    reads_speed: bool = False
    reading_std: float = 0.0  # of one reading, in the output's unit
    torque_density: float = 0.0  # of the white torque noise, (axis_unit/s^2)^2 s
    recorded_time: float = 0.0  # s, length of the longest recording that it was fitted to
    known: Mapping[str, float] = field(default_factory=dict)  # payload, moment; inertia
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def input_name(self) -> str:
        """The FMU's input variable."""
        return INPUT_NAMES[self.input_unit]

    @property
    def holds_moments(self) -> bool:
        """Whether it holds what happened at a moment of its recording."""
        return any(i in self.structure for i in ONCE)

    @property
    def time_start(self) -> float:
        """Time of the recording at which a twin starts, s: its end where the model holds what happened in it."""
        return self.recorded_time if self.holds_moments else 0.0

    @property
    def longest_step(self) -> float:
        """Longest internal step, s."""
        return 0.002 / self.structure.substeps

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters that the recording cannot fix: a note says why, and the error is as large as the value or none."""
        return tuple(n for n in self.notes if n in self.values and not self.std(n) < abs(self.values[n]))

    def std(self, name: str) -> float:
        """Standard error of a parameter; NaN where it was held fixed."""
        if name not in self.fitted:
            return math.nan
        i = self.fitted.index(name)
        return math.sqrt(max(self.covariance[i, i], 0.0))

    def parameter(self, name: str) -> Parameter:
        return next(p for p in self.structure.parameters if p.name == name)

    def unit(self, name: str) -> str:
        return self.parameter(name).unit_for(self.axis_unit, self.input_unit)

    def torque(self, name: str) -> str:
        """A parameter that is an acceleration, as the torque (N*m) or force (N) that causes it. Empty where it is no
        acceleration, or the inertia is not known.
        """
        inertia = self.known.get("inertia", 0.0)
        if not inertia or self.unit(name) != f"{self.axis_unit}/s^2":
            return ""
        return f"{inertia * self.values[name]:.3g} {'N' if self.axis_unit == 'm' else 'N m'}"

    def says(self, effect: str) -> str:
        """The sentence of an effect with the model's numbers in it; a stop that stands nowhere was not met."""
        shown = {}
        for page in pages(effect):
            for p in self.structure.acting(page):
                value, std, unit, torque = self.values[p.name], self.std(p.name), self.unit(p.name), self.torque(p.name)
                spread = f" ± {std:.2g}" if math.isfinite(std) else ""
                text = f"{value:.3g}{spread}{'' if unit == '1' else ' ' + unit}{torque and f' ({torque})'}"
                shown[p.name] = "none met" if value == NOWHERE.get(p.name) else text
        return EFFECTS[effect].sentence.format(**shown)

    def with_values(self, values: Mapping[str, float]) -> Model:
        return replace(self, values={**self.values, **values})

    def table(self) -> DisplayTable:
        """Parameter, value with standard error, meaning."""
        rows, notes = [], []
        for p in self.structure.parameters:
            value = measure(self.values[p.name], self.std(p.name), self.unit(p.name))
            torque = self.torque(p.name)
            rows.append((p.name, f"{value} = {torque}" if torque else value, p.meaning))
            if p.name in self.notes:
                notes.append(f"{p.name}: {self.notes[p.name]}")
        return DisplayTable(f"model: {self.structure}", ("parameter", "value", "meaning"), rows, notes)

    @classmethod
    def read(cls, path: str | Path) -> Model:
        """Read a MODEL.toml. Raises BadInput."""
        return read(Path(path))

    def write(self, path: str | Path, force: bool = False) -> Path:
        """Write the model as TOML; `force` overwrites what is there. Raises BadInput."""
        check_free(Path(path), force)
        put(Path(path), dumps(self))
        return Path(path)


def _check_numbers(model: Model) -> None:
    """Raises BadInput where a model holds what is no number, which no reader of its file would take."""
    told = {**model.values, "reading_std": model.reading_std, "torque_density": model.torque_density, **model.known}
    for name, value in told.items():
        if not math.isfinite(value):
            raise BadInput(
                f"{name} of the model is {value:g}, not a number to write: identify it again with more motion"
            )
    if np.any(np.isnan(model.covariance)):
        raise BadInput("the model's covariance is not a number everywhere: identify it again with more motion")


def dumps(model: Model) -> str:
    """The model as TOML text; the same model gives the same text. Raises BadInput where a value is no number."""
    _check_numbers(model)
    lines = [
        f"format = {quoted(FORMAT)}",
        "",
        "[axis]",
        f"unit = {quoted(model.axis_unit)}",
        f"input_unit = {quoted(model.input_unit)}",
        f"sample_time = {number(model.sample_time)}",
        f"resolution = {number(model.resolution)}",
        f"reads_speed = {str(model.reads_speed).lower()}",
        *([f"recorded_time = {number(model.recorded_time)}"] if model.recorded_time else []),
        "",
        "[structure]",
        f"effects = {texts(model.structure.ids)}",
    ]
    for p in model.structure.parameters:
        lines += ["", f"[parameters.{p.name}]", f"value = {number(model.values[p.name])}"]
        if p.name in model.fitted:
            lines.append(f"std = {number(model.std(p.name))}")
        if p.name in model.intervals:
            low, high = model.intervals[p.name]
            lines.append(f"interval = [{number(low)}, {number(high)}]")
        lines.append(f"unit = {quoted(model.unit(p.name))}")
        lines.append(f"meaning = {quoted(p.meaning)}")
        if p.name in model.notes:
            lines.append(f"note = {quoted(model.notes[p.name])}")
    lines += ["", "[noise]", f"reading_std = {number(model.reading_std)}"]
    lines.append(f"torque_density = {number(model.torque_density)}")
    if model.known:
        lines += ["", "[known]", *(f"{quoted(k)} = {number(v)}" for k, v in model.known.items())]
    lines += ["", "[covariance]", f"parameters = {texts(model.fitted)}", "matrix = ["]
    lines += [f"    [{', '.join(number(v) for v in row)}]," for row in model.covariance]
    lines.append("]")
    if model.provenance:
        lines += ["", "[provenance]", *(f"{quoted(k)} = {quoted(v)}" for k, v in model.provenance.items())]
    return "\n".join(lines) + "\n"


def read_structure(where: str, table: Mapping[str, Any], key: str) -> Structure:
    """The structure that a file's list names. Raises BadInput."""
    ids = table.get(key)
    if not isinstance(ids, list) or not ids:
        raise BadInput(f'{where}: [structure] has no list `{key}`: add one, such as ["inertia"]')
    for i in ids:
        if not isinstance(i, str) or i not in EFFECTS:
            raise BadInput(f"{where}: unknown effect {i!r} in [structure]; known are {', '.join(EFFECTS)}")
    return Structure.of(ids)


def read_units(where: str, axis: Mapping[str, Any]) -> tuple[str, str]:
    """The units of axis and input that a file names. Raises BadInput."""
    unit, input_unit = axis.get("unit", "rad"), axis.get("input_unit", "%")
    if unit not in ("rad", "m", "kcount"):
        raise BadInput(f'{where}: [axis] unit is {unit!r}: use "rad", "m" or "kcount"')
    if input_unit not in tuple(INPUT_NAMES):
        raise BadInput(f"{where}: [axis] input_unit is {input_unit!r}: use one of {', '.join(INPUT_NAMES)}")
    return unit, input_unit


def loads(text: str, where: str = "model") -> Model:
    """A model from TOML text. `where` names it in messages. Raises BadInput."""
    advice = "give a MODEL.toml that twin identify or twin diagnose wrote"
    document = parse(text, where, FORMAT, advice, _TABLES)
    axis = section(
        where, document, "axis", ("unit", "input_unit", "sample_time", "resolution", "reads_speed", "recorded_time")
    )
    noise = section(where, document, "noise", ("reading_std", "torque_density"))
    structure = read_structure(where, section(where, document, "structure", ("effects",)), "effects")
    tables = section(where, document, "parameters")
    values, intervals, notes = {}, {}, {}
    for p in structure.parameters:
        entry = tables.get(p.name)
        if not isinstance(entry, dict) or "value" not in entry:
            raise BadInput(f"{where}: [parameters.{p.name}] has no value: the structure needs it")
        check_keys(f"{where}: [parameters.{p.name}]", entry, _ENTRY)
        value = finite(f"{where}: [parameters.{p.name}] value", entry["value"])
        if not p.lower <= value <= p.upper:
            raise BadInput(f"{where}: {p.name} = {value:g} is outside [{p.lower:g}, {p.upper:g}]: correct it")
        values[p.name] = value
        if "interval" in entry:
            pair = entry["interval"]
            if not isinstance(pair, list) or len(pair) != 2:
                raise BadInput(f"{where}: [parameters.{p.name}] interval is {pair!r}: give [low, high]")
            low, high = (float(v) if isinstance(v, int | float) else math.nan for v in pair)
            intervals[p.name] = (low, high)
        if "note" in entry:
            notes[p.name] = str(entry["note"])
    for name in tables:
        if name not in values:
            raise BadInput(f"{where}: [parameters.{name}] belongs to no effect of the structure: remove it")
    fitted, covariance = _covariance(where, section(where, document, "covariance", ("parameters", "matrix")), values)
    axis_unit, input_unit = read_units(where, axis)
    sample_time = finite(f"{where}: [axis] sample_time", axis.get("sample_time", 0.002))
    if not 0.0 < sample_time <= 10.0:
        raise BadInput(f"{where}: [axis] sample_time is {sample_time:g} s: give a period above 0 and up to 10 s")
    known = {k: finite(f"{where}: [known] {k}", v) for k, v in section(where, document, "known").items()}
    reads_speed = axis.get("reads_speed", False)
    if not isinstance(reads_speed, bool):
        raise BadInput(f"{where}: [axis] reads_speed is {reads_speed!r}: use true or false")
    return Model(
        structure=structure,
        values=values,
        fitted=fitted,
        covariance=covariance,
        intervals=intervals,
        notes=notes,
        axis_unit=axis_unit,
        input_unit=input_unit,
        sample_time=sample_time,
        resolution=size(f"{where}: [axis] resolution", axis.get("resolution", 0.0)),
        recorded_time=size(f"{where}: [axis] recorded_time", axis.get("recorded_time", 0.0)),
        reads_speed=reads_speed,
        reading_std=size(f"{where}: [noise] reading_std", noise.get("reading_std", 0.0)),
        torque_density=size(f"{where}: [noise] torque_density", noise.get("torque_density", 0.0)),
        known=known,
        provenance={k: str(v) for k, v in section(where, document, "provenance").items()},
    )


def _covariance(
    where: str, table: Mapping[str, Any], values: Mapping[str, float]
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    names = table.get("parameters", [])
    rows = table.get("matrix", [])
    if not isinstance(names, list) or any(n not in tuple(values) for n in names):
        raise BadInput(f"{where}: [covariance] parameters must be names of the model's parameters: correct the list")
    good = isinstance(rows, list) and len(rows) == len(names)
    good = good and all(isinstance(r, list) and len(r) == len(names) for r in rows)
    if not good:
        raise BadInput(f"{where}: [covariance] matrix must have {len(names)} rows of {len(names)} numbers: correct it")
    asked = f"{where}: [covariance] matrix"
    # What left no trace in a recording has no end of variance.
    flat = [
        math.inf if i == j and real(asked, v) == math.inf else finite(asked, v)
        for i, row in enumerate(rows)
        for j, v in enumerate(row)
    ]
    return tuple(names), np.array(flat).reshape(len(names), len(names))


def read(path: Path) -> Model:
    """Read MODEL.toml. Raises BadInput."""
    return loads(load(path, "model", "MODEL.toml", "twin identify"), str(path))
