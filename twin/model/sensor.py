"""Where the axis was when its sensor read something: a recording begins with a reading, a model with a position."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.model import equations
from twin.model.stepper import Structure

#: A sensor errs by less than it shows, so that each look halves at least what is still wrong (`encoder_eccentricity`).
_LOOKS, _NEAR = 50, 1e-12
#: Share of a parameter's size by which it is moved to see how the position goes with it.
_MOVED = 1e-6


def _errors(structure: Structure) -> tuple[str, ...]:
    return tuple(e.id for e in structure.effects if e.slot == "sensor")


def parameters(structure: Structure) -> tuple[str, ...]:
    """Names of the parameters that what is read depends on beside the position."""
    return tuple(p.name for e in structure.effects if e.slot == "sensor" for p in e.parameters)


def position(structure: Structure, values: Mapping[str, float], reading: float, gap: float = 0.0) -> float:
    """The link's position at which the structure's sensor reads this, with the motor `gap` ahead; in the axis' unit."""
    errors, found = _errors(structure), reading
    for _ in range(_LOOKS if errors else 0):
        at = {"position": np.array([found]), "gap": np.array([gap])}
        before, found = found, reading - sum(float(equations.along(i, at, values)[0]) for i in errors)
        if abs(found - before) < _NEAR:
            break
    return found


def gap_slope(structure: Structure, values: Mapping[str, float], reading: float, gap: float) -> float:
    """The derivative of that position with respect to the gap."""
    one, other = (position(structure, values, reading, gap + s) for s in (_MOVED, -_MOVED))
    return (one - other) / (2.0 * _MOVED)


def slope(structure: Structure, values: Mapping[str, float], reading: float, name: str, gap: float = 0.0) -> float:
    """The derivative of that position with respect to one of the sensor's parameters."""
    step = _MOVED * max(abs(values[name]), 1.0)
    one, other = (position(structure, {**values, name: values[name] + s}, reading, gap) for s in (step, -step))
    return (one - other) / (2.0 * step)
