"""A table of named columns, whatever the file was, and what the readers of all formats share."""

import gzip
import textwrap
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from twin.errors import BadInput, install

FloatArray = npt.NDArray[np.float64]
#: (stamps in s, values) of a signal with a clock of its own.
Signal = tuple[FloatArray, FloatArray]

#: The largest file, and the largest content of a compressed one, that is taken into memory, bytes.
MAX_BYTES = 2**31
_SHOWN = 20


@dataclass(frozen=True, eq=False)
class Table:
    """Named columns of one file.

    Parameters
    ----------
    name
        The file, and the test in it where it holds several; for messages.
    names
        The columns that `read` knows.
    read
        Takes column names, gives equally long float columns, NaN where a cell is empty or not finite. Where columns
        have clocks of their own the rows are those of the first name.
    scalars
        Single numbers that stand beside the columns.
    clock
        The pseudo-column with the format's own stamps in s.
    where
        Says in words where a row is found in the file.
    units
        The unit of a column, as the file writes it, where it does.
    test
        Which of several tests in one file this is; empty where the file holds one recording.
    """

    name: str
    names: tuple[str, ...]
    read: Callable[[Sequence[str]], list[FloatArray]]
    scalars: Mapping[str, float] = field(default_factory=dict)
    clock: str | None = None
    where: Callable[[int], str] = lambda row: f"row {row + 1}"
    units: Mapping[str, str] = field(default_factory=dict)
    test: str = ""

    def columns(self, names: Sequence[str]) -> list[FloatArray]:
        """Read some columns.

        Parameters
        ----------
        names
            The columns, the one whose clock holds first.

        Returns
        -------
        list of float arrays (N,), in the order of the names.

        Raises
        ------
        BadInput
            Where a column is missing (the message lists those that there are) or cannot be read.
        """
        for name in names:
            if name not in self.names and name != self.clock:
                raise BadInput(f"{self.name}: no column '{name}'; columns are: {listing(self.names)}")
        return [np.where(np.isfinite(column), column, np.nan) for column in self.read(names)]


def listing(names: Sequence[str]) -> str:
    """The names for a message: all of a few, the first of many."""
    if len(names) <= _SHOWN:
        return ", ".join(names)
    return f"{', '.join(names[:_SHOWN])} and {len(names) - _SHOWN} more"


def read_bytes(path: Path) -> bytes:
    """The content of a file, unpacked where it is gzip.

    Raises
    ------
    BadInput
        Where the file cannot be read, is damaged or is larger than memory should be taken for.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise BadInput(f"{path}: is {size / 2**30:.1f} GiB large; cut it into recordings below 2 GiB")
        data = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror})") from None
    if data[:2] != b"\x1f\x8b":
        return data
    try:
        with gzip.open(path) as stream:
            data = stream.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error):
        raise BadInput(f"{path}: is a damaged gzip file; compress the recording again") from None
    if len(data) > MAX_BYTES:
        raise BadInput(f"{path}: unpacks to more than 2 GiB; cut it into smaller recordings")
    return data


def missing_package(path: Path, package: str) -> BadInput:
    """What to say where a format needs a package that is not installed."""
    return BadInput(f"{path}: reading {path.suffix or 'it'} needs {package}: {install('formats', package)}")


def unreadable(path: Path, kind: str, error: Exception | str) -> BadInput:
    """What to say where a reader gives up on a damaged file."""
    said = textwrap.shorten(str(error), 120, placeholder=" ...") or type(error).__name__
    return BadInput(f"{path}: cannot be read as {kind} ({said}); export the recording again")


def unique_names(names: Sequence[tuple[str, str]]) -> list[str]:
    """Short names where they are unique, full ones where not.

    Parameters
    ----------
    names
        Pairs of a full name and its short form.
    """
    count = Counter(short for _, short in names)
    return [short if count[short] == 1 else full for full, short in names]


def from_columns(
    path: Path,
    columns: Mapping[str, Callable[[], FloatArray]],
    scalars: Mapping[str, float],
    units: Mapping[str, str] | None = None,
) -> Table:
    """A table whose columns are made when they are asked for.

    Raises
    ------
    BadInput
        Where there are none, and from `read` where those asked for are not equally long.
    """
    if not columns:
        raise BadInput(f"{path}: holds no numeric columns; give a recording")

    def read(names: Sequence[str]) -> list[FloatArray]:
        chosen = [columns[name]() for name in names]
        for name, column in zip(names, chosen, strict=True):
            if len(column) != len(chosen[0]):
                raise BadInput(
                    f"{path}: column '{name}' has {len(column)} values and '{names[0]}' {len(chosen[0])}; "
                    "columns must be equally long"
                )
        return chosen

    return Table(str(path), tuple(columns), read, scalars, units=units or {})


LOG_TIME = "log time"


def held(stamps: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """The value held at each instant; the first one before the first stamp."""
    index = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, None)
    return values[index]


def from_signals(
    name: str,
    names: Sequence[str],
    signal: Callable[[str], Signal],
    units: Mapping[str, str] | None = None,
    test: str = "",
    window: tuple[float, float] = (-np.inf, np.inf),
) -> Table:
    """A table of signals that may each have a clock of their own: their values are held at the stamps of the first.

    Parameters
    ----------
    name, names, units, test
        As in `Table`.
    signal
        The stamps (s) and values of a name.
    window
        Start and end of the test, s: the rows are the stamps of the first signal from start on and before the end.

    Raises
    ------
    BadInput
        Where there are no signals.
    """
    if not names:
        raise BadInput(f"{name}: holds no numeric signals; give a recording")

    def read(wanted: Sequence[str]) -> list[FloatArray]:
        main = next(n for n in wanted if n != LOG_TIME)
        stamps = signal(main)[0]
        inside = (stamps >= window[0]) & (stamps < window[1])
        if not inside.any():
            raise BadInput(f"{name}: column '{main}' holds no number; record it, or name another")
        columns = []
        for n in wanted:
            own, values = (stamps, stamps) if n == LOG_TIME else signal(n)
            if not own.size:
                raise BadInput(f"{name}: column '{n}' holds no number; record it, or name another")
            same = own.shape == stamps.shape and np.array_equal(own, stamps)
            columns.append(values[inside] if same else held(own, values, stamps[inside]))
        return columns

    return Table(name, tuple(names), read, clock=LOG_TIME, units=units or {}, test=test)
