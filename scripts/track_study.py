"""Sealed histories: a twin and recordings made since, of an axis that wears, that changes at once, or that is sound.

    python scripts/track_study.py --trials 10
    python scripts/track_study.py --trials 2 --length 12 --recorded

Each trial follows one rig through a number of recordings. By default only the twin is fitted to a recording; the later
fits are drawn from its errors around the truth, so that a thousand recordings take minutes. With `--recorded` every
recording is simulated and fitted. Since a change began, all fits so far are
averaged and compared with the twin. The change is visible from the recording on at which its size, over the standard
error of that difference, is what the test asks for.

Printed are: histories whose change was reported within two recordings of that point, those with the right parameter,
and the false alarms among all recordings before a change and in sound histories.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).resolve().parent))

import circuit_rig
from excitations import EXCITATIONS, FREE

from twin.diagnosis.api import fit_again
from twin.diagnosis.tracking import FALSE_ALARMS, Track, track
from twin.estimation import estimate, maximum_likelihood
from twin.io.recording import Recording
from twin.model.fitted_model import Model

KINDS = ("step", "wear", "sound")
#: What may change, by its name in the model and how the rig is changed by a factor.
PARAMETERS = ("viscous_friction", "dead_band_forward", "backlash_gap")
#: Size of the whole change, in standard errors of one fit.
SIZES = (4.0, 12.0)


@dataclass(frozen=True)
class Label:
    """All that is true about one history; the change begins with recording `since` (from 0)."""

    trial: int
    kind: str
    parameter: str
    since: int
    factor: float

    def sealed(self) -> str:
        """A hash that is printed before the tool is asked."""
        return hashlib.sha256(json.dumps(vars(self), sort_keys=True).encode()).hexdigest()[:12]

    def factors(self, length: int) -> list[float]:
        """By how much the parameter is larger than in the twin, for each recording."""
        if self.kind == "sound":
            return [1.0] * length
        if self.kind == "step":
            return [self.factor if i >= self.since else 1.0 for i in range(length)]
        steps = length - self.since
        return [1.0 + (self.factor - 1.0) * max(0, i + 1 - self.since) / steps for i in range(length)]


@dataclass(frozen=True)
class Outcome:
    """A history, when its change can be seen, and what was said."""

    label: Label
    visible: int | None
    history: Track

    @property
    def first(self) -> int | None:
        """The recording with which a change that is there was first reported."""
        if self.label.kind == "sound":
            return None
        return next((a.seen for a in self.history.alarms if a.seen >= self.label.since), None)

    @property
    def in_time(self) -> bool:
        return self.visible is None or (self.first is not None and self.first <= self.visible + 2)

    @property
    def right(self) -> bool:
        alarm = next((a for a in self.history.alarms if a.seen >= self.label.since), None)
        return alarm is not None and [c.parameter for c in alarm.changes] == [self.label.parameter]

    @property
    def sound_recordings(self) -> int:
        return len(self.history.fits) if self.label.kind == "sound" else self.label.since

    @property
    def false_alarms(self) -> int:
        return sum(a.seen < self.sound_recordings for a in self.history.alarms)


def _recording(rig: circuit_rig.Rig, seconds: float, rng: np.random.Generator, name: str) -> Recording:
    stamps, duty = EXCITATIONS[str(rng.choice(list(EXCITATIONS)))](seconds, rng, FREE)
    run = circuit_rig.simulate(rig, [], stamps, duty, int(rng.integers(2**31)))
    count = 2.0 * math.pi / run.counts_per_revolution
    return Recording(name, run.time, run.duty, run.counts * count, "%", "rad", count)


def _worn(rig: circuit_rig.Rig, parameter: str, factor: float) -> circuit_rig.Rig:
    """The rig with one number so many times as large."""
    if parameter == "viscous_friction":
        return rig.with_(link_viscous=rig.link_viscous + (factor - 1.0) * rig.viscous_friction)
    name = {"backlash_gap": "gap"}.get(parameter, parameter)
    return rig.with_(**{name: factor * getattr(rig, name)})


def _drawn(model: Model, parameter: str, factor: float, rng: np.random.Generator) -> Model:
    """A fit of a later recording, with the twin's errors around the truth."""
    names = [n for n in model.fitted if math.isfinite(model.std(n))]
    rows = [model.fitted.index(n) for n in names]
    truth = np.array([model.values[n] * (factor if n == parameter else 1.0) for n in names])
    values = rng.multivariate_normal(truth, model.covariance[np.ix_(rows, rows)])
    return replace(model.with_values(dict(zip(names, values.tolist(), strict=True))), intervals={})


