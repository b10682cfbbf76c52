"""What every simulator of rigs shares: an effect put into one, and how plainly it then shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]

THIN = 10  # every so manieth stamp is compared: windows overlap
ROUNDS = 8  # times that the rig's own numbers are moved
FAIR = 0.01  # share of a sum of squares by which another move has to make it less
NEAREST = 2  # places from which that is begun where something else stands for an effect


@dataclass(frozen=True)
class Concealed:
    """One effect put into a rig; units of the parameters are those of the simulator.

    `carrier` is what the effect is a part of and cannot be without, as the dry friction that is larger one way: it
    is there, too, but how plainly it shows does not count for the effect.
    """

    id: str
    parameters: dict[str, float]
    carrier: Concealed | None = None


def check(effects: Sequence[Concealed], known: Sequence[str]) -> None:
    """Raises ValueError for an effect that is not among the known ones or there twice."""
    ids = [e.id for e in effects]
    for i in ids:
        if i not in known:
            raise ValueError(f"no effect {i!r}; there are {', '.join(known)}")
        if ids.count(i) > 1:
            raise ValueError(f"{i} is there twice")


def together(effects: Sequence[Concealed], known: Sequence[str]) -> dict[str, float]:
    """The numbers of all effects; of what several have a part in, as dry friction, the sum. Raises as `check` does."""
    check(effects, known)
    values: dict[str, float] = {}
    for effect in effects:
        for name, value in effect.parameters.items():
            values[name] = values.get(name, 0.0) + value
    return values


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number between two positive ones, as likely in each half of their ratio."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


@dataclass(frozen=True)
class Drawing:
    """What the numbers of one effect are drawn from: the rig, the effect's size, and chance.

    `duration` (s) is of the recording.
    """

    rng: np.random.Generator
    rig: Any
    size: float
    duration: float

    @property
    def torque(self) -> float:
        """That of the effect: its size is the share of the drive's torque at 50 % duty."""
        return self.size * float(self.rig.half_torque)

    @property
    def speed(self) -> float:
        """Of the rig in steady running at 50 % duty, rad/s."""
        return float(self.rig.half_speed)

    @property
    def reach(self) -> float:
        """The angle (rad) either way that the axis is sure to come by again and again."""
        return min(0.5 * self.speed, np.pi)

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def log_uniform(self, low: float, high: float) -> float:
        return log_uniform(self.rng, low, high)

    def phase(self) -> float:
        return self.between(-np.pi, np.pi)

    def either(self) -> float:
        """Forwards or in reverse: 1 or -1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def one_of(self, *names: str) -> str:
        return str(self.rng.choice(names))


def drawn(
    id: str,
    drawing: Any,
    effects: Mapping[str, Callable[[Any], dict[str, float]]],
    in_dry_friction: Mapping[str, Callable[[Any], tuple[dict[str, float], dict[str, float]]]],
    known: Sequence[str],
) -> Concealed:
    """The effect with numbers from a simulator's tables. Some stand in dry friction, which is drawn with them.

    Raises ValueError for an id that is in neither table; `known` are all that the simulator has.
    """
    if id in in_dry_friction:
        values, plain = in_dry_friction[id](drawing)
        return Concealed(id, values, Concealed("coulomb_friction", plain))
    if id in effects:
        return Concealed(id, effects[id](drawing))
    raise ValueError(f"no effect {id!r}; there are {', '.join(known)}")


def _carriers(effects: Sequence[Concealed]) -> list[Concealed]:
    return [e.carrier for e in effects if e.carrier is not None]


def _travel(position: Array, time: Array, window: float) -> Array:
    """By how much a position (N,) changes within each window, s."""
    stride = max(int(np.searchsorted(time - time[0], window)), 1)
    return np.asarray(position[stride:] - position[:-stride])


def _size(change: Array) -> float:
    return float(np.sqrt(np.mean(change**2)))


def _grown(effects: Sequence[Concealed], ratios: Iterator[float]) -> list[Concealed]:
    """The effects with every number that is not zero, a carrier's too, times the next of the ratios."""
    out = []
    for e in effects:
        carrier = None if e.carrier is None else _grown([e.carrier], ratios)[0]
        numbers = {n: v * next(ratios) if v else v for n, v in e.parameters.items()}
        out.append(Concealed(e.id, numbers, carrier))
    return out


