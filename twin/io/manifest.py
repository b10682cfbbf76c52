"""Manifests: a CSV that names recordings, the role of each and what is known of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from twin.errors import BadInput
from twin.io.tables import TextRows, read_rows, split_cells

_OWN_COLUMNS = ("file", "role", "start", "end")


@dataclass(frozen=True)
class Entry:
    """One recording to load: a path given by the user, or a line of a manifest. `start`, `end` in s."""

    path: Path
    role: str = "train"
    known: Mapping[str, float] = field(default_factory=dict)
    start: float | None = None
    end: float | None = None


def entries_of(path: Path) -> list[Entry]:
    """The recordings that a path stands for: itself, or every line of it when it is a manifest.

    A manifest is a text table with a column `file`. Raises BadInput for a line that cannot be used.
    """
    if path.suffix.lower() not in (".csv", ".txt", ".tsv") or not path.is_file():
        return [Entry(path)]
    rows = read_rows(path)
    if "file" not in rows.header:
        if any(name.lower() == "file" for name in rows.header):
            raise BadInput(f"{path}: line 1: a manifest's column is 'file', in small letters; rename it")
        return [Entry(path)]
    table = _table(rows)
    numeric = [
        name
        for name in rows.header
        if name not in _OWN_COLUMNS
        and any(row[name] for row in table)
        and all(_finite(row[name]) is not None for row in table if row[name])
    ]
    return [
        _entry(path, f"{path}: line {number}", row, numeric) for number, row in zip(rows.numbers, table, strict=True)
    ]


def _table(rows: TextRows) -> list[dict[str, str]]:
    if not rows.lines:
        raise BadInput(f"{rows.name}: a manifest without rows; add a line per recording")
    table = []
    for number, line in zip(rows.numbers, rows.lines, strict=True):
        cells = split_cells(line, rows.separator)
        if len(cells) != len(rows.header):
            raise BadInput(
                f"{rows.name}: line {number} has {len(cells)} cells and the header {len(rows.header)}; "
                "complete or delete that line"
            )
        table.append(dict(zip(rows.header, cells, strict=True)))
    return table


def _entry(path: Path, where: str, row: Mapping[str, str], numeric: list[str]) -> Entry:
    file = path.parent / row["file"]
    if not row["file"] or not _is_file(file):
        raise BadInput(f"{where}, column 'file': no such file '{row['file']}'; paths are relative to the manifest")
    role = row.get("role") or "train"
    if role not in ("train", "holdout"):
        raise BadInput(f"{where}, column 'role': '{role}' is not known; use train or holdout")
    known = {name: value for name in numeric if (value := _finite(row[name])) is not None}
    return Entry(file, role, known, _seconds(row, "start", where), _seconds(row, "end", where))


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long
        return False


def _seconds(row: Mapping[str, str], name: str, where: str) -> float | None:
    text = row.get(name, "")
    value = _finite(text)
    if text and value is None:
        raise BadInput(f"{where}, column '{name}': '{text}' is not a number of seconds")
    return value


def _finite(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
