"""Which laws follow the missing torque, and with which values.

Where much is missing and a motor rattles in its gap, the likelihood is so rough that every fit ends in the first local
optimum. The torque that a filter has to add has no such optima. Along the recorded path it is linear in the sizes of
most laws, and so is any change of the base.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import screening, thresholds
from twin.diagnosis.residual_torque import MissingTorque
from twin.effects.catalogue import EFFECTS, pages
from twin.estimation import likelihood, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model import equations
from twin.model.stepper import Structure

FloatArray = NDArray[np.float64]

#: Slots whose laws give torques along the way of the axis, or what its acceleration makes one of.
TORQUE_SLOTS = ("load", "shaft", "drag", "grip", "mass")
#: Share of the largest speed below which an axis might as well rest: dry friction then is as large as it must be.
_MIN_SPEED_SHARE = 0.03
#: What a regression reads, the length of what it leaves out in turn, s, and in how many turns.
_REGRESSED, _BLOCK_LENGTH, _FOLDS = ("torque", "position", "velocity", "input", "time"), 1.0, 8
#: Share of the travel at either end, and time before and after it, s, in which a stop may act.
_STOP_ZONE, _STOP_RINGING = 0.05, 0.1
#: A drive that pushes less, as acceleration per unit of the input, has no dead-band.
_MIN_INPUT_GAIN = 1e-9
#: Averages of a moving axis that are too few to say anything.
_MIN_AVERAGES = 50
#: A dead-band that is less than this share of the other side's is one that a drive hardly has.
_MAX_DEAD_BAND_RATIO = 0.1
#: Phase by which a law is moved to see how it goes with it.
_PHASE_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class TorqueFollower:
    """A candidate that predicts a share of the missing torque, and the values of base and candidate at which it does.
    There is one set for each side of the gap that it may act on.
    """

    effect: str
    structure: Structure
    share: float
    places: tuple[dict[str, float], ...]


def _moving_averages(missing: MissingTorque) -> dict[str, FloatArray]:
    """Torque and states (N,) in averages, where all of them are known and the axis moves."""
    means = missing.averages()
    known = np.isfinite(np.array([means[n] for n in _REGRESSED])).all(axis=0)
    speed = np.abs(means["velocity"])
    moving = known & (speed > _MIN_SPEED_SHARE * float(speed[known].max(initial=0.0)))
    return {n: c[moving] for n, c in means.items()} | {"direction": np.sign(means["velocity"][moving])}


def _size_parameters(base: Structure, effect: str) -> list[tuple[str, str]]:
    """The effect and what it brings along that the base lacks, each with the parameter that is its size."""
    lacking = (page for page in pages(effect) if page.id not in base)
    return [(page.id, page.screen.gain) for page in lacking if page.screen]


def _base_regressors(states: Mapping[str, FloatArray]) -> FloatArray:
    """Regressors (N, 4) of gain, both sides of the dead-band and viscous friction: torque per unit."""
    command = states["input"]
    return np.stack([command, command > 0.0, command < 0.0, states["velocity"]], axis=1).astype(float)


def _effect_regressors(
    base: Structure, effect: str, row: Mapping[str, float], states: Mapping[str, FloatArray]
) -> FloatArray:
    """Regressors (N, sizes) of the effect and of those that it includes: torque per unit of their sizes and phases."""
    against = {"grip": states["direction"], "mass": states["acceleration"]}
    found = []
    for i, gain in _size_parameters(base, effect):
        page = EFFECTS[i]
        assert page.screen is not None
        unit = {**screening.neutral_values(effect), **row, gain: 1.0}
        sign = -against[page.slot] if page.slot in against else np.ones(len(states["time"]))
        law = sign * equations.along(i, states, unit)
        found.append(law)
        if page.screen.phase is not None:
            found.append(
                (sign * equations.along(i, states, {**unit, page.screen.phase: _PHASE_STEP}) - law) / _PHASE_STEP
            )
    return np.stack(found, axis=1)


def _cross_validated_regression(
    columns: FloatArray, torque: FloatArray, turn: NDArray[np.intp]
) -> tuple[float, FloatArray]:
    """The share of the torque's power that a regression predicts on left-out data, and its coefficients from all
    data."""
    scale = np.sqrt(np.mean(np.square(columns), axis=0)) + 1e-300
    parts = [(columns[turn == k] / scale, torque[turn == k]) for k in range(_FOLDS)]
    squares, pulls = np.array([a.T @ a for a, _ in parts]), np.array([a.T @ t for a, t in parts])
    slight = 1e-9 * np.trace(squares.sum(axis=0)) * np.eye(len(scale)) + 1e-300 * np.eye(len(scale))
    missed = 0.0
    for (a, t), square, pull in zip(parts, squares, pulls, strict=True):
        made = np.linalg.solve(squares.sum(axis=0) - square + slight, pulls.sum(axis=0) - pull)
        missed += float(np.sum(np.square(t - a @ made)))
    sizes = np.linalg.solve(squares.sum(axis=0) + slight, pulls.sum(axis=0)) / scale
    return 1.0 - missed / max(float(np.sum(np.square(torque))), 1e-300), sizes


def _base_values_from(base: Fit, sizes: FloatArray) -> dict[str, float]:
    """The base's values with gain, dead-bands and viscous friction as a regression would have them."""
    old = base.values
    gain = max(old["input_gain"] + sizes[0], 0.2 * old["input_gain"], _MIN_INPUT_GAIN)
    moved = {"input_gain": gain, "viscous_friction": old.get("viscous_friction", 0.0) - sizes[3]}
    for name, size in (("dead_band_forward", -sizes[1]), ("dead_band_reverse", sizes[2])):
        moved[name] = (old["input_gain"] * old.get(name, 0.0) + size) / gain
    return {**old, **screening.clipped_to_bounds({n: v for n, v in moved.items() if n in base.free})}


