"""MATLAB files: v5 (also v6 and v7, compressed), read here, and v7.3, which is HDF5.

The v5 reader is our own because the usual one ends the process on some damaged files. It checks every size against the
bytes that there are before it takes memory, and makes numbers only of what is asked for. Format: MathWorks, "MAT-File
Format", chapter 1.

Variables become columns by these rules, for every version. A vector is a column. A matrix is as many columns as its
shorter side, `name(:,1)`, `name(:,2)` ... A struct gives its fields, also nested ones, by their own names where these
are unique, else as `log.t`. A cell array gives its members. A single number is a scalar.
"""

import itertools
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.io.tables import hdf5
from twin.io.tables.arrays import Arrays, table_of_arrays
from twin.io.tables.table import MAX_BYTES, FloatArray, Table, read_bytes, unreadable

# data types of elements, by their number in the file
_INT8, _UINT32, _COMPRESSED, _MATRIX = 1, 6, 15, 14
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
# classes of arrays
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _OPAQUE = 1, 2, 3, 4, 5, 17
_NUMERIC = range(6, 16)
_DEEPEST = 20
_MOST_ARRAYS = 100_000


class _Damaged(Exception):
    """The bytes are no MAT file."""


@dataclass(frozen=True)
class _Element:
    kind: int
    data: memoryview


def open_mat(path: Path) -> Table:
    """Open a MATLAB file of any version.

    Raises
    ------
    BadInput
        Where the file is damaged, or holds nothing that can be a column.
    """
    data = memoryview(read_bytes(path))
    if bytes(data[:8]) == b"\x89HDF\r\n\x1a\n" or bytes(data[512:520]) == b"\x89HDF\r\n\x1a\n":
        return hdf5.open_hdf5(path)
    objects: dict[str, str] = {}
    try:
        arrays = _read(data, objects)
    except (_Damaged, zlib.error, struct.error, ValueError) as error:
        raise unreadable(path, "MAT", error) from None
    return table_of_arrays(path, arrays, objects)


def _read(data: memoryview, objects: dict[str, str]) -> Arrays:
    """All numeric arrays of a v5 file, each as what makes its numbers; classes of objects are added to `objects`."""
    if len(data) < 128 or bytes(data[126:128]) not in (b"IM", b"MI"):
        raise _Damaged("its header is not that of a MAT file")
    order = "<" if bytes(data[126:128]) == b"IM" else ">"
    found: Arrays = {}
    # the word before the version gives the place of MATLAB's own data about objects, which is no variable
    (subsystem,) = struct.unpack(f"{order}Q", data[116:124])
    for place, element in _elements(data, order, 128):
        if place == subsystem:
            continue
        if element.kind == _COMPRESSED:
            element = next((e for _, e in _elements(_unpacked(element.data), order, 0)), element)
        if element.kind == _MATRIX:
            objects |= _object(element.data, order)
            _collect(element.data, order, "", found, 0)
    return found


def _object(data: memoryview, order: str) -> dict[str, str]:
    """Name and class of a variable that is an object: such as a timetable, whose numbers lie in MATLAB's own data."""
    parts = [element for _, element in itertools.islice(_elements(data, order, 0), 4)]
    if len(parts) < 4 or parts[0].kind != _UINT32 or len(parts[0].data) < 8:
        return {}
    (flags,) = struct.unpack(f"{order}I", parts[0].data[:4])
    return {_text(parts[1]): _text(parts[3])} if flags & 0xFF == _OPAQUE and _text(parts[3]) else {}


def _unpacked(data: memoryview) -> memoryview:
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(data, MAX_BYTES)
    if unpacker.unconsumed_tail:
        raise _Damaged("a variable unpacks to more than 2 GiB")
    return memoryview(content)


