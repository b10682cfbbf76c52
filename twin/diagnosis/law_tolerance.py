"""How much of a misfit the laws of a model leave because no machine follows a law exactly.

A law describes what a machine does up to a share, `thresholds.LAW_TOLERANCE`, of its torque. What that leaves has a
shape, too: another effect or a curve may follow it and gain hundreds of units. Such a gain is no sign of other physics.
"""

from __future__ import annotations

import math

from twin.diagnosis import thresholds
from twin.estimation import local_optima, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.model.stepper import Structure


def plain_fit(problem: FitProblem, first: Structure, like: Fit) -> Fit:
    """The first model without dry friction, which it may have from the start, fitted where another fit stands.

    Dry friction follows its law least exactly of all.
    """
    plain = preparation.with_tooth_compliance(first.without(*(e.id for e in first.effects if e.slot == "grip")))
    return like if plain == like.structure else local_optima.refit(problem.at(like.process_noise), plain, like.values)


def doubt(plain: Fit, point: Fit) -> float:
    """Deviance that the laws by which a model exceeds a plain one may leave, both at one noise density.

    Their torque took the innovations' variance from v0 to v1. Laws that err by a share s of it leave s^2 (v0 - v1). The
    deviance of n innovations is n log(v), so exact laws would lower it by n log(1 + s^2 (v0 / v1 - 1)).
    """
    removed = plain.deviance - point.deviance
    if not (removed > 0.0 and plain.scale > point.scale and math.isfinite(plain.scale)):
        return 0.0
    ratio = plain.scale / point.scale
    return removed * math.log1p(thresholds.LAW_TOLERANCE**2 * (ratio - 1.0)) / math.log(ratio)


def doubt_since(problem: FitProblem, first: Structure, point: Fit) -> float:
    """The same of all laws of a model beyond the plain first one, which is fitted where the model stands."""
    return doubt(plain_fit(problem, first, point), point)
