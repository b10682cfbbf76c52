"""What siblings are worth: a short recording with a fleet's word, against a short and a long one alone.

    python scripts/prior_study.py --units 6

Siblings are rigs of the circuit simulator that differ from one another by a few percent in every number. The errors are
printed by parameter, as root mean square over units in percent of the truth. They are those of a short recording alone,
of the short one with the prior of the siblings, and of a long one alone. Then comes the same parameter of a unit
that is unlike its siblings, with and without the prior.

Below stands what no method can better. A fleet that scatters by tau and a recording with the standard error s leave
1 / sqrt(1 / tau^2 + 1 / s^2), in matrices with all parameters together. So siblings and a short recording are as good
as a long one only where tau is at most 1 / sqrt(1 / s_long^2 - 1 / s_short^2); with six times the information, 0.45
times s_short.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

import circuit_rig
from excitations import EXCITATIONS, FREE

from twin.estimation import estimate, maximum_likelihood
from twin.estimation.prior import Prior, prior_of, with_prior
from twin.io.recording import Recording
from twin.model.fitted_model import Model

FloatArray = NDArray[np.float64]

PARAMETERS = ("input_gain", "viscous_friction", "dead_band_forward", "dead_band_reverse", "backlash_gap")
VARIED = ("stall_torque", "motor_viscous", "link_viscous", "dead_band_forward", "dead_band_reverse", "gap")
ROWS = ("short", "short with siblings", "long")
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


def relative_stds(model: Model, rig: circuit_rig.Rig) -> list[float]:
    """Standard errors of the parameters as shares of the truth."""
    truth = rig.model_values()
    return [model.std(n) / truth[n] for n in PARAMETERS]


def limits(told: dict[str, list[list[float]]], prior: Prior) -> list[str]:
    """What the fits' errors and the siblings' scatter allow, by parameter; `told` holds relative standard errors."""
    short, together, long = (np.sqrt(np.mean(np.square(told[n]), axis=0)) for n in ROWS)
    with np.errstate(divide="ignore", invalid="ignore"):
        most = np.where(long < short, 1.0 / np.sqrt(long**-2.0 - short**-2.0), np.inf)
    spread = np.array([math.sqrt(prior.variance(n)) / abs(prior.centre(n)) for n in PARAMETERS])
    rows = {
        "short, by its error": short, "siblings' spread": spread, "both, at best": together,
        "long, by its error": long, "spread that suffices": most,
    }  # fmt: skip
    return [_row(name, values) for name, values in rows.items()]


def _row(name: str, shares: FloatArray) -> str:
    return f"{name:22}" + "".join(f"{100.0 * v:20.3f}" for v in shares)


def study(
    units: int, siblings: int, seconds: tuple[float, float, float], spread: float, seed: int
) -> tuple[str, Prior]:
    """The table of the errors, and the prior; `seconds` of the short and the long recording, and of each sibling's."""
    rng = np.random.default_rng(seed)
    base = circuit_rig.draw_rig(rng)
    prior = prior_of({f"{i}": fit(sibling(base, spread, rng), seconds[2], rng) for i in range(siblings)})
    found: dict[str, list[list[float]]] = {name: [] for name in ROWS}
    told: dict[str, list[list[float]]] = {name: [] for name in ROWS}
    for _ in range(units):
        rig = sibling(base, spread, rng)
        short, long = (fit(rig, duration, rng) for duration in seconds[:2])
        for name, model in zip(ROWS, (short, with_prior(short, prior), long), strict=True):
            found[name].append(errors(model, rig))
            told[name].append(relative_stds(model, rig))
    lines = [f"{'error, %':22}" + "".join(f"{n:>20}" for n in PARAMETERS)]
    lines += [_row(name, np.sqrt(np.mean(np.square(rows), axis=0))) for name, rows in found.items()]
    lines += limits(told, prior)
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
    parser.add_argument("--sibling", type=float, default=20.0, help="s, of each sibling's recording")
    parser.add_argument("--spread", type=float, default=0.03, help="of the siblings' numbers, as a share of them")
    parser.add_argument("--seed", type=int, default=62)
    given = parser.parse_args(arguments)
    estimate.compile_kernel(lambda sentence, share: None)
    seconds = (given.short, given.long, given.sibling)
    print(study(given.units, given.siblings, seconds, given.spread, given.seed)[0])


if __name__ == "__main__":
    main()
