"""How far noise alone takes a free run from the recording, and how likely an error as large as the one found is.

A free run starts at the recorded state and gets no reading afterwards. A torque that the model lacks, even white noise,
is integrated twice. So the error drifts, and its samples are correlated over the whole run. The mean of its squares is
therefore no chi-square of as many degrees of freedom as there are readings, but a weighted sum of a few:

    error = G z,  z ~ N(0, I)      ->      mean square = sum_i lambda_i z_i^2,  lambda_i eigenvalues of G' W G,

with W the share of the readings at each point of a coarse grid. G follows from the linear dynamics of a small error e
along the run. Stiffness k(t) and damping b(t) are those of the model's laws, and q is the density of a white torque
noise:

    e'' = -k(t) e - b(t) e' + w(t),    E[w(t) w(s)] = q delta(t - s).

Where dry friction holds the axis, noise does not move it and the speed error is zero. The distribution function is the
saddlepoint approximation of Lugannani and Rice (Kuonen, Biometrika 86, 1999).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

FloatArray = NDArray[np.float64]

#: Of a mode that swings so far within one step, rad, only so much is followed: a coarse step would make it grow.
_SWING = 1.0
#: Share of the largest weight below which a chi-square adds nothing.
_NOTHING = 1e-9
#: Share of the variance of all runs below which a mode of one of them is left out.
_FAINT = 1e-7


@dataclass(frozen=True, eq=False)
class Dynamics:
    """How a small error of a free run moves; arrays (N,), one entry a stamp."""

    time: FloatArray  # s
    stiffness: FloatArray  # 1/s^2
    damping: FloatArray  # 1/s
    moving: NDArray[np.bool_]  # whether the axis moves, or dry friction holds it


@dataclass(frozen=True, eq=False)
class Noise:
    """What makes an error: noise on the torque, and of the state at the start."""

    torque: float  # density, axis unit^2/s^3
    position: float  # variance at the start, axis unit^2
    velocity: float  # variance at the start, (axis unit/s)^2


def _stepped(dynamics: Dynamics, edges: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """Transition (K, 2, 2) of position and velocity error over each step of the grid, and the covariance (K, 2, 2) that
    a torque noise of density one adds.

    `edges` (K + 1,) are the stamps at which the steps begin and end.
    """
    count = len(edges) - 1
    moved, added = np.tile(np.eye(2), (count, 1, 1)), np.zeros((count, 2, 2))
    interval = np.append(np.diff(dynamics.time), 0.0)
    for offset in range(int(np.max(np.diff(edges), initial=0))):
        at = edges[:-1] + offset
        inside = at < edges[1:]
        at = np.where(inside, at, 0)
        h = np.where(inside, interval[at], 0.0)
        held = inside & ~dynamics.moving[at]
        turn = np.clip(dynamics.stiffness[at] * h * h, -_SWING, _SWING)
        fade = np.exp(-np.clip(dynamics.damping[at] * h, -_SWING, None))
        step = np.empty((count, 2, 2))
        # Semi-implicit: the velocity first, the position with the velocity that it has then.
        step[:, 1, 0] = -fade * np.divide(turn, h, out=np.zeros(count), where=h > 0.0)
        step[:, 1, 1] = fade
        step[:, 0, 0] = 1.0 - fade * turn
        step[:, 0, 1] = fade * h
        step[held] = [[1.0, 0.0], [0.0, 0.0]]
        moved = step @ moved
        added = step @ added @ step.transpose(0, 2, 1)
        added[:, 1, 1] += np.where(held, 0.0, h)
    return moved, added


def _root(covariance: FloatArray) -> FloatArray:
    """Square roots (K, 2, 2) of 2 by 2 covariances (K, 2, 2), also where one is singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])


def factor(dynamics: Dynamics, edges: NDArray[np.intp], noise: Noise, speed: bool) -> FloatArray:
    """What each of several independent unit normals does to the error (K, sources) at the end of each step of a grid.

    The covariance of the error is its product with its transpose; reading noise is not part of it.

    Parameters
    ----------
    dynamics : Dynamics
        Of a small error along the free run.
    edges : ndarray of int, shape (K + 1,)
        Stamps at which the steps of the grid begin and end.
    noise : Noise
        Torque noise and the uncertainty of the initial state.
    speed : bool
        Whether the output is a speed.
    """
    moved, added = _stepped(dynamics, edges)
    roots = math.sqrt(noise.torque) * _root(added)
    count = len(moved)
    state = np.zeros((2, 2 + 2 * count))
    state[0, 0], state[1, 1] = math.sqrt(noise.position), math.sqrt(noise.velocity)
    row = 1 if speed else 0
    made = np.empty((count, state.shape[1]))
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable law makes errors that no number holds
        for k in range(count):
            state = moved[k] @ state
            state[:, 2 + 2 * k : 4 + 2 * k] = roots[k]
            made[k] = state[row]
    return made


