"""What a fleet knows of a new unit before it is recorded (empirical Bayes).

The siblings' parameters scatter around a centre with a variance tau^2 of their own (`population`). That distribution
is the prior of a new unit of the same structure; its fit, with the covariance S, is the likelihood. The posterior of
both, all of them Gaussian, has the information S^-1 + T^-1.

A unit that is not like its siblings must not be pulled in. Its fit differs from the centre by d, whose covariance is S
+ T where the unit is a sibling. A parameter is left to its own recording where that lowers d' (S + T)^-1 d by more than
chance does in one of a hundred siblings, over all parameters (Bonferroni). The limit is that of Student's t, because T
is estimated from few siblings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from twin.errors import BadInput
from twin.estimation.population import FEWEST, Population, population_of
from twin.model import fitted_model
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

FloatArray = NDArray[np.float64]

#: Share of siblings of which any parameter at all may be left to its own recording.
FALSE_ALARMS = 0.01
#: The files of an axis' folder in which its model is looked for.
MODELS = ("improved.toml", "model.toml")


@dataclass(frozen=True)
class Prior:
    """The distribution of a fleet's parameters.

    Attributes
    ----------
    siblings : int
        Models that it was made of.
    populations : mapping
        By parameter; those that at least `population.FEWEST` siblings fix.
    """

    siblings: int
    populations: Mapping[str, Population]

    def centre(self, name: str) -> float:
        return self.populations[name].centre

    def variance(self, name: str) -> float:
        """Of a new sibling around the centre, whose own error is included."""
        p = self.populations[name]
        between = (p.spread * (abs(p.centre) if p.by_ratio else 1.0)) ** 2
        known = 1.0 / np.sum(1.0 / (p.stds**2 + max(between, 1e-300)))
        return float(between + known)


def prior_of(models: Mapping[str, Model]) -> Prior:
    """The prior that siblings of one structure make.

    Parameters
    ----------
    models : mapping
        By name; each with standard errors.

    Raises
    ------
    BadInput
        There are too few of them, or they differ in structure or units.
    """
    if len(models) < FEWEST:
        raise BadInput(f"a prior needs {FEWEST} siblings of the unit's structure; there are {len(models)}")
    first = next(iter(models.values()))
    for name, m in models.items():
        if m.structure.named != first.structure.named:
            raise BadInput(f"{name} has another structure than its siblings: {m.structure}")
        if (m.axis_unit, m.input_unit) != (first.axis_unit, first.input_unit):
            raise BadInput(f"{name} is in other units than its siblings")
    populations = {}
    for n in first.fitted:
        fixing = {k: m for k, m in models.items() if 0.0 < m.std(n) < math.inf and n not in m.undetermined}
        if len(fixing) >= FEWEST:
            values, stds = {k: m.values[n] for k, m in fixing.items()}, {k: m.std(n) for k, m in fixing.items()}
            populations[n] = population_of(values, stds, FALSE_ALARMS, first.unit(n) == "rad")
    return Prior(len(models), populations)


def read_prior(folder: Path, structure: Structure) -> Prior:
    """The prior of a structure, from the folder that a fleet's run has left.

    Raises
    ------
    BadInput
        It is no such folder, or too few of its axes have a model of this structure.
    """
    if not folder.is_dir():
        raise BadInput(f"{folder} is not a folder: give what twin fleet wrote")
    models = {}
    for axis in sorted(p for p in folder.iterdir() if p.is_dir()):
        for path in (axis / name for name in MODELS):
            if path.exists():
                found = fitted_model.read(path)
                if found.structure.named == structure.named and found.fitted:
                    models[axis.name] = found
                    break
    if len(models) < FEWEST:
        raise BadInput(
            f"{folder} holds {len(models)} models of the structure {structure}, and a prior needs {FEWEST}: "
            "give another fleet, or other effects"
        )
    return prior_of(models)


def _own(d: FloatArray, spread: FloatArray, siblings: int) -> list[int]:
    """Indices of the parameters in which a unit is not like its siblings."""
    limit = float(fdtri(1, siblings - 1, 1.0 - FALSE_ALARMS / len(d)))
    own: list[int] = []
    while len(own) < len(d):
        rest = [i for i in range(len(d)) if i not in own]
        information = np.linalg.pinv(spread[np.ix_(rest, rest)], hermitian=True)
        gains = (information @ d[rest]) ** 2 / np.maximum(np.diag(information), 1e-300)
        best = int(np.argmax(gains))
        if gains[best] < limit:
            break
        own.append(rest[best])
    return own


def with_prior(model: Model, prior: Prior) -> Model:
    """A unit's fit together with what its siblings say.

    Parameters
    ----------
    model : Model
        The unit's own fit, with standard errors.
    prior : Prior
        Of the same structure.

    Returns
    -------
    Model
        Values and covariance of both together. `provenance` names the parameters in which the unit is not like its
        siblings; those were left to its own recording.
    """
    names = [n for n in model.fitted if n in prior.populations]
    if not names:
        return model
    seen = [n for n in names if math.isfinite(model.std(n))]
    rows = [model.fitted.index(n) for n in seen]
    d = np.array([model.values[n] - prior.centre(n) for n in seen])
    between = np.diag([prior.variance(n) for n in seen])
    own = {seen[i] for i in _own(d, model.covariance[np.ix_(rows, rows)] + between, prior.siblings)} if seen else set()
    return _together(model, prior, [n for n in names if n not in own], sorted(own))


def _together(model: Model, prior: Prior, shared: Sequence[str], own: Sequence[str]) -> Model:
    """The posterior, with the fleet's word on the shared parameters."""
    finite = np.isfinite(np.diag(model.covariance))
    size = np.where(finite, np.sqrt(np.where(finite, np.diag(model.covariance), 1.0)), 1.0)
    size = np.maximum(size, 1e-150)
    known = np.zeros_like(model.covariance)
    block = np.ix_(finite, finite)
    known[block] = np.linalg.pinv((model.covariance / np.outer(size, size))[block], rcond=1e-12, hermitian=True)
    pull = np.zeros(len(model.fitted))
    values = np.array([model.values[n] for n in model.fitted])
    for n in shared:
        i = model.fitted.index(n)
        weight = size[i] ** 2 / prior.variance(n)
        known[i, i] += weight
        pull[i] = weight * (prior.centre(n) - values[i]) / size[i]
    used = np.diag(known) > 0.0
    inside = np.ix_(used, used)
    covariance = np.full_like(known, 0.0)
    covariance[~used, ~used] = np.inf
    covariance[inside] = np.linalg.pinv(known[inside], rcond=1e-12, hermitian=True)
    moved = np.zeros(len(values))
    moved[used] = covariance[inside] @ pull[used]
    bounds = [model.parameter(n) for n in model.fitted]
    found = np.clip(values + size * moved, [p.lower for p in bounds], [p.upper for p in bounds])
    scale = np.outer(size, size)
    told = {"prior": f"{prior.siblings} siblings", **({"unlike_siblings": ", ".join(own)} if own else {})}
    return replace(
        model,
        values={**model.values, **dict(zip(model.fitted, found.tolist(), strict=True))},
        covariance=np.where(np.isfinite(covariance), covariance * scale, covariance),
        intervals={n: ends for n, ends in model.intervals.items() if n not in shared},
        notes={n: t for n, t in model.notes.items() if n not in shared},
        provenance={**model.provenance, **told},
    )