def visible_from(label: Label, model: Model, length: int) -> int | None:
    """The recording with which the change is as large as the test asks for; None where it never is."""
    if label.kind == "sound":
        return None
    needed = math.sqrt(float(chi2.isf(FALSE_ALARMS / length / len(model.fitted), 1)))
    value, std, factors = model.values[label.parameter], model.std(label.parameter), label.factors(length)
    for last in range(label.since, length):
        sizes = [value * (f - 1.0) for f in factors[label.since : last + 1]]
        before, after = 1.0 / (1.0 + label.since), 1.0 / len(sizes)
        if abs(float(np.mean(sizes))) >= needed * std * math.sqrt(before + after):
            return last
    return None


def run(seed: int, trial: int, length: int, seconds: float, recorded: bool) -> Outcome:
    """One history, from the sealed label to what was said."""
    rng = np.random.default_rng([seed, trial])
    kind, structure, known = KINDS[trial % len(KINDS)], estimate.first_structure(), []
    while not known:  # of some rigs a twin knows nothing well enough to see it change
        rig = circuit_rig.draw_rig(rng)
        model = replace(maximum_likelihood.identify([_recording(rig, seconds, rng, "twin")], structure), intervals={})
        known = [n for n in PARAMETERS if 0.0 < model.std(n) < 0.2 * abs(model.values[n])]
    parameter = str(rng.choice(known))
    size = float(rng.uniform(*SIZES)) * model.std(parameter) / model.values[parameter]
    label = Label(trial, kind, parameter, int(rng.integers(length // 4, 3 * length // 4)), 1.0 + size)
    print(f"history {trial}: sealed {label.sealed()}", end=" ", flush=True)
    fits = []
    for i, factor in enumerate(label.factors(length)):
        if recorded:
            recording = _recording(_worn(rig, parameter, factor), seconds, rng, f"{i + 1}")
            fits.append(fit_again(model, recording))
        else:
            fits.append(_drawn(model, parameter, factor, rng))
    return Outcome(label, visible_from(label, model, length), track(model, fits))


def summary(outcomes: Sequence[Outcome]) -> str:
    """The figures of the study."""
    changed = [o for o in outcomes if o.label.kind != "sound" and o.visible is not None]
    reported = [o for o in changed if o.first is not None]
    sound = sum(o.sound_recordings for o in outcomes)
    return "\n".join((
        f"reported within two recordings of where it is visible: {sum(o.in_time for o in changed)} of {len(changed)}",
        f"right parameter and nothing else: {sum(o.right for o in reported)} of {len(reported)} reported",
        f"false alarms: {sum(o.false_alarms for o in outcomes)} in {sound} sound recordings",
    ))  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="number of the first history")
    parser.add_argument("--length", type=int, default=50, help="recordings in a history")
    parser.add_argument("--seconds", type=float, default=15.0, help="of each recording")
    parser.add_argument("--recorded", action="store_true", help="simulate and fit every recording")
    parser.add_argument("--seed", type=int, default=61)
    given = parser.parse_args(arguments)
    estimate.compile_kernel(lambda sentence, share: None)
    outcomes = []
    for trial in range(given.first, given.first + given.trials):
        outcome = run(given.seed, trial, given.length, given.seconds, given.recorded)
        outcomes.append(outcome)
        label = outcome.label
        said = [(a.since, a.seen, [c.parameter for c in a.changes]) for a in outcome.history.alarms]
        what = "sound" if label.kind == "sound" else f"{label.kind} of {label.parameter} x {label.factor:.3f}"
        print(f"{what} since {label.since}, visible at {outcome.visible}: {said}", flush=True)
    print(summary(outcomes))


if __name__ == "__main__":
    main()
