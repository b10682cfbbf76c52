"""Where a missing torque acts: in which stretches of time, and at which angles, speeds or commands.

A fit goes through everything, so the base model bends towards a torque that acts in a part of the recording, and then
errs everywhere else. Least absolute deviations are moved less by a minority than least squares (Bloomfield and Steiger,
Least Absolute Deviations, 1983). So the base's own laws are fitted in this way to the torque that the model lacks.
What they leave is small wherever the base alone acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from twin.diagnosis.residual_torque import MissingTorque
from twin.io.faults import runs

FloatArray = NDArray[np.float64]

#: Rounds of reweighted least squares, and the residual that counts as none, as a share of the median one.
_ROUNDS, _NO_RESIDUAL = 30, 1e-3
#: Number of bins of a state, and the least number of stamps that say something.
_BINS, _MIN_STAMPS = 50, 20


@dataclass(frozen=True)
class Segment:
    """A stretch of the recording and its share of the whole misfit."""

    start: float
    end: float
    share: float


@dataclass(frozen=True)
class Regime:
    """Values of one variable between which a torque acts. Of directions, from -1 to 0 is backward and 0 to 1 forward.

    A variable that repeats is counted from zero to its period. There a regime may go on across the end, from `low`
    over zero to `high`.
    """

    variable: str
    low: float
    high: float
    period: float = 0.0  # 0 where the variable does not repeat


def _width(missing: MissingTorque) -> int:
    """Stamps over which the filter that read the torque has smoothed it: twice an average."""
    return max(round(2.0 * missing.averaging / missing.step), 1)


def _base_columns(missing: MissingTorque) -> FloatArray:
    """What gain, dead-bands and viscous friction add to the torque (N, 4), as slowly as the filter shows it."""
    command = missing.command
    columns = (command, (command > 0.0).astype(float), (command < 0.0).astype(float), missing.velocity)
    return np.stack([uniform_filter1d(c, _width(missing)) for c in columns], axis=1)


def _least_absolute(columns: FloatArray, missing: MissingTorque) -> FloatArray | None:
    """How much of each column (N, k) the torque in motion holds, by least absolute deviations; None if little is known.

    Friction at rest has any size up to its largest, so only motion is asked.
    """
    known = np.isfinite(missing.torque) & (missing.state("direction") != 0.0)
    some = np.flatnonzero(known)[:: max(round(missing.averaging / missing.step), 1)]
    if len(some) < _MIN_STAMPS:
        return None
    size = np.sqrt(np.mean(np.square(columns), axis=0)) + 1e-300
    scaled, torque = columns[some] / size, missing.torque[some]
    trust = np.ones((len(some), 1))
    for _ in range(_ROUNDS):
        part = np.linalg.lstsq(scaled * trust, torque * trust[:, 0], rcond=None)[0]
        rest = np.abs(torque - scaled @ part)
        trust = 1.0 / np.sqrt(np.maximum(rest, _NO_RESIDUAL * float(np.median(rest)) + 1e-300))[:, None]
    return np.asarray(part / size)


def without_base(missing: MissingTorque) -> MissingTorque:
    """The missing torque without what the base's own laws can make of it, where the axis moves."""
    columns = _base_columns(missing)
    part = _least_absolute(columns, missing)
    if part is None:
        return missing
    return replace(missing, torque=missing.torque - np.where(missing.state("direction") != 0.0, columns @ part, 0.0))


def gain_error(missing: MissingTorque) -> float:
    """By how much the input gain of a base model is too small, in its unit, because of what the model lacks.

    Dry friction of any size in either direction is taken for what it is: it acts with the command most of the time.
    """
    direction = missing.state("direction")
    width = _width(missing)
    dry = [uniform_filter1d((direction == side).astype(float), width) for side in (-1.0, 1.0)]
    part = _least_absolute(np.column_stack([_base_columns(missing), *dry]), missing)
    return 0.0 if part is None else float(part[0])


def segments(missing: MissingTorque, window: float = 0.5, most: int = 8) -> list[Segment]:
    """The stretches that hold most of the misfit, in order of time."""
    ok = np.isfinite(missing.torque)
    if not ok.any():
        return []
    width = max(window, 5.0 * missing.step)
    which = (missing.time[ok] / width).astype(np.intp)
    energy = np.bincount(which, missing.torque[ok] ** 2 * missing.step)
    total = float(energy.sum())
    if total <= 0.0:
        return []
    loud = energy > max(3.0 * float(np.median(energy)), 0.5 * total / len(energy))
    found = [
        Segment(i * width, min((j + 1) * width, float(missing.time[-1])), float(energy[i : j + 1].sum()) / total)
        for i, j in runs(loud)
    ]
    found.sort(key=lambda s: -s.share)
    return sorted(found[:most], key=lambda s: s.start)


def regimes(missing: MissingTorque, variable: str, period: float = 0.0) -> list[Regime]:
    """The values of a variable at which a torque acts, in order: where it is over half of its largest.

    In each bin of the variable the torque has a median for either direction of motion, of which the larger counts: most
    of what acts at an angle or a speed turns its sign with the direction.

    Parameters
    ----------
    missing : MissingTorque
        The torque without what the base makes of it (`without_base`).
    variable : str
        One of ``position``, ``velocity``, ``direction``, ``acceleration``, ``input``.
    period : float
        What the variable repeats after, in its unit; 0 if it does not.

    Returns
    -------
    list of Regime
        Empty where the torque acts at all values, or nothing is known of it in motion.
    """
    values, direction = missing.state(variable), missing.state("direction")
    values = values % period if period else values
    known = np.isfinite(missing.torque) & np.isfinite(values) & (direction != 0.0)
    if np.count_nonzero(known) < _MIN_STAMPS:
        return []
    values, torque, direction = values[known], missing.torque[known], direction[known]
    alike = np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1))
    edges = np.array([-1.0, 0.0, 1.0]) if variable == "direction" else np.unique(alike)
    label = np.searchsorted(edges[1:-1], values, "right")
    size = np.array([_acting(torque[label == i], direction[label == i]) for i in range(max(len(edges) - 1, 1))])
    loud = size > 0.5 * size.max()
    if loud.all():
        return []
    found = [Regime(variable, float(edges[i]), float(edges[j + 1]), period) for i, j in runs(loud)]
    if period and len(found) > 1 and loud[0] and loud[-1]:
        return [*found[1:-1], Regime(variable, found[-1].low, found[0].high, period)]
    return found


def regimes_of(missing: MissingTorque, variables: Sequence[str], period: float = 0.0) -> list[Regime]:
    """The regimes of the one variable that a torque goes with. That it turns its sign with the direction is left out.

    Where it goes with several variables, no values of one of them say where it acts; with time, its segments do.
    """
    apart = [v for v in variables if v != "direction"] or list(variables)
    return regimes(missing, apart[0], period) if len(apart) == 1 and apart != ["time"] else []


def _acting(torque: FloatArray, direction: FloatArray) -> float:
    """The larger of the two medians of a bin's torque, one for each direction of motion."""
    sides = (torque[direction == side] for side in (-1.0, 1.0))
    return max((abs(float(np.median(t))) for t in sides if len(t) >= _MIN_STAMPS), default=0.0)
