"""What the columns of a log are, by their names and by what stands in them: a rig file for a log that has none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.errors import BadInput
from twin.io.clock import LONGEST_STEP, SHORTEST_STEP
from twin.io.faults import FloatArray
from twin.io.preflight.finding import Finding
from twin.io.preflight.response import Signals, response, to_grid
from twin.io.rig_file import Rig, rig_of, split_unit
from twin.io.tables.table import Table, listing
from twin.io.toml import quoted
from twin.io.units import INPUT_UNITS, OPTIONAL_UNITS, POSITION_UNITS, SPEED_UNITS, TIME_UNITS, spelled_unit

#: Parts of names, the likeliest first, in English and German. A drive comes before what may be a measurement.
_TIME = ("time", "stamp", "clock", "seconds", "millis", "micros", "zeit", "t")
_DRIVES = ("duty", "pwm", "tastgrad", "tastverh", "stellgr", "stellwert", "volt", "spannung", "torque", "drehmoment",
           "tau", "force", "kraft", "effort", "applied", "drive")  # fmt: skip
_INPUT = (*_DRIVES, "control", "input", "current", "strom", "command", "cmd", "u", "vir", "i")
_REFERENCE = ("ref", "goal", "target", "setpoint", "desired", "sp", "des", "sollwert")
_PLACES = ("counts", "ticks", "encoder", "position", "theta", "angle", "winkel", "count", "zähler", "zaehler", "enc")
_POSITION = (*_PLACES, "pos", "phi", "deg", "adc", "pot", "q", "qm", "output", "y", "x")
_ANGLES = ("angle", "winkel")  # a long way under such a name is in deg
_SPEEDS = ("speed", "velocity", "omega", "rpm", "drehzahl", "geschwindigkeit", "vel")
_SPEED = (*_SPEEDS, "w", "v", "output", "y")
_SUPPLY = ("supply", "battery", "vbat", "vbus", "vcc", "bus")
_OPTIONAL = {"temperature": ("temp",), "supply": _SUPPLY, "current": ("current", "amps", "strom", "i")}
#: What is neither the input nor the output.
_NEITHER = (*_REFERENCE, *_SUPPLY, *_OPTIONAL["temperature"])
_DIRECTION = ("dir", "direction", "sign", "richtung", "vorzeichen")
#: Names that may be a position as well as a speed: what stands in the column decides.
_EITHER = ("output", "y", "x")
#: A voltage that is called u goes no further; a duty in percent that moves an axis goes further.
_VOLTS = 30.0
_TICKS = (255, 1000, 1023, 4095, 10_000, 32_767, 65_535)  # at full drive of common timers
#: So many columns of a table are looked at, and so many tables of a set.
_LOOKED_AT, _TABLES = 40, 12
#: So many names are searched for telling ones.
_NAMES = 2000
#: A reading is a speed whose steps the input explains to this share, and that dies away by so many standard errors,
#: seen on a grid of so many rows. Of made axes with time constants from 0.02 to 2 s, positions reach 4 and speeds 12.
_MIN_SHARE, _SURE, _ROWS = 0.8, 10.0, 10.0
_LEAST_ROWS = 30
#: A command that changes in more than this share of the rows is not held. A column that never changes is one, then.
_HELD = 0.3


@dataclass
class Section:
    """One table of the rig file: keys with their values, and what is said of each."""

    keys: dict[str, str | float] = field(default_factory=dict)
    remarks: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Guess:
    """The tables of a rig file by their titles, as `input.direction`, and what the user should check in them."""

    sections: dict[str, Section]
    unsure: list[str]
    columns: Mapping[str, FloatArray]

    @property
    def assumed(self) -> tuple[str, ...]:
        """What was taken for granted, in sentences."""
        return (*(_role(t, self.sections[t].keys) for t in ("time", "input", "output")), *self.unsure)

    def rig(self, name: str) -> Rig:
        """The rig, named after the log in messages. Raises BadInput where the log does not tell the sample time."""
        time = self.sections["time"].keys
        if "sample_time" in time:
            raise BadInput(
                f"{name}: no column looks like time; columns are: {listing(list(self.columns))}; write a rig.toml with "
                "[time] column or sample_time"
            )
        rig = rig_of(_nested(self.sections), name)
        return replace(rig, assumed=tuple(a for a in self.assumed if a))

    def mend(self, findings: Sequence[Finding]) -> bool:
        """Correct what the checks before a fit found, and say so; False where nothing is left to correct."""
        kinds = {f.kind: f.says for f in findings}
        drive, reading = self.sections["input"], self.sections["output"]
        if "sign" in kinds and "scale" not in reading.keys:
            reading.keys["scale"] = -1
            reading.remarks["scale"] = "a positive input drove the reading down"
            self.unsure.append("the output moves against the input: scale = -1 turns it round")
            return True
        if "unsigned_input" in kinds and "signed_bits" not in drive.keys:
            bits = next(b for b in (8, 16, 32) if f"signed_bits = {b} " in kinds["unsigned_input"])
            self._read_as_signed(bits)
            return True
        magnitude = bool(np.nanmin(self.columns[str(drive.keys["column"])]) >= 0.0)
        two = [n for n, v in self.columns.items() if 2 <= np.unique(v[np.isfinite(v)]).size <= 3]
        sign = _pick(two, _DIRECTION) or ("direction" in kinds and next(iter(two), None)) or None
        if not magnitude or sign is None or "input.direction" in self.sections:
            return False
        self.sections["input.direction"] = Section({"column": sign})
        self.unsure.append(f"the input has no sign of its own: column '{sign}' gives it")
        return True

    def mend_refusal(self, error: BadInput) -> bool:
        """Correct what the log was refused for; False where nothing can be."""
        if "signed_bits = 16" not in str(error) or "signed_bits" in self.sections["input"].keys:
            return False
        self._read_as_signed(16)
        return True

    def _read_as_signed(self, bits: int) -> None:
        self.sections["input"].keys["signed_bits"] = bits
        self.unsure.append(f"the input holds signed numbers of {bits} bits")


def _role(title: str, keys: Mapping[str, str | float]) -> str:
    """One role in words; nothing where the format has the stamps."""
    if "column" not in keys:
        return ""
    what = {"time": "time", "input": "the input", "output": "the output"}[title]
    unit = keys.get("unit", "")
    said = f"of {keys['full_scale']:.6g} at full drive" if "full_scale" in keys else f"in {unit}"
    if unit == "1":
        said = "in fractions of full drive"
    return f"{what} is column '{keys['column']}', {said}"


def _nested(sections: Mapping[str, Section]) -> dict[str, Any]:
    """The tables as a rig file holds them: `input.direction` within `input`."""
    tables: dict[str, Any] = {}
    for title, section in sections.items():
        *outer, last = title.split(".")
        table = tables
        for name in outer:
            table = table.setdefault(name, {})
        table.setdefault(last, {}).update(section.keys)
    return tables


def numeric_columns(*tables: Table) -> dict[str, FloatArray]:
    """The columns that hold numbers; of several tables with the same names, one after the other.

    Of many columns those are looked at whose names say something, and the first of the others.
    """
    words = (*_TIME, *_INPUT, *_POSITION, *_SPEED, *_DIRECTION, *_SUPPLY)
    many = tables[0].names[:_NAMES] if len(tables[0].names) > _LOOKED_AT else ()
    telling = [n for n in many if _pick([n], words)]
    names = list(dict.fromkeys([*telling, *tables[0].names]))[:_LOOKED_AT]
    alike = [t for t in tables[:_TABLES] if set(names) <= set(t.names)]
    order = {name: k for k, name in enumerate(tables[0].names)}
    read = _numbers(alike, sorted(names, key=lambda n: order[n]))
    return {name: values for name, values in read.items() if np.isfinite(values).sum() > 0.1 * values.size}


def _numbers(tables: Sequence[Table], names: Sequence[str]) -> dict[str, FloatArray]:
    """Those of the columns that hold no text, in one go where none does."""
    try:
        read = [t.columns(names) for t in tables]
    except BadInput:
        halves = (names[: len(names) // 2], names[len(names) // 2 :]) if len(names) > 1 else ()
        return {n: v for half in halves for n, v in _numbers(tables, half).items()}
    return {n: np.concatenate(parts) for n, *parts in zip(names, *read, strict=True)}


def _pick(names: Iterable[str], words: Sequence[str], without: Sequence[str] = ()) -> str | None:
    """The first name that is, begins with or holds one of the words; a short word has to be the whole name."""
    whole = {name: "".join(c for c in name.lower() if c.isalnum()) for name in names}
    bases = {name: split_unit(name)[0] for name in whole}

    def says(name: str, word: str) -> bool:
        return bases[name] == word or (len(word) > 2 and word in whole[name])

    allowed = [n for n in whole if not any(says(n, w) for w in without)]
    return next((n for word in words for n in allowed if says(n, word)), None)


def guess(*tables: Table) -> Guess:
    """What the columns are: by their names, and by what stands in them where they have none.

    Parameters
    ----------
    tables
        Recordings of one rig, with the same columns.

    Raises
    ------
    BadInput
        No column can be the input or the output.
    """
    table, unsure = tables[0], list[str]()
    columns = numeric_columns(*tables)
    time = _time_section(table, columns if len(tables) == 1 else _numbers([table], list(columns)), unsure)
    left = [n for n in columns if n != time.keys.get("column") and np.nanmax(columns[n]) > np.nanmin(columns[n])]
    names = _by_values(tables, columns, left, time, unsure) if table.names[0] == "1" else _by_names(left, table, unsure)
    if (names.drive is None or names.reading is None) and len(left) == 2 and _pick(left, _NEITHER) is None:
        names = _of_two(names, tables, {n: columns[n] for n in left}, time, unsure)
    if names.drive is None or names.reading is None:
        what = "the input" if names.drive is None else "the output"
        raise BadInput(
            f"{table.name}: no column looks like {what}; columns are: {listing(table.names)}; write a rig.toml with "
            "[time] column, [input] column and [output] column"
        )
    speed = names.is_speed
    if split_unit(names.reading)[0] in _EITHER and _unit(names.reading, table, POSITION_UNITS) is None:
        speed = is_speed(_signals(tables, names.drive, names.reading, time))
    sections = {
        "time": time, "input": _input_section(names.drive, columns[names.drive], table, unsure),
        "output": _output_section(names.reading, columns[names.reading], table, not speed, unsure),
    }  # fmt: skip
    rest = [n for n in left if n not in (names.drive, names.reading)]
    sections |= _optional_sections(rest, table, speed, str(sections["output"].keys["unit"]))
    reference = next((n for n in rest if _pick([n], _REFERENCE)), None)
    if reference is not None:
        unsure.append(f"column '{reference}' looks like a reference of the rig's own loop; it is not the input")
    return Guess(sections, unsure, columns)


@dataclass(frozen=True)
class _Names:
    """Which columns are the input and the output."""

    drive: str | None
    reading: str | None
    is_speed: bool


def _by_names(names: Sequence[str], table: Table, unsure: list[str]) -> _Names:
    """The columns by their names; where these say nothing, by the units that stand behind them."""
    drives = (*_REFERENCE, *_DRIVES, *_SUPPLY)
    position = _pick(names, _POSITION, drives)
    reading = position or _pick(names, _SPEED, drives)
    drive = _pick([n for n in names if n != reading], _INPUT, (*_REFERENCE, *_SUPPLY, *_PLACES, *_SPEEDS))
    if drive is None:
        drive = _by_unit([n for n in names if n != reading], "the input", INPUT_UNITS, table, unsure)
    if reading is None:
        others = [n for n in names if n != drive]
        reading = position = _by_unit(others, "a position", POSITION_UNITS, table, unsure)
        reading = reading or _by_unit(others, "a speed", SPEED_UNITS, table, unsure)
    return _Names(drive, reading, position is None)


def _by_unit(
    names: Iterable[str], what: str, units: Mapping[str, object], table: Table, unsure: list[str]
) -> str | None:
    """The first column in one of the units that is no reference and no supply."""
    other = (*_REFERENCE, *_SUPPLY)
    found = next((n for n in names if _unit(n, table, units) and _pick([n], other) is None), None)
    if found is not None:
        unsure.append(f"column '{found}' is taken for {what} by its unit")
    return found


def _of_two(
    named: _Names, tables: Sequence[Table], columns: Mapping[str, FloatArray], time: Section, unsure: list[str]
) -> _Names:
    """Two columns beside the time are the input and the output: where one is known by its name, the other is, too."""
    if named.drive is None and named.reading is None:
        return _by_values(tables, columns, list(columns), time, unsure)
    drive = named.drive or next(n for n in columns if n != named.reading)
    reading = next(n for n in columns if n != drive)
    speed = named.is_speed if named.reading else is_speed(_signals(tables, drive, reading, time))
    unsure.append(f"of two columns, the input is taken to be '{drive}' and a {_what(speed)} '{reading}'")
    return _Names(drive, reading, speed)


def _what(speed: bool) -> str:
    return "speed" if speed else "position"


def _by_values(
    tables: Sequence[Table], columns: Mapping[str, FloatArray], left: Sequence[str], time: Section, unsure: list[str]
) -> _Names:
    """The columns of a file whose names say nothing, or that has none.

    The input is the one that changes least often: a command is held. Of the others, the reading is the one whose change
    of speed the input explains best, taken for the position or the speed that it is. A position that the input explains
    nearly as well comes before a speed, which is often made of it.
    """
    changes = {n: np.mean(np.diff(columns[n][np.isfinite(columns[n])]) != 0) for n in left}
    drive = min(changes, key=lambda n: changes[n], default=None)
    if drive is None or changes[drive] > _HELD:
        constant = (
            n for n, v in columns.items() if n not in left and n != time.keys.get("column") and np.nanmax(v) != 0
        )
        drive = next(constant, drive)
    others = [n for n in left if n != drive]
    if drive is None or not others:
        return _Names(drive, None, False)
    seen = {n: _signals(tables, drive, n, time) for n in others}
    speeds = {n: is_speed(signals) for n, signals in seen.items()}
    share = {n: max(_explained(signals, s) for s in (True, False)) for n, signals in seen.items()}
    near = [n for n in others if share[n] >= _MIN_SHARE * max(share.values())]
    reading = min(near, key=lambda n: (speeds[n], -share[n]))
    which = f"the input is taken to be column '{drive}', a {_what(speeds[reading])} column '{reading}'"
    unsure.append(f"no name tells which is which: {which}")
    return _Names(drive, reading, speeds[reading])


def is_speed(recordings: Sequence[Signals]) -> bool:
    """Whether a reading is a speed: without a command it dies away, where a position stays as it is.

    A pendulum falls back, too. But a command that turns it explains little of the steps that its position makes.
    """
    share = _explained(recordings, True)
    if share < _MIN_SHARE and share < _explained(recordings, False):
        return False
    rows, changes = [], []
    for r in recordings:
        step = _ROWS * float(np.median(np.diff(r.time)))
        if np.ptp(r.time) > 5 * step:
            grid = to_grid(replace(r, is_speed=True), step)
            own, drive = grid.speed, grid.command
            rows.append(np.column_stack([own[:-1], drive[:-1], drive[1:], np.ones(own.size - 1)]))
            changes.append(np.diff(own))
    if not rows:
        return False
    of, change = np.concatenate(rows), np.concatenate(changes)
    of = of / np.maximum(np.sqrt(np.mean(of**2, axis=0)), 1e-300)
    coefficients = np.linalg.lstsq(of, change, rcond=1e-9)[0]
    variance = float(np.mean((change - of @ coefficients) ** 2)) * float(np.linalg.pinv(of.T @ of, rcond=1e-9)[0, 0])
    return bool(coefficients[0] < -_SURE * np.sqrt(variance))


def _signals(tables: Sequence[Table], drive: str, reading: str, time: Section) -> list[Signals]:
    """The input and a reading of the tables, for the checks before a fit."""
    found = []
    for table in tables[:_TABLES]:
        clock = time.keys.get("column", table.clock)
        y, u, *stamps = table.columns([reading, drive, *([str(clock)] if clock is not None else [])])
        t = stamps[0] if stamps else np.arange(y.size, dtype=np.float64) * float(time.keys["sample_time"])
        t = np.asarray(t * TIME_UNITS[str(time.keys.get("unit", "s"))][1], dtype=np.float64)
        good = np.flatnonzero(np.isfinite(t) & np.isfinite(u) & np.isfinite(y))
        later = good[t[good] > np.concatenate(([-np.inf], np.maximum.accumulate(t[good])[:-1]))]
        if later.size > _LEAST_ROWS:
            found.append(Signals(table.name, t[later], u[later], y[later], False, 0.0, u[later], "%"))
    return found


def _explained(recordings: Sequence[Signals], as_speed: bool) -> float:
    """The share of the change of speed that the input explains (see `twin.io.preflight.response`); 0 for none."""
    seen = response([replace(r, is_speed=as_speed) for r in recordings]) if recordings else None
    return 0.0 if seen is None else seen.share


def _optional_sections(rest: Sequence[str], table: Table, speed: bool, unit: str) -> dict[str, Section]:
    """What lies beside the input and the output and helps to tell bad readings from motion."""
    sections = {}
    beside = None if speed else _pick(rest, _SPEEDS, _REFERENCE)
    if beside is not None:
        own = _unit(beside, table, SPEED_UNITS) or ("rpm" if "rpm" in split_unit(beside)[0] else "rad/s")
        if not own.startswith("count") and unit != "count" and own.startswith("m") == unit.startswith("m"):
            sections["optional.speed"] = Section({"column": beside, "unit": own})
    for key, words in _OPTIONAL.items():
        name = _pick([n for n in rest if n != beside], words, _REFERENCE)
        if name is not None:
            own = _unit(name, table, OPTIONAL_UNITS[key]) or next(iter(OPTIONAL_UNITS[key]))
            sections[f"optional.{key}"] = Section({"column": name, "unit": own})
    return sections


def _unit(name: str, table: Table, units: Mapping[str, object]) -> str | None:
    """The unit that the file or the name gives, where it is one of these."""
    unit = spelled_unit(table.units.get(name, "")) or split_unit(name)[1]
    return unit if unit in units else None


def _time_section(table: Table, columns: Mapping[str, FloatArray], unsure: list[str]) -> Section:
    """The clock: by its name, else the stamps of the format, else the column that only rises, else a guess."""
    rising = [n for n, values in columns.items() if _rises(values)]
    name = _pick(rising, _TIME)
    if name is None and table.clock is not None:
        return Section()
    if name is None and rising:
        name = rising[0]
        unsure.append(f"column '{name}' is taken for time, as it only rises")
    if name is None:
        unsure.append("no column looks like time: sample_time is not known; write the true one")
        return Section({"sample_time": 0.001}, {"sample_time": "s; NOT KNOWN: write the true one"})
    stamps = columns[name][np.isfinite(columns[name])]
    steps = np.diff(stamps)
    # Of stamps that come in bursts the median says nothing. A counter that wraps covers less than it counts.
    step = max(float(np.median(steps)), 0.5 * float(np.sum(steps[steps > 0])) / max(stamps.size, 1))
    written = _unit(name, table, TIME_UNITS) or next(
        (u for word, u in (("millis", "ms"), ("micros", "us"), ("nanos", "ns")) if word in split_unit(name)[0]), None
    )
    sensible = {
        u: abs(np.log(step * f / 3e-3)) for u, (_, f) in TIME_UNITS.items() if SHORTEST_STEP <= step * f <= LONGEST_STEP
    }
    unit = written or min(sensible, key=lambda u: sensible[u], default="s")
    seconds = step * TIME_UNITS[unit][1]
    if written is None and (unit != "s" or not _pick([name], _TIME)):
        unsure.append(f'the unit of time is taken for "{unit}", which makes {1e3 * seconds:.4g} ms a sample')
    return Section({"column": name, "unit": unit}, {"unit": f"{1e3 * seconds:.4g} ms from sample to sample"})


def _rises(values: FloatArray) -> bool:
    """Whether a column goes on evenly, but for a counter that passes its largest number once or twice."""
    step = np.diff(values[np.isfinite(values)])
    if step.size <= 10 or np.median(step) < 0 or np.mean(step >= 0) <= 0.999:
        return False
    forward = step[step >= 0]
    return bool(np.mean(forward > 0) > 0.05 and np.std(forward) < 30 * np.mean(forward))


def _input_section(name: str, values: FloatArray, table: Table, unsure: list[str]) -> Section:
    unit = _unit(name, table, INPUT_UNITS)
    base = split_unit(name)[0]
    words = {
        "volt": "V", "spannung": "V", "vir": "V", "current": "A", "strom": "A", "torque": "N*m", "drehmoment": "N*m",
        "tau": "N*m", "effort": "N*m", "force": "N", "kraft": "N",
    }  # fmt: skip
    unit = unit or next((u for word, u in words.items() if word in base), None)
    peak = float(np.nanmax(np.abs(values)))
    if unit is None and base == "u" and 1.0 < peak <= _VOLTS:
        unit = "V"
        unsure.append(f"the input '{name}' is taken for V")
    if unit is not None and unit not in ("%", "1"):
        return Section({"column": name, "unit": unit})
    if peak <= 1.0:
        return Section({"column": name, "unit": "1"}, {"unit": f"never beyond {peak:.3g}: a fraction of full drive"})
    if peak <= 101.0:
        if unit is None and not base.startswith("duty"):
            unsure.append(f"the input '{name}' is taken for percent of full drive")
        return Section({"column": name, "unit": "%"}, {"unit": f"up to {peak:.4g}"})
    ticks = next((t for t in _TICKS if t >= peak), round(peak))
    unsure.append(f"the input '{name}' reaches {peak:.5g}: full drive is taken for {ticks}")
    return Section({"column": name, "full_scale": ticks}, {"full_scale": "ticks at full drive; CHECK"})


def _output_section(name: str, values: FloatArray, table: Table, position: bool, unsure: list[str]) -> Section:
    units = POSITION_UNITS if position else SPEED_UNITS
    finite = values[np.isfinite(values)]
    whole = np.array_equal(finite, np.round(finite))
    unit = _unit(name, table, units)
    base = split_unit(name)[0]
    if unit is None and not position:
        unit = "rpm" if any(w in base for w in ("rpm", "drehzahl")) or (whole and np.ptp(finite) > 50) else "rad/s"
        if "rpm" not in base:
            unsure.append(f"the unit of '{name}' is not known: {unit} is taken")
    if unit is None:
        counted = any(w in base for w in ("count", "enc", "ticks")) or (whole and np.ptp(finite) > 50)
        degrees = "deg" in base or (np.ptp(finite) > 60 and _pick([name], _ANGLES) is not None)
        unit = "count" if counted else "deg" if degrees else "rad"
        if unit != "count":
            unsure.append(f"the unit of '{name}' is not known: {unit} is taken")
    section = Section({"column": name, "unit": unit})
    if unit in ("count", "count/s"):
        section.remarks["unit"] = "counts_per_revolution = ..., after quadrature and gear, makes angles of them"
        unsure.append(
            "the axis is in thousands of counts (kcount): counts_per_revolution, which no log shows, makes it an angle"
        )
    return section


def write_sections(
    sections: Mapping[str, Section], log: str, columns: Iterable[str], unsure: Sequence[str] = ()
) -> str:
    """The rig file as text.

    Parameters
    ----------
    sections
        Its tables by their titles.
    log
        The name of the recording that it is written for.
    columns
        All columns of that.
    unsure
        What the user should check.
    """
    lines = [f"# What the columns of {quoted(log)} are. Columns: {', '.join(map(quoted, columns))}"]
    lines += [f"# CHECK: {u}" for u in unsure]
    titles = ("time", "input", "input.direction", "output", *(s for s in sections if s.startswith("optional")))
    for title in (t for t in titles if t in sections):
        lines.append(f"\n[{title}]")
        for key, value in sections[title].keys.items():
            said = quoted(value) if isinstance(value, str) else f"{value:.10g}"
            remark = sections[title].remarks.get(key)
            lines.append(f"{key} = {said}" + (f"  # {remark}" if remark else ""))
    lines.append("\n[known]\n# inertia = 0.012  # kg m^2, where it is known: turns accelerations into N*m")
    return "\n".join(lines) + "\n"
