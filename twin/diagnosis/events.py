"""Events of a running search for an observer: the rivals of a round, and each model reached.

A sentence and a share of the work are told to `progress`; here are the models themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem


@dataclass(frozen=True, eq=False)
class Compared:
    """Candidates of a round that are fitted so far.

    Attributes
    ----------
    before : Fit
        The model that each would be added to.
    rivals : tuple of (str, Fit)
        The effect that is added and the larger model.
    """

    before: Fit
    rivals: tuple[tuple[str, Fit], ...]


@dataclass(frozen=True, eq=False)
class Reached:
    """The model that the search has come to: the first one, then one a round, the same again where a round is lost."""

    problem: FitProblem
    model: Fit


Event = Compared | Reached
Observer = Callable[[Event], None]

_observer: ContextVar[Observer | None] = ContextVar("observer", default=None)


@contextmanager
def observing(observer: Observer | None) -> Iterator[None]:
    """Events of searches that run in this block, in this thread, go to the observer; None hears nothing."""
    token = _observer.set(observer)
    try:
        yield
    finally:
        _observer.reset(token)


def announce(event: Event) -> None:
    """Tell the observer, where there is one."""
    observer = _observer.get()
    if observer is not None:
        observer(event)
