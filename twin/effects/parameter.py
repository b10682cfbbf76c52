"""Parameters and their units: the vocabulary in which a model is written down."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """One number of a law, with everything a reader, a file or an importer needs to know about it.

    `unit` may hold the placeholders `{x}` (rad, m or kcount, the axis) and `{u}` (the unit of the input).
    `neutral` is the value at which the effect is absent, or None where the value then does not matter.
    `estimated` is False for numbers that describe the law and are not fitted; `acts_on` names the effect or slot
    without which the number has nothing to act on.
    """

    name: str
    unit: str
    meaning: str
    neutral: float | None
    lower: float = -math.inf
    upper: float = math.inf
    start: float = 0.0
    estimated: bool = True
    acts_on: str = ""

    def unit_for(self, axis: str, drive: str) -> str:
        """The unit on a given rig: `axis` is "rad", "m" or "kcount", `drive` the unit of the input."""
        unit = self.unit.format(x=axis, u=drive)
        return "1" if unit == "rad/rad" else unit

    def __repr__(self) -> str:
        return f"{self.name} [{self.unit}]: {self.meaning}"
