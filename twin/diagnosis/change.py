"""What changed: a model against a later fit of the same structure.

The errors of each fit are correlated. So the question is not which values differ, but which few parameters have to
differ for the rest to agree. The differences d of two independent fits are Gaussian with the sum S of their
covariances. A hypothesis names a few directions A in which the axis may have changed. It leaves min (d - A x)' S^-1 (d
- A x), a chi-square variable where it is true. Each direction has to remove more than chance does in one of a hundred
unchanged axes, over all directions that are tried (Bonferroni). The set with the best sum of chi-square and this
penalty is taken.

The sizes hold for axes in which all else is as it was. Where that leaves more than chance does, the fits err by more
than their covariances say. The standard errors then grow by the root of chi-square over its degrees of freedom (Birge,
Phys. Rev. 40, 1932).

A direction is one parameter, or what one cause does to several. For example, all torques are divided by the inertia: an
inertia that grows by r divides them all by r.

A wide gap and a light motor that crosses it in the same time leave nearly the same motion. Along that ridge the
likelihood has many maxima, one for each order of bounces, and a fit stays in one of them. So the gap is compared at the
same motor share: by the product of both, which is well known, and which falls where the load's inertia grows.

Inertia and torques are measured by the drive's own torque at the same command. A drive whose torque falls, because its
winding is warm or its supply low, divides the input gain and the back-EMF's damping alone. Where that explains the
recordings about as well as another inertia, it is offered beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from twin.display.numbers import capital, listed
from twin.effects.parameter import Parameter
from twin.errors import BadInput
from twin.model.fitted_model import Model

FloatArray = NDArray[np.float64]

#: Share of unchanged axes for which any change at all may be reported.
FALSE_ALARMS = 0.01
#: A parameter is compared by its ratio where both values are this many standard errors from zero.
SURELY_NOT_ZERO = 3.0
#: A parameter is not determined where its standard error is as large as its value and as this share of the bound.
NOT_DETERMINED = 1.0
#: Two explanations whose chi-squares differ by less are not told apart: odds of 20 to 1, 2 ln 20.
CANNOT_TELL = 2.0 * math.log(20.0)
#: Directions that one answer may name.
MOST_CHANGES = 3
#: Parameters that are not compared: those that belong to one recording, and those of how motor and link bounce. Of
#: the latter the likelihood has many maxima, and a standard error describes only one of them.
NOT_COMPARED = (
    "load_time", "disturbance_phase", "pulse_start", "pulse_end", "tooth_frequency", "tooth_damping", "motor_share",
    "friction_share", "dry_share", "shaft_share",
)  # fmt: skip
INERTIA = "inertia_ratio"
#: Compared by their product.
GAP, SHARE = "backlash_gap", "motor_share"
#: What a drive's torque at the same command acts on. It is offered instead of an inertia, and not looked for itself:
#: which share of the viscous friction is back-EMF is not known.
DRIVE, BY_THE_DRIVE = "drive_torque", ("input_gain", "viscous_friction")


@dataclass(frozen=True)
class Change:
    """A parameter that changed.

    Attributes
    ----------
    parameter : str
        Its name, or "inertia_ratio" where all torques over the inertia changed together.
    before, after : float
        Values, in `unit`; of the inertia, and of a torque where the inertia changed with it, 1 and the ratio.
    interval : tuple of float
        95 % interval of `after`.
    unit : str
    says : str
        One sentence in plain words.
    rivals : tuple of str
        Parameters whose change would explain the recordings about as well.
    """

    parameter: str
    before: float
    after: float
    interval: tuple[float, float]
    unit: str
    says: str
    rivals: tuple[str, ...] = ()


@dataclass(frozen=True)
class Changes:
    """All that changed from one model to another.

    Attributes
    ----------
    found : tuple of Change
        The most certain first.
    undetermined : tuple of str
        Parameters that one of the two fits cannot fix.
    standardised : mapping
        Difference of each parameter over its standard error, by itself.
    p_value : float
        Of the hypothesis that nothing changed.
    explained : float
        Chi-square that the changes found remove.
    """

    found: tuple[Change, ...]
    undetermined: tuple[str, ...]
    standardised: Mapping[str, float]
    p_value: float
    explained: float


@dataclass(frozen=True)
class _Coordinate:
    """How one parameter is compared: by its logarithm, or as it is."""

    parameter: Parameter
    before: float
    after: float
    by_ratio: bool
    #: Logarithm by which the motor's share grew, where both are compared by their product.
    share_grew: float | None = None

    @property
    def difference(self) -> float:
        if self.by_ratio:
            return math.log(self.after / self.before) + (self.share_grew or 0.0)
        if self.parameter.unit == "rad":
            return math.remainder(self.after - self.before, 2.0 * math.pi)
        return self.after - self.before

    def slope(self, value: float) -> float:
        """Of the coordinate over the parameter."""
        return 1.0 / value if self.by_ratio else 1.0

    def moved(self, by: float) -> float:
        """The value before, moved by so much."""
        return self.before * math.exp(by) if self.by_ratio else self.before + by

    @property
    def is_torque(self) -> bool:
        """Whether the parameter is a torque over the inertia."""
        return "over inertia" in self.parameter.meaning or self.parameter.name == "input_gain"

    @property
    def per_inertia(self) -> float:
        """Change of the coordinate for a unit of the logarithm of the inertia."""
        if self.share_grew is not None:
            return -1.0
        if not self.is_torque:
            return 0.0
        return -1.0 if self.by_ratio else -self.before


def _undetermined(model: Model, name: str) -> bool:
    """Whether the fit says next to nothing of a parameter."""
    std = model.std(name)
    return not math.isfinite(std) or (name in model.notes and std >= NOT_DETERMINED * abs(model.values[name]))


def _coordinates(before: Model, after: Model, names: Sequence[str]) -> list[_Coordinate]:
    def surely(name: str) -> bool:
        """Whether both values are clearly on the same side of zero."""
        far = all(abs(m.values[name]) > SURELY_NOT_ZERO * m.std(name) for m in (before, after))
        return far and before.values[name] * after.values[name] > 0.0

    shared = all(SHARE in m.fitted for m in (before, after)) and surely(SHARE)
    grew = math.log(after.values[SHARE] / before.values[SHARE]) if shared else None

    def coordinate(name: str) -> _Coordinate:
        parameter = before.parameter(name)
        by_ratio = surely(name) and parameter.unit != "rad"
        along = grew if name == GAP and by_ratio else None
        return _Coordinate(parameter, before.values[name], after.values[name], by_ratio, along)

    return [coordinate(n) for n in names]


def _spread(model: Model, names: Sequence[str], coordinates: Sequence[_Coordinate]) -> FloatArray:
    """Covariance (n, n) of the coordinates in one fit."""
    slopes, excess = np.zeros((len(names), len(model.fitted))), np.zeros(len(names))
    for i, (name, c) in enumerate(zip(names, coordinates, strict=True)):
        slope = c.slope(model.values[name])
        slopes[i, model.fitted.index(name)] = slope
        excess[i] = _excess(model, name) * slope**2
        if c.share_grew is not None:
            per_share = 1.0 / model.values[SHARE]
            slopes[i, model.fitted.index(SHARE)] = per_share
            # By as much as the share's is wider, the gap's profile is wide along the ridge.
            excess[i] = max(0.0, excess[i] - _excess(model, SHARE) * per_share**2)
    used = np.any(slopes != 0.0, axis=0)
    return np.asarray(slopes[:, used] @ model.covariance[np.ix_(used, used)] @ slopes[:, used].T + np.diag(excess))


def _excess(model: Model, name: str) -> float:
    """By how much the profile of the likelihood, where it was drawn, is wider than the standard error; a variance."""
    low, high = model.intervals.get(name, (0.0, 0.0))
    return max(0.0, ((high - low) / (2.0 * 1.96)) ** 2 - model.std(name) ** 2)


def scaled_inverse(spread: FloatArray) -> FloatArray:
    """Inverse (n, n) of a covariance, or of an information, whose parameters may be of any size.

    It is taken of the correlations. A direction in which these leave next to nothing counts as known to 1e-5 of the
    parameters' own errors, and no better.
    """
    size = np.sqrt(np.diag(spread))
    values, vectors = np.linalg.eigh(spread / np.outer(size, size))
    return np.asarray((vectors / np.maximum(values, 1e-10)) @ vectors.T / np.outer(size, size))


def _columns(directions: Mapping[str, FloatArray], names: Sequence[str], rows: int) -> FloatArray:
    """The directions of these names as columns (n, m)."""
    return np.array([directions[n] for n in names]).reshape(len(names), rows).T


def _left(d: FloatArray, information: FloatArray, directions: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Chi-square that a hypothesis leaves, and its sizes (m,) with their covariance (m, m)."""
    if directions.shape[1] == 0:
        return float(d @ information @ d), np.zeros(0), np.zeros((0, 0))
    known = np.asarray(np.linalg.pinv(directions.T @ information @ directions), dtype=float)
    sizes = known @ directions.T @ information @ d
    rest = d - directions @ sizes
    return float(rest @ information @ rest), sizes, known


