"""What `import twin` offers for reading recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from twin.io import recording
from twin.io.recording import Recording

PathLike = str | Path


def load(log: PathLike | Sequence[PathLike], rig: PathLike | None = None) -> list[Recording]:
    """Read recordings of one axis.

    Parameters
    ----------
    log
        A recording, a manifest (a CSV with a column `file`), or several of either. CSV and MAT v5 need no extra;
        the other formats need ``pip install '.[formats]'``.
    rig
        The rig file, which says what the columns are and in which units. By default the ``rig.toml`` beside the first
        log; without one, columns are recognised by their names, and `Recording.rig` says what was assumed.

    Returns
    -------
    list of Recording
        One entry a recording. Time is in s from 0; input and output are in the units that the rig file names. Readings
        that cannot be right are NaN, and `Recording.faults` says why.

    Raises
    ------
    BadInput
        A file cannot be used. The message names file, line, column and value, and says what to do.

    Examples
    --------
    >>> import twin
    >>> recordings = twin.load("models/shipped/recording.csv")
    >>> recordings[0].output_unit
    'rad'
    """
    paths = [log] if isinstance(log, str | Path) else list(log)
    return recording.load([Path(p) for p in paths], None if rig is None else Path(rig))[0]


def as_list(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """A list, also where one recording was given."""
    return [recordings] if isinstance(recordings, Recording) else list(recordings)
