"""Whether a drive has a gap: left out where it stands for other physics or does not show, and looked for again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin.diagnosis import (
    model_comparison,
    thresholds,
)
from twin.diagnosis.search_result import SearchResult
from twin.estimation import (
    likelihood,
    local_optima,
    parameter_bounds,
)
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem

GAP = ("backlash", "tooth_compliance")


def without_idle_gap(found: SearchResult) -> tuple[FitProblem, Fit] | None:
    """The problem and the last model of a search, both without a gap, where a rigid drive is more likely; else None.

    A model with a gap has two inertias and teeth, and no gap of nothing makes it rigid. Where there is none, these
    follow what else is missing. It is asked at the end only: a model that lacks much may be likelier without a gap that
    is there. A gap that is known stays, and so does one that another effect needs.
    """
    last, problem = found.last, found.problem
    structure = last.structure.without(*GAP)
    known = any(n in problem.held for n in ("backlash_gap", "motor_share"))
    if known or "backlash" in structure or "backlash" not in last.structure:
        return None
    rigid = local_optima.refit(problem.at(last.process_noise), structure, last.values)
    return _without_gap(problem, rigid) if model_comparison.criterion_difference(rigid, last) > 0.0 else None


def is_gap_a_makeshift(problem: FitProblem, point: Fit) -> bool:
    """Whether the widest gap that is looked for, with all else the same, is about as likely as the one that was found.

    A recording that shows a gap bounds it from above: a wider one would let the axis stand where it was seen to move.
    Where nothing bounds it, the gap stands for other physics.
    """
    if "backlash_gap" not in point.free:
        return False
    widest = {**point.values, "backlash_gap": parameter_bounds.bounds_of("backlash_gap")[1]}
    wide = likelihood.evaluate(problem.at(point.process_noise), point.structure, widest, point.free)
    lost = (wide.deviance - point.deviance) / model_comparison.overdispersion([point])
    return lost < thresholds.PENALTY_PER_PARAMETER


def with_gap_again(problem: FitProblem, point: Fit, candidates: Sequence[str]) -> Fit:
    """The point, or one with a gap where that shows beside the effects that are known now.

    The first model's gap stood for them, and hid the one that is there.
    """
    if "backlash" not in candidates or "backlash" in point.structure:
        return point
    geared = local_optima.search_gap(problem, point)
    shows = model_comparison.is_significant(point, geared) and not is_gap_a_makeshift(problem, geared)
    return geared if shows else point


def _without_gap(problem: FitProblem, point: Fit) -> tuple[FitProblem, Fit]:
    """The problem and the model with motor and link as one. They do not rattle, so nothing is left out for that."""
    unmasked = problem.on([replace(c, rattle_mask=None, start_mask=None) for c in problem.recordings])
    structure = point.structure.without(*GAP)
    return unmasked, local_optima.refit(unmasked.at(point.process_noise), structure, point.values)
