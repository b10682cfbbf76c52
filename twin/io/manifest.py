"""Manifests: a CSV that names recordings, the role of each and what is known of it."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from twin.errors import BadInput
from twin.io.tables.table import listing
from twin.io.tables.text import MISSING, TextRows, read_cells, split_cells, without_trailing
from twin.io.units import KNOWN_UNITS

_OWN_COLUMNS = ("file", "test", "role", "start", "end")
_FLEET_COLUMNS = ("axis", "rig")
_LONGEST_AXIS = 100  # bytes of an axis' name, which names a folder
_HEAD = 65536  # bytes in which the word `file` stands where a table is a manifest


@dataclass(frozen=True)
class Entry:
    """One recording to load: a path given by the user, or a line of a manifest. `start`, `end` in s; `test` is the one
    that is meant of a file that holds several, empty for all of them.
    """

    path: Path
    role: str = "train"
    known: Mapping[str, float] = field(default_factory=dict)
    start: float | None = None
    end: float | None = None
    test: str = ""


@dataclass(frozen=True)
class Axis:
    """One axis of a fleet: its name, its recordings, and its rig file where the list names one."""

    name: str
    entries: tuple[Entry, ...]
    rig: Path | None = None


def entries_of(path: Path) -> list[Entry]:
    """The recordings that a path stands for: itself, or every line of it when it is a manifest.

    A manifest is a text table with a column `file`, in any dialect that a recording may have. Numbers in columns such
    as `payload_mass [g]` are converted. Raises BadInput for a line that cannot be used.
    """
    rows = _manifest_rows(path)
    if rows is None:
        return [Entry(path)]
    table = _table(rows)
    numeric = _numeric(rows, table)
    entries = []
    for number, row in zip(rows.numbers, table, strict=True):
        where = f"{path}: line {number}"
        entry = _entry(path, where, row, numeric)
        if not _is_there(entry.path):
            raise BadInput(f"{where}, column 'file': no such file '{row['file']}'; paths are relative to the manifest")
        entries.append(entry)
    return entries


def expand(entries: Sequence[Entry]) -> list[Entry]:
    """The entries, with those of a manifest in the place of one that is a manifest. Raises BadInput."""
    told = []
    for entry in entries:
        inside = entries_of(entry.path)
        told += [entry] if inside == [Entry(entry.path)] else inside
    return told


def read_fleet(path: Path) -> list[Axis]:
    """The axes of a fleet, in the order of the list.

    A fleet is a manifest with a column `axis`: rows of the same axis are recordings of it. An optional column `rig`
    names the rig file of an axis. Whether the files are there is not asked: they may lie where only the workers of a
    cluster see them. Raises BadInput for a line that cannot be used.
    """
    if not path.is_file():
        raise BadInput(f"{path} does not exist: give a CSV with the columns axis and file")
    rows = read_cells(path)
    for name in ("axis", "file"):
        if name not in rows.header:
            raise BadInput(f"{path}: line 1 has no column '{name}': a fleet has the columns axis and file")
    table = _table(rows)
    numeric = [n for n in _numeric(rows, table) if n not in _FLEET_COLUMNS]
    entries: dict[str, list[Entry]] = {}
    rigs: dict[str, str] = {}
    for number, row in zip(rows.numbers, table, strict=True):
        where, name = f"{path}: line {number}", row["axis"]
        _check_axis(where, name)
        entries.setdefault(name, []).append(_entry(path, where, row, numeric))
        rig = row.get("rig", "")
        if rigs.setdefault(name, rig) != rig:
            raise BadInput(f"{where}, column 'rig': '{rig}', where axis {name} has '{rigs[name]}': give one rig file")
    return [Axis(n, tuple(e), path.parent / rigs[n] if rigs[n] else None) for n, e in entries.items()]


def _check_axis(where: str, name: str) -> None:
    """Raises BadInput where an axis' name cannot name a folder."""
    if not name:
        raise BadInput(f"{where}, column 'axis': is empty; name the axis")
    unfit = name.startswith(".") or any(c in '/\\:*?"<>|' or not c.isprintable() for c in name)
    if unfit or len(name.encode()) > _LONGEST_AXIS or name.startswith("fleet."):
        raise BadInput(f"{where}, column 'axis': '{name}' cannot name a folder; use letters, digits, - and _")


