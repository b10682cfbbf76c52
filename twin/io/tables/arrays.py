"""Arrays under nested names, as MATLAB and HDF5 files hold them, turned into the columns of a table."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from twin.errors import BadInput
from twin.io.tables.table import FloatArray, Table, from_columns, unique_names

#: Per full name, such as `log.t`: the shape, and what makes the numbers, the first index running fastest.
Arrays = dict[str, tuple[tuple[int, ...], Callable[[], FloatArray]]]

#: What MATLAB has to be told, by the class of an object whose numbers only MATLAB can find; {0} is the variable.
_EXPORTS = {
    "timetable": "writetimetable({0}, 'log.csv')",
    "table": "writetable({0}, 'log.csv')",
    "timeseries": "t = {0}.Time; y = squeeze({0}.Data); save('log.mat', 't', 'y')",
    "iddata": "t = {0}.SamplingInstants; u = {0}.InputData; y = {0}.OutputData; save('log.mat', 't', 'u', 'y')",
    "Simulink.SimulationData.Dataset": "s = {0}{{1}}.Values; t = s.Time; y = squeeze(s.Data), the same for the input, "
    "and save('log.mat', 't', 'u', 'y')",
}
#: Vectors that are shorter than this stand beside a recording.
_SHORT = 50
_MOST_COLUMNS = 1000  # of one matrix: more is no table with a row a sample


def table_of_arrays(path: Path, arrays: Arrays, objects: Mapping[str, str] | None = None) -> Table:
    """A table of vectors, of the columns of matrices, and of scalars.

    Only arrays of the commonest length become columns where lengths differ, unless a rig file asks for others: `read`
    knows them all.

    Parameters
    ----------
    path
        The file, for messages.
    arrays
        As `Arrays`.
    objects
        The class of each variable that is an object of MATLAB's.

    Raises
    ------
    BadInput
        Where nothing can be a column; of an object the message says how to export it.
    """
    longest = max((max(shape, default=0) for shape, _ in arrays.values()), default=0)
    for name, kind in (objects or {}).items() if longest < _SHORT else ():
        how = _EXPORTS.get(kind, "save its numbers as vectors with save('log.mat', 't', 'u', 'y')").format(name)
        raise BadInput(f"{path}: '{name}' is a {kind} object, whose numbers only MATLAB finds; in MATLAB, {how}")
    full: dict[str, Callable[[], FloatArray]] = {}
    scalars: dict[str, float] = {}
    for name, (shape, make) in arrays.items():
        sides = [n for n in shape if n != 1]
        if not sides:
            scalars[name] = float(make()[0])
        elif len(sides) == 1 and sides[0] > 1:
            full[name] = make
        elif len(sides) == 2 and 1 < min(sides) <= _MOST_COLUMNS:
            by_rows = sides[0] >= sides[1]  # a sample a row
            for k in range(min(sides)):
                label = f"{name}(:,{k + 1})" if by_rows else f"{name}({k + 1},:)"
                full[label] = _side(make, (sides[0], sides[1]), k)
    names = list(full)
    short = unique_names([(name, _leaf(name)) for name in names])
    columns = dict(zip(short, full.values(), strict=True))
    lone = unique_names([(name, _leaf(name)) for name in scalars])
    return from_columns(path, columns, dict(zip(lone, scalars.values(), strict=True)))


def _leaf(name: str) -> str:
    """The last part of a nested name: `signals.values(:,2)` of `log.signals.values(:,2)` stays whole.

    "Structure with time" of Simulink keeps its samples in `signals.values`, where the last part alone says nothing.
    """
    parts = name.split(".")
    generic = parts[-1].split("(")[0] in ("values", "data", "Data", "value", "Value")
    return ".".join(parts[-2:]) if generic and len(parts) > 1 else parts[-1]


def _side(make: Callable[[], FloatArray], shape: tuple[int, int], k: int) -> Callable[[], FloatArray]:
    def column() -> FloatArray:
        matrix = make().reshape(shape, order="F")
        return np.ascontiguousarray(matrix[:, k] if shape[0] >= shape[1] else matrix[k])

    return column
