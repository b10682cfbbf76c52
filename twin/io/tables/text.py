"""Delimited text: CSV and its dialects.

The shape of a file follows from its rows of numbers, not from its first line. The separator is the one that cuts most
lines into the same number of cells that are numbers. The first row is the first such line. The names stand in the
nearest line above it that has as many cells and holds no number.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from twin.errors import BadInput
from twin.io.tables.table import FloatArray, Table, read_bytes
from twin.io.units import spelled_unit

SEPARATORS: tuple[str | None, ...] = (";", "\t", ",", "|", None)  # None: runs of blanks
#: Cells that say that there is no value, in small letters.
MISSING = frozenset(
    ["nan", "null", "none", "nil", "n/a", "na", "#n/a", "#value!", "#div/0!", "-", "--", "?", "inf", "-inf", "+inf"]
) | {""}
_WORDS = {"true": 1.0, "false": 0.0, "on": 1.0, "off": 0.0}
_COMMENT = re.compile(r"\s*(#|%|//)+\s?")
_DATE = re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d.*)?|\d{1,2}:\d\d(:\d\d)?([.,]\d+)?")
_SAMPLE = 200  # lines from which the shape of a file is judged, from its middle on
_SAMPLE_CHARACTERS = 2_000_000
_JUDGED = 1000  # cells of a line that are looked at
_CHUNK = 20_000  # rows that are read at once; a chunk with a cell that is no number is read cell by cell


@dataclass(frozen=True)
class TextRows:
    """The lines of a delimited text file with their 1-based line numbers, and what its columns are called."""

    name: str
    separator: str | None  # None: runs of blanks
    header: tuple[str, ...]
    lines: Sequence[str]
    numbers: Sequence[int]
    units: tuple[str, ...] = ()
    has_header: bool = True


def decode(path: Path) -> str:
    """The text of a file: UTF-8, UTF-16 with or without its mark, else Windows' Western European characters.

    Raises
    ------
    BadInput
        Where the file cannot be read or is binary.
    """
    data = read_bytes(path)
    alternating = len(data) > 3 and data[:2].count(0) == 1 and data[2:4].count(0) == 1
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or alternating:
        big = data[:2] == b"\xfe\xff" or (alternating and data[0] == 0)
        text = data.decode("utf-16-be" if big else "utf-16-le", "replace").lstrip("\ufeff")
        if "\0" not in text:
            return text
    if data[:4] == b"PK\3\4":
        raise BadInput(f"{path}: is an Excel or zip file, not a text table; save the sheet as CSV, or unpack the file")
    if b"\0" in data:
        raise BadInput(f"{path}: byte {data.index(0)} is 0: a binary file, not a text table; export it as CSV")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def split_lines(text: str) -> tuple[list[str], str | None]:
    """The lines of a text without blank ones at its end, and the separator where a first line `sep=;` names it.

    A line that names the separator becomes blank, so that the numbers of the others stay.
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    named = re.fullmatch(r'"?sep=(.)"?[;,\t]*', lines[0].strip("\ufeff ")) if lines else None
    if named is not None:
        lines[0] = ""
    return lines, named.group(1) if named is not None else None


def split_cells(line: str, separator: str | None) -> list[str]:
    """The cells of one line, without blanks and quotes around them."""
    if separator is None:
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        cells = line.split(separator)
    return [cell.strip() for cell in cells]


def without_trailing(cells: list[str], width: int) -> list[str]:
    """The cells without empty ones that a separator at the end of the line makes."""
    while len(cells) > width and not cells[-1]:
        cells.pop()
    return cells


def is_number(cell: str, decimal_comma: bool = False) -> bool:
    """Whether a cell is a number, a date or a time of day."""
    try:
        float(cell.replace(",", ".", 1) if decimal_comma else cell)
    except ValueError:
        return cell.lower() in _WORDS or _DATE.fullmatch(cell) is not None
    return cell.lower() not in MISSING


def _count_numbers(cells: Sequence[str], separator: str | None) -> int:
    return sum(is_number(cell, separator != ",") for cell in cells[:_JUDGED])


def is_comment(line: str) -> bool:
    """Whether a line below the header is a comment."""
    return line.startswith(("#", "%", "//"))


@dataclass(frozen=True)
class _Shape:
    separator: str | None
    width: int  # cells of most rows
    numbers: int  # numbers in a usual row


