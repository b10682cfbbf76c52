"""Where a report comes from: version, date, command, the files that went in, and what to do next."""

from __future__ import annotations

import hashlib
import os
import shlex
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from twin.io.recording import Recording


@dataclass(frozen=True)
class Origin:
    """What another person needs to make the same report again.

    Attributes
    ----------
    version : str
        Of twin.
    date : str
        ISO 8601, UTC; from SOURCE_DATE_EPOCH where that is set, so that the same input gives the same bytes.
    command : str
        The command line, or "" where the report was made from Python.
    inputs : tuple of (name, sha256)
        The files that were read.
    outputs : tuple of str
        The files that were written.
    next_commands : tuple of str
        Commands to copy.
    """

    version: str
    date: str
    command: str
    inputs: tuple[tuple[str, str], ...]
    outputs: tuple[str, ...]
    next_commands: tuple[str, ...]


def command_line() -> str:
    """The command that runs now, to be copied; "" where it is no command of twin."""
    program = Path(sys.argv[0])
    called = program.stem == "twin" or (program.name == "__main__.py" and program.parent.name == "twin")
    return shlex.join(["twin", *sys.argv[1:]]) if called else ""


def trace_origin(inputs: Iterable[Path], outputs: Iterable[str], next_commands: Iterable[str] = ()) -> Origin:
    """The origin of a report that is made now.

    Parameters
    ----------
    inputs : iterable of Path
        Recordings, rig file, model; what is no file is left out.
    outputs, next_commands : iterable of str
        Files that are written, and commands to copy.
    """
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    made = datetime.fromtimestamp(int(epoch), UTC) if epoch.isdigit() else datetime.now(UTC)
    read = tuple((p.name, file_digest(p)) for p in dict.fromkeys(inputs) if p.is_file())
    return Origin(
        version("twin"), made.isoformat(timespec="seconds"), command_line(), read, tuple(outputs), tuple(next_commands)
    )


def file_digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def files_of(recordings: Iterable[Recording]) -> list[Path]:
    """The files that recordings were read from, and the rig files that said how."""
    read = [(r.file, r.rig and Path(r.rig.name)) for r in recordings]
    return [path for pair in read for path in pair if path]
