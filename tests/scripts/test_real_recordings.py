"""What the tool says about parts of the real data sets, and the arithmetic of the table's metrics."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import manifests
import real_recordings

from twin.diagnosis import diagnose, forward_selection, screening
from twin.diagnosis.plausibility import is_plausible
from twin.diagnosis.search_result import SearchResult
from twin.effects.catalogue import CANDIDATES
from twin.estimation import estimate, filter_memory, likelihood, optimizer, preparation, prepared_recording
from twin.estimation.problem import FitProblem
from twin.io import recording
from twin.io.recording import Loop, Recording
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.simulation import kernel

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
real = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not here")


BARE = Structure.of(["inertia", "viscous_friction"])


def made(
    unit: str, count: int, duration: float = 10.0, swing: float = 0.3
) -> list[prepared_recording.PreparedRecording]:
    """Cases of a slow oscillation at 0.5 Hz."""
    time = np.arange(0.0, duration, 0.01)
    output = swing * np.sin(np.pi * time)
    one = Recording("made", time, np.cos(np.pi * time), output, "V", unit, resolution=1e-4)
    return [prepared_recording.prepare_recording(replace(one, name=f"made {k}"), BARE) for k in range(count)]


def test_only_what_such_recordings_can_show_is_offered() -> None:
    assert set(screening.testable_candidates(FitProblem(made("rad", 1, swing=5.0)), CANDIDATES, BARE)) == set(
        CANDIDATES
    )
    linear = screening.testable_candidates(FitProblem(made("m", 1)), CANDIDATES, BARE)
    assert "constant_offset" in linear and not {"gravity", "encoder_eccentricity"} & set(linear)
    several = screening.testable_candidates(FitProblem(made("rad", 2, swing=5.0)), CANDIDATES, BARE)
    assert "gravity" in several and not {"load_change", "periodic_disturbance"} & set(several)
    short = screening.testable_candidates(FitProblem(made("rad", 1, swing=0.3)), CANDIDATES, BARE)
    assert "gravity" in short and "encoder_eccentricity" not in short
    assert "position_dependent_friction" in short, "it turns with the motion over a tenth of a turn, too"
    shorter = screening.testable_candidates(FitProblem(made("rad", 1, swing=0.2)), CANDIDATES, BARE)
    assert "gravity" in shorter and "position_dependent_friction" not in shorter
    third = screening.testable_candidates(FitProblem(made("rad", 1, swing=1.0)), CANDIDATES, BARE)
    assert {"encoder_eccentricity", "position_dependent_friction"} <= set(third)
    speeds = screening.testable_candidates(FitProblem(made("rad/s", 2)), CANDIDATES, BARE)
    assert "drive_saturation" in speeds and not {"gravity", "spring", "torque_ripple"} & set(speeds)
    known = screening.testable_candidates(FitProblem(made("rad", 1)), CANDIDATES, BARE.with_("coulomb_friction"))
    assert "stribeck_friction" in known and "presliding_friction" not in known, "it would replace what the user knows"


@pytest.mark.parametrize(("frequency", "outside"), [(0.5, False), (1.0, False), (0.37, True), (2.3, True)])
def test_a_disturbance_in_the_rhythm_of_the_motion_is_not_one_from_outside(frequency: float, outside: bool) -> None:
    cases = made("rad", 1, duration=40.0)
    structure = Structure.of(["inertia", "viscous_friction", "periodic_disturbance"])
    values = {p.name: p.start for p in structure.parameters}
    values |= {"disturbance_frequency": frequency, "disturbance_phase": 0.3, "disturbance": 1.0}
    point = likelihood.evaluate(FitProblem(cases, process_noise=1.0), structure, values)
    assert is_plausible(FitProblem(cases), point) == outside


def test_held_and_rounded_readings_do_not_run_away_with_the_noise_density() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 4.0, 0.001)
    speed = 100.0 * (1.0 - np.exp(-5.0 * time)) + rng.normal(0.0, 0.5, len(time))
    seen = np.repeat(np.round(speed[::10] / 4.0) * 4.0, 10)
    one = Recording("held", time, np.full(len(time), 10.0), seen, "%", "rad/s", resolution=4.0)
    structure = Structure.of(["inertia", "viscous_friction"])
    case = prepared_recording.prepare_recording(one, structure)
    found = optimizer.most_likely_process_noise(
        FitProblem([case]), structure, {"input_gain": 50.0, "viscous_friction": 5.0}
    )
    assert found <= filter_memory.process_noise_of(case, 4.9 * case.step)


def test_one_sensor_has_one_noise_however_quick_the_motion() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    count = 1.5e-3
    runs = [np.round(swing * np.sin(20.0 * time) / count) * count for swing in (0.02, 2.0)]
    recordings = [Recording("run", time, np.cos(time), y, "%", "rad", resolution=count) for y in runs]
    structure = Structure.of(["inertia", "viscous_friction"])
    alone = [prepared_recording.prepare_recording(r, structure).reading_variance for r in recordings]
    assert alone[1] > 10.0 * alone[0]
    together = preparation.prepare_recordings(recordings, structure).recordings
    assert [c.reading_variance for c in together] == pytest.approx([count**2 / 12.0] * 2, rel=0.5)


def test_the_floor_of_a_changed_friction_is_what_an_exact_model_errs() -> None:
    structure = Structure.of(["inertia", "viscous_friction", "coulomb_friction"])
    truth = {"input_gain": 0.37, "viscous_friction": 2.1, "coulomb_friction": 0.2}
    model = Model(structure, truth, fitted=tuple(truth), covariance=1e-6 * np.eye(3), axis_unit="m", input_unit="V",
                  sample_time=0.001, reading_std=1e-7, torque_density=1e-6)  # fmt: skip
    time = 0.001 * np.arange(12000)
    loop = Loop("P-P", kp=160.0, kv=240.0)
    reference = 0.1 * np.abs(0.25 * np.maximum(time - 0.5, 0.0) % 2.0 - 1.0)

    def made(role: str, friction: float) -> Recording:
        asked = Recording("made", time, time, 0.1 + 0.0 * time, "V", "m", role=role, loop=loop,
                          optional={"reference": reference})  # fmt: skip
        case = prepared_recording.prepare_recording(asked, structure, closed=True)
        p = kernel.vector(structure, {**truth, "coulomb_friction": friction})
        run = kernel.predict(case.drive, p, kernel.start_state(0.1, 0.0, 0.0), keep_states=True)
        wish = loop.kv * (loop.kp * (reference - run.reading) - run.states[:, 1])
        return replace(asked, input=wish, output=run.reading)

    both = [made("train", 0.2), made("holdout", 0.21)]
    said = real_recordings._emps_floor(both, model)
    errors = [e[20:] for _, e in real_recordings._run(model, both[1:])]
    assert float(said.split(" mm")[0]) == pytest.approx(1e3 * real_recordings._rms(errors), rel=0.06)
    assert real_recordings._rms(errors) > 1e-3
    assert real_recordings._rms([e for _, e in real_recordings._run(model, both[:1])]) < 1e-4


def test_the_floor_of_a_counted_speed_is_its_rounding() -> None:
    time = np.arange(0.0, 1.9, 0.001)
    count = 4.0
    runs = [
        Recording(f"{u:g}", time, np.full(len(time), u), count * np.round((v + 8.0 * time) / count), "%", "rad/s",
                  resolution=count, role="holdout")
        for u, v in ((20.0, 60.0), (80.0, 300.0))
    ]  # fmt: skip
    said = real_recordings._jga25_floor(runs, Model(Structure.of(["inertia"]), {"input_gain": 1.0}))
    total, rounding = float(said.split()[1]), float(said.split()[-1])
    assert rounding == pytest.approx(30.0 / np.pi * count / np.sqrt(12.0), rel=0.01)
    assert total == pytest.approx(np.hypot(rounding, 30.0 / np.pi * 8.0 * 0.6 / np.sqrt(12.0)), rel=0.1)


def quick(name: str, candidates: Sequence[str] = CANDIDATES) -> SearchResult:
    """The search on the quick part of a set, from its plain model."""
    chosen = real_recordings.SETS[name]
    recordings, _ = real_recordings.recordings_of(name, DATA, quick=True)
    train = [r for r in recordings if r.role == "train"]
    first = estimate.first_structure(recordings, chosen.more, chosen.fewer)
    return forward_selection.search(train, first, {}, candidates)


@real
def test_the_linear_axis_lacks_friction_and_a_constant_pull() -> None:
    found = quick("emps").last
    assert "coulomb_friction" in found.structure
    # Which of the two it is shows at rest only.
    assert {"constant_offset", "friction_asymmetry", "viscous_asymmetry"} & set(found.structure.named)
    numbers = real_recordings.SETS["emps"].numbers(found)  # as published, from a third of the record
    assert numbers["M, kg"] == pytest.approx(95.1, rel=0.03)
    assert numbers["Fv, N s/m"] == pytest.approx(203.5, rel=0.06)
    assert numbers["Fc, N"] == pytest.approx(20.4, rel=0.06)


@real
def test_the_friction_of_the_linear_axis_keeps_its_name_beside_a_curve_that_does_more() -> None:
    """Published models have dry friction and an offset: while it moves that is friction which is larger one way."""
    chosen, rivals = real_recordings.SETS["emps"], ("coulomb_friction", "friction_asymmetry", "constant_offset")
    recordings, _ = real_recordings.recordings_of("emps", DATA, quick=False)
    first = estimate.first_structure(recordings, chosen.more, chosen.fewer)
    found = diagnose.diagnose(recordings, first, candidates=rivals)
    assert [f.id for f in found.findings] == ["friction_asymmetry"] and found.verdict == "partly_explained"
    assert [u.ids for u in found.undecided] == [("friction_asymmetry", "constant_offset")]


@real
def test_the_gear_motor_saturates() -> None:
    found = quick("jga25").last
    assert "drive_saturation" in found.structure
    assert 85.0 < found.values["saturation_limit"] < 96.0  # published: 90..100 %
    assert 9.0 < found.values["dead_band_forward"] < 19.0


@real
def test_the_servo_loses_more_the_more_its_gears_carry() -> None:
    # A short list, for the sake of time; the whole of it is for the script.
    found = quick("sts3215", ("coulomb_friction", "load_dependent_friction", "constant_offset", "input_delay")).last
    assert "load_dependent_friction" in found.structure
    assert 0.3 < found.values["load_friction"] < 0.8


@real
def test_runs_end_where_the_drive_is_switched_off(tmp_path: Path) -> None:
    rows = manifests.sts3215(DATA / "sts3215_pendulum", brutal=False)
    manifests.write(tmp_path / "set.csv", rows)
    with (tmp_path / "set.csv").open(encoding="utf-8") as stream:
        ends = {r["trajectory"]: r["end"] for r in csv.DictReader(stream)}
    assert float(ends["lift_and_drop"]) == pytest.approx(2.0, abs=0.05)
    assert ends["sin_sin"] == ""
    loaded, _ = recording.load([tmp_path / "set.csv"], ROOT / "models" / "rigs" / "sts3215.toml")
    assert min(r.time[-1] for r in loaded) < 2.05 and max(r.time[-1] for r in loaded) > 5.9
