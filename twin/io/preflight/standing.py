"""An output that stands still while another column of the same file says that the axis moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.io.faults import FloatArray

#: Correlation with the speed of the output from which on a column is taken for a speed.
_MIN_CORRELATION = 0.8
#: A column says motion where its mean size exceeds this share of what it is while the output moves.
_MIN_MOTION = 0.05
#: Over so many rows the speed of a coarse output is taken.
_ROWS = 10


@dataclass(frozen=True, eq=False)
class Columns:
    """The output of one file and its other columns. Arrays have shape (N,)."""

    time: FloatArray  # s
    output: FloatArray
    is_speed: bool
    others: Mapping[str, FloatArray]

    @property
    def moves(self) -> bool:
        """Whether the output ever changes."""
        return bool(np.nanmax(self.output) > np.nanmin(self.output))


def _correlation(columns: Columns, name: str) -> float:
    """Of a column with the speed of the output, over the same stretches of time."""
    rows = min(_ROWS, columns.time.size // 5)
    speed = columns.output[rows:] if columns.is_speed else columns.output[rows:] - columns.output[:-rows]
    if not columns.is_speed:
        speed = speed / (columns.time[rows:] - columns.time[:-rows])
    total = np.cumsum(columns.others[name])
    mean = (total[rows:] - total[:-rows]) / rows
    good = np.isfinite(speed) & np.isfinite(mean)
    if np.count_nonzero(good) < 10 or np.ptp(speed[good]) == 0 or np.ptp(mean[good]) == 0:
        return 0.0
    return float(np.corrcoef(speed[good], mean[good])[0, 1])


def contradicted(files: Sequence[Columns]) -> dict[int, str]:
    """The files whose output stands still throughout while a column says motion, and the name of that column.

    A column that follows the speed of the output wherever that moves (a correlation of over 0.8 in each file) measures
    the same motion. Where it goes on while the output stands, the output is not what it was.
    """
    moving = [f for f in files if f.moves]
    names = set.intersection(*(set(f.others) for f in files)) if files else set()
    found: dict[int, str] = {}
    for name in sorted(names):
        if not moving or min(_correlation(f, name) for f in moving) < _MIN_CORRELATION:
            continue
        usual = float(np.mean([np.nanmean(np.abs(f.others[name])) for f in moving]))
        for k, f in enumerate(files):
            if not f.moves and np.nanmean(np.abs(f.others[name])) > _MIN_MOTION * usual:
                found.setdefault(k, name)
    return found