@dataclass(frozen=True, eq=False)
class MeanSquare:
    """A mean square as a weighted sum of chi-squares: `weights` (M,), each of `freedom` (M,) degrees of freedom."""

    weights: FloatArray
    freedom: FloatArray

    @property
    def mean(self) -> float:
        """Its expectation."""
        return float(self.weights @ self.freedom)

    def exceeded(self, chance: float) -> float:
        """The mean square that is exceeded with this probability."""
        if not self.mean > 0.0:
            return 0.0
        high = self.mean
        while self.chance(high) > chance:
            high *= 2.0
        return float(brentq(lambda value: self.chance(value) - chance, 0.0, high, xtol=1e-6 * high))

    def chance(self, value: float) -> float:
        """The probability of a mean square above `value`; one where nothing is random."""
        kept = self.weights > _NOTHING * float(self.weights.max(initial=0.0))
        scale, weights = self.mean, self.weights[kept]
        if not scale > 0.0:
            return 1.0 if value <= 0.0 else 0.0
        return _tail(weights / scale, self.freedom[kept], value / scale)


def _tail(weights: FloatArray, freedom: FloatArray, value: float) -> float:
    """P(sum of weights times chi-squares > value), for a sum whose mean is one."""
    if value <= 0.0:
        return 1.0
    limit = 0.5 / float(weights.max())

    def slope(t: float) -> float:
        return float(np.sum(freedom * weights / (1.0 - 2.0 * t * weights))) - value

    low = -1.0
    while slope(low) > 0.0:
        low *= 4.0
    # At the limit the slope has no bound, but numbers have.
    high = limit * (1.0 - 1e-12)
    at = brentq(slope, low, high, xtol=1e-14 * limit) if slope(high) > 0.0 else high
    left = 1.0 - 2.0 * at * weights
    bend = float(np.sum(2.0 * freedom * weights**2 / left**2))
    depth = at * value + 0.5 * float(np.sum(freedom * np.log(left)))
    w, v = math.copysign(math.sqrt(max(2.0 * depth, 0.0)), at), at * math.sqrt(bend)
    if abs(w) < 1e-3 or abs(v) < 1e-3:
        # At the mean both vanish; their limit holds the skewness.
        skew = float(np.sum(8.0 * freedom * weights**3)) / float(np.sum(2.0 * freedom * weights**2)) ** 1.5
        return float(np.clip(0.5 - skew / (6.0 * math.sqrt(2.0 * math.pi)), 0.0, 1.0))
    return float(np.clip(1.0 - ndtr(w + math.log(v / w) / w), 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Run:
    """One of several free runs on its grid of K points: what makes its error, without reading noise.

    Sources act on one run alone; parameters are those of the model, and the same in all runs.
    """

    factor: FloatArray  # (K, sources) error by source, each of variance one
    parameters: FloatArray  # (K, n) error by standard errors of the parameters, each of variance one
    share: FloatArray  # (K,) share of all readings that each point stands for
    reading: FloatArray  # (K,) variance of the mean of the readings that each point stands for


def mean_square(runs: Sequence[Run], reading: float, readings: int, was_fitted: bool) -> MeanSquare:
    """The distribution of the mean square of the error of several free runs.

    Of each run only the modes count that hold its variance, some ten: a torque that is integrated twice leaves little
    in the others. So hundreds of runs are judged together.

    Parameters
    ----------
    runs : sequence of Run
        With the same parameters.
    reading : float
        Variance of the reading noise, which is independent from reading to reading.
    readings : int
        How many readings there are.
    was_fitted : bool
        Whether the parameters were fitted to these readings: see `_by_parameters`.
    """
    middle = _by_parameters(runs) if was_fitted else np.eye(runs[0].parameters.shape[1])
    size, axes = np.linalg.eigh(middle)
    along = axes * np.sqrt(np.abs(size))
    own = [np.sqrt(r.share)[:, None] * r.factor for r in runs]
    shared = [np.sqrt(r.share)[:, None] * (r.parameters @ along) for r in runs]
    modes = [np.linalg.eigh(a @ a.T + b @ b.T) for a, b in zip(own, shared, strict=True)]
    least = _FAINT * sum(float(variance.sum()) for variance, _ in modes)
    bases = [vectors[:, variance > least] for variance, vectors in modes]
    common = np.vstack([basis.T @ b for basis, b in zip(bases, shared, strict=True)])
    whole = common * np.sign(size) @ common.T
    begin = 0
    for basis, a in zip(bases, own, strict=True):
        here = slice(begin, begin + basis.shape[1])
        reduced = basis.T @ a
        whole[here, here] += reduced @ reduced.T
        begin = here.stop
    weights = np.maximum(np.linalg.eigvalsh(whole), 0.0)
    count = max(readings, 1)
    return MeanSquare(np.append(weights, reading / count), np.append(np.ones(len(weights)), float(count)))


def _by_parameters(runs: Sequence[Run]) -> FloatArray:
    """What parameters that were fitted to the same readings add to the covariance of the error: less than nothing.

    The likelihood of a linear model with this noise is that of generalised least squares. Its residuals have the
    covariance C - S (S' C^-1 S)^-1 S': what the parameters can follow is no longer an error. Returned is the middle of
    the second term (n, n). C is a block for each run.
    """
    count = runs[0].parameters.shape[1]
    scale = np.sqrt(np.maximum(sum(np.sum(r.parameters**2, axis=0) for r in runs), 1e-300))
    information = np.zeros((count, count))
    for r in runs:
        columns = r.parameters / scale
        information += columns.T @ np.linalg.solve(r.factor @ r.factor.T + np.diag(r.reading), columns)
    return np.asarray(-np.linalg.pinv(information, rcond=1e-10, hermitian=True) / np.outer(scale, scale))
