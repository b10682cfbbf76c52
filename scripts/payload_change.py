"""A payload that nobody told of: what `compare_models` says of a servo pendulum whose masses were weighed.

    python scripts/payload_change.py ../shared/data/sts3215_pendulum

One twin for each payload (mass and arm), made from the first repetition; each is held against recordings of the second
repetition at every payload. Printed are the ratios of gravity's torque and of the inertia with their 95 % intervals.
Beside them stand the ratios of the weighed masses. The servo's own inertia was not weighed, so the
inertia's ratio has two bounds. With no inertia of the servo it is the ratio of the loads. The other bound takes the
motor's inertia that the authors of the recordings fitted. At the same payload nothing may be reported.

Every ratio is a ratio to the drive's torque at the same command. A drive that gives a tenth less makes the load look a
tenth heavier in all of its pairs. So each payload is given one factor of its own, by least squares over the pairs. It
is printed with the mean temperature of the servo's case, with what the pairs scatter about these factors, and with how
often the intervals hold once they are taken off.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.diagnosis.change import DRIVE, INERTIA, Changes, compare_models
from twin.estimation import estimate, maximum_likelihood
from twin.io.recording import load
from twin.model.fitted_model import Model

RIG = Path(__file__).resolve().parents[1] / "models" / "rigs" / "sts3215.toml"
#: Without the jerks and the lifted arm. Gentle and medium gains: at the highest ones the drive is at its limit.
TRAJECTORIES, GAINS = ("sin_time_square", "sin_sin", "up_and_down"), ("8", "16")
#: What this servo is known to have. A gap does not show at 100 readings a second.
EFFECTS, WITHOUT = ("gravity", "coulomb_friction", "load_dependent_friction"), ("backlash",)
GRAVITY = 9.81  # m/s^2
MOTOR_INERTIA = 0.0246  # kg m^2 at the link, as the authors of the recordings fitted it


@dataclass(frozen=True, order=True)
class Payload:
    """A disc on an arm: kg, m, kg."""

    mass: float
    arm: float
    arm_mass: float

    @property
    def moment(self) -> float:
        """Of gravity at the horizontal arm, N m."""
        return GRAVITY * self.arm * (self.mass + 0.5 * self.arm_mass)

    @property
    def inertia(self) -> float:
        """About the axis, kg m^2."""
        return self.arm**2 * (self.mass + self.arm_mass / 3.0)


@dataclass(frozen=True)
class Pair:
    """A twin of one payload held against recordings at another."""

    before: Payload
    after: Payload
    changes: Changes

    def ratio(self, parameter: str) -> tuple[float, float, float]:
        """A ratio found with its interval; 1 where none was reported."""
        for c in self.changes.found:
            if c.parameter == parameter:
                return (c.after / c.before, *sorted(v / c.before for v in c.interval))
        return (1.0, 1.0, 1.0)

    @property
    def gravity(self) -> float:
        return self.after.moment / self.before.moment

    @property
    def inertia_bounds(self) -> tuple[float, float]:
        bare = self.after.inertia / self.before.inertia
        return bare, (self.after.inertia + MOTOR_INERTIA) / (self.before.inertia + MOTOR_INERTIA)


def files(folder: Path, repetition: str) -> Mapping[Payload, Sequence[Path]]:
    """The recordings of one repetition by payload."""
    found: dict[Payload, list[Path]] = {}
    with (folder / "manifest.csv").open(encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            if row["rep"] == repetition and row["trajectory"] in TRAJECTORIES and row["kp"] in GAINS:
                payload = Payload(float(row["mass_kg"]), float(row["length_m"]), float(row["arm_mass_kg"]))
                found.setdefault(payload, []).append(folder / "runs" / row["file"])
    return dict(sorted(found.items()))


def rig_without_loop(folder: Path) -> Path:
    """The servo's rig file without what it tells of the loop and of the payload."""
    text = RIG.read_text(encoding="utf-8")
    rig = folder / "rig.toml"
    rig.write_text(text[: text.index("[loop]")], encoding="utf-8")
    return rig


def case_temperature(logs: Sequence[Path]) -> float:
    """Mean over the recordings, degC."""
    read = []
    for log in logs:
        with log.open(encoding="utf-8") as stream:
            read.append(float(np.mean([float(row["temp_C"]) for row in csv.DictReader(stream)])))
    return float(np.mean(read))


def twin_of(logs: Sequence[Path], rig: Path) -> Model:
    """The twin that these recordings alone ask for."""
    recordings, _ = load(logs, rig)
    return maximum_likelihood.identify(recordings, estimate.first_structure((), EFFECTS, WITHOUT))


def pairs(before: Mapping[Payload, Model], after: Mapping[Payload, Model]) -> list[Pair]:
    """Every twin against every later fit."""
    return [Pair(a, b, compare_models(before[a], after[b])) for a in before for b in after]


def _shown(found: tuple[float, float, float]) -> str:
    return f"{found[0]:5.2f} ({found[1]:4.2f} to {found[2]:4.2f})"