def _numbers(effects: Sequence[Concealed]) -> int:
    """How many numbers `_grown` moves."""
    return sum(sum(map(bool, e.parameters.values())) for e in (*effects, *_carriers(effects)))


@dataclass(frozen=True)
class Trip:
    """How far a rig is read to come within each window, s, under a command (N,) with one run of the noise."""

    simulate: Callable[..., Any]
    time: Array
    duty: Array
    seed: int
    window: float = 0.5

    def counts(self, rig: Any, effects: Sequence[Concealed], seed: int) -> NDArray[np.int64]:
        """Of the encoder, at every stamp."""
        counts: NDArray[np.int64] = self.simulate(rig, effects, self.time, self.duty, seed).counts
        return counts

    def travel(self, rig: Any, effects: Sequence[Concealed], seed: int) -> Array:
        """In counts."""
        shown = self.simulate(rig, effects, self.time, self.duty, seed).shown
        return _travel(shown, self.time, self.window)[::THIN] * rig.counts_per_revolution / (2.0 * np.pi)

    def noise(self, rig: Any, effects: Sequence[Concealed]) -> float:
        """RMS of what another run of the noise changes, in counts; half a count at least."""
        return max(_size(self.travel(rig, effects, self.seed + 1) - self.travel(rig, effects, self.seed)), 0.5)

    def least(self, rig: Any, changed: Array, fixed: Sequence[Concealed], loose: Sequence[Concealed]) -> float:
        """RMS, in counts, of what is left of `changed` once the rig's `own` numbers and those of the `loose` effects
        are chosen anew, by least squares from what they are. A search that ends early leaves more, so that this is the
        most that it can be.
        """
        own = dict(rig.own)

        def left(ratios: Array) -> Array:
            each = iter(ratios.tolist())
            moved = rig.with_(**{n: value * next(each) for n, (value, _) in own.items()})
            return self.travel(moved, [*fixed, *_grown(loose, each)], self.seed) - changed

        most = [limit / value for value, limit in own.values()] + _numbers(loose) * [np.inf]
        found = least_squares(
            left, np.ones(len(most)), bounds=(0.01, most), x_scale="jac", diff_step=1e-3, ftol=FAIR, max_nfev=ROUNDS
        )  # fmt: skip
        return _size(found.fun)


def visibility(trip: Trip, rig: Any, effects: Sequence[Concealed]) -> float:
    """How much more the effects change than noise does: RMS change of the travel per window, in counts,
    over the same for another seed of the noise. Runs are not restarted at each window, so above ten or so it
    only says "plain to see".
    """
    carriers = _carriers(effects)
    plain = trip.counts(rig, carriers, trip.seed)
    other = trip.counts(rig, carriers, trip.seed + 1)
    changed = trip.counts(rig, effects, trip.seed)

    def travel_change(counts: NDArray[np.int64]) -> float:
        return _size(_travel((counts - plain).astype(float), trip.time, trip.window))

    return travel_change(changed) / max(travel_change(other), 0.5)


def unabsorbed(trip: Trip, rig: Any, effects: Sequence[Concealed], beside: Sequence[Concealed] = ()) -> float:
    """What the effects change over what noise does, where the rig's `own` numbers, and those of what is there beside
    them, are chosen anew without them.

    A gain that is smaller does most of what a supply does that gives way, and only what it does not do is left for a
    first model to show. And beside a torque that keeps the axis away from it a stop does nothing.
    """
    carriers, changed = _carriers(effects), trip.travel(rig, [*effects, *beside], trip.seed)
    return trip.least(rig, changed, carriers, beside) / trip.noise(rig, [*carriers, *beside])


def unanswered(trip: Trip, rig: Any, effects: Sequence[Concealed], answers: Sequence[Sequence[Concealed]]) -> float:
    """What the effects change over what noise does, where others stand in their place: of `answers`, which are the same
    effects at other numbers, the nearest few, with these numbers and the rig's `own` chosen anew.
    """
    changed = trip.travel(rig, effects, trip.seed)
    nearest = sorted(answers, key=lambda a: _size(trip.travel(rig, a, trip.seed) - changed))[:NEAREST]
    return min(trip.least(rig, changed, (), a) for a in nearest) / trip.noise(rig, _carriers(effects))
