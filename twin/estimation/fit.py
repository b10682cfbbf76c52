"""A model at certain values: deviance, gradient and information of its likelihood there, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.estimation import numerics
from twin.model.stepper import Structure

FloatArray = NDArray[np.float64]

#: A gradient that scatters by less than this share of what the information says is one of slopes that have run away.
OVERDISPERSION_OF_CHAOS = 0.3
#: Deviance from which on a change is one that is seen: what is not seen has no slope but the rounding's.
MIN_VISIBLE_DEVIANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Fit:
    """A model at certain values: what there is to know for the next step."""

    structure: Structure
    values: dict[str, float]
    process_noise: float  # torque noise over reading variance, 1/s^3 (positions) or 1/s (speeds)
    free: tuple[str, ...]
    deviance: float  # minus twice the log-likelihood, up to a constant of the data
    scale: float  # innovation variance found over that expected
    information: FloatArray  # (n, n) information about the free parameters
    gradient: FloatArray  # (n,) of the log-likelihood
    scatter: FloatArray  # (n, n) of the gradient, from stretch to stretch; the information where the model is right
    converged: bool = True
    message: str = ""

    @property
    @numerics.ignore_overflow()
    def covariance(self) -> FloatArray:
        """Of the free parameters. A parameter that cannot be seen gets a huge variance, not a small one. One that
        leaves no trace gets an infinite variance, and no covariance with others."""
        eigenvalues, vectors, size = self._eigen
        inverse = (vectors / np.maximum(eigenvalues, numerics.EIGENVALUE_FLOOR)) @ vectors.T
        return numerics.without_what_is_lost(np.asarray(inverse / np.outer(size, size)))

    @cached_property
    @numerics.ignore_overflow()
    def _eigen(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Eigenvalues (n,) and vectors (n, n) of the information, each parameter in units of its own (n,)."""
        size = np.sqrt(np.maximum(np.diag(self.information), 1e-300))
        eigenvalues, vectors = np.linalg.eigh(self.information / np.outer(size, size))
        return eigenvalues, vectors, size

    @property
    @numerics.ignore_overflow()
    def robust_covariance(self) -> FloatArray:
        """Covariance (n, n) of the free parameters that holds where the model errs a little, too.

        The information is the curvature of the likelihood. The scatter of its slope from stretch to stretch says how
        far the maximum may have moved (White's sandwich, Econometrica 50, 1982). Innovations that a slightly wrong
        model leaves correlated make the second larger; each standard error is the larger of the two.
        """
        wider = np.sqrt(np.fmax(self._variance_inflation, 1.0))
        return np.asarray(self.covariance * np.outer(wider, wider))

    @cached_property
    @numerics.ignore_overflow()
    def _variance_inflation(self) -> FloatArray:
        """Variances (n,) from the scatter of the slopes, over those that the information promises.

        In a direction that nothing determines, both are zero: for example gain and dead-band where the command has one
        size. The ratio is then that of the remaining directions, and NaN where the parameter has none.
        """
        eigenvalues, vectors, size = self._eigen
        known = eigenvalues > numerics.EIGENVALUE_FLOOR
        plain = (vectors[:, known] / eigenvalues[known]) @ vectors[:, known].T / np.outer(size, size)
        return np.asarray(np.diag(plain @ self.scatter @ plain) / np.diag(plain))

    @cached_property
    @numerics.ignore_overflow()
    def visible(self) -> NDArray[np.bool_]:
        """Which free parameters (n,) leave a trace: to move one by its own size, or by one, would not go unseen."""
        sizes = np.array([max(abs(self.values.get(n, 0.0)), 1.0) for n in self.free])
        return np.asarray(np.diag(self.information) * sizes**2 > MIN_VISIBLE_DEVIANCE)

    @property
    def overdispersion(self) -> float:
        """What one unit of deviance is worth here: the more the model errs, the less a change of one means."""
        return self.overdispersion_by(self.free)

    @numerics.ignore_overflow()
    def overdispersion_by(self, names: Iterable[str]) -> float:
        """The same by some parameters alone, or by all where none of these is free.

        Parameters that leave no trace have no say in it.
        """
        if not self.free:
            return 1.0
        among = set(names) & set(self.free) or set(self.free)
        own = self._variance_inflation[[n in among for n in self.free]]
        traced = own[np.isfinite(own)]
        return float(np.median(np.maximum(traced, 1.0))) if len(traced) else math.nan

    @property
    @numerics.ignore_overflow()
    def is_chaotic(self) -> bool:
        """Whether the slopes have grown from bounce to bounce until they say nothing about the maximum.

        They then promise an information that the gradient's scatter gives the lie to.
        """
        traced = self._variance_inflation[np.isfinite(self._variance_inflation)]
        return bool(len(traced)) and float(np.median(traced)) < OVERDISPERSION_OF_CHAOS