def table(found: Iterable[Pair]) -> str:
    """One row for each pair of payloads."""
    head = (
        f"{'mass arm -> mass arm':26}{'gravity found':>24}{'weighed':>9}{'inertia found':>24}{'load':>7}{'+motor':>8}"
    )
    lines = [head]
    for p in found:
        a, b = p.before, p.after
        name = f"{a.mass:.3f} {a.arm:.3f} -> {b.mass:.3f} {b.arm:.3f}"
        bare, whole = p.inertia_bounds
        others = [c.parameter for c in p.changes.found if c.parameter not in (INERTIA, "gravity_gain")]
        unchanged = "  unchanged" if not p.changes.found else ""
        lines.append(
            f"{name:26}{_shown(p.ratio('gravity_gain')):>24}{p.gravity:9.2f}{_shown(p.ratio(INERTIA)):>24}"
            f"{bare:7.2f}{whole:8.2f}{unchanged}{'  also ' + ', '.join(others) if others else ''}"
        )
    return "\n".join(lines)


def summary(found: Sequence[Pair]) -> str:
    """How far off the ratios are, and how often the same payload is left alone."""
    same = [p for p in found if p.before == p.after]
    other = [p for p in found if p.before != p.after]
    alone = sum(not p.changes.found for p in same)
    lines = [f"same payload, another repetition: unchanged in {alone} of {len(same)}"]
    noticed = sum(bool(p.changes.found) for p in other)
    only = sum({c.parameter for c in p.changes.found} <= {INERTIA, "gravity_gain"} for p in other)
    lines.append(f"another payload: seen in {noticed} of {len(other)}, nothing but gravity and inertia in {only}")
    errors = [abs(math.log(p.ratio("gravity_gain")[0] / p.gravity)) for p in other]
    held = sum(p.ratio("gravity_gain")[1] <= p.gravity <= p.ratio("gravity_gain")[2] for p in other)
    lines.append(
        f"gravity's ratio: median error {100 * float(np.median(errors)):.0f} %, largest {100 * max(errors):.0f} %; "
        f"interval holds it in {held} of {len(other)}"
    )
    within = 0
    for p in other:
        low, high = sorted(p.inertia_bounds)
        value = p.ratio(INERTIA)
        within += value[2] >= low and value[1] <= high
    lines.append(f"inertia's ratio: interval meets the bounds in {within} of {len(other)}")
    heavier = [c for p in other for c in p.changes.found if c.parameter == INERTIA]
    drive = sum(DRIVE in c.rivals for c in heavier)
    lines.append(f"another torque of the drive is offered beside another inertia in {drive} of {len(heavier)}")
    return "\n".join(lines)


def by_payload(found: Sequence[Pair], temperatures: Mapping[Payload, float]) -> str:
    """Each payload's own factor of gravity's torque over the weighed one, and what the pairs scatter about it."""
    payloads = list(temperatures)
    other = [p for p in found if p.before != p.after and p.ratio("gravity_gain")[0] != 1.0]
    design = np.zeros((len(other), len(payloads)))
    for row, p in zip(design, other, strict=True):
        row[payloads.index(p.after)] += 1.0
        row[payloads.index(p.before)] -= 1.0
    errors = np.array([math.log(p.ratio("gravity_gain")[0] / p.gravity) for p in other])
    # Only ratios are seen: the factors are those to their median.
    factors = np.linalg.lstsq(design, errors, rcond=None)[0]
    factors -= np.median(factors)
    lines = [f"{'payload':14}{'gravity over weighed':>22}{'case, degC':>12}"]
    for payload, factor in zip(payloads, factors, strict=True):
        name = f"{payload.mass:.3f} {payload.arm:.3f}"
        lines.append(f"{name:14}{math.exp(factor):22.3f}{temperatures[payload]:12.1f}")
    ends = np.log([p.ratio("gravity_gain")[1:] for p in other])
    expected = np.log([p.gravity for p in other]) + design @ factors
    held = int(np.sum((ends[:, 0] <= expected) & (expected <= ends[:, 1])))
    lines.append(
        f"about these factors the pairs scatter by {100 * float(np.std(errors - design @ factors)):.1f} %, and the "
        f"interval holds in {held} of {len(other)}"
    )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="the servo's recordings, with manifest.csv")
    parser.add_argument("--models", type=Path, default=Path("payload_models"), help="where the fits are kept")
    arguments = parser.parse_args()
    arguments.models.mkdir(exist_ok=True)
    rig = rig_without_loop(arguments.models)
    fits: list[dict[Payload, Model]] = []
    measured: dict[Payload, list[Path]] = {}
    for repetition in ("1", "2"):
        fits.append({})
        for payload, logs in files(arguments.folder, repetition).items():
            kept = arguments.models / f"{payload.mass:g}_{payload.arm:g}_{repetition}.toml"
            if not kept.exists():
                twin_of(logs, rig).write(kept)
            fits[-1][payload] = Model.read(kept)
            measured.setdefault(payload, []).extend(logs)
    found = pairs(*fits)
    print(table(found))
    print(summary(found))
    print(by_payload(found, {payload: case_temperature(logs) for payload, logs in measured.items()}))


if __name__ == "__main__":
    main()
