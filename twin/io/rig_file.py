"""What the columns of a recording are: the rig file (rig.toml), or a guess from the column names.

Every unit that a user may write is converted to one of `%, V, A, N*m, N` for the input and one of
`rad, m, kcount, rad/s, m/s, kcount/s` for the output. What the user writes is `value = (raw - offset) * scale`, in
`unit`. An axis is in thousands of counts where the counts per revolution are not known.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twin.errors import BadInput
from twin.io.toml import check_keys, parse_toml
from twin.io.units import (
    INPUT_UNITS,
    OPTIONAL_UNITS,
    OUTPUT_UNITS,
    POSITION_UNITS,
    TIME_UNITS,
    ZERO_CELSIUS,
    Units,
    spelled_unit,
)


@dataclass(frozen=True)
class Clock:
    """Where time comes from: a column, a constant sample time, or (both None) the file format's own
    stamps."""

    column: str | None = None
    factor: float = 1.0  # s per unit
    sample_time: float | None = None  # s


@dataclass(frozen=True)
class Column:
    """One column of the table and how its numbers become a quantity: (raw - offset) * scale * factor + zero.

    `full_scale` (input only) is the raw value at full drive, for commands in timer ticks instead of percent or a
    fraction. The value is then 100 * (raw - offset) * scale / full_scale percent.
    """

    name: str  # of a file without a header the column's number, from 1
    unit: str  # what the converted values are in
    offset: float = 0.0
    scale: float = 1.0
    factor: float = 1.0  # from the unit that the user wrote to `unit`
    written: str = ""  # the unit that the user wrote
    zero: float = 0.0
    resolution: float | None = None  # in `unit`; None: to be found from the data
    turn: float | None = None  # raw units per full turn, when the raw values are an angle
    counts: bool = False
    signed_bits: int = 0  # width of a signed integer that was logged without its sign; 0: the values are as they are
    file: str = ""  # where the column lies if not in the recording, relative to it; `*` stands for the recording's name
    clock: Clock | None = None  # of that file; None: as the recording's


@dataclass(frozen=True)
class Direction:
    """The column that holds the sign of an input that is logged as a magnitude.

    Without `forward` and `reverse` the column holds signs, or 1 for forward and 0 for reverse. With `forward`
    alone every other value is reverse; with both, every other value is no drive at all.
    """

    name: str
    forward: float | None = None
    reverse: float | None = None


@dataclass(frozen=True)
class LoopRig:
    """The rig's own position loop as the rig file describes it; a name stands for a manifest column or a
    scalar.

    Numbers are in the units that the user wrote for input and output; they are converted with the recording.
    """

    reference: str
    law: str
    gain: float | str | None = None
    gain_scale: float = 1.0
    kp: float | str | None = None
    kv: float | str | None = None
    limit: float | None = None
    reference_rate_limit: float | None = None
    minimum: float | None = None


@dataclass(frozen=True)
class Rig:
    """What the columns are, what is known already and what the first model contains besides the base
    effects."""

    name: str
    time: Clock
    input: Column
    output: Column
    optional: Mapping[str, Column] = field(default_factory=dict)
    known: Mapping[str, float | str] = field(default_factory=dict)
    loop: LoopRig | None = None
    direction: Direction | None = None
    location: str = "link"  # "link" | "motor": the side of gear, gap and elasticity that the sensor sits on
    refresh: float | None = None  # s, how often the sensor is read anew; None: not known
    effects: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()

    def own_unit(self, unit: str) -> tuple[str, float] | None:
        """The unit in which the rig logs an angle, a length or its speed, and how many of it make one of `unit`.

        None where it logs in `unit` itself, or nothing of that kind. A speed in revolutions is in rpm, and an angle of
        such a rig in degrees.
        """
        axis = self.output.unit.removesuffix("/s")
        logged = "rev" if self.output.written == "rpm" else self.output.written.removesuffix("/s")
        if unit not in (axis, f"{axis}/s") or logged in ("", axis):
            return None
        speed = unit != axis
        if logged == "rev":
            return ("rpm", 30.0 / math.pi) if speed else ("deg", 180.0 / math.pi)
        counted = logged == "count"
        factor = abs(self.output.factor * self.output.scale) if counted else POSITION_UNITS[logged][1]
        return f"{logged}{'s' if counted else ''}{'/s' if speed else ''}", 1.0 / factor

    def __repr__(self) -> str:
        return (
            f"{self.name}: input '{self.input.name}' in {self.input.unit}, "
            f"output '{self.output.name}' in {self.output.unit}"
        )


_MOTIONS = ("motor_position", "speed")  # optional columns that are motions of the axis
_ELSEWHERE = ("file", "time_column", "time_unit")  # keys of a column that may lie in another file


def read_rig(path: Path) -> Rig:
    """Read a rig file.

    Beyond the plain keys, a column may have `offset` and `scale` (value = (raw - offset) * scale, before the unit) and
    `resolution` (one count, in the column's unit). For an input in timer ticks, `full_scale` gives the ticks at full
    drive, in place of a unit. So full_scale = 5299 makes 5299 ticks 100 %. [known] and the gains of [loop] are numbers
    or names of manifest columns (or of scalars in a MAT file); `gain_scale` multiplies the gain. `signed_bits` = 8, 16
    or 32 gives a signed integer its sign back that was logged without it. Of a file without a header `column` is a
    number, from 1.

    Raises BadInput for TOML that cannot be read, an unknown key, a wrong unit, or a value of the wrong kind.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise BadInput(f"{path}: no such rig file; check the path") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8 text (byte {error.start}); save the rig file as UTF-8") from None
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give a rig.toml file") from None
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise BadInput(f"{path}: not valid TOML: {error}; mend that line") from None
    return rig_of(table, str(path))


def rig_of(table: Mapping[str, Any], where: str) -> Rig:
    """The rig that the tables of a rig file describe; `where` names it in messages. Raises BadInput."""
    check_keys(where, table, ("time", "input", "output", "optional", "known", "loop", "structure"))
    for key in ("input", "output"):
        if key not in table:
            raise BadInput(f"{where}: [{key}] is missing; say which column it is and in what unit")
    roles = {key: _table(table, key, where).get("column") for key in ("time", "input", "output")}
    apart = "file" in _table(table, "input", where)
    for key, other in (("input", "output"), ("time", "input"), ("time", "output")):
        if not (apart and "input" in (key, other)) and roles[key] is not None and roles[key] == roles[other]:
            raise BadInput(f"{where}: [{key}] and [{other}] are both column '{roles[key]}'; name two columns")
    optional = _table(table, "optional", where)
    check_keys(f"{where} [optional]", optional, OPTIONAL_UNITS)
    structure = _table(table, "structure", where)
    check_keys(f"{where} [structure]", structure, ("effects",))
    effects = structure.get("effects", [])
    if not isinstance(effects, list) or not all(isinstance(e, str) for e in effects):
        raise BadInput(f'{where} [structure]: effects = {effects!r} must be a list of names, such as ["gravity"]')
    drive, reading = _table(table, "input", where), _table(table, "output", where)
    rig = Rig(
        name=where,
        time=_clock(_table(table, "time", where), f"{where} [time]"),
        input=_column(drive, INPUT_UNITS, f"{where} [input]", ("full_scale", "direction", *_ELSEWHERE)),
        output=_column(reading, OUTPUT_UNITS, f"{where} [output]", ("location", "refresh")),
        direction=_direction(drive, f"{where} [input]") if "direction" in drive else None,
        location=_location(reading, f"{where} [output]"),
        refresh=_positive(reading, "refresh", f"{where} [output]") if "refresh" in reading else None,
        optional={
            key: _column(_table(optional, key, where), OPTIONAL_UNITS[key], f"{where} [optional.{key}]", _ELSEWHERE)
            for key in optional
        },
        known={
            key: _number_or_name(_table(table, "known", where), key, f"{where} [known]")
            for key in _table(table, "known", where)
        },
        loop=_loop(_table(table, "loop", where), f"{where} [loop]") if "loop" in table else None,
        effects=tuple(effects),
    )
    _check_one_axis_unit(rig)
    return rig


def _check_one_axis_unit(rig: Rig) -> None:
    """Raises BadInput where a motion beside the output cannot be compared with it, as one is in counts."""
    axis = rig.output.unit.removesuffix("/s")
    units = {key: rig.optional[key].unit.removesuffix("/s") for key in _MOTIONS if key in rig.optional}
    for key, unit in units.items():
        if unit != axis and "kcount" in (unit, axis):
            place = "[output]" if axis == "kcount" else f"[optional.{key}]"
            said, other = (u.removeprefix("k") for u in (axis, unit))
            raise BadInput(
                f"{rig.name}: [output] is in {said} and [optional.{key}] in {other}: give counts_per_revolution in "
                f"{place}"
            )


def _clock(table: Mapping[str, Any], where: str) -> Clock:
    check_keys(where, table, ("column", "unit", "sample_time"))
    column = _name(table, where) if "column" in table else None
    sample_time = _number(table, "sample_time", where) if "sample_time" in table else None
    if column is not None and sample_time is not None:
        raise BadInput(f"{where}: give either column or sample_time, not both")
    if sample_time is not None and sample_time <= 0:
        raise BadInput(f"{where}: sample_time = {sample_time:g} must be greater than 0 s")
    factor = _unit(table, TIME_UNITS, where, default="s")[1]
    return Clock(column, factor, None if sample_time is None else sample_time * factor)


def _column(table: Mapping[str, Any], units: Units, where: str, more: Sequence[str] = ()) -> Column:
    allowed = ("column", "unit", "offset", "scale", "resolution", "counts_per_revolution", "signed_bits", *more)
    check_keys(where, table, allowed)
    if "column" not in table:
        raise BadInput(f"{where}: column is missing; name the column of the recording")
    written = table.get("unit")
    full_scale = _number(table, "full_scale", where) if "full_scale" in table else None
    unit, factor = _unit(table, units, where, default="%" if full_scale is not None else None)
    if full_scale is not None:
        if unit != "%" or full_scale <= 0:
            raise BadInput(f'{where}: full_scale must be greater than 0 and goes with unit = "%" only')
        factor = 100.0 / full_scale
    scale = _number(table, "scale", where) if "scale" in table else 1.0
    if scale == 0:
        raise BadInput(f"{where}: scale = 0 would make every value 0; give another scale")
    per_revolution = _number(table, "counts_per_revolution", where) if "counts_per_revolution" in table else None
    if per_revolution is not None and per_revolution <= 0:
        raise BadInput(f"{where}: counts_per_revolution = {per_revolution:g} must be greater than 0")
    if written in ("count", "count/s"):
        thousands = (f"k{written}", 1e-3)  # of counts: an encoder's turn is then of the size of a radian
        unit, factor = thousands if per_revolution is None else (unit, factor / per_revolution)
    bits = _number(table, "signed_bits", where) if "signed_bits" in table else 0
    if bits not in (0, 8, 16, 32):
        raise BadInput(f"{where}: signed_bits = {bits:g} is no width of an integer; give 8, 16 or 32")
    resolution = abs(factor * scale) if written == "count" else None
    if resolution is None and per_revolution is not None and unit == "rad":
        resolution = 2 * math.pi / per_revolution
    if "resolution" in table:
        resolution = _number(table, "resolution", where) * factor
        if resolution < 0:
            raise BadInput(f"{where}: resolution must not be negative")
    turn = 2 * math.pi / abs(factor * scale) if unit == "rad" else None
    return Column(
        name=_name(table, where),
        unit=unit,
        offset=_number(table, "offset", where) if "offset" in table else 0.0,
        scale=scale,
        factor=factor,
        written=written or "",
        zero=ZERO_CELSIUS if written == "degC" else 0.0,
        resolution=resolution,
        turn=turn,
        counts=written == "count",
        signed_bits=int(bits),
        file=_text(table, "file", where) if "file" in table else "",
        clock=_clock_elsewhere(table, where),
    )


def _clock_elsewhere(table: Mapping[str, Any], where: str) -> Clock | None:
    """The clock of another file that a column lies in; None where the rig file does not give it."""
    given = {key: table[f"time_{key}"] for key in ("column", "unit") if f"time_{key}" in table}
    if given and "file" not in table:
        raise BadInput(f"{where}: time_column and time_unit go with file; name the file that the column lies in")
    return _clock(given, where) if "column" in given else None


def _direction(drive: Mapping[str, Any], where: str) -> Direction:
    table, where = _table(drive, "direction", where), where.replace("[input]", "[input.direction]")
    check_keys(where, table, ("column", "forward", "reverse"))
    if "column" not in table:
        raise BadInput(f"{where}: column is missing; name the column that holds the sign of the input")
    if "reverse" in table and "forward" not in table:
        raise BadInput(f"{where}: reverse needs forward; give the values that mean forward and reverse")
    forward, reverse = (_number(table, key, where) if key in table else None for key in ("forward", "reverse"))
    if forward is not None and forward == reverse:
        raise BadInput(f"{where}: forward and reverse are both {forward:g}; give two values")
    return Direction(_name(table, where), forward, reverse)


def _location(table: Mapping[str, Any], where: str) -> str:
    location = table.get("location", "link")
    if location not in ("link", "motor"):
        raise BadInput(f'{where}: location = {location!r} is not known; use "link" or "motor"')
    return str(location)


def _positive(table: Mapping[str, Any], key: str, where: str) -> float:
    value = _number(table, key, where)
    if value <= 0:
        raise BadInput(f"{where}: {key} = {value:g} must be greater than 0")
    return value


def _loop(table: Mapping[str, Any], where: str) -> LoopRig:
    allowed = (
        "reference",
        "law",
        "gain",
        "gain_scale",
        "kp",
        "kv",
        "limit",
        "reference_rate_limit",
        "minimum",
    )
    check_keys(where, table, allowed)
    for key in ("reference", "law"):
        if key not in table:
            raise BadInput(f"{where}: {key} is missing")
    law = _text(table, "law", where)
    needed = {"P": ("gain",), "P-P": ("kp", "kv")}
    if law not in needed:
        raise BadInput(f'{where}: law = "{law}" is not known; use "P" or "P-P"')
    for key in needed[law]:
        if key not in table:
            raise BadInput(f'{where}: law = "{law}" needs {" and ".join(needed[law])}')

    def number(key: str) -> float | None:
        return _number(table, key, where) if key in table else None

    def number_or_name(key: str) -> float | str | None:
        return _number_or_name(table, key, where) if key in table else None

    return LoopRig(
        reference=_text(table, "reference", where),
        law=law,
        gain=number_or_name("gain"),
        gain_scale=_number(table, "gain_scale", where) if "gain_scale" in table else 1.0,
        kp=number_or_name("kp"),
        kv=number_or_name("kv"),
        limit=number("limit"),
        reference_rate_limit=number("reference_rate_limit"),
        minimum=number("minimum"),
    )


def _table(table: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise BadInput(f"{where}: {key} = {value!r} must be a table, written [{key}]")
    return value


def _number(table: Mapping[str, Any], key: str, where: str) -> float:
    value = table[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadInput(f"{where}: {key} = {value!r} must be a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise BadInput(f"{where}: {key} must be a finite number")
    return number


def _number_or_name(table: Mapping[str, Any], key: str, where: str) -> float | str:
    return table[key] if isinstance(table[key], str) else _number(table, key, where)


def _name(table: Mapping[str, Any], where: str) -> str:
    """The name of a column; the number of one is a name, too, as files without a header have no other."""
    value = table["column"]
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value < 10**6:
        return str(value)
    return _text(table, "column", where)


def _text(table: Mapping[str, Any], key: str, where: str) -> str:
    value = table[key]
    if not isinstance(value, str) or not value:
        raise BadInput(f"{where}: {key} = {value!r} must be a name in quotes")
    return value


def _unit(table: Mapping[str, Any], units: Units, where: str, default: str | None) -> tuple[str, float]:
    allowed = ", ".join(f'"{u}"' for u in units)
    value = table.get("unit", default)
    if value is None:
        raise BadInput(f"{where}: unit is missing; use one of {allowed}")
    if not isinstance(value, str) or value not in units:
        raise BadInput(f"{where}: unit = {value!r} is not known; use one of {allowed}")
    return units[value]


# --- without a rig file ---

_LOOKED_AT = 2000  # columns among which obvious names are looked for

# Column names that mean the same thing wherever we have seen them, best first.
_TIME_NAMES = ("t", "time", "timestamp", "times", "seconds", "clock")
_BRACKETED = re.compile(r"^(.*?)[\s_]*[(\[]\s*([^)\]]+?)\s*[)\]]$")
_SUFFIXED = re.compile(
    r"^(.+?)[_ ](rad_s|radps|rad/s|deg_s|deg/s|dps|rev/s|rps|counts?/s|mm_s|mm/s|m_s|m/s|mps|rpm|rad|deg|rev|counts?"
    r"|mm|m|s|sec|ms|us|ns|pct|percent|%|v|a|nm|n)$",
    re.I,
)


def split_unit(name: str) -> tuple[str, str | None]:
    """'Motor_Speed(RPM)' -> ('motorspeed', 'rpm'); a name without a unit has None."""
    match = _BRACKETED.match(name.strip()) or _SUFFIXED.match(name.strip())
    base, unit = match.groups() if match else (name, None)
    if unit is not None:
        unit = spelled_unit(unit) or unit.lower()
    return re.sub(r"[^a-z0-9]", "", base.lower()), unit


def _pick(
    names: Sequence[str], known: Iterable[str], units: Units, written: Mapping[str, str]
) -> tuple[str, str, str | None] | None:
    """The first column whose name is one of `known`, in that order, and whose unit, if the name or the file gives
    one, is possible.
    """
    split = []
    for name in names[:_LOOKED_AT]:
        base, unit = split_unit(name)
        split.append((name, base, unit or spelled_unit(written.get(name, "")) or None))
    for wanted in known:
        for name, base, unit in split:
            if base == wanted and (unit is None or unit in units):
                return name, base, unit
    return None


def guess_time(names: Sequence[str], units: Mapping[str, str]) -> Clock | None:
    """The clock, from the names of the columns and the units that the file gives; None when no name says time."""
    found = _pick(names, _TIME_NAMES, TIME_UNITS, units)
    return None if found is None else Clock(found[0], TIME_UNITS[found[2] or "s"][1])
