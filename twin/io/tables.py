"""Tables as they lie on disk: CSV, Parquet, MAT (v5 and v7.3), MDF4 and MCAP.

`open_table` reads the names of the columns; the numbers are read when they are asked for, so that columns
which nobody needs may hold anything.
"""

import csv
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin.errors import BadInput

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Table:
    """Named columns of one file.

    `read(names)` gives equally long float columns, NaN where a cell is empty or not finite; when columns
    have clocks of their own, the rows are those of the first name. `clock`: the pseudo-column with the
    format's own stamps in s. `where(row)` says in words where a row is found in the file.
    """

    name: str
    names: tuple[str, ...]
    read: Callable[[Sequence[str]], list[FloatArray]]
    scalars: Mapping[str, float] = field(default_factory=dict)
    clock: str | None = None
    where: Callable[[int], str] = lambda row: f"row {row + 1}"

    def columns(self, names: Sequence[str]) -> list[FloatArray]:
        """The columns asked for; BadInput names those that there are when one is missing."""
        for name in names:
            if name not in self.names and name != self.clock:
                raise BadInput(f"{self.name}: no column '{name}'; columns are: {', '.join(self.names)}")
        return self.read(names)


def open_table(path: Path) -> Table:
    """Open a recording of any format we know, told apart by the ending of its name.

    Raises BadInput when it cannot be read as that format.
    """
    path = Path(path)
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; give a recording or a manifest")
    if not path.exists():
        raise BadInput(f"{path}: no such file; check the path")
    readers: dict[str, Callable[[Path], Table]] = {
        ".parquet": _open_parquet,
        ".pq": _open_parquet,
        ".mat": _open_mat,
        ".mf4": _open_mdf,
        ".mdf": _open_mdf,
        ".mcap": _open_mcap,
    }
    return readers.get(path.suffix.lower(), _open_text)(path)


# --- text ---


@dataclass(frozen=True)
class TextRows:
    """A delimited text file: its header, and the lines below it with their 1-based line numbers."""

    name: str
    separator: str | None  # None: runs of blanks
    header: tuple[str, ...]
    lines: list[str]
    numbers: Sequence[int]


def read_rows(path: Path) -> TextRows:
    """The header and the lines of a delimited text file; separator and decimal comma are recognised.

    Raises BadInput for another encoding, binary data, an empty file, a missing header or a name that comes
    twice.
    """
    text = _decode(path)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    first = 0
    comment = ""
    while first < len(lines) and (not lines[first].strip() or lines[first].lstrip().startswith("#")):
        comment = lines[first].lstrip().lstrip("#").strip() or comment
        first += 1
    if not lines or (first == len(lines) and not comment):
        raise BadInput(f"{path}: is empty; give a recording with a header line and rows of numbers")
    head = lines[first] if first < len(lines) else comment
    separator = _separator(head)
    cells = split_cells(head, separator)
    if all(_is_number(cell) for cell in cells):
        # numpy.savetxt puts the names in a comment above the numbers
        cells = split_cells(comment, _separator(comment)) if comment else cells
        if len(cells) != len(split_cells(head, separator)) or all(_is_number(cell) for cell in cells):
            raise BadInput(f"{path}: line {first + 1} holds numbers; the first line must name the columns")
        first -= 1
    header = tuple(cells)
    for name in header:
        if name and header.count(name) > 1:
            raise BadInput(f"{path}: line {first + 1}: column '{name}' comes twice; rename one of them")
    body = lines[first + 1 :]
    numbers: Sequence[int] = range(first + 2, len(lines) + 1)
    if any(not line or line.isspace() or line.startswith("#") for line in body):
        kept = [(n, ln) for n, ln in zip(numbers, body, strict=True) if ln.strip() and not ln.startswith("#")]
        numbers, body = [n for n, _ in kept], [line for _, line in kept]
    if separator != "," and any("," in line for line in body[:20]):
        body = [line.replace(",", ".") for line in body]
    return TextRows(str(path), separator, header, body, numbers)


def _decode(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror})") from None
    alternating = len(data) > 3 and data[:2].count(0) == 1 and data[2:4].count(0) == 1
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or alternating:
        raise BadInput(f"{path}: looks like UTF-16 text; save it as UTF-8")
    if b"\0" in data:
        raise BadInput(f"{path}: byte {data.index(0)} is 0: a binary file, not a text table; export it as CSV")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise BadInput(
            f"{path}: line {line}: byte 0x{data[error.start]:02x} is not UTF-8, perhaps Latin-1; save it as UTF-8"
        ) from None