def _shape(lines: Sequence[str], named: str | None) -> _Shape | None:
    """Separator, width and count of numbers of most rows; None where no lines are alike."""
    full = [line for line in lines if line.strip() and not is_comment(line)]
    size = min(_SAMPLE, max(3, _SAMPLE_CHARACTERS // (len(full[-1]) + 1))) if full else 0
    start = max(0, min(len(full) // 2, len(full) - size))
    sample = full[start : start + size]
    best: tuple[float, _Shape | None] = (0.0, None)
    for separator in (named,) if named is not None else SEPARATORS:
        split = [split_cells(line, separator) for line in sample]
        width, alike = Counter(map(len, split)).most_common(1)[0] if split else (0, 0)
        rows = [cells for cells in split if len(cells) == width]
        numbers = [_count_numbers(cells, separator) for cells in rows]
        # what is cut too finely or not at all leaves cells that are no numbers
        filled = sum(1 for cells in rows for cell in cells[:_JUDGED] if cell.lower() not in MISSING)
        score = alike / len(split) * sum(numbers) / filled if width > 1 and filled else 0.0
        if score > best[0]:
            best = score, _Shape(separator, width, sorted(numbers)[len(numbers) // 2])
    return best[1]


def _is_row(line: str, shape: _Shape) -> bool:
    cells = without_trailing(split_cells(line, shape.separator), shape.width)
    return len(cells) == shape.width and 2 * _count_numbers(cells, shape.separator) >= max(shape.numbers, 1)


def read_rows(path: Path) -> TextRows:
    """The header and the rows of a delimited text file.

    Comments and other lines above the header are passed over, a row of units below it is kept apart. Without a header
    the columns are called by their numbers, from 1. A last line that breaks off is left out: so does a log end when
    the power goes.

    Raises
    ------
    BadInput
        For binary data, an empty file, rows without numbers, or a header that does not fit the rows.
    """
    text = decode(path)
    lines, named = split_lines(text)
    if not any(line.strip() for line in lines):
        raise BadInput(f"{path}: is empty; give a recording with a header line and rows of numbers")
    shape = _shape(lines, named)
    first = -1 if shape is None else next((k for k, line in enumerate(lines) if _is_row(line, shape)), -1)
    if shape is None or first < 0:
        said = "only a header line, no rows below it" if len(lines) < 3 else "no rows of numbers in it"
        raise BadInput(f"{path}: {said}; give a recording with data")
    header, units = _header(path, lines, first, shape)
    body, numbers = lines[first:], range(first + 1, len(lines) + 1)
    width = len(header) if header else shape.width
    cut = split_cells(body[-1], shape.separator)
    if not text.endswith(("\n", "\r")) and len(cut) < width and len(body) > 1:
        body, numbers = body[:-1], numbers[:-1]
    kept: Sequence[int] = numbers
    if any(not line or line.isspace() or is_comment(line) for line in body):
        pairs = [(n, line) for n, line in zip(numbers, body, strict=True) if line.strip() and not is_comment(line)]
        kept, body = [n for n, _ in pairs], [line for _, line in pairs]
    if shape.separator != ",":
        body = [line.replace(",", ".") for line in body]
    names = tuple(name or str(k + 1) for k, name in enumerate(header or [""] * width))
    return TextRows(str(path), shape.separator, names, body, kept, tuple(units), bool(header))


def _header(path: Path, lines: Sequence[str], first: int, shape: _Shape) -> tuple[list[str], list[str]]:
    """Names and units from the lines above the first row; no names where there are none."""
    units: list[str] = []
    above = [(k, line) for k, line in enumerate(lines[:first]) if line.strip()]
    for _, line in reversed(above[-50:]):
        cells = _names_in(line, shape)
        if not cells:
            continue
        if not units and len(above) > 1 and all(spelled_unit(cell) is not None for cell in cells if cell):
            units = [spelled_unit(cell) or "" for cell in cells]
            continue
        return cells, units
    if above and not units:
        k, line = above[-1]
        cells = split_cells(line, shape.separator)
        if len(cells) > 1 and not is_comment(line) and not _count_numbers(cells, shape.separator):
            raise BadInput(
                f"{path}: line {k + 1} names {len(cells)} columns and line {first + 1} has {shape.width} cells; "
                "complete the header"
            )
    return [], units


def _names_in(line: str, shape: _Shape) -> list[str]:
    """The cells of a line that may name the columns, also in a comment or cut by another separator; else none."""
    comment = _COMMENT.match(line)
    choices: Sequence[str | None] = (shape.separator,)
    if comment:
        line, choices = line[comment.end() :], SEPARATORS  # blanks last: they also follow commas
    for separator in choices:
        cells = without_trailing(split_cells(line, separator), shape.width)
        filled = [cell for cell in cells if cell]
        if (
            len(cells) == shape.width
            and 2 * len(filled) >= len(cells)
            and not any(is_number(cell, True) or cell.lower() in MISSING - {"-"} for cell in filled)
        ):
            return cells
    return []


def open_text(path: Path) -> Table:
    """Open a delimited text file. Raises BadInput as `read_rows` does."""
    rows = read_rows(path)
    units = {name: unit for name, unit in zip(rows.header, rows.units, strict=False) if unit}

    def where(row: int) -> str:
        return f"line {rows.numbers[row]}"

    return Table(str(path), rows.header, lambda names: _columns(rows, names), where=where, units=units)


def _columns(rows: TextRows, names: Sequence[str]) -> list[FloatArray]:
    places = {name: k for k, name in reversed(list(enumerate(rows.header)))}
    count = Counter(rows.header)
    for name in names:
        if count[name] > 1:
            raise BadInput(f"{rows.name}: line {rows.numbers[0] - 1}: column '{name}' comes twice; rename one of them")
    use = [places[name] for name in names]
    table = np.empty((len(use), len(rows.lines)))
    readers: list[Callable[[str], float] | None] = [None] * len(use)
    for start in range(0, len(rows.lines), _CHUNK):
        chunk = slice(start, min(start + _CHUNK, len(rows.lines)))
        if not _read_fast(rows, use, chunk, table):
            _read_cells(rows, use, chunk, table, readers)
    return list(table)


def _read_fast(rows: TextRows, use: Sequence[int], chunk: slice, table: FloatArray) -> bool:
    """Rows that hold nothing but numbers in the columns asked for; False where there is anything else."""
    lines, mark = rows.lines[chunk], rows.separator
    marks = {line.count(mark) for line in lines} if mark is not None else set()
    extra = min(marks, default=-1) - len(rows.header) + 1
    if mark is None or len(marks) > 1 or extra < 0 or not all(line.endswith(mark * extra) for line in lines):
        return False
    try:
        table[:, chunk] = np.loadtxt(lines, delimiter=mark, usecols=use, comments=None, ndmin=2).T
    except (ValueError, OverflowError):
        return False
    return True


def _read_cells(
    rows: TextRows,
    use: Sequence[int],
    chunk: slice,
    table: FloatArray,
    readers: list[Callable[[str], float] | None],
) -> None:
    """Cell by cell: missing ones become NaN, and what cannot be read is named with its line and column."""
    width = len(rows.header)
    for k in range(chunk.start, chunk.stop):
        cells = without_trailing(split_cells(rows.lines[k], rows.separator), width)
        if len(cells) != width:
            kind = "header" if rows.has_header else "first row"
            raise BadInput(
                f"{rows.name}: line {rows.numbers[k]} has {len(cells)} cells and the {kind} {width}; "
                "complete or delete that line"
            )
        for i, column in enumerate(use):
            cell = cells[column]
            if cell.lower() in MISSING:
                table[i, k] = math.nan
                continue
            reader = readers[i] = readers[i] or (_read_date if _DATE.fullmatch(cell) else _read_number)
            try:
                table[i, k] = reader(cell)
            except ValueError:
                where = f"line {rows.numbers[k]}, column '{rows.header[column]}'"
                raise BadInput(f"{rows.name}: {where}: {cell[:40]!r} is no number; {_advice(cell)}") from None


def _read_number(cell: str) -> float:
    word = _WORDS.get(cell.lower())
    return float(cell) if word is None else word


def _read_date(cell: str) -> float:
    """Seconds since 1970, or of the day."""
    if ":" in cell and "-" not in cell:
        hours, minutes, *seconds = cell.replace(",", ".").split(":")
        if seconds:
            return 3600.0 * float(hours) + 60.0 * float(minutes) + float(seconds[0])
        return 60.0 * float(hours) + float(minutes)
    stamp = datetime.fromisoformat(cell)
    return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()


def _advice(cell: str) -> str:
    """What to do about a cell that is no number."""
    if _DATE.fullmatch(cell):
        return "give times in seconds, or leave the column out and say [time] sample_time in the rig file"
    if re.fullmatch(r"[-+]?\d*,\d+", cell):
        return "write it with a decimal point, or separate cells by semicolons"
    return "correct or empty it"


def read_cells(path: Path) -> TextRows:
    """A table of texts, as a manifest is: its first line that is no comment names the columns.

    Raises
    ------
    BadInput
        As `decode`; for an empty file, or a name that comes twice.
    """
    lines, named = split_lines(decode(path))
    rows = [(k + 1, line) for k, line in enumerate(lines) if line.strip() and not is_comment(line.lstrip())]
    if not rows:
        raise BadInput(f"{path}: is empty; give a line that names the columns, and rows below it")
    number, head = rows[0]
    separator = named or next((mark for mark in SEPARATORS if mark is not None and mark in head), ",")
    header = split_cells(head, separator)
    while header and not header[-1]:
        header.pop()
    for name, count in Counter(header).items():
        if name and count > 1:
            raise BadInput(f"{path}: line {number}: column '{name}' comes twice; rename one of them")
    return TextRows(str(path), separator, tuple(header), [line for _, line in rows[1:]], [n for n, _ in rows[1:]])