def _elements(data: memoryview, order: str, start: int) -> Iterator[tuple[int, _Element]]:
    """The data elements one after the other, with the place of each."""
    place = start
    while len(data) - place >= 8:
        kind, size = struct.unpack(f"{order}II", data[place : place + 8])
        begin = place + 8
        if kind >> 16:  # a small element: size and type share a word, four bytes of data follow
            kind, size = kind & 0xFFFF, kind >> 16
            begin = place + 4
            if size > 4:
                raise _Damaged(f"a small element of {size} bytes at byte {place}")
        if size > len(data) - begin:
            raise _Damaged(f"an element of {size} bytes at byte {place} goes beyond the end")
        yield place, _Element(kind, data[begin : begin + size])
        if begin == place + 4:
            place += 8
        else:
            place = begin + size + (-size % 8 if kind != _COMPRESSED else 0)


def _collect(data: memoryview, order: str, prefix: str, found: Arrays, depth: int) -> None:
    """Add an array, or those within a struct or a cell, to those found."""
    if depth > _DEEPEST or len(found) > _MOST_ARRAYS:
        raise _Damaged("structs are nested too deep, or too many")
    parts = [element for _, element in _elements(data, order, 0)]
    if len(parts) < 3 or parts[0].kind != _UINT32 or len(parts[0].data) < 8:
        return
    (flags,) = struct.unpack(f"{order}I", parts[0].data[:4])
    shape = _integers(parts[1], order)
    name = _text(parts[2])
    full = f"{prefix}.{name}" if prefix and name else prefix or name
    kind = flags & 0xFF
    if kind in (_STRUCT, _OBJECT):
        _collect_fields(parts[3 + (kind == _OBJECT) :], order, full, found, depth)
    elif kind == _CELL:
        for k, part in enumerate(parts[3:]):
            if part.kind == _MATRIX:
                _collect(part.data, order, f"{full}{{{k + 1}}}", found, depth + 1)
    elif kind in _NUMERIC and len(parts) > 3 and parts[3].kind in _NUMBERS:
        dtype = np.dtype(order + _NUMBERS[parts[3].kind])
        count = int(np.prod(shape, dtype=np.float64))
        if count * dtype.itemsize != len(parts[3].data):
            raise _Damaged(f"{full or 'an array'} is said to hold {count} values and holds others")
        found[full] = (tuple(shape), _maker(parts[3].data, dtype))


def _collect_fields(parts: list[_Element], order: str, name: str, found: Arrays, depth: int) -> None:
    if len(parts) < 2:
        return
    lengths = _integers(parts[0], order)
    width = lengths[0] if lengths else 0
    if not 0 < width <= 1024:
        raise _Damaged(f"field names of {width} characters")
    raw = bytes(parts[1].data)
    fields = [raw[k : k + width].split(b"\0")[0].decode("latin-1") for k in range(0, len(raw), width)]
    values = parts[2:]
    several = len(values) > len(fields)
    for k, part in enumerate(values if fields else []):
        index = f"({k // len(fields) + 1})" if several else ""
        if part.kind == _MATRIX and len(part.data):
            _collect(part.data, order, f"{name}{index}.{fields[k % len(fields)]}", found, depth + 1)


def _maker(data: memoryview, dtype: np.dtype[np.generic]) -> Callable[[], FloatArray]:
    return lambda: np.frombuffer(data, dtype).astype(np.float64)


def _integers(element: _Element, order: str) -> list[int]:
    if element.kind not in _NUMBERS or len(element.data) % np.dtype(_NUMBERS[element.kind]).itemsize:
        raise _Damaged("sizes that are no integers")
    numbers = np.frombuffer(element.data, np.dtype(order + _NUMBERS[element.kind])).tolist()
    if not all(0 <= n < 2**53 for n in numbers) or len(numbers) > 32:
        raise _Damaged("sizes that no array has")
    return [int(n) for n in numbers]


def _text(element: _Element) -> str:
    return bytes(element.data[:1024]).decode("latin-1") if element.kind == _INT8 else ""
