"""WPILib's data log (.wpilog): records of named entries, each with a stamp in us. Format: WPILib, "Data Log File Format
Specification", version 1.0.

A log that SysId's routine wrote names the test that runs in an entry `sysid-test-state-...`; each test is then a
recording of its own. Other logs are one recording.
"""

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from twin.errors import BadInput
from twin.io.tables.table import Signal, Table, from_signals, read_bytes, unique_names, unreadable
from twin.io.units import spelled_unit

_MAGIC = b"WPILOG"
_FORMATS = {"double": "<f8", "float": "<f4", "int64": "<i8", "boolean": "u1"}
_STATE = "sysid-test-state"
_NONE = "none"


@dataclass
class _Entry:
    name: str
    kind: str
    metadata: str
    stamps: list[int] = field(default_factory=list)  # us
    values: list[bytes] = field(default_factory=list)


def open_wpilog(path: Path) -> list[Table]:
    """Open a data log.

    Returns
    -------
    list of Table: one a test where SysId's routine ran, else one.

    Raises
    ------
    BadInput
        Where the file is no data log, or holds no numbers.
    """
    entries = _read(path, read_bytes(path))
    numeric = [e for e in entries if e.kind.removesuffix("[]") in _FORMATS and e.stamps]
    names = unique_names([(e.name, e.name.rsplit("/", 1)[-1]) for e in numeric])
    signals = {name: _signals(e) for name, e in zip(names, numeric, strict=True)}
    flat = {f"{name}{index}": signal for name, several in signals.items() for index, signal in several.items()}
    units = {name: unit for name, e in zip(names, numeric, strict=True) if (unit := _unit(e))}
    state = next((e for e in entries if _STATE in e.name and e.kind == "string" and e.stamps), None)
    if state is None:
        return [from_signals(str(path), list(flat), flat.__getitem__, units)]
    tables = [
        from_signals(f"{path}: {test}", list(flat), flat.__getitem__, units, test, (start, end))
        for test, start, end in _spans(state)
    ]
    if not tables:
        raise BadInput(f"{path}: no test ran, '{state.name}' says none all the time; give a log of SysId's routine")
    return tables


def _unit(entry: _Entry) -> str:
    """The unit that an entry's metadata or a type of WPILib's own says, where one does."""
    for word in entry.metadata.replace('"', " ").replace(":", " ").replace("}", " ").split():
        unit = spelled_unit(word)
        if unit:
            return unit
    return ""


def _spans(state: _Entry) -> list[tuple[str, float, float]]:
    """Name, start and end in s of each test."""
    end = [*state.stamps[1:], state.stamps[-1] + 10**12]
    named = [raw.decode("utf-8", "replace").strip() for raw in state.values]
    spans: list[tuple[str, float, float]] = []
    for name, first, last in zip(named, state.stamps, end, strict=True):
        start, stop = 1e-6 * first, 1e-6 * last
        if spans and spans[-1][0] == name and spans[-1][2] == start:
            spans[-1] = (name, spans[-1][1], stop)  # the state is logged again and again while a test runs
        elif name != _NONE:
            spans.append((name, start, stop))
    runs = Counter[str]()
    unique = []
    for name, start, stop in spans:
        runs[name] += 1
        unique.append((name if runs[name] == 1 else f"{name} {runs[name]}", start, stop))
    return unique


def _signals(entry: _Entry) -> dict[str, Signal]:
    """An entry's values; those of an array by the index of each."""
    dtype = np.dtype(_FORMATS[entry.kind.removesuffix("[]")])
    width = dtype.itemsize
    stamps = 1e-6 * np.array(entry.stamps, dtype=np.float64)
    if not entry.kind.endswith("[]"):
        sound = np.array([len(raw) == width for raw in entry.values])
        values = np.frombuffer(b"".join(raw for raw in entry.values if len(raw) == width), dtype)
        return {"": (stamps[sound], values.astype(np.float64))}
    longest = min(max(len(raw) for raw in entry.values) // width, 64)
    found: dict[str, Signal] = {}
    for k in range(longest):
        sound = np.array([len(raw) >= (k + 1) * width for raw in entry.values])
        parts = b"".join(raw[k * width : (k + 1) * width] for raw in entry.values if len(raw) >= (k + 1) * width)
        found[f"[{k}]"] = (stamps[sound], np.frombuffer(parts, dtype).astype(np.float64))
    return found


def _read(path: Path, data: bytes) -> Sequence[_Entry]:
    """All entries with their records. A log that breaks off keeps what was written."""
    if data[:6] != _MAGIC or len(data) < 12:
        raise unreadable(path, "WPILOG", "its first bytes are not WPILOG")
    (extra,) = struct.unpack("<I", data[8:12])
    if extra > len(data) - 12:
        raise unreadable(path, "WPILOG", "its header goes beyond the end")
    entries: list[_Entry] = []
    current: dict[int, _Entry] = {}
    for number, stamp, payload in _records(data, 12 + extra):
        if number:
            if number in current:
                current[number].stamps.append(stamp)
                current[number].values.append(payload)
        elif payload[:1] == b"\0" and len(payload) >= 17:
            (started,) = struct.unpack("<I", payload[1:5])
            name, kind, metadata = _texts(payload[5:])
            current[started] = _Entry(name, kind, metadata)
            entries.append(current[started])
        elif payload[:1] == b"\1" and len(payload) >= 5:
            current.pop(struct.unpack("<I", payload[1:5])[0], None)
    return entries


def _records(data: bytes, place: int) -> Iterator[tuple[int, int, bytes]]:
    """Entry number, stamp in us and payload of each record; 0 is the number of the log's own records."""
    while place < len(data):
        lengths = data[place]
        sizes = ((lengths & 3) + 1, (lengths >> 2 & 3) + 1, (lengths >> 4 & 7) + 1)
        fields = []
        place += 1
        for size in sizes:
            fields.append(int.from_bytes(data[place : place + size], "little"))
            place += size
        number, length, stamp = fields
        if place + length > len(data):
            return
        yield number, stamp, data[place : place + length]
        place += length


def _texts(data: bytes) -> tuple[str, str, str]:
    """Name, type and metadata of an entry."""
    found = []
    for _ in range(3):
        (length,) = struct.unpack("<I", data[:4]) if len(data) >= 4 else (0,)
        found.append(data[4 : 4 + length].decode("utf-8", "replace"))
        data = data[4 + length :]
    return found[0], found[1], found[2]
