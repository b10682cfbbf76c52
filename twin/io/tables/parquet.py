"""Parquet through pyarrow: only the columns asked for are read; stamps become seconds of the first one's day."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import BadInput
from twin.io.tables.library import call_library
from twin.io.tables.table import MAX_BYTES, FloatArray, Table, from_columns, missing_package

_PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


def open_parquet(path: Path) -> Table:
    """Open a Parquet file.

    Raises
    ------
    BadInput
        Where pyarrow is not installed, the file is damaged, or it holds no columns of numbers.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise missing_package(path, "pyarrow") from None
    types = pyarrow.types

    def look() -> tuple[int, dict[str, Any]]:
        with pyarrow.parquet.ParquetFile(path) as file:
            schema = file.schema_arrow
            return file.metadata.num_rows, {schema.field(k).name: schema.field(k).type for k in range(len(schema))}

    rows, kinds = call_library(path, "Parquet", look)
    stamps = (types.is_timestamp, types.is_duration, types.is_time)
    numbers = (types.is_integer, types.is_floating, types.is_decimal, types.is_boolean, *stamps)
    columns: dict[str, Callable[[], FloatArray]] = {}
    units: dict[str, str] = {}
    for name, kind in kinds.items():
        if any(test(kind) for test in numbers):
            is_stamp = any(test(kind) for test in stamps)
            columns[name] = _reader(path, pyarrow, name, rows, kind.unit if is_stamp else "")
            units |= {name: "s"} if is_stamp else {}
    return from_columns(path, columns, {}, units)


def _reader(path: Path, pyarrow: Any, name: str, rows: int, unit: str) -> Callable[[], FloatArray]:
    """What reads one column; `unit` of a column of stamps."""

    def work() -> FloatArray:
        if 8 * rows > MAX_BYTES:
            raise BadInput(f"{path}: has {rows} rows, more than fit into 2 GiB; cut it into recordings")
        with pyarrow.parquet.ParquetFile(path) as file:
            column = file.read(columns=[name])[name]
        if not unit:
            if pyarrow.types.is_boolean(column.type):
                column = column.cast(pyarrow.int8())
            return np.asarray(column.cast(pyarrow.float64(), safe=False).to_numpy(), dtype=np.float64)
        missing = np.asarray(column.is_null().to_numpy(), dtype=bool)
        width = pyarrow.int32() if column.type.bit_width == 32 else pyarrow.int64()
        ticks = np.asarray(column.cast(width).fill_null(0).to_numpy(), dtype=np.int64)
        origin = 0
        if pyarrow.types.is_timestamp(column.type) and not missing.all():
            # from the midnight before the first: a double cannot hold nanoseconds since 1970
            day = 86400 * int(_PER_SECOND[unit])
            origin = int(ticks[~missing][0]) // day * day
        seconds = (ticks - origin).astype(np.float64) / _PER_SECOND[unit]
        return np.where(missing, np.nan, seconds)

    return lambda: call_library(path, "Parquet", work)
