"""ASAM MDF (.mf4, .mdf) through asammdf: a signal is read when it is asked for."""

from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import BadInput
from twin.io.tables.library import call_in_child
from twin.io.tables.table import MAX_BYTES, Signal, Table, from_signals, missing_package, unique_names

_KIND = "MDF4"
#: Data types of channels that are numbers, by the major version of the format.
_NUMERIC = {4: range(6), 3: (0, 1, 2, 3, 9, 10, 11, 12, 13, 14, 15, 16)}


def open_mdf(path: Path) -> Table:
    """Open an MDF file of version 3 or 4.

    Raises
    ------
    BadInput
        Where asammdf is not installed, the file is damaged, or it holds no signals.
    """
    try:
        from asammdf import MDF
    except ImportError:
        raise missing_package(path, "asammdf") from None

    def channels() -> list[tuple[str, str, int, int]]:
        """Name, unit, group and index of every signal that is a number."""
        with MDF(path) as file:
            numeric = _NUMERIC[4 if file.version >= "4" else 3]
            return [
                (str(channel.name), str(getattr(channel, "unit", "") or ""), g, c)
                for g, group in enumerate(file.groups)
                for c, channel in enumerate(group.channels)
                if file.masters_db.get(g) != c and channel.data_type in numeric and _cycles(group) > 0
            ]

    found = call_in_child(path, _KIND, channels)
    names = unique_names([(f"{name} (group {g + 1})", name) for name, _, g, _ in found])
    places = {name: (g, c) for name, (_, _, g, c) in zip(names, found, strict=True)}
    units = {name: unit for name, (_, unit, _, _) in zip(names, found, strict=True) if unit}

    def signal(name: str) -> Signal:
        def read() -> Signal:
            with MDF(path) as file:
                group, index = places[name]
                if 16 * _cycles(file.groups[group]) > MAX_BYTES:
                    raise BadInput(f"{path}: '{name}' has more samples than fit into 2 GiB; cut the recording")
                got = file.get(group=group, index=index)
                samples = np.asarray(got.samples)
                if samples.ndim != 1 or samples.dtype.kind not in "fiub":
                    raise BadInput(f"{path}: column '{name}' holds no numbers; name another")
                return np.asarray(got.timestamps, dtype=np.float64), samples.astype(np.float64)

        return call_in_child(path, _KIND, read)

    return from_signals(str(path), list(places), signal, units)


def _cycles(group: Any) -> int:
    return int(getattr(group.channel_group, "cycles_nr", 0))
