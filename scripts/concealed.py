"""What every simulator of rigs shares: an effect put into one, and how plainly it then shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]

THIN = 10  # every so manieth stamp is compared: windows overlap
ROUNDS = 4  # times that the rig's own numbers are moved


@dataclass(frozen=True)
class Concealed:
    """One effect put into a rig; units of the parameters are those of the simulator.

    `carrier` is what the effect is a part of and cannot be without, as the dry friction that is larger one way: it
    is there, too, but how plainly it shows does not count for the effect.
    """

    id: str
    parameters: dict[str, float]
    carrier: Concealed | None = None


def _carriers(effects: Sequence[Concealed]) -> list[Concealed]:
    return [e.carrier for e in effects if e.carrier is not None]


def _travel(position: Array, time: Array, window: float) -> Array:
    """By how much a position (N,) changes within each window, s."""
    stride = max(int(np.searchsorted(time - time[0], window)), 1)
    return np.asarray(position[stride:] - position[:-stride])


def _size(change: Array) -> float:
    return float(np.sqrt(np.mean(change**2)))


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
    carriers = _carriers(effects)
    plain = simulate(rig, carriers, time, duty, seed).counts
    other = simulate(rig, carriers, time, duty, seed + 1).counts
    changed = simulate(rig, effects, time, duty, seed).counts

    def travel_change(counts: NDArray[np.int64]) -> float:
        return _size(_travel((counts - plain).astype(float), time, window))

    return travel_change(changed) / max(travel_change(other), 0.5)


def unabsorbed(
    simulate: Callable[..., Any],
    rig: Any,
    effects: Sequence[Concealed],
    time: Array,
    duty: Array,
    seed: int,
    window: float = 0.5,
) -> float:
    """What the effects change over what noise does, where the rig's `own` numbers are chosen anew without them.

    A gain that is smaller does most of what a supply does that gives way, and only what it does not do is left for a
    first model to show. The numbers are found by least squares from those of the rig; a search that ends early leaves
    more, so that this is the most that it can be.
    """
    carriers = _carriers(effects)
    count = 2.0 * np.pi / rig.counts_per_revolution

    def travel(rig: Any, effects: Sequence[Concealed], seed: int = seed) -> Array:
        return _travel(simulate(rig, effects, time, duty, seed).position, time, window)[::THIN] / count

    noise = max(_size(travel(rig, carriers, seed + 1) - travel(rig, carriers)), 0.5)
    changed, own = travel(rig, effects), dict(rig.own)

    def left(ratios: Array) -> Array:
        moved = {n: value * r for (n, (value, _)), r in zip(own.items(), ratios.tolist(), strict=True)}
        return (travel(rig.with_(**moved), carriers) - changed) / noise

    most = [limit / value for value, limit in own.values()]
    found = least_squares(
        left, np.ones(len(own)), bounds=(0.01, most), x_scale="jac", diff_step=1e-3, max_nfev=ROUNDS
    )  # fmt: skip
    return _size(found.fun)
