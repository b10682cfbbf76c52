"""What a search for effects has found: the path to a structure, and what comes near it."""

from __future__ import annotations

from dataclasses import dataclass

from twin.diagnosis.selection_round import Round
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem


@dataclass(frozen=True, eq=False)
class Alternative:
    """The last model with a rival in the place of one of its effects, fitted."""

    effect: str
    rival: str
    point: Fit


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The path to a structure: the first model, the last, and the rounds between. Also the last less one effect, and
    the last with one effect exchanged for a close rival, or for one that contains it.
    """

    first: Fit
    last: Fit
    rounds: tuple[Round, ...]
    problem: FitProblem
    smaller_models: tuple[Fit, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
