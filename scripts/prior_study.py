"""What siblings are worth: a short recording with a fleet's word, against a short and a long one alone.

    python scripts/prior_study.py --units 6

Siblings are rigs of the circuit simulator that differ from one another by a few percent in every number. The errors are
printed by parameter, as root mean square over units in percent of the truth. They are those of a short recording alone,
of the short one with the prior of the siblings, and of a long one alone. Then comes the same parameter of a unit
that is unlike its siblings, with and without the prior.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import circuit_rig
from excitations import EXCITATIONS, FREE

from twin.estimation import estimate, maximum_likelihood
from twin.estimation.prior import Prior, prior_of, with_prior
from twin.io.recording import Recording
from twin.model.fitted_model import Model

PARAMETERS = ("input_gain", "viscous_friction", "dead_band_forward", "dead_band_reverse", "backlash_gap")
VARIED = ("stall_torque", "motor_viscous", "link_viscous", "dead_band_forward", "dead_band_reverse", "gap")
OUTLIER, FACTOR = "viscous_friction", 1.5


def sibling(base: circuit_rig.Rig, spread: float, rng: np.random.Generator) -> circuit_rig.Rig:
    """A rig like the others."""
    return base.with_(**{n: getattr(base, n) * math.exp(spread * rng.normal()) for n in VARIED})


def fit(rig: circuit_rig.Rig, seconds: float, rng: np.random.Generator) -> Model:
    """The twin from one recording of so many seconds."""
    stamps, duty = EXCITATIONS[str(rng.choice(list(EXCITATIONS)))](seconds, rng, FREE)
    run = circuit_rig.simulate(rig, [], stamps, duty, int(rng.integers(2**31)))
    count = 2.0 * math.pi / run.counts_per_revolution
    recording = Recording("unit", run.time, run.duty, run.counts * count, "%", "rad", count)
    return maximum_likelihood.identify([recording], estimate.first_structure())


def errors(model: Model, rig: circuit_rig.Rig) -> list[float]:
    """Relative errors of the parameters."""
    truth = rig.model_values()
    return [model.values[n] / truth[n] - 1.0 for n in PARAMETERS]


def study(units: int, siblings: int, seconds: tuple[float, float], spread: float, seed: int) -> tuple[str, Prior]:
    """The table of the errors, and the prior."""
    rng = np.random.default_rng(seed)
    base = circuit_rig.draw_rig(rng)
    prior = prior_of({f"{i}": fit(sibling(base, spread, rng), seconds[1], rng) for i in range(siblings)})
    found: dict[str, list[list[float]]] = {"short": [], "short with siblings": [], "long": []}
    for _ in range(units):
        rig = sibling(base, spread, rng)
        short = fit(rig, seconds[0], rng)
        for name, model in (("short", short), ("short with siblings", with_prior(short, prior))):
            found[name].append(errors(model, rig))
        found["long"].append(errors(fit(rig, seconds[1], rng), rig))
    lines = [f"{'error, %':22}" + "".join(f"{n:>20}" for n in PARAMETERS)]
    for name, rows in found.items():
        size = 100.0 * np.sqrt(np.mean(np.square(rows), axis=0))
        lines.append(f"{name:22}" + "".join(f"{v:20.3f}" for v in size))
    unlike = sibling(base, spread, rng)
    unlike = unlike.with_(link_viscous=unlike.link_viscous + (FACTOR - 1.0) * unlike.viscous_friction)
    short = fit(unlike, seconds[0], rng)
    at = PARAMETERS.index(OUTLIER)
    together = with_prior(short, prior)
    lines.append(
        f"{OUTLIER} {FACTOR:g} times the siblings': error {100 * errors(short, unlike)[at]:.2f} % alone, "
        f"{100 * errors(together, unlike)[at]:.2f} % with siblings; "
        f"said to be unlike them in: {together.provenance.get('unlike_siblings', 'nothing')}"
    )
    return "\n".join(lines), prior


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--units", type=int, default=6)
    parser.add_argument("--siblings", type=int, default=20)
    parser.add_argument("--short", type=float, default=10.0, help="s")
    parser.add_argument("--long", type=float, default=60.0, help="s")
    parser.add_argument("--spread", type=float, default=0.03, help="of the siblings' numbers, as a share of them")
    parser.add_argument("--seed", type=int, default=62)
    given = parser.parse_args(arguments)
    estimate.compile_kernel(lambda sentence, share: None)
    print(study(given.units, given.siblings, (given.short, given.long), given.spread, given.seed)[0])


if __name__ == "__main__":
    main()
