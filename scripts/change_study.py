"""Sealed changes: a rig is recorded, one of its numbers changes, it is recorded again. Is the right one named?

    python scripts/change_study.py --trials 20

Each trial draws a rig of the circuit simulator, one effect at most, and a change of 3 to 100 %, either way. The tool is
given the two recordings, and the effects of the rig as the model's structure; it is not told what changed. Printed
are the trials, how often the right parameter and nothing else is named, and how often the 95 % interval holds the
truth. A change is visible where it is five times the standard error of the difference of the two estimates. Every
tenth trial changes nothing.
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
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import circuit_rig
from excitations import EXCITATIONS, FREE

from twin.diagnosis.api import fit_again
from twin.diagnosis.change import INERTIA, Changes, compare_models
from twin.estimation import estimate, maximum_likelihood
from twin.io.recording import Recording
from twin.model.fitted_model import Model

#: What may change: the effect that it belongs to, its name in the simulator, its name in the model.
CHANGES = {
    "inertia": ("", "", INERTIA),
    "viscous friction": ("", "viscous", "viscous_friction"),
    "dead band forward": ("", "dead_band_forward", "dead_band_forward"),
    "dead band reverse": ("", "dead_band_reverse", "dead_band_reverse"),
    "gap": ("", "gap", "backlash_gap"),
    "dry friction": ("coulomb_friction", "coulomb", "coulomb_friction"),
    "gravity": ("gravity", "gravity", "gravity_gain"),
    "spring": ("spring", "spring", "spring_stiffness"),
    "drag": ("quadratic_drag", "drag", "quadratic_drag"),
    "delay": ("input_delay", "delay", "delay"),
    "eccentricity": ("encoder_eccentricity", "eccentricity", "eccentricity"),
    "saturation": ("drive_saturation", "saturation", "saturation_limit"),
}
SMALLEST, LARGEST = 0.03, 1.0
#: A change of so many standard errors of the difference is visible.
VISIBLE = 5.0
#: What stands over the load's inertia in the simulator.
OVER_INERTIA = (
    "stall_torque", "motor_viscous", "link_viscous", "motor_inertia", "teeth_stiffness", "teeth_damping", "noise"
)  # fmt: skip


@dataclass(frozen=True)
class Label:
    """All that is true about one trial; `factor` 1 where nothing changed."""

    seed: int
    trial: int
    kind: str
    factor: float

    @property
    def parameter(self) -> str:
        return CHANGES[self.kind][2] if self.factor != 1.0 else ""

    def sealed(self) -> str:
        """A hash that is printed before the tool is asked."""
        return hashlib.sha256(json.dumps(vars(self), sort_keys=True).encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Outcome:
    """A trial and what the tool said of it."""

    label: Label
    named: tuple[str, ...]
    holds: bool | None
    visible: bool

    @property
    def right(self) -> bool:
        return self.named == ((self.label.parameter,) if self.label.parameter else ())


def _changed(rig: Any, kind: str, factor: float) -> Any:
    """The rig with one of its own numbers so many times as large."""
    if kind == "inertia":
        return rig.with_(**{n: getattr(rig, n) / factor for n in OVER_INERTIA})
    name = CHANGES[kind][1]
    if name == "viscous":
        return rig.with_(link_viscous=rig.link_viscous + (factor - 1.0) * rig.viscous_friction)
    return rig.with_(**{name: factor * getattr(rig, name)})


def make(seed: int, trial: int, seconds: float) -> tuple[Label, list[Recording], tuple[str, ...]]:
    """A trial's label, its recordings before and after, and the effects that the rig has beside the base model's."""
    rng = np.random.default_rng([seed, trial])
    kind = list(CHANGES)[trial % len(CHANGES)]
    size = SMALLEST * (LARGEST / SMALLEST) ** float(rng.uniform())
    factor = 1.0 + size if rng.random() < 0.5 else 1.0 / (1.0 + size)
    if kind in ("viscous friction", "inertia"):
        factor = max(factor, 1.0 / factor)  # what the link's bearing or load has may not fall below none
    if trial % 10 == 9:
        factor = 1.0
    effect, name, _ = CHANGES[kind]
    rig = circuit_rig.draw_rig(rng)
    planted = [circuit_rig.draw_effect(rng, effect, rig, 0.2, seconds)] if effect else []
    label, recordings = Label(seed, trial, kind, factor), []
    for when, by in (("before", 1.0), ("after", factor)):
        now, has = rig, planted
        if effect:
            has = [replace(p, parameters={**p.parameters, name: by * p.parameters[name]}) for p in planted]
        else:
            now = _changed(rig, kind, by)
        stamps, duty = EXCITATIONS[str(rng.choice(list(EXCITATIONS)))](seconds, rng, FREE)
        run = circuit_rig.simulate(now, has, stamps, duty, int(rng.integers(2**31)))
        count = 2.0 * math.pi / run.counts_per_revolution
        recordings.append(Recording(when, run.time, run.duty, run.counts * count, "%", "rad", count))
    return label, recordings, (effect,) if effect else ()


def ask(recordings: Sequence[Recording], effects: tuple[str, ...], kept: Path | None = None) -> Changes:
    """What the tool says, from the recordings and the structure alone; both fits are written to files named so."""
    before = maximum_likelihood.identify([recordings[0]], estimate.first_structure((), effects))
    after = fit_again(before, recordings[1])
    if kept is not None:
        before.write(kept.with_suffix(".before.toml"))
        after.write(kept.with_suffix(".after.toml"))
    return compare_models(before, after)


def ask_again(kept: Path) -> Changes:
    """What the tool says of two fits that are kept."""
    return compare_models(*(Model.read(kept.with_suffix(f".{when}.toml")) for when in ("before", "after")))


def judge(label: Label, said: Changes) -> Outcome:
    """The answer against the label."""
    found = {c.parameter: c for c in said.found}
    own = found.get(label.parameter)
    holds = None
    if own is not None:
        low, high = sorted(v / own.before for v in own.interval)
        holds = low <= label.factor <= high
    # The inertia moves all that stands over it, the input gain among them.
    seen = said.standardised.get("input_gain" if label.parameter == INERTIA else label.parameter, 0.0)
    return Outcome(label, tuple(found), holds, abs(seen) >= VISIBLE)


def summary(outcomes: Sequence[Outcome]) -> str:
    """The figures of the study."""
    changed = [o for o in outcomes if o.label.parameter]
    seen = [o for o in changed if o.visible]
    held = [o.holds for o in outcomes if o.holds is not None]
    sound = [o for o in outcomes if not o.label.parameter]
    return "\n".join((
        f"right parameter and nothing else: {sum(o.right for o in changed)} of {len(changed)}",
        f"  of visible changes: {sum(o.right for o in seen)} of {len(seen)}; "
        f"right one among those named: {sum(o.label.parameter in o.named for o in seen)}",
        f"95 % interval holds the truth: {sum(held)} of {len(held)}",
        f"nothing changed and nothing named: {sum(o.right for o in sound)} of {len(sound)}",
    ))  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each recording")
    parser.add_argument("--seed", type=int, default=60)
    parser.add_argument("--models", type=Path, help="folder where fits are kept, and taken from where they are there")
    given = parser.parse_args(arguments)
    estimate.compile_kernel(lambda sentence, share: None)
    if given.models:
        given.models.mkdir(exist_ok=True)
    outcomes = []
    for trial in range(given.first, given.first + given.trials):
        label, recordings, effects = make(given.seed, trial, given.seconds)
        print(f"trial {trial}: sealed {label.sealed()}", end=" ", flush=True)
        kept = given.models / f"{given.seed}_{trial}" if given.models else None
        done = kept is not None and kept.with_suffix(".after.toml").exists()
        outcome = judge(label, ask_again(kept) if kept and done else ask(recordings, effects, kept))
        outcomes.append(outcome)
        state = "right" if outcome.right else "wrong"
        shown = "" if outcome.visible or not label.parameter else ", not visible"
        print(f"{label.kind} x {label.factor:.3f}{shown}: {state}, {', '.join(outcome.named) or 'nothing'}; "
              f"interval holds: {outcome.holds}", flush=True)  # fmt: skip
    print(summary(outcomes))


if __name__ == "__main__":
    main()
