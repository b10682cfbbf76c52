"""Recordings that are too long to be searched as a whole: stretches of them lead to the maximum of the whole.

A search looks at the likelihood some hundred times, mostly far from the maximum. There a share of the readings says as
much as all of them. Near the maximum all of them count: the last steps and the standard errors are made on the whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.io.recording import Recording

#: More stamps than this are many for a fit. Of many, this share of that number is searched, in stretches of so many s.
MANY, _SEARCHED, _STRETCH = 200_000, 0.4, 12.0
#: A stretch of which this share of the readings is missing is none.
_MIN_READ = 0.5


def is_long(recordings: Sequence[Recording], many: int = MANY) -> bool:
    """Whether the recordings hold more stamps than so many."""
    return sum(len(r.time) for r in recordings) > many


def stretches(recordings: Sequence[Recording], many: int = MANY) -> list[Recording]:
    """Stretches of long recordings, spread evenly over those that move at least half as far as all do on average.

    Parameters
    ----------
    recordings
        What is to be fitted.
    many
        More stamps than this are too many.

    Returns
    -------
    list of Recording
        The recordings themselves where they are not long, or where stretches would hold most of them.
    """
    if not is_long(recordings, many):
        return list(recordings)
    cuts, travel, rows = [], [], []
    for k, r in enumerate(recordings):
        read = np.isfinite(r.output)
        ends = np.searchsorted(r.time, _STRETCH * np.arange(max(round(r.time[-1] / _STRETCH), 1) + 1))
        ends[-1] = len(r.time)
        for begin, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
            seen = r.output[begin:end][read[begin:end]]
            if len(seen) > _MIN_READ * (end - begin) * float(np.mean(read)) and len(seen) > 2:
                cuts.append((k, begin, end - 1))
                travel.append(float(np.sum(np.abs(np.diff(seen)))))
                rows.append(end - begin)
    moving = [c for c, way in zip(cuts, travel, strict=True) if way >= 0.5 * float(np.mean(travel))]
    wanted = max(math.ceil(_SEARCHED * many / float(np.median(rows))), 2) if rows else 0
    if not 0 < wanted <= len(moving) // 2:
        return list(recordings)
    chosen = [moving[i] for i in np.linspace(0, len(moving) - 1, wanted).astype(int)]
    return [recordings[k].part(float(recordings[k].time[a]), float(recordings[k].time[b])) for k, a, b in chosen]