def _separator(head: str) -> str | None:
    return next((mark for mark in (";", "\t", ",") if mark in head), None)


def split_cells(line: str, separator: str | None) -> list[str]:
    """The cells of one line, without blanks and quotes around them."""
    if separator is None:
        return line.split()
    try:
        cells = next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        cells = line.split(separator)
    return [cell.strip() for cell in cells]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _open_text(path: Path) -> Table:
    rows = read_rows(path)
    if not rows.lines:
        raise BadInput(f"{path}: only a header line, no rows below it; give a recording with data")

    def where(row: int) -> str:
        return f"line {rows.numbers[row]}"

    return Table(str(path), rows.header, lambda names: _text_columns(rows, names), where=where)


def _text_columns(rows: TextRows, names: Sequence[str]) -> list[FloatArray]:
    width = len(rows.header)
    use = [rows.header.index(name) for name in names]
    mark = rows.separator
    if mark is not None and {line.count(mark) for line in rows.lines} == {width - 1}:
        try:
            table = np.loadtxt(rows.lines, delimiter=mark, usecols=use, comments=None, ndmin=2)
        except (ValueError, OverflowError):
            pass
        else:
            return [np.where(np.isfinite(column), column, np.nan) for column in table.T]
    return _text_columns_slowly(rows, names, use)


def _advice(cell: str, row: int) -> str:
    """What to do about a cell that is no number."""
    if re.fullmatch(r"\d{4}-\d\d-\d\d.*|\d+:\d\d.*", cell):
        return "give times in seconds, or leave the column out and say [time] sample_time in the rig file"
    if re.fullmatch(r"[-+]?\d*,\d+", cell):
        return "write it with a decimal point, or separate cells by semicolons"
    return "correct or empty it" + ("; if the line holds units, delete it" if row == 0 else "")


def _text_columns_slowly(rows: TextRows, names: Sequence[str], use: Sequence[int]) -> list[FloatArray]:
    """Line by line: empty cells become NaN, and what cannot be read is named with its line and column."""
    width = len(rows.header)
    table = np.empty((len(use), len(rows.lines)))
    for k, line in enumerate(rows.lines):
        cells = split_cells(line, rows.separator)
        if len(cells) == width + 1 and not cells[-1]:
            cells.pop()
        if len(cells) != width:
            raise BadInput(
                f"{rows.name}: line {rows.numbers[k]} has {len(cells)} cells and the header {width}; "
                "complete or delete that line"
            )
        for i, column in enumerate(use):
            try:
                table[i, k] = float(cells[column]) if cells[column] else math.nan
            except ValueError:
                where, cell = f"line {rows.numbers[k]}, column '{names[i]}'", cells[column]
                raise BadInput(f"{rows.name}: {where}: {cell[:40]!r} is no number; {_advice(cell, k)}") from None
    return [np.where(np.isfinite(column), column, np.nan) for column in table]


# --- binary formats ---


def _missing(path: Path, package: str) -> BadInput:
    return BadInput(f"{path}: reading {path.suffix} needs {package}: pip install twin[formats]")


def _unreadable(path: Path, kind: str, error: Exception) -> BadInput:
    said = " ".join(str(error).split())[:120] or type(error).__name__
    return BadInput(f"{path}: cannot be read as {kind} ({said}); export the recording again")


def _from_columns(path: Path, columns: Mapping[str, FloatArray], scalars: Mapping[str, float]) -> Table:
    """A table whose columns are in memory already."""
    if not columns:
        raise BadInput(f"{path}: holds no numeric columns; give a recording")

    def read(names: Sequence[str]) -> list[FloatArray]:
        chosen = [columns[name] for name in names]
        for name, column in zip(names, chosen, strict=True):
            if len(column) != len(chosen[0]):
                raise BadInput(
                    f"{path}: column '{name}' has {len(column)} values and '{names[0]}' {len(chosen[0])}; "
                    "columns must be equally long"
                )
        return [np.where(np.isfinite(column), column, np.nan) for column in chosen]

    return Table(str(path), tuple(columns), read, scalars)


