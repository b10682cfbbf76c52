"""What is held out: what may be fitted, what held-out data alone show, and free runs through it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from axis_runs import run, steps

from twin.diagnosis import data_split, diagnose, holdout, nonparametric, residual_torque
from twin.effects.catalogue import BASE
from twin.errors import BadInput
from twin.estimation import maximum_likelihood, optimizer, preparation
from twin.estimation.fit import Fit
from twin.estimation.problem import FitProblem
from twin.fmi import python_fmu
from twin.io.recording import Recording, load
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

STRUCTURE = Structure.of(("inertia", "viscous_friction", "dead_band"))
VALUES = {"input_gain": 0.4, "viscous_friction": 2.0, "dead_band_forward": 5.0, "dead_band_reverse": 4.0}
COUNT = 2.0 * np.pi / 16384


def made(supply: float = 0.0, load: float = 0.0) -> Recording:
    """Half a minute, with a logged supply that goes up and down by this share; the load grows by one just before what
    will be held out.
    """
    time = 0.002 * np.arange(15000)
    duty = steps(np.random.default_rng(3), len(time), 300, 40.0)
    volts = 12.0 * (1.0 + supply * np.sin(0.7 * time))
    values = VALUES | {"load_added": load, "load_time": 20.9}
    y, _ = run(STRUCTURE.with_("load_change"), values, time, duty * volts / float(np.median(volts)))
    more = {"supply": volts} if supply else {}
    return Recording("made", time, duty, np.round(y / COUNT) * COUNT, "%", "rad", COUNT, optional=more)


def fitted(
    recording: Recording,
) -> tuple[FitProblem, Fit, list[data_split.RecordingPart]]:
    train, held_out = data_split.split([recording])
    problem = preparation.prepare_recordings(train, STRUCTURE)
    return problem, optimizer.fit_with_process_noise(problem, STRUCTURE, VALUES, tuple(VALUES)), held_out


@pytest.mark.parametrize("supply", [0.0, 0.1])
def test_a_supply_that_is_logged_acts_once_in_what_is_held_out(supply: float) -> None:
    assert holdout.physics_only_in_holdout(*fitted(made(supply))) == []


def test_a_supply_that_nobody_told_of_is_seen_there() -> None:
    """The same truth, so that the test above can fail: what is held out goes by another supply than what was fitted."""
    recording = made(0.1)
    problem, point, held_out = fitted(recording)
    volts = np.where(recording.time > held_out[0].begin, 0.5, 1.0) * recording.optional["supply"]
    (part,) = [replace(p, recording=replace(recording, optional={"supply": volts})) for p in held_out]
    assert len(holdout.physics_only_in_holdout(problem, point, [part])) == 1


def test_a_load_that_grew_a_little_just_before_is_seen_there() -> None:
    (says,) = holdout.physics_only_in_holdout(*fitted(made(load=0.015)))
    assert "goes with acceleration" in says


@pytest.mark.parametrize(("ends_slow", "size", "seen"), [(1, 0.12, 1), (1, 0.06, 0), (0, 0.2, 1), (0, 0.12, 0)])
def test_what_goes_with_the_acceleration_is_less_where_that_is(ends_slow: int, size: float, seen: int) -> None:
    """A motion that ends slow makes less of a load that changed late than its quick beginning of what a fit had left;
    one that ends quick makes more of what a fit had left, too.
    """
    time = 0.002 * np.arange(15000)
    height = np.linspace(20.0, 60.0, len(time))[:: -1 if ends_slow else 1]
    acceleration, nothing = height * np.sin(2.0 * np.pi * 1.5 * time), np.zeros(len(time))
    whole = residual_torque.MissingTorque(time, nothing, nothing, nothing, acceleration, nothing, 0.002)
    early, late = whole.between(0.0, 21.0), whole.between(21.0, 30.0)

    def goes_with(variable: str, size: float) -> nonparametric.RemainingDependence:
        return nonparametric.RemainingDependence(0.5, 0.0, (variable,), variable, size, 0.1, ())

    least = holdout._least_size(late, goes_with("acceleration", size), [(early, goes_with("velocity", 0.06))])
    assert (size > least) == seen


def test_where_every_recording_is_held_out_there_is_nothing_to_fit() -> None:
    recording = replace(made(), role="holdout")
    for fit in (
        data_split.split,
        lambda r: maximum_likelihood.identify(r, STRUCTURE),
        lambda r: diagnose.diagnose(r, STRUCTURE),
    ):
        with pytest.raises(BadInput, match="at least one to fit"):
            fit([recording])


def test_a_held_out_part_in_which_nothing_was_read_is_run_all_the_same() -> None:
    recording = made()
    blind = replace(recording, output=np.where(recording.time > 20.0, np.nan, recording.output))
    problem, point, held_out = fitted(blind)
    model: Model = maximum_likelihood.to_model(problem, point, [recording])
    (shown,) = holdout.traces(model, model, [("holdout", held_out[0])])
    assert np.isnan(shown.recorded).all() and np.isfinite(shown.after).all()


@pytest.mark.parametrize("speed", [False, True])
def test_an_unknown_loop_is_refused(speed: bool) -> None:
    recording = made()
    recording = replace(recording, output_unit="rad/s") if speed else recording
    with pytest.raises(BadInput, match="loop"):
        diagnose.diagnose([recording], Structure.of(BASE), closed=True)


def on_battery(volts: float, folder: Path, seed: int) -> Path:
    """A recording of the same axis on a battery that has run down to so much."""
    time = 0.002 * np.arange(6000)
    duty = steps(np.random.default_rng(seed), len(time), 300, 40.0)
    supply = volts * (1.0 - 0.02 * time / time[-1])
    y, _ = run(STRUCTURE, VALUES, time, duty * supply / 12.0)
    rows = zip(time.tolist(), duty.tolist(), supply.tolist(), y.tolist(), strict=True)
    path = folder / f"at_{volts:g}.csv"
    path.write_text("t,duty,volts,q\n" + "".join(f"{t:.4f},{u:g},{v:.6f},{x:.8f}\n" for t, u, v, x in rows))
    return path


def test_a_battery_that_runs_down_is_no_other_axis(tmp_path: Path) -> None:
    """Neither of two recordings nor of a model and what is recorded next week."""
    (tmp_path / "rig.toml").write_text(
        '[time]\ncolumn = "t"\n[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "q"\nunit = "rad"\n'
        '[optional.supply]\ncolumn = "volts"\nunit = "V"\n[known]\nsupply_nominal = 12.0\n'
    )
    full, low = (on_battery(v, tmp_path, i) for i, v in enumerate((12.6, 10.8)))
    both, _ = load([full, low])
    problem = preparation.prepare_recordings(both, STRUCTURE)
    point = optimizer.fit_with_process_noise(problem, STRUCTURE, VALUES, tuple(VALUES))
    assert point.values["input_gain"] == pytest.approx(VALUES["input_gain"], rel=1e-3)
    model = maximum_likelihood.to_model(problem, point, both)
    fmu = python_fmu.export(model, tmp_path / "axis.fmu")
    # The rig file of next week says nothing of the supply that the model goes by.
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text(rig_file.read_text().split("[known]")[0])
    for path in (full, low):
        (later,), _ = load([path])
        assert python_fmu.replay(fmu, later).nrmse_percent(later) < 0.1
    # Nobody said what is nominal: what is usual among all of them.
    unsaid, _ = load([full, low])
    assert [r.known["supply_nominal"] for r in unsaid] == 2 * [pytest.approx(0.99 * 11.7, rel=1e-3)]
