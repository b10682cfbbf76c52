"""A coarse counter, read where its count changes.

A reading is wrong by up to half a count, and the likelihood takes the errors of two readings for independent. They are
where the axis moves by a count or more from row to row. Where it takes many rows for one count, all of these hold the
error of the first. They say many times over what is known once, and a filter that repeats the last reading foretells
them best. From where more than every second reading of a moving axis repeats the one before, that outweighs all else.

Such a counter still says exactly where the axis is: on the edge between two counts, when it passes from one to the
other. That moment lies between two rows. At the second of them, the axis is beyond the edge by half of what it moves in
a row, give or take as much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.io.faults import BoolArray, FloatArray

#: An axis that stays in one count for longer than this, s, may stand.
_REST_DURATION = 0.5
#: Readings that are further apart than so many usual intervals do not say when the count changed.
_APART = 1.5


@dataclass(frozen=True, eq=False)
class Counted:
    """The readings of a position that are there, in counts of one size. Arrays have shape (M,)."""

    time: FloatArray  # s
    value: FloatArray
    count: float  # size of one, in the unit of `value`

    @property
    def changed(self) -> BoolArray:
        """Whether a reading is another count than the one before; the first is."""
        return np.concatenate(([True], np.abs(np.diff(self.value)) > 0.5 * self.count))

    @property
    def lasts(self) -> FloatArray:
        """How long each count is read (changes,), s."""
        return np.diff(self.time[self.changed], append=self.time[-1])

    @property
    def repeats(self) -> tuple[int, int]:
        """How many readings of a moving axis repeat the one before, and how many there are."""
        changed = self.changed
        moving = (self.lasts < _REST_DURATION)[np.cumsum(changed) - 1]
        return int(np.count_nonzero(moving & ~changed)), int(np.count_nonzero(moving))

    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Where the axis was when its count changed (M,), NaN elsewhere, and how well that is known (changes - 1,).

        The latter is the way within the row, as a share of a count. The first reading stays, known to a count.
        """
        at = np.flatnonzero(self.changed)
        known = np.full(self.time.size, np.nan)
        known[at[0]] = self.value[at[0]]
        at = at[1:]
        row, step = np.diff(self.time)[at - 1], np.diff(self.value)[at - 1]
        lasts = np.minimum(self.lasts, _REST_DURATION)
        # at the mean of the speeds before and after the edge
        share = np.minimum(2.0 * row / np.maximum(lasts[1:] + lasts[:-1], 1e-12), 1.0)
        apart = row > _APART * float(np.median(np.diff(self.time)))
        share[apart | (np.abs(step) > 1.5 * self.count)] = 1.0
        known[at] = self.value[at] - 0.5 * (1.0 - share) * self.count * np.sign(step)
        return known, share


def counted(time: FloatArray, values: FloatArray, count: float) -> Counted | None:
    """The readings of a position (N,), of which NaN are not there; None where nothing is counted, or one count only."""
    read = np.isfinite(values)
    found = Counted(time[read], values[read], count)
    return found if count > 0.0 and np.count_nonzero(found.changed) > 1 else None
