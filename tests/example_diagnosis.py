"""A diagnosis made by hand, in no time: an axis with gravity beside a first model without it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from twin.codegen import latex
from twin.control.cosimulation import ModelPlant
from twin.diagnosis import residual_torque
from twin.diagnosis.adequacy import Adequacy, Comparison, FreeRun, TorqueFigures
from twin.diagnosis.change import Change
from twin.diagnosis.coverage import Beyond
from twin.diagnosis.localization import Segment
from twin.diagnosis.residual_torque import MissingTorque
from twin.diagnosis.result import Diagnosis, Estimate, Experiment, Finding, Fitness, Trace, Undecided
from twin.io.preflight.finding import Finding as Preflight
from twin.io.preflight.finding import Severity
from twin.io.recording import Fault, Recording
from twin.io.rig_file import Clock, Column, Rig
from twin.model.fitted_model import Model
from twin.model.stepper import BASE, Structure

VALUES = {
    "input_gain": 0.4, "viscous_friction": 1.8, "dead_band_forward": 6.0, "dead_band_reverse": 5.0,
    "backlash_gap": 0.02, "gravity_gain": 3.1, "gravity_angle": 0.2, "coulomb_friction": 0.5,
}  # fmt: skip
_ASSUMED = ("column 'q' is the <position> in rad",)
RIG = Rig("guess", Clock("t"), Column("duty", "%"), Column("q", "rad"), assumed=_ASSUMED)


@cache
def model_of(*effects: str, axis_unit: str = "rad") -> Model:
    structure = Structure.of([*BASE, *effects])
    values = {p.name: VALUES.get(p.name, p.start) for p in structure.parameters}
    names = tuple(values)
    errors = {name: 0.01 * max(abs(v), 0.1) for name, v in values.items()} | {"motor_share": 0.4}
    covariance = np.diag([errors[name] ** 2 for name in names])
    return Model(
        structure, values, names, covariance, {"backlash_gap": (0.015, 0.026)},
        {"motor_share": "the recording cannot fix it; add reversals at two or more amplitudes"}, axis_unit=axis_unit,
    )  # fmt: skip


def simulated(model: Model, time: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Position (N,) from rest at zero."""
    plant, out = ModelPlant(model, 0.0), np.empty(len(time))
    for i, (t, u) in enumerate(zip(time.tolist(), command.tolist(), strict=True)):
        out[i] = plant.read()[1]
        plant.advance(t, u, 0.002)
    return out


def excitation(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    time = 0.002 * np.arange(round(seconds / 0.002))
    return time, np.where(np.sin(2.0 * np.pi * time / 1.7) > 0.0, 35.0, -30.0) * np.where(time > 0.3, 1.0, 0.0)


@cache
def recording_of(model: Model, seconds: float = 4.0, name: str = "axis.csv", role: str = "train") -> Recording:
    time, command = excitation(seconds)
    count = 2.0 * np.pi / 10000.0
    reading = count * np.round(simulated(model, time, command) / count)
    reading[700:710] = np.nan
    fault = Fault("outlier", 1.4, 1.42, "The output <jumps> to 7 at 1.400 s & comes back.")
    return Recording(name, time, command, reading, "%", model.axis_unit, count, role, faults=(fault,))


@cache
def _adequacy() -> Adequacy:
    compared = Comparison(FreeRun(0.1, 0.012, 1e-6, 0.024), FreeRun(0.01, 0.012, 0.4, 0.024), 3.1)
    return Adequacy(
        {"train": compared, "holdout": compared},
        missing_torque=TorqueFigures(2.8, 0.035, 0.03, 0.01, 0.002),
        beyond_training=(Beyond("input", (-30.0, 35.0), (-30.0, 40.0)),),
        says="The figures support the model: p = 0.40.",
    )


def example(verdict: str = "explained", several: bool = False, axis_unit: str = "rad") -> Diagnosis:
    before, truth = model_of(axis_unit=axis_unit), model_of("gravity", axis_unit=axis_unit)
    after = before if verdict in ("nothing_missing", "unexplained") else truth
    names = [("a.csv", "train"), ("b.csv", "holdout")] if several else [("axis.csv", "train")]
    warned = (Preflight("duty_scale", "the command never exceeds 40 %", Severity.WARNS),)
    recordings = tuple(replace(recording_of(truth, name=n, role=r), preflight=warned) for n, r in names)
    traces = []
    for r in recordings:
        runs = [simulated(m, r.time, r.input) for m in (before, after)]
        cut = len(r.time) if several else 1400
        traces.append(Trace(r.name, r.role, r.time[:cut], r.output[:cut], *(v[:cut] for v in runs)))
        if not several:
            traces.append(Trace(r.name, "holdout", r.time[cut:], r.output[cut:], *(v[cut:] for v in runs)))
    first = recordings[0]
    position = np.nan_to_num(first.output)
    velocity = np.gradient(position, first.time)
    torque = -3.1 * np.sin(position - 0.2)
    noise = 0.05 * np.sin(1e3 * first.time)
    missing = MissingTorque(
        first.time, torque + noise, position, velocity, np.gradient(velocity, first.time), first.input, 0.002
    )
    found = (
        Finding(
            "gravity", "load", 0.62, "Gravity pulls the link towards 0.2 rad: the axis is not vertical.",
            latex.equation("gravity", axis_unit),
            {"gravity_gain": Estimate(3.1, 0.02, "rad/s^2"), "gravity_angle": Estimate(0.2, 0.001, "rad")},
        ),
    )  # fmt: skip
    lacking = replace(missing, torque=noise) if after is truth else missing
    fits = {"before": Fitness(0.1, 3.2, 0.0), "after": Fitness(0.01, 0.3, 0.4)}
    return Diagnosis(
        verdict=verdict,
        findings=found if after is truth else (),
        ranking=(("gravity", 0.62), ("spring", 0.37)),
        station="load",
        depends_on=("position",),
        telling=first.name,
        segments=(Segment(1.0, 1.5, 0.21), Segment(2.5, 3.5, 0.34)),
        before=before,
        after=after,
        fit={"train": fits, "holdout": fits},
        traces=tuple(traces),
        missing_before=missing,
        missing_after=lacking,
        shapes_before=tuple(residual_torque.torque_shapes(missing)),
        shapes_after=tuple(residual_torque.torque_shapes(lacking)),
        recordings=recordings,
        experiment=Experiment("Travel over more than half a turn.", *excitation(2.0)),
        undecided=(Undecided(("gravity", "spring"), (0.62, 0.37), "travel over more than half a turn"),),
        remarks=("The likelihood & the free run <disagree>.",),
        changes=(Change("viscous_friction", 1.2, 1.8, (1.7, 1.9), "1/s", "the viscous friction grew"),),
        adequacy=_adequacy(),
        seconds={"search": 12.3, "locate": 0.1},
    )
