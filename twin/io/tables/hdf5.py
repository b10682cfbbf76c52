"""HDF5, which is also what MATLAB writes as v7.3.

Links that lead out of the file are not followed, nor are data sets that live in other files.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import BadInput
from twin.io.tables.arrays import Arrays, table_of_arrays
from twin.io.tables.table import MAX_BYTES, FloatArray, Table, missing_package, unreadable

_DEEPEST = 20
_MOST_OBJECTS = 100_000


def open_hdf5(path: Path) -> Table:
    """Open an HDF5 file.

    Raises
    ------
    BadInput
        Where h5py is not installed, the file is damaged, leads to other files, or holds nothing that can be a column.
    """
    try:
        import h5py
    except ImportError:
        raise missing_package(path, "h5py") from None
    arrays: Arrays = {}
    try:
        with h5py.File(path, "r") as file:
            objects = _objects(file, h5py)
            _collect(file, "", arrays, path, h5py, 0)
    except BadInput:
        raise
    except Exception as error:  # a damaged file makes the library raise anything
        raise unreadable(path, "MAT v7.3 (HDF5)", error) from None
    return table_of_arrays(path, {n: a for n, a in arrays.items() if n not in objects}, objects)


def _objects(file: Any, h5py: Any) -> dict[str, str]:
    """Name and class of the variables that are objects of MATLAB's: what stands there are references, no numbers."""
    found = {}
    for name in file:
        if not isinstance(file.get(name, getlink=True), h5py.HardLink):
            continue
        attributes = file[name].attrs
        if "MATLAB_object_decode" in attributes:
            kind = attributes.get("MATLAB_class", b"")
            found[name] = kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
    return found


def _collect(group: Any, prefix: str, found: Arrays, path: Path, h5py: Any, depth: int) -> None:
    if depth > _DEEPEST:
        return
    for name in group:
        if name.startswith("#"):  # MATLAB's own references
            continue
        link = group.get(name, getlink=True)
        full = f"{prefix}.{name}" if prefix else name
        if isinstance(link, h5py.ExternalLink):
            raise BadInput(f"{path}: '{full}' is a link to another file; copy the data into one file")
        if not isinstance(link, h5py.HardLink) or len(found) > _MOST_OBJECTS:
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            _collect(item, full, found, path, h5py, depth + 1)
        elif isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub" and item.size:
            if item.external or item.is_virtual:
                raise BadInput(f"{path}: '{full}' keeps its data in another file; copy the data into one file")
            # HDF5 keeps the last index running fastest, MATLAB the first: the shape is turned round
            found[full] = (tuple(item.shape[::-1]), _maker(path, item.name, int(item.size), h5py))


def _maker(path: Path, name: str, count: int, h5py: Any) -> Callable[[], FloatArray]:
    """What reads one data set when it is asked for."""

    def read() -> FloatArray:
        if 8 * count > MAX_BYTES:
            raise BadInput(f"{path}: '{name}' holds {count} values, more than 2 GiB; cut the recording")
        try:
            with h5py.File(path, "r") as file:
                return np.asarray(file[name][()], dtype=np.float64).ravel()
        except Exception as error:
            raise unreadable(path, "MAT v7.3 (HDF5)", error) from None

    return read
