"""What a search says of itself, as a page can show it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from twin.diagnosis import events, model_comparison, residual_torque
from twin.diagnosis.events import Compared, Reached
from twin.diagnosis.residual_torque import MissingTorque
from twin.display.numbers import number, unit_text
from twin.estimation import maximum_likelihood
from twin.estimation.fit import Fit
from twin.io.recording import Recording
from twin.model import fitted_model
from twin.report.explorer import tell_missing_torque
from twin.report.wording import title

#: Rivals of a round that are shown.
RIVALS = 8


class Watch:
    """Turns what a search tells into events for the page.

    Parameters
    ----------
    recordings : sequence of Recording
        What is searched.
    send : callable
        Takes each event, a dict.
    """

    def __init__(self, recordings: Sequence[Recording], send: Callable[[dict[str, Any]], None]) -> None:
        self.recordings, self.send = recordings, send
        self.first: tuple[Fit, MissingTorque] | None = None
        self.reached: Fit | None = None

    def progress(self, sentence: str, share: float) -> None:
        self.send({"kind": "stage", "says": sentence, "share": share})

    def observe(self, event: events.Event) -> None:
        if isinstance(event, Compared):
            self._rivals(event)
        else:
            self._model(event)

    def _rivals(self, event: Compared) -> None:
        """The candidates fitted so far, by the gain of each over the model before."""
        gains = [(effect, model_comparison.gain(event.before, fit)) for effect, fit in event.rivals]
        shown = sorted((g for g in gains if np.isfinite(g[1]) and g[1] > 0.0), key=lambda g: -g[1])[:RIVALS]
        best = shown[0][1] if shown else 1.0
        bars = [{"title": title(effect), "gain": number(gain), "share": gain / best} for effect, gain in shown]
        self.send({"kind": "rivals", "bars": bars})

    def _model(self, event: Reached) -> None:
        """A model with the torque that it lacks, beside that of the first."""
        fit, longest = event.model, event.problem.longest
        missing = residual_torque.missing_torque(longest, fit.structure, fit.values)
        if self.first is None:
            self.first = (fit, missing)
        start, first = self.first
        unit = f"{self.recordings[0].output_unit.removesuffix('/s')}/s^2"
        model = maximum_likelihood.to_model(event.problem, fit, [c.recording for c in event.problem.recordings])
        since = self.reached.structure if self.reached else start.structure
        self.reached = fit
        self.send(
            {
                "kind": "model",
                "joined": [title(i) for i in fit.structure.named if i not in since],
                "left": [title(i) for i in since.named if i not in fit.structure],
                "lacks": f"{number(missing.rms, 2)} {unit_text(unit)}",
                "share": missing.rms / first.rms if first.rms > 0.0 else 0.0,
                "panels": tell_missing_torque(unit, first, missing),
                "model": fitted_model.dumps(model),
            }
        )
