"""How the speed of an axis changes with its command: a regression that knows nothing of the axis.

On an even grid of step h, with the mean speed v and the mean command u of each interval,

    v[j+1] - v[j] = c . (u[j+1], u[j], u[j-1]) + own motion + noise

where own motion is linear in v, sign v, the position, its sine and cosine, and 1: viscous and dry friction, springs,
gravity and offsets. Without these, a loop that holds a load against gravity would turn the sign of c.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

#: Steps of the grid to try, s; the one on which the command explains most is taken.
_GRID = (0.01, 0.03, 0.1)
#: A command is moved in time by so many different amounts, to see what chance gives.
_SHIFTS = 40
#: Rows that are enough; more of them only take time.
_MAX_ROWS = 20_000


@dataclass(frozen=True, eq=False)
class Signals:
    """What the checks look at. Arrays have shape (N,)."""

    name: str
    time: FloatArray  # s
    command: FloatArray
    output: FloatArray  # NaN where there is no reading
    is_speed: bool
    resolution: float  # of the output, 0.0 where it is not counted
    logged_command: FloatArray  # as the file holds it
    input_unit: str


@dataclass(frozen=True, eq=False)
class Grid:
    """Motion on an even grid of one recording. Arrays have shape (M,)."""

    speed: FloatArray  # mean over each interval
    position: FloatArray  # where each interval begins
    command: FloatArray  # mean over each interval


def to_grid(signals: Signals, step: float) -> Grid:
    """Mean speed and mean command over intervals of `step` s, of readings as they are."""
    good = np.isfinite(signals.output)
    t, y = signals.time[good], signals.output[good]
    at = np.arange(t[0], t[-1], step)
    if signals.is_speed:
        moved = np.concatenate(([0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))))
        position = np.interp(at, t, moved)
    else:
        position = np.interp(at, t, y)
    held = np.concatenate(([0.0], np.cumsum(signals.command[:-1] * np.diff(signals.time))))
    command = np.diff(np.interp(at, signals.time, held)) / step
    return Grid(np.diff(position) / step, position[:-1], command)


@dataclass(frozen=True, eq=False)
class Regression:
    """The rows of all recordings: `change` (R,), `command` (R, 3), `motion` (R, 6) with speed and its sign first."""

    change: FloatArray
    motion: FloatArray
    command: FloatArray
    lengths: tuple[int, ...]  # rows of each recording

    def gain(self, command: FloatArray | None = None, rows: npt.NDArray[np.bool_] | None = None) -> tuple[float, float]:
        """The share of what own motion leaves that the command explains, and the sum of its coefficients."""
        command = self.command if command is None else command
        change, motion = self.change, self.motion
        if rows is not None:
            change, motion, command = change[rows], motion[rows], command[rows]
        if change.size < 30:
            return 0.0, 0.0
        left = _residual(motion, np.column_stack([change, command]))
        ours, theirs = left[:, 0], left[:, 1:]
        coefficients = np.linalg.lstsq(theirs, ours, rcond=1e-9)[0]
        total = float(np.dot(ours, ours))
        rest = float(np.sum((ours - theirs @ coefficients) ** 2))
        return (1.0 - rest / total if total > 0.0 else 0.0), float(np.sum(coefficients))

    def shifted(self, share: float) -> FloatArray:
        """The command of each recording, moved round by a share of its length."""
        parts = np.split(self.command, np.cumsum(self.lengths)[:-1])
        return np.concatenate([np.roll(p, max(1, round(share * len(p))), axis=0) for p in parts])


def _residual(of: FloatArray, values: FloatArray) -> FloatArray:
    """What is left of each column of `values` after least squares on the columns of `of`."""
    scaled = of / np.maximum(np.sqrt(np.mean(of**2, axis=0)), 1e-300)
    orthogonal, weights, _ = np.linalg.svd(scaled, full_matrices=False)
    orthogonal = orthogonal[:, weights > 1e-9 * weights[0]]
    return np.asarray(values - orthogonal @ (orthogonal.T @ values))


def regression(recordings: Sequence[Signals], step: float) -> Regression | None:
    """The rows of the regression on a grid of `step` s; None where there are too few of them."""
    change, motion, command, lengths = [], [], [], []
    for signals in recordings:
        grid = to_grid(signals, step)
        rows = grid.speed.size - 2
        if rows < 5:
            continue
        v, x, u = grid.speed[1:-1], grid.position[1:-1], grid.command
        change.append(np.diff(grid.speed[1:]))
        x = x - np.mean(x)
        motion.append(
            np.column_stack([v, np.sign(v), x, np.sin(grid.position[1:-1]), np.cos(grid.position[1:-1]), np.ones(rows)])
        )
        command.append(np.column_stack([u[2:], u[1:-1], u[:-2]]))
        lengths.append(rows)
        if sum(lengths) > _MAX_ROWS:
            break
    if sum(lengths) < 30:
        return None
    return Regression(np.concatenate(change), np.concatenate(motion), np.concatenate(command), tuple(lengths))


@dataclass(frozen=True, eq=False)
class Response:
    """How much of the change of speed the command explains, as it is and moved in time."""

    rows: Regression
    step: float  # s
    share: float  # 0 to 1
    coefficient: float  # speed a step and unit of the command
    shifted_shares: FloatArray  # (_SHIFTS,)
    shifted_coefficients: FloatArray  # (_SHIFTS,)

    @property
    def score(self) -> float:
        """The coefficient over the standard deviation that it has with the command moved in time."""
        return self.coefficient / max(float(np.sqrt(np.mean(self.shifted_coefficients**2))), 1e-300)

    @property
    def rank(self) -> float:
        """The share of the moved commands that explain less than the true one."""
        return float(np.mean(self.shifted_shares < self.share))


def response(
    recordings: Sequence[Signals], reading: Callable[[Regression], FloatArray] | None = None
) -> Response | None:
    """The response on the grid on which the command explains most; None where there are too few readings.

    Parameters
    ----------
    recordings
        Recordings of one rig.
    reading
        What to take for the command (R, 3), from the rows; the command as it is by default.
    """
    usual = max(3.0 * float(np.median(np.diff(s.time[np.isfinite(s.output)]))) for s in recordings)
    tried = [(h, rows) for h in (max(h, usual) for h in _GRID) if (rows := regression(recordings, h)) is not None]
    if reading is not None:
        tried = [(h, replace(rows, command=reading(rows))) for h, rows in tried]
    if not tried:
        return None
    found = [(*rows.gain(), h, rows) for h, rows in tried]
    share, coefficient, step, rows = max(found, key=lambda f: f[0])
    moved = [rows.gain(rows.shifted(s)) for s in np.linspace(0.08, 0.92, _SHIFTS)]
    shares, coefficients = (np.array(values) for values in zip(*moved, strict=True))
    return Response(rows, step, share, coefficient, shares, coefficients)


def speed_response(seen: Response, size: Callable[[FloatArray], FloatArray]) -> tuple[float, float]:
    """How much of the speed itself the command explains, and the share of the moved commands that explain less of it.

    Parameters
    ----------
    seen
        The rows.
    size
        What is to be explained of the speed (R,): the speed, or its size.
    """
    return _share_and_rank(replace(seen.rows, change=size(seen.rows.motion[:, 0]), motion=seen.rows.motion[:, 2:]))


def size_of_change_response(seen: Response) -> tuple[float, float]:
    """The same of the size of what own motion leaves of the change of speed."""
    left = np.abs(_residual(seen.rows.motion, seen.rows.change[:, np.newaxis])[:, 0])
    return _share_and_rank(replace(seen.rows, change=left, motion=np.ones((left.size, 1))))


def _share_and_rank(rows: Regression) -> tuple[float, float]:
    """How much the command explains, and the share of the moved commands that explain less."""
    share = rows.gain()[0]
    moved = [rows.gain(rows.shifted(s))[0] for s in np.linspace(0.08, 0.92, _SHIFTS)]
    return share, float(np.mean(np.array(moved) < share))
