"""What the tool says about four real data sets when it starts from a plain model.

    python scripts/real_recordings.py DATA_DIR [--set NAME] [--quick]

For each set: the verdict, the effects with their numbers, the error of a free run over held-out recordings before
and after, by the metric of the README beside the set, and that README's own figures. Free runs go through the
exported FMU in FMPy. `--quick` takes a small part of each set and says so.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import manifests
import numpy as np
from numpy.typing import NDArray

from twin import extend, pipeline, recording
from twin.finding import Diagnosis, Trace
from twin.likelihood import Point
from twin.model import Model

FloatArray = NDArray[np.float64]
Figures = dict[str, float]
RIGS = Path(__file__).resolve().parents[1] / "models" / "rigs"
Errors = list[tuple[Trace, FloatArray]]


def _errors(found: Diagnosis, which: str) -> Errors:
    """Of every held-out recording: simulation less recording, NaN where nothing was read."""
    held_out = [t for t in found.traces if t.role == "holdout"]
    return [(t, getattr(t, which) - t.recorded) for t in held_out]


def _rms(errors: Sequence[FloatArray]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2))) if errors else float("nan")


def _mean(errors: Sequence[FloatArray]) -> float:
    return float(np.nanmean(np.abs(np.concatenate(errors)))) if errors else float("nan")


def _emps(found: Diagnosis, errors: Errors) -> Figures:
    return {"position RMSE, mm": 1e3 * _rms([e[20:] for _, e in errors])}


def _jga25(found: Diagnosis, errors: Errors) -> Figures:
    largest = {r.name: float(np.max(np.abs(r.input))) for r in found.recordings}
    rpm = [(largest[t.name], 30.0 / np.pi * e) for t, e in errors]
    return {"RMSE, rpm": _rms([e for _, e in rpm]), "below 30 % PWM": _rms([e for d, e in rpm if d < 30.0])}


def _radians(found: Diagnosis, errors: Errors) -> Figures:
    return {
        "MAE, mrad": 1e3 * _mean([e for _, e in errors]),
        "RMSE, mrad": 1e3 * _rms([e for _, e in errors]),
    }


def _emps_numbers(model: Model | Point) -> Figures:
    """Mass and forces from accelerations, by the published drive gain of 35.1507 N/V."""
    mass = 35.1507 / model.values["input_gain"]
    forces = {"Fv, N s/m": "viscous_friction", "Fc, N": "coulomb_friction", "offset, N": "offset"}
    return {"M, kg": mass} | {k: mass * model.values[n] for k, n in forces.items() if n in model.values}


def _gap(model: Model) -> Figures:
    """The gap with its standard error, as an angle."""
    return {
        "gap, deg": np.degrees(model.values["backlash_gap"]),
        "standard error, deg": np.degrees(model.std("backlash_gap")),
    }


def _nothing(model: Model | Point) -> Figures:
    return {}


@dataclass(frozen=True)
class Set:
    """One data set: its manifest, the first model, the metric, and what is known of it."""

    rows: Callable[[Path], Sequence[manifests.Row]]
    rig: str
    fewer: tuple[str, ...]
    metric: Callable[[Diagnosis, Errors], Figures]
    expected: str
    readme: str
    quick: Callable[[Sequence[manifests.Row]], list[manifests.Row]]
    more: tuple[str, ...] = ()
    numbers: Callable[[Any], Figures] = _nothing


def _every(step: int) -> Callable[[Sequence[manifests.Row]], list[manifests.Row]]:
    """Of either role, every so manieth recording."""

    def chosen(rows: Sequence[manifests.Row]) -> list[manifests.Row]:
        roles = [[r for r in rows if r["role"] == role] for role in ("train", "holdout")]
        return [r for same in roles for r in same[::step]]

    return chosen


SETS: Mapping[str, Set] = {
    "emps": Set(
        lambda data: manifests.emps(data / "emps"),
        "emps", ("backlash", "dead_band"), _emps,
        "Coulomb friction, drive offset",
        "7.1 mm linear with offset, 6.1 + Coulomb, 4.8 + asymmetric viscous; published honest best 5.17",
        lambda rows: [{**r, "start": 0.0, "end": 8.0} for r in rows],
        numbers=_emps_numbers,
    ),
    "jga25": Set(
        lambda data: manifests.jga25(data / "jga25_pwm_steps"),
        "jga25", ("backlash",), _jga25,
        "saturation, asymmetry, delay or lag",
        "92.7 (131.5) rpm linear, 42.4 (33.4) + dead-band, 40.9 (32.7) + asymmetry, 38.4 (30.7) + saturation",
        _every(12),
    ),
    "sts3215": Set(
        lambda data: manifests.sts3215(data / "sts3215_pendulum", brutal=False),
        "sts3215", ("backlash",), _radians,
        "load-dependent friction; runs end where the drive is switched off",
        "MAE 82.3 mrad linear, 61.9 + Coulomb, 42.6 + load-dependent, 35.9 + Stribeck; RMSE 145, 119, 58.5, 51.7",
        _every(7),
    ),
    "brutal": Set(
        lambda data: manifests.sts3215(data / "sts3215_pendulum", brutal=True),
        "sts3215", (), _radians,
        "the size of the gap",
        "not given",
        _every(4),
        numbers=_gap,
    ),
    "ak80": Set(
        lambda data: manifests.ak80(data / "ak80_pendulum"),
        "ak80", ("backlash",), _radians,
        "Coulomb friction, offset, load-dependent friction",
        "RMSE (MAE) 498 (258) mrad linear, 249 (116) + Coulomb, offset, torque gain, 88 (45) + load-dependent",
        lambda rows: list(rows),
    ),
}  # fmt: skip


def _shown(figures: Figures) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in figures.items())


def recordings_of(name: str, data: Path, quick: bool) -> tuple[list[recording.Recording], recording.Rig]:
    """The recordings of one set, or a small part of them, and their rig."""
    chosen = SETS[name]
    with tempfile.TemporaryDirectory() as folder:
        manifest = Path(folder) / f"{name}.csv"
        rows = chosen.rows(data)
        manifests.write(manifest, chosen.quick(rows) if quick else rows)
        return recording.load([manifest], RIGS / f"{chosen.rig}.toml")


def report(name: str, data: Path, quick: bool) -> str:
    """Diagnose one set and say what came of it."""
    chosen = SETS[name]
    began = time.perf_counter()
    recordings, rig = recordings_of(name, data, quick)
    first = pipeline.first_structure(rig, chosen.more, chosen.fewer)
    found = extend.diagnose(recordings, first)
    lines = [
        f"{name}: {len(recordings)} recordings{' (a part of the set)' if quick else ''}; {recordings[0]}",
        f"  first model    {first}",
        f"  verdict        {found.verdict}",
        *(f"  effect         {f.id} ({100.0 * f.probability:.0f} %): {f.says}" for f in found.findings),
        *(f"  undecided      {one} or {two}: {what}" for one, two, what in found.undecided),
        *(f"  remark         {said}" for said in found.remarks),
        f"  expected       {chosen.expected}",
        *(f"  numbers        {text}" for text in [_shown(chosen.numbers(found.after))] if text),
        f"  model          {found.after}",
        f"  hold-out       before: {_shown(chosen.metric(found, _errors(found, 'before')))}",
        f"                 after:  {_shown(chosen.metric(found, _errors(found, 'after')))}",
        f"  README         {chosen.readme}",
        f"  time           {time.perf_counter() - began:.0f} s ("
        + ", ".join(f"{stage} {s:.0f}" for stage, s in found.seconds.items()) + ")",
    ]  # fmt: skip
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="folder that holds emps, jga25_pwm_steps, ...")
    parser.add_argument("--set", choices=SETS, action="append", help="this set only; may be given more than once")
    parser.add_argument("--quick", action="store_true", help="a small part of each set")
    given = parser.parse_args(arguments)
    for name in given.set or SETS:
        print(report(name, given.data.resolve(), given.quick), "\n", flush=True)


if __name__ == "__main__":
    main()
