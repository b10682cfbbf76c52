"""Between what values each parameter may lie."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from twin.model.stepper import EVERYTHING

FloatArray = NDArray[np.float64]

BOUNDS = {p.name: (p.lower, p.upper) for p in EVERYTHING.parameters}


def bounds_of(name: str) -> tuple[float, float]:
    """Between what a parameter lies."""
    return BOUNDS[name]


def within_bounds(values: Mapping[str, float]) -> bool:
    """Whether every parameter lies where it may."""
    return all(BOUNDS[n][0] <= v <= BOUNDS[n][1] for n, v in values.items())


def clipped_to_bounds(values: Mapping[str, float]) -> dict[str, float]:
    """The values, each moved to its nearest bound where it lies beyond."""
    return {n: min(max(v, BOUNDS[n][0]), BOUNDS[n][1]) for n, v in values.items()}
