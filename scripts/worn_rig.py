"""Rigs that depart from every law a little, as machines in use do: `gearmotor_rig`, with three departures each.

A departure is an effect of a list, at 2 to 5 % of the drive's torque. It is part of the rig and is not what is
concealed: to name one is right, and not to name it is right, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields

import gearmotor_rig
import numpy as np
from concealed import Array, Concealed
from gearmotor_rig import OUTSIDE, VOCABULARY, Simulated, draw_effect

__all__ = ["OUTSIDE", "VOCABULARY", "draw_effect", "draw_rig", "simulate"]

#: Friction that runs in, friction that differs by direction, cogging with an overtone, a sensor or a drive that is late
#: (the recording cannot tell which), a supply that sags.
DEPARTURES = ("friction_run_in", "friction_asymmetry", "torque_ripple", "input_delay", "supply_sag")
SMALLEST, LARGEST, COUNT = 0.02, 0.05, 3
#: A key of `Rig.truths` that begins so holds the size of a departure.
DEPARTS = "departs_"


@dataclass(frozen=True)
class Departure:
    """An effect that a rig has beside the concealed ones, and its size as `draw_effect` has it."""

    effect: Concealed
    size: float


@dataclass(frozen=True)
class Rig(gearmotor_rig.Rig):
    """A drive with its departures."""

    departures: tuple[Departure, ...] = ()

    def truths(self) -> dict[str, float]:
        own = {f.name: float(getattr(self, f.name)) for f in fields(gearmotor_rig.Rig)}
        return own | self.model_values() | {f"{DEPARTS}{d.effect.id}": d.size for d in self.departures}


def draw_rig(rng: np.random.Generator) -> Rig:
    """A drive of the same population, with three of the departures."""
    rig = gearmotor_rig.draw_rig(rng)
    drawn = []
    for id in rng.choice(DEPARTURES, COUNT, replace=False).tolist():
        size = float(rng.uniform(SMALLEST, LARGEST))
        drawn.append(Departure(draw_effect(rng, id, rig, size), size))
    return Rig(**asdict(rig), departures=tuple(drawn))


def simulate(rig: Rig, effects: Sequence[Concealed], time: Array, duty: Array, seed: int | None) -> Simulated:
    """As `gearmotor_rig.simulate`; a departure of the kind of a concealed effect leaves its place to that."""
    concealed = {e.id for e in effects}
    others = [d.effect for d in rig.departures if d.effect.id not in concealed]
    return gearmotor_rig.simulate(rig, [*effects, *others], time, duty, seed)