def compare_models(before: Model, after: Model, false_alarms: float = FALSE_ALARMS) -> Changes:
    """Which parameters changed from one fit to a later one of the same structure.

    Parameters
    ----------
    before, after : Model
        Two fits with standard errors, of recordings that are independent.
    false_alarms : float
        Probability that any change at all is reported of an axis that did not change.

    Returns
    -------
    Changes

    Raises
    ------
    BadInput
        Where the structures or units differ, or a model has no standard errors.
    """
    if before.structure.named != after.structure.named:
        raise BadInput(f"the models differ in structure: {before.structure}, and {after.structure}")
    if (before.axis_unit, before.input_unit) != (after.axis_unit, after.input_unit):
        raise BadInput("the models differ in their units")
    shared = [n for n in before.fitted if n in after.fitted and n not in NOT_COMPARED]
    if not shared:
        raise BadInput("one of the models holds no standard errors: make both with twin identify")
    lost = tuple(n for n in shared if _undetermined(before, n) or _undetermined(after, n))
    names = [n for n in shared if n not in lost]
    if not names:
        return Changes((), lost, {}, 1.0, 0.0)
    coordinates = _coordinates(before, after, names)
    d = np.array([c.difference for c in coordinates])
    spread = _spread(before, names, coordinates) + _spread(after, names, coordinates)
    information = scaled_inverse(spread)
    directions = {n: np.eye(len(names))[i] for i, n in enumerate(names)}
    inertia = np.array([c.per_inertia for c in coordinates])
    if np.count_nonzero(inertia) > 1:
        directions[INERTIA] = inertia
    chosen, rivals = _chosen(d, information, directions, false_alarms)
    if INERTIA in chosen and not set(BY_THE_DRIVE) - set(names):
        drive = {DRIVE: np.where([n in BY_THE_DRIVE for n in names], inertia, 0.0)}
        rivals[INERTIA] += _instead(INERTIA, chosen, drive, (d, information, directions))
    left, sizes, known = _left(d, information, _columns(directions, chosen, len(d)))
    by_name = dict(zip(names, coordinates, strict=True))
    wider = math.sqrt(max(1.0, left / max(len(d) - len(chosen), 1)))
    found = [
        _change(
            name, (float(sizes[i]), wider * math.sqrt(known[i, i])), by_name, after, rivals[name], INERTIA in chosen
        )
        for i, name in enumerate(chosen)
    ]
    chi_square = float(d @ information @ d)
    return Changes(
        tuple(found),
        lost,
        dict(zip(names, (d / np.sqrt(np.diag(spread))).tolist(), strict=True)),
        float(chi2.sf(chi_square, len(names))),
        chi_square - left,
    )


