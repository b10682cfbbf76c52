"""What the tool says about real data sets when it starts from a plain model.

    python scripts/real_recordings.py DATA_DIR [--set NAME] [--quick] [--markdown]

For each set it prints the verdict, the effects with their numbers, and the error of a free run over held-out
recordings before and after. The metric is that of the README beside the set, whose own figures stand there, too. Free
runs go through the exported FMU in FMPy. Then comes the same structure with the values that predict best over a whole
recording (`twin identify --horizon`). Where the set has a rig's own loop, it is also run under that. Last comes the
floor: a calculation of what no model could do better.

`--quick` takes a small part of each set and says so; `--markdown` prints one table.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import manifests
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from twin.diagnosis import diagnose, holdout
from twin.diagnosis.result import Diagnosis
from twin.estimation import estimate, horizon
from twin.estimation.fit import Fit
from twin.io import recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.report import wording

FloatArray = NDArray[np.float64]
Figures = dict[str, float]
Recordings = Sequence[recording.Recording]
RIGS = Path(__file__).resolve().parents[1] / "models" / "rigs"
Errors = list[tuple[str, FloatArray]]


def _errors(found: Diagnosis, which: str) -> Errors:
    """Of every held-out recording: simulation less recording, NaN where nothing was read."""
    held_out = [t for t in found.traces if t.role == "holdout"]
    return [(t.name, getattr(t, which) - t.recorded) for t in held_out]


def _run(model: Model, recordings: Sequence[recording.Recording], closed: bool = False) -> Errors:
    """The same for a model of its own, by the kernel (which the FMU equals), from the recorded start."""
    return [(r.name, holdout.simulate_recording(model, r, closed) - r.output) for r in recordings]


def _rms(errors: Sequence[FloatArray]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2))) if errors else float("nan")


def _mean(errors: Sequence[FloatArray]) -> float:
    return float(np.nanmean(np.abs(np.concatenate(errors)))) if errors else float("nan")


def _emps(recordings: Recordings, errors: Errors) -> Figures:
    return {"position RMSE, mm": 1e3 * _rms([e[20:] for _, e in errors])}


def _jga25(recordings: Recordings, errors: Errors) -> Figures:
    largest = {r.name: float(np.max(np.abs(r.input))) for r in recordings}
    rpm = [(largest[name], 30.0 / np.pi * e) for name, e in errors]
    return {"RMSE, rpm": _rms([e for _, e in rpm]), "below 30 % PWM": _rms([e for d, e in rpm if d < 30.0])}


def _radians(recordings: Recordings, errors: Errors) -> Figures:
    return {
        "MAE, mrad": 1e3 * _mean([e for _, e in errors]),
        "RMSE, mrad": 1e3 * _rms([e for _, e in errors]),
    }


def _speeds(recordings: Recordings, errors: Errors) -> Figures:
    return {"RMSE, rad/s": _rms([e for _, e in errors])}


def _kv(model: Model | Fit) -> Figures:
    return {"kV = b/c, V/(rad/s)": model.values["viscous_friction"] / model.values["input_gain"]}


def _emps_numbers(model: Model | Fit) -> Figures:
    """Mass and forces from accelerations, by the published drive gain of 35.1507 N/V."""
    mass = 35.1507 / model.values["input_gain"]
    forces = {"Fv, N s/m": "viscous_friction", "Fc, N": "coulomb_friction", "offset, N": "offset"}
    return {"M, kg": mass} | {k: mass * model.values[n] for k, n in forces.items() if n in model.values}


def _emps_floor(recordings: Recordings, model: Model) -> str:
    """What a model errs on the held-out record that is exact on the training record.

    Both records follow one reference to within a tenth of a millimetre. The voltage that the later one took beyond the
    earlier is friction that has changed: no fit to the earlier can know it, and a free run integrates it.
    """
    train, held_out = (next(r for r in recordings if r.role == role) for role in ("train", "holdout"))
    b, step = model.values["viscous_friction"], model.sample_time
    more = model.values["input_gain"] * (held_out.input - train.input)
    decay = np.exp(-b * step)
    speed = lfilter([(1.0 - decay) / b], [1.0, -decay], np.concatenate([[0.0], more[:-1]]))
    apart = step * np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    floor = _rms([(apart + train.output - held_out.output)[20:]])
    moved = np.sign(np.gradient(train.output))
    share = float(np.mean(held_out.input * moved) / np.mean(train.input * moved)) - 1.0
    own = horizon.for_horizon(model, [replace(held_out, role="train")], float(held_out.time[-1]))
    return (
        f"{1e3 * floor:.2g} mm for a model exact on the training record, because the same motion took "
        f"{100.0 * share:.1f} % more voltage in the other; "
        f"{1e3 * _rms([e[20:] for _, e in _run(own, [held_out])]):.2g} mm for this structure fitted to the held-out "
        f"record itself; {1e3 * held_out.resolution / np.sqrt(12.0):.1g} mm by the sensor"
    )


def _jga25_floor(recordings: Recordings, model: Model) -> str:
    """How far the readings scatter about their own mean once the speed is steady: a model gives one speed there."""
    held_out = [r for r in recordings if r.role == "holdout"]
    steady = [r.output[r.time > r.time[-1] - 0.6] for r in held_out]
    driven = [float(np.max(np.abs(r.input))) for r in held_out]
    scatter = [30.0 / np.pi * (y - np.nanmean(y)) for y in steady]
    slow = [y for y, d in zip(scatter, driven, strict=True) if d < 30.0]
    count = 30.0 / np.pi * held_out[0].resolution
    return (
        f"RMSE {_rms(scatter):.3g} rpm, below 30 % PWM {_rms(slow):.3g}: the scatter of the steady readings about "
        f"their own mean in each run; rounding to {count:.3g} rpm alone makes {count / np.sqrt(12.0):.3g}"
    )


def _no_floor(recordings: Recordings, model: Model) -> str:
    return ""


def _gap(model: Model) -> Figures:
    """The gap with its standard error, as an angle."""
    return {
        "gap, deg": np.degrees(model.values["backlash_gap"]),
        "standard error, deg": np.degrees(model.std("backlash_gap")),
    }


def _nothing(model: Model | Fit) -> Figures:
    return {}


@dataclass(frozen=True)
class Set:
    """One data set: its manifest, the first model, the metric, and what is known of it."""

    rows: Callable[[Path], Sequence[manifests.Row]]
    rig: str
    fewer: tuple[str, ...]
    metric: Callable[[Recordings, Errors], Figures]
    expected: str
    readme: str
    quick: Callable[[Sequence[manifests.Row]], list[manifests.Row]]
    more: tuple[str, ...] = ()
    numbers: Callable[[Any], Figures] = _nothing
    floor: Callable[[Recordings, Model], str] = _no_floor
    role: Callable[[recording.Recording], str] = lambda one: one.role
    closed: str = ""  # published figures from the reference under the rig's own loop; empty: not looked at


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
        numbers=_emps_numbers, floor=_emps_floor,
    ),
    "jga25": Set(
        lambda data: manifests.jga25(data / "jga25_pwm_steps"),
        "jga25", ("backlash",), _jga25,
        "saturation, asymmetry, delay or lag",
        "92.7 (131.5) rpm linear, 42.4 (33.4) + dead-band, 40.9 (32.7) + asymmetry, 38.4 (30.7) + saturation",
        _every(12),
        floor=_jga25_floor,
    ),
    "sts3215": Set(
        lambda data: manifests.sts3215(data / "sts3215_pendulum", brutal=False),
        "sts3215", ("backlash",), _radians,
        "load-dependent friction; runs end where the drive is switched off",
        "MAE 82.3 mrad linear, 61.9 + Coulomb, 42.6 + load-dependent, 35.9 + Stribeck; RMSE 145, 119, 58.5, 51.7",
        _every(7),
        closed="MAE 42.7 mrad linear, 29.0 + Coulomb, 26.5 + load-dependent; published, fitted and scored on the same "
        "logs: M1 24.8, M4 23.9, M6 23.7",
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
    "frc_roller": Set(
        lambda data: [{"file": data / "frc_roller" / "spu_data.json", "role": "train"}],
        "frc_roller", (), _radians,
        "a sensor that is read every 20 ms; dry friction or dead-band",
        "RMSE 447 mrad (dry friction), 460 (two dead-bands), 975 with the published values; published kV 0.17836",
        lambda rows: list(rows),
        numbers=_kv,
        role=lambda one: "holdout" if one.name.endswith("fast-backward") else "train",
    ),
    "ev3": Set(
        lambda data: [
            {"file": file, "role": "holdout" if file.stem in ("data60", "data-80") else "train"}
            for file in sorted((data / "ev3_motor").glob("data*.csv"))
        ],
        "ev3", ("backlash",), _radians,
        "data20 is faulty: its position stands still; nothing is missing in the rest, or dry friction",
        "RMSE 117 mrad with dead-band, all files; without data20 81.3, dry friction 79.7",
        lambda rows: list(rows),
    ),
    "n20": Set(
        lambda data: [
            {"file": data / "n20_aprbs" / "aprbsResult.mat", "role": role, "start": start, "end": end}
            for role, start, end in (("train", 0.0, 67.2), ("holdout", 67.2, 96.0))
        ],
        "n20", ("backlash",), _speeds,
        "a dead-band, or dry friction",
        "RMSE 23.7 rad/s linear, 21.9 + dead-band, 21.9 output-error; rounding alone 6.5",
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
        recordings, rig = recording.load([manifest], RIGS / f"{chosen.rig}.toml")
    return [replace(r, role=chosen.role(r)) for r in recordings], rig


@dataclass(frozen=True)
class Outcome:
    """What came of one set."""

    name: str
    found: Diagnosis
    first: Structure
    figures: Mapping[str, Figures]  # on held-out recordings, by what was simulated
    floor: str
    seconds: float


def outcome(name: str, data: Path, quick: bool) -> Outcome:
    """Diagnose one set, then fit the structure found for whole recordings."""
    chosen = SETS[name]
    began = time.perf_counter()
    recordings, _ = recordings_of(name, data, quick)
    first = estimate.first_structure(recordings, chosen.more, chosen.fewer)
    found = diagnose.diagnose(recordings, first)
    held_out = [r for r in recordings if r.role == "holdout"]
    whole = max(float(r.time[-1]) for r in recordings)
    errors = {when: _errors(found, when) for when in ("before", "after")}
    errors["for whole runs"] = _run(horizon.for_horizon(found.after, recordings, whole), held_out)
    if chosen.closed:
        looped = horizon.for_horizon(found.after, recordings, whole, closed=True)
        errors["own loop, after"] = _run(found.after, held_out, closed=True)
        errors["own loop, for whole runs"] = _run(looped, held_out, closed=True)
    figures = {when: chosen.metric(recordings, e) for when, e in errors.items()}
    floor = chosen.floor(recordings, found.after)
    return Outcome(name, found, first, figures, floor, time.perf_counter() - began)


def report(name: str, data: Path, quick: bool) -> str:
    """Diagnose one set and say what came of it."""
    chosen, came = SETS[name], outcome(name, data, quick)
    found = came.found
    recordings = found.recordings
    lines = [
        f"{name}: {len(recordings)} recordings{' (a part of the set)' if quick else ''}; {recordings[0]}",
        f"  first model    {came.first}",
        f"  verdict        {found.verdict}",
        *(f"  effect         {f.id} ({100.0 * f.probability:.0f} %): {f.says}" for f in found.findings),
        *(f"  undecided      {wording.doubt(u)}" for u in found.undecided),
        *(f"  remark         {said}" for said in found.remarks),
        f"  expected       {chosen.expected}",
        *(f"  numbers        {text}" for text in [_shown(chosen.numbers(found.after))] if text),
        f"  model          {found.after}",
        *(f"  hold-out       {when}: {_shown(figures)}" for when, figures in came.figures.items()),
        f"  README         {chosen.readme}",
        *(f"  own loop       {text}" for text in [chosen.closed] if text),
        *(f"  floor          {text}" for text in [came.floor] if text),
        f"  time           {came.seconds:.0f} s ("
        + ", ".join(f"{stage} {s:.0f}" for stage, s in found.seconds.items()) + ")",
    ]  # fmt: skip
    return "\n".join(lines)


def row(came: Outcome) -> str:
    """One line of the table in markdown."""
    chosen, found = SETS[came.name], came.found
    named = "; ".join(f.says for f in found.findings) or "nothing"
    cells = [came.name, f"{found.verdict}: {named}", *(_shown(came.figures[w]) for w in ("before", "after"))]
    cells.append("<br>".join(f"{w}: {_shown(f)}" for w, f in came.figures.items() if w not in ("before", "after")))
    known = [chosen.readme, *(f"own loop: {text}" for text in [chosen.closed] if text)]
    known += [f"floor: {text}" for text in [came.floor] if text]
    return "| " + " | ".join([*cells, "<br>".join(known)]) + " |"


TABLE = (
    "| set | what twin says, from a plain model | hold-out before | after | values for whole runs | known figures |",
    "|---|---|---|---|---|---|",
)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="folder that holds emps, jga25_pwm_steps, ...")
    parser.add_argument("--set", choices=SETS, action="append", help="this set only; may be given more than once")
    parser.add_argument("--quick", action="store_true", help="a small part of each set")
    parser.add_argument("--markdown", action="store_true", help="one table in markdown")
    given = parser.parse_args(arguments)
    if given.markdown:
        print(*TABLE, sep="\n", flush=True)
        for name in given.set or SETS:
            print(row(outcome(name, given.data.resolve(), given.quick)), flush=True)
        return
    for name in given.set or SETS:
        print(report(name, given.data.resolve(), given.quick), "\n", flush=True)


if __name__ == "__main__":
    main()