def _numeric(rows: TextRows, table: list[dict[str, str]]) -> list[str]:
    """The columns that hold known quantities: numbers, and none of the manifest's own."""
    return [
        name
        for name in rows.header
        if _quantity(name)[0] not in _OWN_COLUMNS
        and any(row[name] for row in table)
        and all(_finite(row[name]) is not None for row in table if row[name])
    ]


def is_manifest(path: Path) -> bool:
    """Whether a file lists recordings. Raises BadInput where it seems to, but does not say so rightly."""
    return _manifest_rows(path) is not None


def _manifest_rows(path: Path) -> TextRows | None:
    """The rows of a manifest; None for any other file."""
    if path.suffix.lower() not in (".csv", ".txt", ".tsv") or not path.is_file() or not _may_be_manifest(path):
        return None
    rows = read_cells(path)
    if "file" in rows.header:
        return rows
    if any(name.lower() == "file" for name in rows.header):
        raise BadInput(f"{path}: line 1: a manifest's column is 'file', in small letters; rename it")
    return None


def _may_be_manifest(path: Path) -> bool:
    """Whether the word `file` stands in the first lines: so a long recording is not read twice."""
    try:
        with path.open("rb") as stream:
            return b"file" in stream.read(_HEAD).replace(b"\0", b"").lower()
    except OSError:
        return False


def _table(rows: TextRows) -> list[dict[str, str]]:
    if not rows.lines:
        raise BadInput(f"{rows.name}: a manifest without rows; add a line per recording")
    table = []
    for number, line in zip(rows.numbers, rows.lines, strict=True):
        cells = without_trailing(split_cells(line, rows.separator), len(rows.header))
        if len(cells) != len(rows.header):
            raise BadInput(
                f"{rows.name}: line {number} has {len(cells)} cells and the header {len(rows.header)}; "
                "complete or delete that line"
            )
        empty = ["" if cell.lower() in MISSING else cell for cell in cells]
        points = [_with_point(cell) if rows.separator != "," else cell for cell in empty]
        table.append(dict(zip(rows.header, points, strict=True)))
    return table


def _with_point(cell: str) -> str:
    """A number with a decimal comma, written with a point; other texts as they are."""
    changed = cell.replace(",", ".", 1)
    return changed if _finite(changed) is not None else cell


def _quantity(name: str) -> tuple[str, float]:
    """'payload_mass [g]' -> ('payload_mass', 1e-3). Raises BadInput for a unit that is not known."""
    match = re.fullmatch(r"(.*?)\s*[(\[]\s*([^)\]]+?)\s*[)\]]", name)
    if match is None:
        return name, 1.0
    base, unit = match.groups()
    if unit not in KNOWN_UNITS:
        raise BadInput(f"manifest column '{name}': unit '{unit}' is not known; use one of {listing(list(KNOWN_UNITS))}")
    return base, KNOWN_UNITS[unit]


def _entry(path: Path, where: str, row: Mapping[str, str], numeric: list[str]) -> Entry:
    if not row["file"]:
        raise BadInput(f"{where}, column 'file': is empty; name a recording, relative to the manifest")
    role = row.get("role") or "train"
    if role not in ("train", "holdout"):
        raise BadInput(f"{where}, column 'role': '{role}' is not known; use train or holdout")
    known = {}
    for name in numeric:
        value, (base, factor) = _finite(row[name]), _quantity(name)
        if value is not None:
            known[base] = value * factor
    start, end = (_seconds(row, name, where) for name in ("start", "end"))
    return Entry(path.parent / row["file"], role, known, start, end, row.get("test", ""))


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that is too long
        return False


def _seconds(row: Mapping[str, str], name: str, where: str) -> float | None:
    """A time in s; the column may give its unit, as in `start [ms]`."""
    for column, text in row.items():
        base, factor = _quantity(column) if column.startswith(name) else (column, 1.0)
        if base != name or not text:
            continue
        value = _finite(text)
        if value is None:
            raise BadInput(f"{where}, column '{column}': '{text}' is not a number of seconds")
        return value * factor
    return None


def _finite(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
