"""What a diagnosis says: findings, how well each model fits, and what to record next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import adequacy, change
from twin.diagnosis.adequacy import Adequacy
from twin.diagnosis.change import Change
from twin.diagnosis.localization import Regime, Segment
from twin.diagnosis.residual_torque import MissingTorque, TorqueShape
from twin.display.numbers import measure, number, percent
from twin.display.table import DisplayTable, Tabular
from twin.io.recording import Recording, faults_of, preflight_of
from twin.model.fitted_model import Model

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A parameter's value, its standard error (NaN where held) and unit."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Finding:
    """An effect that was left out."""

    id: str
    station: str
    probability: float
    says: str
    equation: str  # LaTeX
    parameters: Mapping[str, Estimate]


@dataclass(frozen=True)
class Fitness:
    """Free run from the initial state only: RMSE in the output's unit, the same in percent of the recorded range,
    and the p-value of the whiteness of the one-step innovations. NaN where there was nothing to compare."""

    rmse: float
    nrmse_percent: float
    whiteness_p: float


@dataclass(frozen=True, eq=False)
class Trace:
    """One recording, or part of one, beside two free runs. Arrays have shape (N,).

    `name` is that of the whole recording.
    """

    name: str
    role: str  # train | holdout
    time: FloatArray
    recorded: FloatArray  # NaN where a reading is left out
    before: FloatArray
    after: FloatArray


@dataclass(frozen=True)
class Experiment:
    """What to record next: why, and the input that would tell (time in s and input (N,)), or nothing.

    `about` is the parameter that it fixes, or the effects that it tells apart.
    """

    why: str = ""
    time: FloatArray = field(default_factory=lambda: np.zeros(0))
    input: FloatArray = field(default_factory=lambda: np.zeros(0))
    about: tuple[str, ...] = ()


@dataclass(frozen=True)
class Undecided:
    """Two effects that this recording cannot tell apart: the one in the model, the one that could stand in its place.

    `probabilities` are what each is given, `experiment` what would decide.
    """

    ids: tuple[str, str]
    probabilities: tuple[float, float]
    experiment: str


@dataclass(frozen=True)
class NotBorneOut:
    """A name that was tried and that its own figures contradict: why, and the figure that it failed by."""

    id: str
    reason: str
    figure: float


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Tabular):
    """The answer of `twin diagnose`.

    `verdict` is explained, nothing_missing, partly_explained, unexplained or inconclusive. It is stopped where the
    search was ended early (`twin.diagnosis.unfinished`). `ranking` pairs effect ids with probabilities, the likeliest
    first. `fit` is keyed by "train" and "holdout", then "before" and "after". `undecided` are pairs that this recording
    cannot tell apart, with the experiment that would.
    """

    verdict: str
    findings: tuple[Finding, ...]
    ranking: tuple[tuple[str, float], ...]
    station: str
    depends_on: tuple[str, ...]
    telling: str  # name of the training recording in which the first model lacks most
    segments: tuple[Segment, ...]  # of it, in which the first model lacks most
    before: Model  # its best free run
    after: Model
    fit: Mapping[str, Mapping[str, Fitness]]
    traces: tuple[Trace, ...]
    missing_before: MissingTorque  # in it
    missing_after: MissingTorque
    shapes_before: tuple[TorqueShape, ...]
    shapes_after: tuple[TorqueShape, ...]
    recordings: tuple[Recording, ...]
    experiment: Experiment = field(default_factory=Experiment)
    undecided: tuple[Undecided, ...] = ()
    remarks: tuple[str, ...] = ()  # sentences: criteria that disagree, what the recording cannot fix
    seconds: Mapping[str, float] = field(default_factory=dict)  # per stage
    changes: tuple[Change, ...] = ()  # from a model that was given to what this recording asks for
    given_fit: Mapping[str, Fitness] = field(default_factory=dict)  # of that model as it is, by recording
    since: tuple[str, ...] = ()  # sentences on that model: how it runs as it is, and what changed since it was made
    not_borne_out: tuple[NotBorneOut, ...] = ()  # names that were tried and failed
    adequacy: Adequacy = field(default_factory=Adequacy)
    regimes: tuple[Regime, ...] = ()  # values of a variable at which the first model lacks most
    gain_bias: float = 0.0  # of the first model's input gain because of what it lacks, relative

    @property
    def model(self) -> Model:
        """The first model with what was found."""
        return self.after

    def table(self) -> DisplayTable:
        """The effects that were left out, and how well the models run freely before and after."""
        rows = []
        for f in self.findings:
            values = [f"{n} = {measure(e.value, e.std, e.unit)}" for n, e in f.parameters.items()]
            rows.append((f.id, f.station, percent(f.probability), ", ".join(values)))
        notes = []
        for role, runs in self.fit.items():
            errors = [f"{number(runs[w].nrmse_percent)} %" for w in ("before", "after") if w in runs]
            notes.append(f"free run, {role}: {' before, '.join(errors)} after, of the recorded range")
        columns = ("effect", "station", "probability", "parameters")
        said = [*self.since, *notes, *self.remarks]
        return DisplayTable(f"diagnosis: {self.verdict.replace('_', ' ')}", columns, rows, said)


def _fitness(fitness: Fitness) -> dict[str, Any]:
    values = {"rmse": fitness.rmse, "nrmse_percent": fitness.nrmse_percent, "whiteness_p": fitness.whiteness_p}
    return {k: v for k, v in values.items() if np.isfinite(v)}


def to_json(diagnosis: Diagnosis, experiment_file: str = "") -> dict[str, Any]:
    """The diagnosis as the contract's JSON."""
    d = diagnosis
    return {
        "format": "twin-diagnosis/1",
        "verdict": d.verdict,
        "effects": [
            {
                "id": f.id,
                "station": f.station,
                "probability": f.probability,
                "says": f.says,
                "equation": f.equation,
                "parameters": {
                    n: {"value": e.value, "std": e.std if np.isfinite(e.std) else None, "unit": e.unit}
                    for n, e in f.parameters.items()
                },
            }
            for f in d.findings
        ],
        "ranking": [{"id": i, "probability": p} for i, p in d.ranking],
        "mismatch": {
            "station": d.station,
            "depends_on": list(d.depends_on),
            "recording": d.telling,
            "segments": [{"start": s.start, "end": s.end, "share": s.share} for s in d.segments],
            "regimes": [
                {"variable": r.variable, "from": r.low, "to": r.high, "period": r.period or None} for r in d.regimes
            ],
            "gain_bias": d.gain_bias,
        },
        "fit": {role: {when: _fitness(f) for when, f in both.items()} for role, both in d.fit.items()},
        "preflight": preflight_of(d.recordings),
        "recording_faults": faults_of(d.recordings),
        "next_experiment": {"why": d.experiment.why, "file": experiment_file},
        "undecided": [
            {"ids": list(u.ids), "probabilities": list(u.probabilities), "experiment": u.experiment}
            for u in d.undecided
        ],
        "not_borne_out": [{"id": n.id, "reason": n.reason, "figure": n.figure} for n in d.not_borne_out],
        "remarks": [*d.since, *d.remarks],
        "changes": change.to_json(d.changes),
        "given_model": {name: _fitness(f) for name, f in d.given_fit.items()},
        "seconds": dict(d.seconds),
        "adequacy": adequacy.to_json(d.adequacy),
    }


def experiment_csv(experiment: Experiment, input_name: str) -> str:
    """What to feed the rig next, as CSV; empty where there is nothing to try."""
    if experiment.time.size == 0:
        return ""
    rows = zip(experiment.time, experiment.input, strict=True)
    return f"time,{input_name}\n" + "".join(f"{t:.6g},{u:.6g}\n" for t, u in rows)
