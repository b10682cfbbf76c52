"""The plugin, from a user's side: checks that hold pass, others fail with figures and a plot."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from controlled_axis import axis

from twin.control.controller import dumps
from twin.control.cosimulation import ModelPlant, make_reference, simulate, unaware
from twin.control.design import design
from twin.fmi.python_fmu import export
from twin.testing.checks import Checks

pytest_plugins = ["pytester"]


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A plant, a controller for it, and a recording of the plant."""
    model = axis("gravity", gravity_gain=3.0)
    made = design(model, 2.0)
    export(model, tmp_path / "axis.fmu")
    export(axis("gravity", gravity_gain=1.0), tmp_path / "other.fmu")
    (tmp_path / "CONTROLLER.toml").write_text(dumps(made))
    run = simulate(model, made, make_reference("minimum-jerk", made))
    rows = "".join(f"{t:.4f},{u:.10f},{x:.10f}\n" for t, u, x in zip(run.time, run.input, run.position, strict=True))
    (tmp_path / "log.csv").write_text("t,duty,position\n" + rows)
    (tmp_path / "rig.toml").write_text(
        '[time]\ncolumn = "t"\n[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "position"\nunit = "rad"\n'
    )
    return tmp_path


def test_checks_hold_for_the_twin_and_fail_for_another(files: Path) -> None:
    checks = Checks(files / "plots", "test[odd name]")
    log, rig, controller = files / "log.csv", files / "rig.toml", files / "CONTROLLER.toml"
    assert checks.load(files / "axis.fmu").version == 2
    assert checks.assert_nrmse(files / "axis.fmu", log, 0.5, rig) < 0.5
    assert checks.assert_tracking(files / "axis.fmu", controller, 0.01).peak < 0.01
    assert checks.assert_no_limit_cycle(files / "axis.fmu", controller).limit_cycle is None
    assert np.ptp(checks.track(files / "axis.fmu", controller, "step").reference) > 0.0
    (files / "reference.csv").write_text("time,position\n0,0\n1,0.1\n2,0.2\n3,0.2\n")
    assert checks.track(files / "axis.fmu", controller, files / "reference.csv").reference[-1] == pytest.approx(0.2)
    assert not (files / "plots").exists()
    with pytest.raises(pytest.fail.Exception, match=r"no longer fits .*\n.*furthest off at .*\n.*plot: "):
        checks.assert_nrmse(files / "other.fmu", log, 0.5, rig)
    with pytest.raises(pytest.fail.Exception, match=r"tracking error .* > 1e-06"):
        checks.assert_tracking(files / "axis.fmu", controller, 1e-6)
    assert (files / "plots" / "test_odd_name_.png").stat().st_size > 5000


def test_a_replay_knows_the_supply_and_the_payload(tmp_path: Path) -> None:
    """A rig whose supply falls to half while it swings a payload that its rig file knows."""
    model = axis("payload_gravity", own_inertia=0.02)
    time = 0.002 * np.arange(2000)
    duty, supply = 30.0 * np.sign(np.sin(5.0 * time)), np.linspace(16.0, 8.0, 2000)
    plant, rows = ModelPlant(replace(model, known={"payload": 0.5 * 0.2**2, "moment": 0.5 * 0.2}), 0.0), []
    for t, u, v in zip(time.tolist(), duty.tolist(), supply.tolist(), strict=True):
        rows.append(f"{t:.4f},{u:.10f},{v:.10f},{plant.read()[1]:.10f}\n")
        plant.advance(t, u * v / float(np.median(supply)), 0.002)
    (tmp_path / "log.csv").write_text("t,duty,volts,position\n" + "".join(rows))
    (tmp_path / "rig.toml").write_text(
        '[time]\ncolumn = "t"\n[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "position"\nunit = "rad"\n'
        '[optional.supply]\ncolumn = "volts"\nunit = "V"\n[known]\npayload_mass = 0.5\narm_length = 0.2\n'
    )
    fmu = export(model, tmp_path / "axis.fmu")
    assert Checks(tmp_path, "t").assert_nrmse(fmu, tmp_path / "log.csv", 0.5) < 0.5


def test_hunting_fails_the_check(tmp_path: Path) -> None:
    model = axis(backlash_gap=0.02)
    made = design(model)
    fmu = export(model, tmp_path / "axis.fmu")
    with pytest.raises(pytest.fail.Exception, match="hunts at rest"):
        Checks(tmp_path, "t").assert_no_limit_cycle(fmu, unaware(made))


def test_plugin_runs_in_a_users_suite(files: Path, pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        f"""
        def test_fits(twin):
            assert twin.assert_nrmse(r"{files}/axis.fmu", r"{files}/log.csv", 0.5, r"{files}/rig.toml") < 0.5
        def test_typo(twin):
            twin.load("axs.fmu")
        def test_drifts(twin):
            twin.assert_nrmse(r"{files}/other.fmu", r"{files}/log.csv", 0.5, r"{files}/rig.toml")
        """
    )
    result = pytester.runpytest_subprocess("-p", "twin.testing.pytest_plugin", "--twin-plots", str(files / "seen"))
    result.assert_outcomes(passed=1, failed=2)
    result.stdout.fnmatch_lines(["axs.fmu: there is no such FMU: check the name*"])
    assert "in open_fmu" not in result.stdout.str()
    assert [p.name for p in (files / "seen").iterdir()] == ["test_drifts.png"]
    assert np.all([p.stat().st_size > 5000 for p in (files / "seen").iterdir()])


def test_a_project_that_asks_for_no_check_waits_for_none() -> None:
    """The plugin is read at every start of pytest."""
    asked = "import twin.testing.pytest_plugin"
    code = f"import sys, pytest; known = {{*sys.modules}}; {asked}; print(*({{*sys.modules}} - known))"
    new = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "twin.testing.pytest_plugin" in new
    assert {name for name in new if name.split(".")[0] != "twin"} == set()