def to_json(changes: Sequence[Change]) -> list[dict[str, Any]]:
    """Changes as the contract's JSON."""
    return [
        {
            "parameter": c.parameter, "before": c.before, "after": c.after, "interval": list(c.interval),
            "unit": c.unit, "says": c.says, "rivals": list(c.rivals),
        }
        for c in changes
    ]  # fmt: skip


def changes_sentence(changes: Changes) -> str:
    """What changed since the model was made, and what this recording cannot say, in plain words."""
    lost = [f"the {n.replace('_', ' ')}" for n in changes.undetermined]
    they = "it" if len(lost) == 1 else "they"
    unknown = (
        f" {capital(listed(lost))} cannot be fixed by this recording: whether {they} changed is not known."
        if lost
        else ""
    )
    if not changes.found:
        return f"None of the model's parameters changed.{unknown}"
    said = "; ".join(c.says for c in changes.found)
    rivals = sorted({r.replace("_", " ") for c in changes.found for r in c.rivals})
    doubt = f" A change of the {', or of the '.join(rivals)} would do the same." if rivals else ""
    if any(DRIVE in c.rivals for c in changes.found):
        doubt += " A known weight at the axis tells the inertia from the drive."
    return f"Since the model was made: {said}.{doubt}{unknown}"


def _chosen(
    d: FloatArray, information: FloatArray, directions: Mapping[str, FloatArray], false_alarms: float
) -> tuple[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """The fewest directions that are needed, the largest first. And for each the alternatives that do about as well.

    All sets of up to `MOST_CHANGES` are tried: one cause that acts on several parameters is found only as a whole.
    """
    needed = float(chi2.isf(false_alarms / len(directions), 1))

    index = {name: i for i, name in enumerate(directions)}
    every = _columns(directions, tuple(directions), len(d))
    seen, pull = every.T @ information @ every, every.T @ information @ d

    def left(names: Sequence[str]) -> float:
        """Chi-square that these directions leave, but for a constant."""
        rows = [index[n] for n in names]
        sizes = np.linalg.lstsq(seen[np.ix_(rows, rows)], pull[rows], rcond=None)[0] if rows else np.zeros(0)
        return -float(pull[rows] @ sizes)

    most = min(MOST_CHANGES, len(d))
    sets = (s for size in range(most + 1) for s in combinations(directions, size))
    best = min(sets, key=lambda s: left(s) + needed * len(s))
    without = {name: left([n for n in best if n != name]) for name in best}
    others = {n: column for n, column in directions.items() if n not in best}
    rivals = {name: _instead(name, best, others, (d, information, directions)) for name in best}
    return tuple(sorted(best, key=lambda name: -without[name])), rivals


def _instead(
    name: str, chosen: Sequence[str], offered: Mapping[str, FloatArray],
    evidence: tuple[FloatArray, FloatArray, Mapping[str, FloatArray]],
) -> tuple[str, ...]:  # fmt: skip
    """The offered directions that explain the differences about as well as a chosen one does in its place."""
    d, information, directions = evidence
    rest = [directions[n] for n in chosen if n != name]

    def left(columns: Sequence[FloatArray]) -> float:
        return _left(d, information, np.array(columns).T)[0]

    least = left([*rest, directions[name]])
    return tuple(n for n, column in offered.items() if left([*rest, column]) - least < CANNOT_TELL)


def _change(
    name: str, found: tuple[float, float], coordinates: Mapping[str, _Coordinate], after: Model,
    rivals: tuple[str, ...], other_inertia: bool,
) -> Change:  # fmt: skip
    """A direction and its size with its standard error, put into words.

    Where the inertia changed, too, a torque over it differs from both models' values: the torque itself is reported.
    """
    size, std = found
    ends = (size - 1.96 * std, size + 1.96 * std)
    if name == INERTIA:
        ratio, low, high = (math.exp(v) for v in (size, *ends))
        says = f"the inertia is {ratio:.3g} times what it was ({low:.3g} to {high:.3g})"
        return Change(name, 1.0, ratio, (low, high), "1", says, rivals)
    c = coordinates[name]
    if other_inertia and c.is_torque and c.by_ratio:
        ratio, low, high = (math.exp(v) for v in (size, *ends))
        shown = "torque of gravity" if name == "gravity_gain" else name.replace("_", " ")
        says = f"the {shown} is {ratio:.3g} times what it was ({low:.3g} to {high:.3g})"
        return Change(name, 1.0, ratio, (low, high), "1", says, rivals)
    value, low, high = (c.moved(v) for v in (size, *ends))
    unit = after.unit(name)
    shown = "" if unit == "1" else f" {unit}"
    grew = "grew" if abs(value) > abs(c.before) else "fell"
    says = f"the {name.replace('_', ' ')} {grew} from {c.before:.3g} to {value:.3g}{shown} ({low:.3g} to {high:.3g})"
    if other_inertia and c.is_torque:
        says += " over the inertia that was"
    return Change(name, c.before, value, (low, high), unit, says, rivals)