def _start_places(
    base: Fit, effect: str, row: Mapping[str, float], sizes: FloatArray, rows: Sequence[Mapping[str, float]]
) -> tuple[dict[str, float], ...]:  # fmt: skip
    """Values of base and effect as a regression would have them, on each side of the gap that one of the rows names.

    The first four of the sizes are the base's (`_base_regressors`), the others the effect's (`_effect_regressors`).
    """
    own, rest = dict(row), iter(sizes[4:].tolist())
    for i, gain in _size_parameters(base.structure, effect):
        screen = EFFECTS[i].screen
        assert screen is not None
        own[gain] = next(rest)
        if screen.phase is not None:
            assert screen.combine is not None
            own[gain], own[screen.phase] = screen.combine(own[gain], next(rest))
    begun = replace(base, values=_base_values_from(base, sizes))
    sides = [{n: v for n, v in other.items() if n.endswith("_share")} for other in rows]
    places = []
    for side in sides:
        place = screening.values_with(begun, screening.structure_with(base.structure, effect), effect, {**own, **side})
        if (place := screening.clipped_to_bounds(place)) not in places:
            places.append(place)
    return tuple(places)


def equal_dead_bands(values: Mapping[str, float]) -> dict[str, float]:
    """Equal dead-bands, and the constant torque that replaces their difference, beside one that is there: as long as
    the drive pushes, both do the same.
    """
    ahead, behind = values["dead_band_forward"], values["dead_band_reverse"]
    equal = dict.fromkeys(("dead_band_forward", "dead_band_reverse"), 0.5 * (ahead + behind))
    return equal | {"offset": values.get("offset", 0.0) + 0.5 * (behind - ahead) * values["input_gain"]}


