"""A rig file written from a log: what its columns are, by their names and by what stands in them."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from twin.errors import BadInput
from twin.io.clock import LONGEST_STEP, SHORTEST_STEP
from twin.io.faults import FloatArray
from twin.io.recording import load
from twin.io.rig_file import split_unit
from twin.io.tables.formats import open_tables
from twin.io.tables.table import Table, listing
from twin.io.units import INPUT_UNITS, OPTIONAL_UNITS, POSITION_UNITS, SPEED_UNITS, TIME_UNITS, spelled_unit

#: Parts of names, the likeliest first. A drive comes before what may be a reference or a measurement.
_TIME = ("time", "stamp", "clock", "seconds", "millis", "micros", "t")
_INPUT = ("duty", "pwm", "volt", "torque", "tau", "force", "effort", "drive", "control", "input", "current", "command",
          "cmd", "u", "vir", "i")  # fmt: skip
_REFERENCE = ("ref", "goal", "target", "setpoint", "desired", "sp", "des")
_POSITION = (
    "count",
    "encoder",
    "enc",
    "position",
    "pos",
    "theta",
    "angle",
    "phi",
    "deg",
    "q",
    "qm",
    "output",
    "y",
    "x",
)
_SPEED = ("speed", "velocity", "omega", "rpm", "vel", "w", "v", "output", "y")
_OPTIONAL = {"temperature": ("temp",), "supply": ("supply", "battery", "vbat", "vbus"), "current": ("current", "amps")}
_DIRECTION = ("dir", "direction", "sign")
#: Ticks at full drive of common timers, and counts per revolution to stand in until the right number is given.
_TICKS = (255, 1000, 1023, 4095, 10_000, 32_767, 65_535)
_STAND_IN = 4096
#: The cures that the checks before a fit name, and how often they are tried.
_ROUNDS = 4


@dataclass
class Section:
    """One table of the rig file: keys with their values, and what is said of each."""

    keys: dict[str, str | float] = field(default_factory=dict)
    remarks: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Draft:
    """A rig file as text, what the user should check in it, and its tables by their titles, as `input.direction`."""

    text: str
    unsure: tuple[str, ...]
    sections: Mapping[str, Section]


def draft(log: Path) -> Draft:
    """Look at a log and write its rig file.

    Parameters
    ----------
    log
        A recording of any format that can be read.

    Returns
    -------
    Draft
        The text of a rig file that loads the recording. Faults that the checks before a fit find, such as a reversed
        sensor or a lost sign, are corrected in it. What a log cannot show is said as a comment.

    Raises
    ------
    BadInput
        The log cannot be read, or has no column that can be the input or the output.
    """
    table = open_tables(log)[0]
    columns = numeric_columns(table)
    sections, unsure = guess_sections(table, columns)
    for _ in range(_ROUNDS):
        text = write_sections(sections, log.name, columns, unsure)
        cure = _cure(log, text, sections, columns)
        if not cure:
            break
        unsure.append(cure)
    return Draft(write_sections(sections, log.name, columns, unsure), tuple(unsure), sections)


def numeric_columns(table: Table) -> dict[str, FloatArray]:
    """The columns that hold numbers."""
    found: dict[str, FloatArray] = {}
    for name in table.names[:200]:
        try:
            (values,) = table.columns([name])
        except BadInput:  # a column of text
            continue
        if np.isfinite(values).sum() > 0.1 * values.size:
            found[name] = values
    return found


def _pick(names: Sequence[str], words: Sequence[str], without: Sequence[str] = ()) -> str | None:
    """The first name that is, begins with or holds one of the words; a short word has to be the whole name."""
    bases = {name: split_unit(name)[0] for name in names}
    allowed = [n for n in names if not any((len(w) > 2 and w in bases[n]) or w == bases[n] for w in without)]
    for word in words:
        for name in allowed:
            if bases[name] == word or (len(word) > 2 and word in bases[name]):
                return name
    return None


def guess_sections(table: Table, columns: Mapping[str, FloatArray]) -> tuple[dict[str, Section], list[str]]:
    """The rig file's tables by the names of the columns and what stands in them, and what the user should check.

    Raises
    ------
    BadInput
        No column can be the input or the output.
    """
    unsure: list[str] = []
    time = _time_section(table, columns, unsure)
    left = [n for n in columns if n != time.keys.get("column") and np.nanmax(columns[n]) > np.nanmin(columns[n])]
    position = _pick(left, _POSITION, (*_REFERENCE, *_INPUT[:8]))
    reading = position or _pick(left, _SPEED, (*_REFERENCE, *_INPUT[:8]))
    drive = _pick([n for n in left if n != reading], _INPUT, _REFERENCE)
    if drive is None or reading is None:
        what = "the input" if drive is None else "the output"
        raise BadInput(
            f"{table.name}: no column looks like {what}; columns are: {listing(list(columns))}; write a rig.toml that "
            "names the columns"
        )
    sections = {
        "time": time, "input": _input_section(drive, columns[drive], table, unsure),
        "output": _output_section(reading, columns[reading], table, position is not None, unsure),
    }  # fmt: skip
    rest = [n for n in left if n not in (drive, reading)]
    speed = _pick(rest, _SPEED[:5], _REFERENCE) if position is not None else None
    if speed is not None:
        unit = _unit(speed, table, SPEED_UNITS) or "rad/s"
        if not unit.startswith("count"):
            sections["optional.speed"] = Section({"column": speed, "unit": unit})
    for key, words in _OPTIONAL.items():
        name = _pick([n for n in rest if n != speed], words, _REFERENCE)
        if name is not None:
            unit = _unit(name, table, OPTIONAL_UNITS[key]) or next(iter(OPTIONAL_UNITS[key]))
            sections[f"optional.{key}"] = Section({"column": name, "unit": unit})
    reference = next((n for n in rest if _pick([n], _REFERENCE)), None)
    if reference is not None:
        unsure.append(f"column '{reference}' looks like a reference of the rig's own loop; it is not the input")
    return sections, unsure


def _unit(name: str, table: Table, units: Mapping[str, object]) -> str | None:
    """The unit that the file or the name gives, where it is one of these."""
    unit = spelled_unit(table.units.get(name, "")) or split_unit(name)[1]
    return unit if unit in units else None


def _time_section(table: Table, columns: Mapping[str, FloatArray], unsure: list[str]) -> Section:
    """The clock: by its name, else the column that only rises, else the stamps of the format, else a guess."""
    rising = [n for n, v in columns.items() if _rises(v)]
    name = _pick(rising, _TIME) or (None if table.clock else (rising[0] if rising else None))
    if name is None and table.clock is not None:
        return Section()
    if name is None:
        unsure.append("no column looks like time: sample_time is a guess; write the true one")
        return Section({"sample_time": 0.001}, {"sample_time": "s; NOT KNOWN, a guess"})
    step = float(np.median(np.diff(columns[name][np.isfinite(columns[name])])))
    written = _unit(name, table, TIME_UNITS)
    sensible = {
        u: abs(np.log(step * f / 3e-3)) for u, (_, f) in TIME_UNITS.items() if SHORTEST_STEP <= step * f <= LONGEST_STEP
    }
    unit = written or min(sensible, key=lambda u: sensible[u], default="s")
    seconds = step * TIME_UNITS[unit][1]
    if written is None and len(sensible) > 1:
        unsure.append(f'the unit of time is taken for "{unit}", which makes {1e3 * seconds:.4g} ms a sample')
    return Section({"column": name, "unit": unit}, {"unit": f"{1e3 * seconds:.4g} ms from sample to sample"})


def _rises(values: FloatArray) -> bool:
    step = np.diff(values[np.isfinite(values)])
    return bool(step.size > 10 and np.mean(step >= 0) > 0.999 and np.mean(step > 0) > 0.05 and np.median(step) >= 0
                and np.std(step) < 30 * np.mean(step))  # fmt: skip


def _input_section(name: str, values: FloatArray, table: Table, unsure: list[str]) -> Section:
    unit = _unit(name, table, INPUT_UNITS)
    base = split_unit(name)[0]
    words = {"volt": "V", "vir": "V", "current": "A", "torque": "N*m", "tau": "N*m", "effort": "N*m", "force": "N"}
    unit = unit or next((u for word, u in words.items() if word in base), None)
    peak = float(np.nanmax(np.abs(values)))
    if unit is not None and unit not in ("%", "1"):
        return Section({"column": name, "unit": unit})
    if peak <= 1.0:
        return Section({"column": name, "unit": "1"}, {"unit": f"never beyond {peak:.3g}: a fraction of full drive"})
    if peak <= 101.0:
        if unit is None:
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
        unit = "rpm" if "rpm" in base or (whole and np.ptp(finite) > 50) else "rad/s"
        unsure.append(f"the unit of '{name}' is not known: {unit} is taken")
    if unit is None:
        counted = whole and (np.ptp(finite) > 50 or any(w in base for w in ("count", "enc")))
        degrees = not whole and (np.ptp(finite) > 60 or "deg" in base)
        unit = "count" if counted else "deg" if degrees else "rad"
        if unit != "count":
            unsure.append(f"the unit of '{name}' is not known: {unit} is taken")
    section = Section({"column": name, "unit": unit})
    if unit in ("count", "count/s"):
        section.keys["counts_per_revolution"] = _STAND_IN
        section.remarks["counts_per_revolution"] = "after quadrature and gear; NOT KNOWN: all angles scale with it"
        unsure.append("counts_per_revolution cannot be seen in a log: write the true number")
    return section


def _cure(log: Path, text: str, sections: dict[str, Section], columns: Mapping[str, FloatArray]) -> str:
    """Load the log with the rig file, mend in it what the checks before a fit find, and say what was mended."""
    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "rig.toml"
        rig.write_text(text, encoding="utf-8")
        try:
            recordings, _ = load([log], rig)
        except BadInput as error:
            if "signed_bits = 16" in str(error) and "signed_bits" not in sections["input"].keys:
                sections["input"].keys["signed_bits"] = 16
                return "the input holds signed numbers of 16 bits"
            raise BadInput(str(error).replace(str(rig), "the rig file")) from None
    findings = {f.kind: f for r in recordings for f in r.preflight}
    drive, reading = sections["input"], sections["output"]
    if "sign" in findings and "scale" not in reading.keys:
        reading.keys["scale"] = -1
        reading.remarks["scale"] = "a positive input drove the reading down"
        return "the output moves against the input: scale = -1 turns it round"
    magnitude = bool(np.nanmin(columns[str(drive.keys["column"])]) >= 0.0)
    two = [n for n, v in columns.items() if 2 <= np.unique(v[np.isfinite(v)]).size <= 3]
    sign = _pick(two, _DIRECTION) or ("direction" in findings and next(iter(two), None)) or None
    if magnitude and sign is not None and "input.direction" not in sections:
        sections["input.direction"] = Section({"column": sign})
        return f"the input has no sign of its own: column '{sign}' gives it"
    if "unsigned_input" in findings and "signed_bits" not in drive.keys:
        bits = next(b for b in (8, 16, 32) if f"signed_bits = {b} " in findings["unsigned_input"].says)
        drive.keys["signed_bits"] = bits
        return f"the input holds signed numbers of {bits} bits"
    if "refresh" in findings and recordings[0].refresh is not None:
        reading.keys["refresh"] = float(f"{recordings[0].refresh:.3g}")
        reading.remarks["refresh"] = "s; the sensor is read anew only so often"
        return "the sensor is read more slowly than it is logged (refresh)"
    return ""


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
    lines = [f"# What the columns of {json.dumps(log)} are. Columns: {', '.join(map(json.dumps, columns))}"]
    lines += [f"# CHECK: {u}" for u in unsure]
    titles = ("time", "input", "input.direction", "output", *(s for s in sections if s.startswith("optional")))
    for title in (t for t in titles if t in sections):
        lines.append(f"\n[{title}]")
        for key, value in sections[title].keys.items():
            said = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else f"{value:.10g}"
            remark = sections[title].remarks.get(key)
            lines.append(f"{key} = {said}" + (f"  # {remark}" if remark else ""))
    lines.append("\n[known]\n# inertia = 0.012  # kg m^2, where it is known: turns accelerations into N*m")
    return "\n".join(lines) + "\n"
