"""What every simulator of rigs shares: an effect put into one, and how plainly it then shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Concealed:
    """One effect put into a rig; units of the parameters are those of the simulator.

    `carrier` is what the effect is a part of and cannot be without, as the dry friction that is larger one way: it
    is there, too, but how plainly it shows does not count for the effect.
    """

    id: str
    parameters: dict[str, float]
    carrier: Concealed | None = None


def visibility(
    simulate: Callable[..., Any],
    rig: Any,
    effects: Sequence[Concealed],
    time: Array,
    duty: Array,
    seed: int,
    window: float = 0.5,
) -> float:
    """How much more the effects change than noise does: RMS change of the travel per window, in counts,
    over the same for another seed of the noise. Runs are not restarted at each window, so above ten or so it
    only says "plain to see".
    """
    carriers = [e.carrier for e in effects if e.carrier is not None]
    plain = simulate(rig, carriers, time, duty, seed).counts
    other = simulate(rig, carriers, time, duty, seed + 1).counts
    changed = simulate(rig, effects, time, duty, seed).counts
    stride = max(int(np.searchsorted(time - time[0], window)), 1)

    def travel_change(counts: NDArray[np.int64]) -> float:
        change = (counts - plain).astype(float)
        return float(np.sqrt(np.mean((change[stride:] - change[:-stride]) ** 2)))

    return travel_change(changed) / max(travel_change(other), 0.5)