def offset_starts(base: Fit, candidates: Sequence[str]) -> list[dict[str, float]]:
    """Values at which a constant torque replaces the difference of the base's dead-bands, if one of them has nearly
    gone and can go no further. Where its side of the gap is open, they are given for the link and for the motor.

    No slope leads there, and in the missing torque it looks as the dead-bands do.
    """
    sides = ("dead_band_forward", "dead_band_reverse")
    least, most = sorted(base.values.get(n, 0.0) for n in sides)
    if "constant_offset" not in candidates or not set(sides) <= set(base.free) or least >= _MAX_DEAD_BAND_RATIO * most:
        return []
    longer = base.structure.with_("constant_offset")
    rows = screening.with_gap_sides([equal_dead_bands(base.values)], base.structure, base.values, "constant_offset")
    return [preparation.complete_values(longer, {**base.values, **row}) for row in rows]


def fit_to_free_motion(problem: FitProblem, missing: MissingTorque, base: Fit) -> Fit | None:
    """The base fitted to free motion of the axis, if its input gain there is several times larger or smaller. `missing`
    is the torque that it lacks.

    Missing stops or dry friction hold the axis, and lead a fit to a drive that does nothing.
    """
    states = _moving_averages(missing)
    low, high = float(np.nanmin(missing.position)), float(np.nanmax(missing.position))
    beside = _STOP_ZONE * (high - low)
    ends = missing.time[(missing.position < low + beside) | (missing.position > high - beside)]
    after = np.searchsorted(ends, states["time"])
    away = np.minimum(
        np.abs(states["time"] - ends[np.maximum(after - 1, 0)]),
        np.abs(states["time"] - ends[np.minimum(after, len(ends) - 1)]),
    )
    free = {n: c[away > _STOP_RINGING] for n, c in states.items()}
    if len(free["time"]) < _MIN_AVERAGES:
        return None
    _, sizes = _cross_validated_regression(
        _base_regressors(free), free["torque"], (free["time"] / _BLOCK_LENGTH).astype(np.intp) % _FOLDS
    )
    values, pushed = _base_values_from(base, sizes), base.values["input_gain"]
    if pushed / thresholds.MAX_GAIN_RATIO < values["input_gain"] < pushed * thresholds.MAX_GAIN_RATIO:
        return None
    found = likelihood.evaluate(problem.at(base.process_noise), base.structure, values, base.free)
    return found if math.isfinite(found.deviance) else None


def ranked_by_torque(
    missing: MissingTorque, base: Fit, trials: Mapping[str, Sequence[dict[str, float]]]
) -> list[TorqueFollower]:
    """The candidates that predict more of the base's missing torque than a change of it would, the best first.

    `trials` holds the rows of values that each candidate tries beside this base.
    """
    states = _moving_averages(missing)
    if len(states["time"]) < _MIN_AVERAGES:
        return []
    torque, turn = states["torque"], (states["time"] / _BLOCK_LENGTH).astype(np.intp) % _FOLDS
    # What is transmitted as far as the base knows: what is missing moves the axis, too, and would follow itself.
    states["transmitted"] = base.values["input_gain"] * states["input"]
    linear = [e for e in trials if EFFECTS[e].slot in TORQUE_SLOTS and e not in screening.WITHOUT_SCORE_TEST]
    own = _base_regressors(states)
    alone, _ = _cross_validated_regression(own, torque, turn)
    found = []
    for effect in linear:
        rows = trials[effect]
        laws = (_effect_regressors(base.structure, effect, row, states) for row in rows)
        told = [_cross_validated_regression(np.concatenate([own, law], axis=1), torque, turn) for law in laws]
        (share, sizes), row = max(zip(told, rows, strict=True), key=lambda t: t[0][0])
        if share > alone + thresholds.MIN_PREDICTED_SHARE * (1.0 - alone):
            structure = screening.structure_with(base.structure, effect)
            found.append(TorqueFollower(effect, structure, share, _start_places(base, effect, row, sizes, rows)))
    return sorted(found, key=lambda f: -f.share)
