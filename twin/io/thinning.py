"""More recordings than memory holds: of each, what moves most is kept.

What an axis does while it moves says most of its parameters. A longer record of the same motion says the same again:
standard errors shrink with the root of its length. So where too many stamps are held, each recording is cut to that
half of it which moves most. All that were read are halved alike, however many follow, and each has its share.
"""

from __future__ import annotations

import numpy as np

from twin.io.faults import FloatArray

#: So many stamps are held of all recordings together: over two hours at 2 ms.
MOST = 4_000_000
#: A recording of fewer stamps than twice as many is not cut: a short one shows little but how it begins.
_FEWEST = 5_000


def busiest_half(time: FloatArray, output: FloatArray) -> tuple[float, float] | None:
    """First and last moment (s) of the half that moves most; None where the recording is short.

    Parameters
    ----------
    time, output
        The recording (N,), NaN where nothing is read.
    """
    half = time.size // 2
    if half < _FEWEST:
        return None
    read = np.isfinite(output)
    way = np.zeros(time.size)
    way[read] = np.abs(np.diff(output[read], prepend=output[read][:1]))
    if not way.any():  # it stands: where most is read
        way = read.astype(float)
    passed = np.concatenate(([0.0], np.cumsum(way)))
    begin = int(np.argmax(passed[half:] - passed[:-half]))
    return float(time[begin]), float(time[begin + half - 1])