def _open_parquet(path: Path) -> Table:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise _missing(path, "pyarrow") from None
    try:
        table = pyarrow.parquet.read_table(path)
        columns = {}
        for name in table.column_names:
            kind = table.schema.field(name).type
            is_number = (pyarrow.types.is_integer, pyarrow.types.is_floating, pyarrow.types.is_decimal)
            if any(test(kind) for test in is_number):
                columns[name] = table[name].cast(pyarrow.float64(), safe=False).to_numpy().astype(np.float64)
    except Exception as error:  # a damaged file makes the reader raise anything
        raise _unreadable(path, "Parquet", error) from None
    return _from_columns(path, columns, {})


def _open_mat(path: Path) -> Table:
    import scipy.io

    try:
        variables = {k: v for k, v in scipy.io.loadmat(path).items() if not k.startswith("__")}
    except NotImplementedError:  # v7.3 is HDF5
        variables = _read_hdf5(path)
    except Exception as error:
        raise _unreadable(path, "MAT", error) from None
    columns: dict[str, FloatArray] = {}
    scalars: dict[str, float] = {}
    for name, value in variables.items():
        array = np.asarray(value)
        if array.dtype.kind not in "fiub":
            continue
        if array.size == 1:
            scalars[name] = float(array.ravel()[0])
        elif array.size and array.size == max(array.shape):
            columns[name] = array.ravel().astype(np.float64)
    return _from_columns(path, columns, scalars)


def _read_hdf5(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise _missing(path, "h5py") from None
    try:
        with h5py.File(path) as file:
            return {name: item[()] for name, item in file.items() if isinstance(item, h5py.Dataset)}
    except Exception as error:
        raise _unreadable(path, "MAT v7.3", error) from None


_LOG_TIME = "log time"


def _held(stamps: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """The value held at each instant; the first one before the first stamp."""
    index = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, None)
    return values[index]


def _from_signals(path: Path, signals: Mapping[str, tuple[FloatArray, FloatArray]]) -> Table:
    """A table of signals (stamps in s, values) that may each have a clock of their own."""
    if not signals:
        raise BadInput(f"{path}: holds no numeric signals; give a recording")

    def read(names: Sequence[str]) -> list[FloatArray]:
        master = next(name for name in names if name != _LOG_TIME)
        stamps = signals[master][0]
        columns = []
        for name in names:
            own, values = signals.get(name, (stamps, stamps))
            same = own.shape == stamps.shape and np.array_equal(own, stamps)
            column = values if same else _held(own, values, stamps)
            columns.append(np.where(np.isfinite(column), column, np.nan))
        return columns

    return Table(str(path), tuple(signals), read, clock=_LOG_TIME)


def _open_mdf(path: Path) -> Table:
    try:
        from asammdf import MDF
    except ImportError:
        raise _missing(path, "asammdf") from None
    signals: dict[str, tuple[FloatArray, FloatArray]] = {}
    try:
        with MDF(path) as file:
            for signal in file.iter_channels(skip_master=True):
                samples = np.asarray(signal.samples)
                if samples.ndim == 1 and samples.dtype.kind in "fiub" and samples.size:
                    signals[signal.name] = (
                        np.asarray(signal.timestamps, dtype=np.float64),
                        samples.astype(np.float64),
                    )
    except Exception as error:
        raise _unreadable(path, "MDF4", error) from None
    return _from_signals(path, signals)


def _open_mcap(path: Path) -> Table:
    try:
        from mcap.reader import make_reader
    except ImportError:
        raise _missing(path, "mcap") from None
    gathered: dict[tuple[str, str], tuple[list[int], list[float]]] = {}
    try:
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                if channel.message_encoding != "json":
                    continue
                for key, value in json.loads(message.data).items():
                    if isinstance(value, int | float):
                        stamps, values = gathered.setdefault((channel.topic, key), ([], []))
                        stamps.append(message.log_time)
                        values.append(float(value))
    except Exception as error:
        raise _unreadable(path, "MCAP with JSON messages", error) from None
    origin = min((stamps[0] for stamps, _ in gathered.values()), default=0)
    signals: dict[str, tuple[FloatArray, FloatArray]] = {}
    for (topic, key), (stamps, values) in gathered.items():
        unique = sum(other == key for _, other in gathered) == 1
        # subtracted as integers: a double cannot hold nanoseconds since 1970
        seconds = 1e-9 * (np.array(stamps, dtype=np.int64) - origin).astype(np.float64)
        signals[key if unique else f"{topic}/{key}"] = (seconds, np.array(values))
    return _from_signals(path, signals)
