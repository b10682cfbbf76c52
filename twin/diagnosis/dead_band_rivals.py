"""What a recording may not tell from a dead-band: dry friction, and a constant torque."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twin.diagnosis import (
    model_comparison,
    screening,
    thresholds,
    torque_regression,
)
from twin.diagnosis.search_result import Alternative
from twin.estimation import (
    local_optima,
    optimizer,
    preparation,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.parallel import each

#: Units of inputs that no pulse-width stage cuts: an amplifier that is linear loses no command.
LINEAR_INPUTS = ("V", "A", "N*m", "N")


DEAD_BANDS = ("dead_band_forward", "dead_band_reverse")


def with_level_dead_bands(problem: FitProblem, last: Fit) -> Fit:
    """The model with its constant torque held where the dead-bands are about equal, if its size is not known.

    As long as the drive pushes, the torque may be any that leaves no dead-band negative. Machines have equal dead-bands
    more often than others.
    """
    if not {"offset", *DEAD_BANDS} <= set(last.free):
        return last
    place = last.free.index("offset")
    error = math.sqrt(max(float(last.robust_covariance[place, place]), 0.0))
    if abs(last.values["offset"]) >= thresholds.MIN_SIZE_IN_ERRORS * error:
        return last
    begun = last.values | torque_regression.equal_dead_bands(last.values)
    free = tuple(n for n in last.free if n != "offset")
    level = optimizer.levenberg_marquardt(problem.at(last.process_noise), last.structure, begun, free)
    return level if model_comparison.criterion_difference(last, level) < thresholds.UNDECIDED_MARGIN else last


def are_dead_bands_unequal(fit: Fit) -> bool:
    """Whether the dead-bands of the two directions differ by three standard errors or more."""
    one, other = (fit.free.index(n) for n in DEAD_BANDS)
    known, differ = fit.robust_covariance, fit.values[DEAD_BANDS[1]] - fit.values[DEAD_BANDS[0]]
    variance = known[one, one] + known[other, other] - 2.0 * known[one, other]
    return bool(differ**2 >= thresholds.UNEQUAL_DEAD_BAND_DEVIATIONS**2 * variance)


def offset_for_dead_bands(problem: FitProblem, last: Fit, candidates: Sequence[str]) -> list[Alternative]:
    """The last model with equal dead-bands and a constant torque in the place of their difference, where that fits
    about as well. As long as the drive pushes, the torque only shifts both.
    """
    offered = "constant_offset" in candidates and "constant_offset" not in last.structure
    if not offered or not set(DEAD_BANDS) <= set(last.free):
        return []
    if not are_dead_bands_unequal(last):
        return []
    differ = last.values[DEAD_BANDS[1]] - last.values[DEAD_BANDS[0]]
    longer, equal = last.structure.with_("constant_offset"), torque_regression.equal_dead_bands(last.values)
    begun = preparation.complete_values(longer, last.values | equal)
    rows = screening.with_gap_sides([equal], last.structure, last.values, "constant_offset")
    free = (*last.free, *(n for n in rows[0] if n not in equal))
    # The torque is held where it levels the dead-bands; they stay about equal unless something else makes up for it.
    fits = each(
        lambda row: optimizer.levenberg_marquardt(problem.at(last.process_noise), longer, begun | row, free), rows
    )
    found = min(fits, key=lambda p: p.deviance)
    level = abs(found.values[DEAD_BANDS[1]] - found.values[DEAD_BANDS[0]]) < 0.5 * abs(differ)
    stands = level and model_comparison.criterion_difference(last, found) < thresholds.UNDECIDED_MARGIN
    return [Alternative("dead_band", "constant_offset", found)] if stands else []


def friction_for_dead_band(problem: FitProblem, first: Fit, candidates: Sequence[str]) -> Fit | None:
    """The first model with dry friction in the dead-band's place, for inputs that no pulse-width stage cuts: there the
    friction is the default.

    A torque is added where that is more likely: dead-bands differ by as much as it moves the axis. None where the
    friction is no gain over neither of the two, or the dead-band is clearly more likely.
    """
    unit = problem.recordings[0].recording.input_unit
    offered = "coulomb_friction" in candidates and "coulomb_friction" not in first.structure
    if unit not in LINEAR_INPUTS or not offered or not set(DEAD_BANDS) <= set(first.free):
        return None
    bare = first.structure.without("dead_band")
    level = torque_regression.equal_dead_bands(first.values)
    lost = first.values["input_gain"] * level["dead_band_forward"]
    begun = {**first.values, "coulomb_friction": lost, "offset": level["offset"]}
    structures = [bare, bare.with_("coulomb_friction")]
    if "constant_offset" in candidates and "constant_offset" not in first.structure:
        structures.append(structures[1].with_("constant_offset"))
    same = problem.at(first.process_noise)
    without, *fits = each(lambda s: local_optima.refit(same, s, begun), structures)
    unit_of_deviance = model_comparison.overdispersion([first, *fits])
    best = min(fits, key=lambda p: model_comparison.criterion(p, unit_of_deviance))
    stands = model_comparison.criterion_difference(first, best) < thresholds.UNDECIDED_MARGIN
    return best if stands and model_comparison.is_significant(without, fits[0]) else None


def dead_band_for_friction(problem: FitProblem, last: Fit, first: Fit) -> list[Alternative]:
    """The last model with the first one's dead-band in the place of dry friction; none where another effect needs that
    friction.
    """
    dry = [i for i in ("coulomb_friction", "presliding_friction") if i in last.structure]
    needed = any("coulomb_friction" in e.includes for e in last.structure.effects)
    if len(dry) != 1 or needed or last.structure == first.structure:
        return []
    structure = last.structure.without(*dry).with_("dead_band")
    starts = [{**first.values, **last.values}, {**last.values, **first.values}]
    found = local_optima.best_refit(problem.at(last.process_noise), structure, starts)
    return [Alternative(dry[0], "dead_band", found)]
