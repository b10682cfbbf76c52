"""Recordings that lie in several files: the input in one, the output in another, each with a clock of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from twin.errors import BadInput
from twin.io.rig_file import Clock, Column, Rig, guess_time
from twin.io.tables.formats import open_table
from twin.io.tables.table import FloatArray, Table, held


@dataclass(frozen=True)
class _Elsewhere:
    """A column of another file, and the clock of that file."""

    table: Table
    column: str
    clock: Clock


def join_files(table: Table, rig: Rig, path: Path, clock: Clock) -> tuple[Table, Rig]:
    """The table with the columns that the rig file finds in other files, joined by time.

    The values of the other file are held at the stamps of the recording; where it has none, they are missing.

    Parameters
    ----------
    table, path
        The recording, which holds the output, and where it lies.
    rig
        Its columns with a `file` are those that lie elsewhere: relative to the recording, where `*` stands for the name
        of the recording without its ending.
    clock
        The recording's own.

    Returns
    -------
    The table, and the rig file's word on it, with such columns called by file and name.

    Raises
    ------
    BadInput
        Where another file cannot be read, or its clock has nothing in common with the recording's.
    """
    elsewhere: dict[str, _Elsewhere] = {}

    def moved(column: Column) -> Column:
        if not column.file:
            return column
        name = f"{column.file}: {column.name}"
        elsewhere[name] = _open(column, rig, path)
        return replace(column, name=name)

    drive = moved(rig.input)
    optional = {key: moved(column) for key, column in rig.optional.items()}
    direction = rig.direction
    if direction is not None and rig.input.file:
        direction = replace(direction, name=moved(replace(rig.input, name=direction.name)).name)
    if not elsewhere:
        return table, rig
    if clock.column is None:
        raise BadInput(f"{table.name}: its columns lie in two files, which only time joins; give [time] column")
    main = clock.column

    def read(names: Sequence[str]) -> list[FloatArray]:
        own = [name for name in names if name not in elsewhere]
        wanted = own if main in own else [*own, main]
        columns = dict(zip(wanted, table.columns(wanted), strict=True))
        stamps = columns[main] * clock.factor
        joined = {name: _held_at(stamps, elsewhere[name], table.name) for name in names if name in elsewhere}
        return [joined[name] if name in joined else columns[name] for name in names]

    names = (*table.names, *elsewhere)
    return (
        replace(table, names=names, read=read),
        replace(rig, input=drive, optional=optional, direction=direction),
    )


def _open(column: Column, rig: Rig, path: Path) -> _Elsewhere:
    other = path.parent / column.file.replace("*", path.name.split(".")[0])
    table = open_table(other)
    clock = column.clock or rig.time
    if clock.column is None and table.clock is not None:
        clock = Clock(table.clock)
    if clock.column is None or clock.column not in (*table.names, table.clock):
        clock = guess_time(table.names, table.units) or clock
    if clock.column is None:
        raise BadInput(f"{other}: no time column is named; give time_column beside file in {rig.name}")
    return _Elsewhere(table, column.name, clock)


def _held_at(stamps: FloatArray, elsewhere: _Elsewhere, name: str) -> FloatArray:
    """The values of a column of another file, held at the recording's stamps, s; NaN where that file has none."""
    assert elsewhere.clock.column is not None
    own, values = elsewhere.table.columns([elsewhere.clock.column, elsewhere.column])
    good = np.isfinite(own)
    own, values = own[good] * elsewhere.clock.factor, values[good]
    finite = stamps[np.isfinite(stamps)]
    if not own.size or not finite.size or own[-1] < finite[0] or own[0] > finite[-1]:
        ranges: Mapping[str, FloatArray] = {elsewhere.table.name: own, name: finite}
        said = " and ".join(f"{n} runs from {t[0]:.6g} to {t[-1]:.6g} s" if t.size else n for n, t in ranges.items())
        raise BadInput(f"{said}: their clocks have nothing in common; write both with one clock")
    if (np.diff(own) < 0).any():
        raise BadInput(f"{elsewhere.table.name}: time goes backwards; sort the rows or split the file")
    step = float(np.median(np.diff(own))) if own.size > 1 else np.inf
    inside = (stamps >= own[0]) & (stamps <= own[-1] + step)
    return np.where(inside, held(own, values, np.where(np.isfinite(stamps), stamps, own[0])), np.nan)
