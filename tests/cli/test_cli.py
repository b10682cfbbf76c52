from __future__ import annotations

import argparse
import io
import json
import os
import re
import subprocess
import sys
import time
import tomllib
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from example_diagnosis import example, model_of, recording_of

from twin import pipeline
from twin.cli import output
from twin.cli.main import EXAMPLES, _parser, main
from twin.control import controller, cosimulation, design
from twin.diagnosis import diagnose, result
from twin.effects.catalogue import EFFECTS, UNKNOWN
from twin.estimation import estimate, two_stage
from twin.estimation.preparation import base_structure
from twin.fmi import evidence, python_fmu
from twin.io import files
from twin.model import fitted_model

SHARED = Path(__file__).resolve().parents[3] / "shared"
COMMANDS = ["run", "identify", "export", "update", "simulate", "diagnose", "control", "cosim", "check"]


def csv_of(recording) -> str:
    rows = ["t,duty,q"]
    for t, u, y in zip(recording.time, recording.input, recording.output, strict=True):
        rows.append(f"{t:.4f},{u:g},{'' if np.isnan(y) else f'{y:.8f}'}")
    return "\n".join(rows) + "\n"


@pytest.fixture(scope="module")
def shelf(tmp_path_factory) -> Path:
    """A good recording, models, FMU and controller, made once."""
    folder = tmp_path_factory.mktemp("shelf")
    truth = model_of("gravity")
    (folder / "good.csv").write_text(csv_of(recording_of(truth)))
    (folder / "model.toml").write_text(fitted_model.dumps(truth))
    (folder / "other.toml").write_text(fitted_model.dumps(truth.with_values({"input_gain": 0.5})))
    (folder / "base.toml").write_text(fitted_model.dumps(model_of()))
    python_fmu.export(truth, folder / "arm.fmu")
    assert main(["control", str(folder / "model.toml"), "--out", str(folder / "c.toml"), "--bandwidth", "2"]) == 0
    return folder


@pytest.fixture
def bench(shelf, tmp_path, monkeypatch) -> Iterator[Path]:
    """An own copy of the shelf to work in."""
    for path in shelf.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    yield tmp_path


def call(capsys, *arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout, and stderr without the progress bar."""
    capsys.readouterr()
    code = main(list(arguments))
    out, err = capsys.readouterr()
    return code, out, err.split("\r")[-1]


def state(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def refused(capsys, bench: Path, *arguments: str) -> str:
    """One line on stderr, exit 2, nothing written and nothing changed; the line."""
    before = state(bench)
    code, out, err = call(capsys, *arguments)
    assert code == 2, (out, err)
    assert out == ""
    assert re.fullmatch(r"twin: [^\n]+\n", err), err
    assert state(bench) == before
    assert "Error" not in err and "Traceback" not in err
    return err


# ---- bad recordings, through every command that takes one ----


def good_lines() -> list[str]:
    return csv_of(recording_of(model_of("gravity"))).splitlines()


def spoilt(case: str) -> bytes:
    lines = good_lines()
    cells = [line.split(",") for line in lines]
    match case:
        case "missing column":
            return "\n".join(",".join(c[:2]) for c in cells).encode()
        case "text for a number":
            lines[100] = "0.2,fast,0.1"
        case "time goes backwards":
            lines[500] = "0.1,35,0.2"
        case "constant input":
            lines = [lines[0], *(f"{t},35,{y}" for t, _, y in cells[1:])]
        case "constant output":
            lines = [lines[0], *(f"{t},{u},0.25" for t, u, _ in cells[1:])]
        case "empty":
            return b""
        case "header only":
            lines = lines[:1]
        case "rubbish":
            return bytes(np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8))
        case "three samples":
            lines = lines[:4]
    return "\n".join(lines).encode()


BAD = [
    "missing column", "text for a number", "time goes backwards", "constant input", "constant output", "empty",
    "header only", "rubbish", "three samples",
]  # fmt: skip
TAKES_LOG = {
    "run": ["LOG", "--out", "new"],
    "identify": ["LOG", "--out", "new.toml"],
    "diagnose": ["LOG", "--out", "new.toml", "--report", "new.html", "--json", "new.json"],
    "simulate": ["arm.fmu", "--log", "LOG", "--out", "new.csv"],
    "check": ["arm.fmu", "--log", "LOG", "--max-nrmse", "5"],
}


def with_log(command: str, log: str) -> list[str]:
    return [command, *(log if a == "LOG" else a for a in TAKES_LOG[command])]


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("command", TAKES_LOG)
def test_bad_recordings_are_refused(capsys, bench, command, case):
    (bench / "bad.csv").write_bytes(spoilt(case))
    said = refused(capsys, bench, *with_log(command, "bad.csv"))
    assert "bad.csv" in said


@pytest.mark.parametrize("command", TAKES_LOG)
def test_missing_files_and_folders_are_refused(capsys, bench, command):
    (bench / "folder").mkdir()
    assert "nothere.csv" in refused(capsys, bench, *with_log(command, "nothere.csv"))
    assert "folder" in refused(capsys, bench, *with_log(command, "folder"))
    assert "nothere.toml" in refused(capsys, bench, *with_log(command, "good.csv"), "--rig", "nothere.toml")


@pytest.mark.parametrize(
    ("rig", "names"),
    [
        ('[input]\ncolumn = "duty"\nunit = "furlong"\n[output]\ncolumn = "q"\nunit = "rad"', "furlong"),
        ('[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "angle"\nunit = "rad"', "angle"),
        ('[input\ncolumn = "duty"', "line 1"),
        (
            '[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "q"\nunit = "rad"\n'
            '[structure]\neffects = ["gravty"]',
            "gravity",
        ),
    ],
)
def test_bad_rig_files_are_refused(capsys, bench, rig, names):
    (bench / "r.toml").write_text(rig)
    assert names in refused(capsys, bench, "identify", "good.csv", "--rig", "r.toml", "--out", "new.toml")


def test_files_that_are_not_what_they_should_be(capsys, bench):
    (bench / "no.fmu").write_bytes(b"PK\x03\x04 this is no archive")
    for arguments in (
        ["simulate", "no.fmu", "--log", "good.csv"],
        ["check", "no.fmu", "--log", "good.csv", "--max-nrmse", "5"],
        ["check", "good.csv", "--log", "good.csv", "--max-nrmse", "5"],
        ["update", "no.fmu", "--from", "model.toml"],
        ["update", "arm.fmu", "--from", "base.toml"],
        ["update", "arm.fmu", "--from", "c.toml"],
        ["export", "good.csv", "--out", "new.fmu"],
        ["export", "nothere.toml", "--out", "new.fmu"],
        ["control", "c.toml", "--out", "new.toml"],
        ["control", "model.toml", "--out", "new.toml", "--bandwidth", "-1"],
        ["cosim", "arm.fmu", "model.toml"],
        ["cosim", "no.fmu", "c.toml"],
        ["cosim", "arm.fmu", "c.toml", "--reference", "good.csv"],
        ["diagnose", "good.csv", "--model", "good.csv", "--out", "new.toml"],
    ):
        refused(capsys, bench, *arguments)


def test_wrong_arguments_take_one_line(capsys, bench):
    assert "did you mean identify" in refused(capsys, bench, "identfy", "good.csv")
    assert "did you mean gravity" in refused(
        capsys, bench, "identify", "good.csv", "--with", "gravty", "--out", "new.toml"
    )
    for effect, says in (("spring", "no such effect"), ("inertia", "input gain"), ("sprung", "did you mean spring")):
        assert says in refused(capsys, bench, "identify", "good.csv", "--without", effect, "--out", "new.toml")
    assert "--out" in refused(capsys, bench, "identify", "good.csv")
    assert "--native" in refused(capsys, bench, "export", "model.toml", "--native", "--out", "new.fmu")
    assert "native" in refused(capsys, bench, "export", "model.toml", "--fmi", "3", "--out", "new.fmu")
    assert "native" in refused(capsys, bench, "export", "model.toml", "--held-input", "--out", "new.fmu")
    assert "percentage" in refused(capsys, bench, "check", "arm.fmu", "--log", "good.csv", "--max-nrmse", "small")
    assert "above 0" in refused(capsys, bench, "check", "arm.fmu", "--log", "good.csv", "--max-nrmse", "0")
    assert "two different outputs" in refused(
        capsys, bench, "diagnose", "good.csv", "--out", "new.toml", "--report", "new.toml"
    )
    refused(capsys, bench)


# ---- nothing is overwritten ----


@pytest.mark.parametrize(
    "arguments",
    [
        ["identify", "good.csv", "--out", "base.toml"],
        ["export", "model.toml", "--out", "arm.fmu"],
        ["export", "model.toml", "--out", "new.fmu", "--json", "good.csv"],
        ["check", "arm.fmu", "--log", "good.csv", "--max-nrmse", "5", "--json", "base.toml"],
        ["update", "arm.fmu", "--from", "other.toml", "--out", "base.toml"],
        ["simulate", "arm.fmu", "--log", "good.csv", "--out", "base.toml"],
        ["diagnose", "good.csv", "--out", "base.toml"],
        ["diagnose", "good.csv", "--out", "new.toml", "--report", "base.toml"],
        ["control", "model.toml", "--out", "c.toml"],
        ["cosim", "arm.fmu", "c.toml", "--out", "good.csv"],
    ],
)
def test_nothing_is_overwritten(capsys, bench, arguments):
    assert "--force" in refused(capsys, bench, *arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        ["identify", "good.csv", "--out", "good.csv"],
        ["export", "model.toml", "--out", "./model.toml"],
        ["update", "arm.fmu", "--from", "other.toml", "--out", "other.toml"],
        ["simulate", "arm.fmu", "--log", "good.csv", "--out", "good.csv"],
        ["check", "arm.fmu", "--log", "good.csv", "--max-nrmse", "5", "--json", "arm.fmu"],
        ["diagnose", "good.csv", "--model", "base.toml", "--out", "new.toml", "--report", "base.toml"],
        ["control", "model.toml", "--out", "model.toml"],
        ["cosim", "arm.fmu", "c.toml", "--plot", "c.toml"],
    ],
)
def test_what_is_read_is_written_over_by_no_force(capsys, bench, arguments):
    assert "is read by this command" in refused(capsys, bench, *arguments, "--force")


@pytest.mark.parametrize(
    "arguments", [["run", "nowhere.csv", "--out", "new"], ["control", "nowhere.toml", "--out", "n.toml"]]
)
def test_a_bandwidth_that_no_controller_has_is_refused_at_once(capsys, bench, arguments):
    """Before anything is read."""
    for value in ("-1", "0", "nan", "inf"):
        assert "--bandwidth" in refused(capsys, bench, *arguments, "--bandwidth", value)


@pytest.mark.parametrize(
    "arguments",
    [
        ["check", "arm.fmu", "--log", "LOG", "--max-nrmse", "5"],
        ["simulate", "arm.fmu", "--log", "LOG"],
        ["diagnose", "LOG", "--model", "base.toml", "--out", "new.toml"],
    ],
)
@pytest.mark.parametrize(("column", "unit"), [("voltage", "V"), ("y_m", "m")])
def test_what_is_compared_is_in_the_same_units(capsys, bench, arguments, column, unit):
    """A model of a rig in percent says nothing about one in volts, and would seem to fit."""
    head, *rows = good_lines()
    names = head.split(",")
    names[1 if unit == "V" else 2] = column
    (bench / "other.csv").write_text("\n".join([",".join(names), *rows]))
    said = refused(capsys, bench, *("other.csv" if a == "LOG" else a for a in arguments))
    assert f"in {unit}" in said and ("in %" in said or "in rad" in said) and "same rig" in said


def test_a_controller_of_a_turning_axis_moves_no_carriage(capsys, bench):
    text = (bench / "c.toml").read_text().replace('axis_unit = "rad"', 'axis_unit = "m"').replace('"rad"', '"m"')
    (bench / "m.toml").write_text(text)
    assert "moves in rad" in refused(capsys, bench, "cosim", "arm.fmu", "m.toml")


def test_a_disk_that_takes_no_more_is_told_in_one_line(capsys, bench, no_zig):
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        said = refused(capsys, bench, "export", "model.toml", "--out", "new.fmu")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "File too large" in said


def test_a_folder_with_results_is_not_overwritten(capsys, bench):
    (bench / "out").mkdir()
    (bench / "out" / "report.html").write_text("mine")
    assert "report.html" in refused(capsys, bench, "run", "good.csv", "--out", "out")
    assert "is a file" in refused(capsys, bench, "run", "good.csv", "--out", "good.csv")
    assert "not a folder" in refused(capsys, bench, "run", "good.csv", "--out", "no/such/place")


def test_what_is_said_of_an_axis_is_refused_for_a_controller(capsys, bench):
    for option in (["--evidence", "good.csv"], ["--author", "A"], ["--license", "MIT"], ["--modelica", "a.mo"]):
        assert "c.toml is a controller" in refused(capsys, bench, "export", "c.toml", "--out", "new.fmu", *option)
    assert call(capsys, "export", "c.toml", "--out", "c.fmu")[0] == 0
    assert "c.fmu is a controller" in refused(capsys, bench, "update", "c.fmu", "--from", "model.toml")
    assert "minimum-jerk, sine, step" in refused(capsys, bench, "cosim", "arm.fmu", "c.toml", "--reference", "ramp")


def test_an_update_that_changes_nothing_warns_of_nothing(capsys, bench):
    given = ("export", "model.toml", "--out", "with.fmu", "--evidence", "good.csv")
    assert call(capsys, *given)[0] == 0
    assert call(capsys, "update", "with.fmu", "--from", "model.toml")[1] == "with.fmu: 0 of 9 parameters changed.\n"
    assert "of the old parameters" in call(capsys, "update", "with.fmu", "--from", "other.toml")[1]


def test_force_overwrites_and_update_needs_none(capsys, bench):
    old = (bench / "arm.fmu").read_bytes()
    assert call(capsys, "export", "other.toml", "--out", "arm.fmu", "--force")[0] == 0
    assert python_fmu.read_model(bench / "arm.fmu").values["input_gain"] == 0.5
    (bench / "arm.fmu").write_bytes(old)
    code, out, _ = call(capsys, "update", "arm.fmu", "--from", "other.toml", "--json", "-")
    assert code == 0
    assert json.loads(out)["changed"] == {"input_gain": [0.4, 0.5]}
    assert python_fmu.read_model(bench / "arm.fmu").values["input_gain"] == 0.5


# ---- what the commands do ----


def test_simulate_writes_what_the_fmu_did(capsys, bench):
    code, out, _ = call(capsys, "simulate", "arm.fmu", "--log", "good.csv", "--out", "s.csv", "--json", "j.json")
    assert code == 0 and "RMSE" in out
    lines = (bench / "s.csv").read_text().splitlines()
    assert lines[0] == "time,input,recorded,position_measured,velocity"
    table = np.genfromtxt(bench / "s.csv", delimiter=",", skip_header=1)
    assert len(table) == 2000
    error = np.sqrt(np.nanmean((table[:, 3] - table[:, 2]) ** 2))
    said = json.loads((bench / "j.json").read_text())["fit"][0]
    assert said["rmse"] == pytest.approx(error, rel=1e-6)
    assert said["rmse"] < 1e-3  # the FMU is the truth that was recorded, but for the count
    assert said["nrmse_percent"] == pytest.approx(100 * error / np.ptp(table[np.isfinite(table[:, 2]), 2]), rel=1e-6)


def test_several_recordings_are_named_in_the_table(capsys, bench):
    (bench / "list.csv").write_text("file,role\ngood.csv,train\ngood.csv,holdout\n")
    assert call(capsys, "simulate", "arm.fmu", "--log", "list.csv", "--out", "s.csv")[0] == 0
    lines = (bench / "s.csv").read_text().splitlines()
    assert lines[0].startswith("recording,time,") and lines[1].startswith("good.csv,0")
    assert len(lines) == 4001


def test_check_is_for_ci(capsys, bench):
    arguments = ["check", "arm.fmu", "--log", "good.csv", "--json", "-", "--max-nrmse"]
    assert call(capsys, *arguments, "1%")[0] == 0
    code, out, _ = call(capsys, *arguments, "1e-6")
    assert code == 1
    answer = json.loads(out)
    assert answer["holds"] is False and answer["fit"][0]["nrmse_percent"] > 1e-6


def test_what_a_recording_lacks_is_told_where_it_is_compared(capsys, bench):
    lines = good_lines()
    lines[400] = lines[400].rsplit(",", 1)[0] + ","
    (bench / "holed.csv").write_text("\n".join(lines))
    for arguments in (["check", "arm.fmu", "--log", "holed.csv", "--max-nrmse", "5"],
                      ["simulate", "arm.fmu", "--log", "holed.csv"]):  # fmt: skip
        _, out, _ = call(capsys, *arguments, "--json", "new.json", "--force")
        assert "missing" in out
        faults = json.loads((bench / "new.json").read_text())["recording_faults"]
        assert float(lines[400].split(",")[0]) in [f["start"] for f in faults if f["kind"] == "missing"]


def test_quiet_says_nothing(capsys, bench):
    assert call(capsys, "export", "model.toml", "--out", "q.fmu", "--quiet") == (0, "", "")
    assert call(capsys, "check", "arm.fmu", "--log", "good.csv", "--max-nrmse", "1", "--quiet") == (0, "", "")


def test_json_to_stdout_is_nothing_but_json(capsys, bench):
    for arguments in (
        ["export", "model.toml", "--out", "q.fmu"],
        ["control", "model.toml", "--out", "q.toml", "--bandwidth", "2"],
        ["cosim", "arm.fmu", "c.toml", "--reference", "sine"],
    ):
        code, out, _ = call(capsys, *arguments, "--json", "-")
        assert code == 0
        assert json.loads(out, parse_constant=pytest.fail)["format"].startswith("twin-")


def test_cosim_writes_its_run(capsys, bench):
    code, out, _ = call(capsys, "cosim", "arm.fmu", "c.toml", "--out", "run.csv")
    assert code == 0 and "link errs by" in out
    table = np.genfromtxt(bench / "run.csv", delimiter=",", names=True)
    assert table.dtype.names == ("time", "reference", "position", "input")
    assert np.max(np.abs(table["position"] - table["reference"])) < 0.1


def test_cosim_takes_other_names_other_structures_and_draws(capsys, bench):
    with zipfile.ZipFile(bench / "arm.fmu") as old, zipfile.ZipFile(bench / "theirs.fmu", "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'name="duty"', b'name="u"').replace(b'name="position"', b'name="phi"')
            new.writestr(name, content)
    said = refused(capsys, bench, "cosim", "theirs.fmu", "c.toml")
    assert "no input 'duty', only u: map it (duty=NAME)" in said
    assert "write it as OURS=THEIRS" in refused(capsys, bench, "cosim", "theirs.fmu", "c.toml", "--map", "duty")
    told = ["--map", "duty=u", "--map", "position=phi", "--plot", "run.svg", "--json", "-", "--reference", "step"]
    code, out, _ = call(capsys, "cosim", "theirs.fmu", "c.toml", *told, "--amplitude", "0.2")
    usual = call(capsys, "cosim", "arm.fmu", "c.toml", "--json", "-", "--reference", "step", "--amplitude", "0.2")[1]
    assert code == 0 and json.loads(out) == json.loads(usual) and json.loads(out)["peak"] < 0.21
    assert ET.parse(bench / "run.svg").getroot().tag.endswith("svg")
    assert main(["export", "base.toml", "--out", "base.fmu", "--quiet"]) == 0
    assert "--other-structure" in refused(capsys, bench, "cosim", "base.fmu", "c.toml")
    assert call(capsys, "cosim", "base.fmu", "c.toml", "--other-structure")[0] == 0
    assert "shape minimum-jerk" in refused(
        capsys, bench, "cosim", "arm.fmu", "c.toml", "--reference", "good.csv", "--amplitude", "1"
    )


def test_control_says_when_the_parameters_are_too_uncertain(capsys, bench):
    found = fitted_model.read(bench / "model.toml")
    names, gravity = found.fitted, found.fitted.index("gravity_gain")
    for name, std in (("sure", 1e-3), ("vague", 2.5)):
        spread = np.full(len(names), 1e-5)
        spread[gravity] = std
        (bench / f"{name}.toml").write_text(fitted_model.dumps(replace(found, covariance=np.diag(spread**2))))
    told = ["--bandwidth", "2", "--draws", "40", "--max-peak"]
    code, out, _ = call(capsys, "control", "sure.toml", "--out", "d.toml", *told, "0.005", "--json", "sure.json")
    assert code == 0 and "Over 40 axes that the recording allows" in out
    assert json.loads((bench / "sure.json").read_text())["robustness"]["share"] == 1.0
    code, out, _ = call(capsys, "control", "vague.toml", "--out", "e.toml", *told, "0.005")
    assert code == 1 and "too uncertain for 2 Hz: learn gravity_gain better" in out
    code, out, _ = call(capsys, "control", "sure.toml", "--out", "f.toml", *told, "1e-5")
    assert code == 1 and "Even with the parameters as they stand" in out and "learn" not in out
    assert "give an error above 0" in refused(capsys, bench, "control", "sure.toml", "--out", "g.toml", *told, "0")
    assert "--draws is 0" in refused(
        capsys, bench, "control", "sure.toml", "--out", "g.toml", "--max-peak", "1", "--draws", "0"
    )
    (bench / "hand.toml").write_text(fitted_model.dumps(replace(found, fitted=(), covariance=np.zeros((0, 0)))))
    assert "no covariance" in refused(capsys, bench, "control", "hand.toml", "--out", "g.toml", *told, "1")
    code, out, _ = call(capsys, "control", "hand.toml", "--out", "g.toml")
    assert code == 0 and "no covariance" in out


def test_the_rigs_own_loop_is_closed_where_asked(capsys, bench):
    said = refused(capsys, bench, "simulate", "arm.fmu", "--log", "good.csv", "--closed")
    assert "add [loop] to the rig file" in said
    columns = '[time]\ncolumn = "t"\n[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "q"\nunit = "rad"\n'
    (bench / "rig.toml").write_text(columns + '[loop]\nreference = "q"\nlaw = "P"\ngain = 2000.0\nlimit = 100.0\n')
    code, _, _ = call(capsys, "simulate", "arm.fmu", "--log", "good.csv", "--closed", "--out", "sim.csv")
    table = np.genfromtxt(bench / "sim.csv", delimiter=",", names=True)
    recorded = np.genfromtxt(bench / "good.csv", delimiter=",", names=True)
    assert code == 0 and np.max(np.abs(table["input"])) <= 100.0
    assert not np.allclose(table["input"], recorded["duty"])  # the loop's own commands
    assert call(capsys, "check", "arm.fmu", "--log", "good.csv", "--closed", "--max-nrmse", "15")[0] == 0
    assert call(capsys, "check", "arm.fmu", "--log", "good.csv", "--closed", "--max-nrmse", "0.001")[0] == 1


def test_two_stage_says_what_it_lacks(capsys, bench):
    said = refused(capsys, bench, "identify", "good.csv", "--method", "two-stage", "--out", "new.toml")
    assert "two-stage" in said and "joint" in said
    more = ["--method", "two-stage", "--horizon", "5", "--out", "new.toml"]
    assert "--horizon goes with --method joint" in refused(capsys, bench, "identify", "good.csv", *more)
    assert "give --horizon" in refused(capsys, bench, "identify", "good.csv", "--closed", "--out", "new.toml")
    assert "horizon is 0 s" in refused(capsys, bench, "identify", "good.csv", "--horizon", "0", "--out", "new.toml")


# ---- diagnose and run, with the search itself left out ----


@pytest.fixture
def known_answer(monkeypatch, no_zig):
    def answer(recordings, first, held=None, progress=None, closed=False):
        progress("searching", 0.5)
        answer.first = first
        return example()

    monkeypatch.setattr(diagnose, "diagnose", answer)
    return answer


def keys(value) -> object:
    """The shape of a JSON value: keys, and the shape of the first of a list."""
    if isinstance(value, dict):
        return {k: keys(v) for k, v in value.items()}
    return [keys(value[0])] if isinstance(value, list) and value else type(value).__name__


def contains(shape, wanted) -> bool:
    if isinstance(wanted, dict):
        return isinstance(shape, dict) and all(k in shape and contains(shape[k], v) for k, v in wanted.items())
    if isinstance(wanted, list):
        return isinstance(shape, list) and contains(shape[0], wanted[0])
    return not isinstance(shape, dict | list) or wanted == "str"


def test_diagnosis_is_what_the_contract_promises(capsys, bench, known_answer):
    if not (SHARED / "contract.md").exists():
        pytest.skip("the contract is not beside the project")
    code, out, _ = call(capsys, "diagnose", "good.csv", "--out", "better.toml", "--report", "r.html", "--json", "-")
    assert code == 0
    text = (SHARED / "contract.md").read_text(encoding="utf-8")
    promised = json.loads(re.search(r"```json\n(.*?)```", text, re.DOTALL).group(1))
    promised["effects"][0]["parameters"] = {"gravity_gain": {"value": 1.0, "std": 1.0, "unit": "s"}}
    answer = json.loads(out, parse_constant=pytest.fail)
    assert contains(keys(answer), keys(promised)), (keys(answer), keys(promised))
    assert answer["verdict"] == "explained"
    assert "gravity" in tomllib.loads((bench / "better.toml").read_text())["structure"]["effects"]
    assert (bench / "r.html").read_text().startswith("<!DOCTYPE html>")
    assert Path(answer["next_experiment"]["file"]).read_text().startswith("time,duty\n")


def test_the_first_model_is_the_users_choice(capsys, bench, known_answer):
    base = base_structure()
    for more, expected in (
        ([], base),
        (["--with", "gravity"], base.with_("gravity")),
        (["--without", "backlash"], base.without("backlash", "tooth_compliance")),
        (["--with", "spring", "--without", "dead_band"], base.with_("spring").without("dead_band")),
        (["--model", "model.toml"], model_of("gravity").structure),
        (["--model", "model.toml", "--without", "gravity"], model_of().structure),
    ):
        assert call(capsys, "diagnose", "good.csv", "--out", "better.toml", "--force", *more)[0] == 0
        assert known_answer.first.ids == expected.ids


def test_a_given_model_is_judged_as_it_is(capsys, bench, known_answer):
    asked = ("diagnose", "good.csv", "--model", "base.toml", "--out", "judged.toml", "--json", "judged.json")
    code, out, err = call(capsys, *asked)
    assert code == 0, err
    (fit,) = json.loads((bench / "judged.json").read_text())["given_model"].values()
    assert fit["rmse"] > 0.0 and f"runs freely with an error of {fit['rmse']:.3g} rad" in out


def test_run_leaves_everything_in_its_folder(capsys, bench, known_answer):
    code, out, err = call(capsys, "run", "good.csv", "--out", "out", "--bandwidth", "2", "--json", "run.json")
    assert code == 0, err
    assert {p.name for p in (bench / "out").iterdir()} == set(pipeline.FILES)
    assert not [p for p in bench.iterdir() if p.name.startswith(".")]
    assert "gravity" in out and "report.html" in out and "Assumed" in out
    said = [line for line in out.splitlines() if not line.startswith(("Assumed", "Everything"))]
    assert len(said) == 5  # what was left out, what is missing, the fit, what may be claimed, the closed loop
    assert python_fmu.read_model(bench / "out/improved.fmu").structure == model_of("gravity").structure
    assert python_fmu.read_model(bench / "out/arm.fmu").structure == model_of().structure
    assert fitted_model.read(bench / "out/improved.toml").provenance["largest_command"] == "35"
    assert controller.read(bench / "out/controller.toml").bandwidth == 2.0
    diagnosis = json.loads((bench / "out/diagnosis.json").read_text())
    assert diagnosis["next_experiment"]["file"] == "next_experiment.csv"
    answer = json.loads((bench / "run.json").read_text(), parse_constant=pytest.fail)
    assert answer["fmu"][1]["nrmse_percent"] < answer["fmu"][0]["nrmse_percent"]
    assert all(not c["problems"] for c in answer["fmu"])
    assert set(answer["files"]) == set(pipeline.FILES)
    page = (bench / "out/report.html").read_text()
    assert "phase margin" in page and "improved.fmu" in page
    refused(capsys, bench, "run", "good.csv", "--out", "out")
    for name in ("arm", "improved", "improved-native"):
        trials, _ = evidence.carried(bench / f"out/{name}.fmu")
        assert trials[0].recording.name.startswith("good.csv") and trials[0].judged_from > 0.0
    assert call(capsys, "check", "out/improved-native.fmu")[0] == 0
    assert "improved-native.fmu (Linux x86_64)" in out
    assert call(capsys, "run", "good.csv", "--out", "out", "--force", "--quiet")[0] == 0


def fail(*_, **__):
    raise ZeroDivisionError("in the middle")


def test_a_failing_diagnosis_leaves_the_first_model(capsys, bench, monkeypatch):
    monkeypatch.setattr(estimate, "identify", lambda *_, **__: model_of())
    monkeypatch.setattr(diagnose, "diagnose", fail)
    code, out, err = call(capsys, "run", "good.csv", "--out", "out", "--json", "run.json")
    assert code == 1 and "There is no diagnosis: an internal error" in out and "Traceback" not in err
    assert {p.name for p in (bench / "out").iterdir()} == {"model.toml", "arm.fmu"}
    answer = json.loads((bench / "run.json").read_text())
    assert answer["failures"]["diagnosis"] == answer["says"][0]


def test_where_no_model_is_found_nothing_is_left_behind(capsys, bench, monkeypatch):
    monkeypatch.setattr(estimate, "identify", fail)
    monkeypatch.setattr(diagnose, "diagnose", fail)
    before = state(bench)
    code, _, err = call(capsys, "run", "good.csv", "--out", "out")
    assert code == 3 and "internal error" in err and "Traceback" not in err
    assert state(bench) == before and not (bench / "out").exists()


@pytest.mark.parametrize(
    ("broken", "lost"),
    [
        ({"controller": (design, "design"), "report": (pipeline, "html")}, {"controller.toml", "report.html"}),
        (
            {
                "closed loop": (cosimulation, "run"),
                "check of arm.fmu": (python_fmu, "replay"),
                "two-stage estimate": (two_stage, "two_stage"),
            },
            set(),
        ),
        ({"improved.fmu": (python_fmu, "export")}, {"arm.fmu", "improved.fmu"}),
    ],
)
def test_a_stage_that_fails_costs_only_itself(capsys, bench, known_answer, monkeypatch, broken, lost):
    for module, function in broken.values():
        monkeypatch.setattr(module, function, fail)
    code, out, err = call(capsys, "run", "good.csv", "--out", "out", "--json", "run.json")
    assert code == 0, err
    assert {p.name for p in (bench / "out").iterdir()} == set(pipeline.FILES) - lost
    answer = json.loads((bench / "run.json").read_text(), parse_constant=pytest.fail)
    assert answer["diagnosis"]["verdict"] == "explained" and "Traceback" not in out + err
    for stage in broken:
        assert answer["failures"][stage] in answer["says"] and f"There is no {stage}: " in out
        if "report.html" not in lost:
            assert f"There is no {stage}: " in (bench / "out/report.html").read_text()


def test_without_a_compiler_a_run_says_what_to_install(capsys, bench, known_answer, monkeypatch):
    monkeypatch.setenv("PATH", str(bench))
    monkeypatch.delenv("CC", raising=False)
    code, out, _ = call(capsys, "run", "good.csv", "--out", "out")
    assert code == 0 and not (bench / "out/improved-native.fmu").exists()
    assert "There is no improved-native.fmu: a native FMU needs a C compiler" in out and "pip install ziglang" in out


def test_a_controller_that_is_asked_for_and_cannot_be_made_is_exit_1(capsys, bench, known_answer):
    code, out, _ = call(capsys, "run", "good.csv", "--out", "out", "--bandwidth", "1e-15")
    assert code == 1 and "There is no controller: bandwidth 1e-15 Hz is too slow" in out
    assert (bench / "out/report.html").exists()


def test_json_of_nothing_found_has_no_numbers_that_json_lacks():
    found = json.loads(files.json_text(result.to_json(example("unexplained"))), parse_constant=pytest.fail)
    assert found["effects"] == [] and set(found) == set(result.to_json(example()))


# ---- the program itself ----


def program(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "twin", *arguments], capture_output=True, text=True, check=False, encoding="utf-8",
        env={**os.environ, **environment}, cwd=Path(__file__).resolve().parents[2],
    )  # fmt: skip


def test_help_is_there_for_every_command():
    said = program("--help")
    assert said.returncode == 0
    for command in COMMANDS:
        assert command in said.stdout
    for command in ("run", "check"):
        said = program(command, "--help")
        assert said.returncode == 0 and "--json" in said.stdout and "--quiet" in said.stdout


@pytest.mark.parametrize(
    "command, code, heavy",
    [
        ("--help", 0, "numpy scipy sympy numba matplotlib fmpy control"),
        ("identify good.csv --out", 2, "numpy scipy sympy numba matplotlib fmpy control"),
        ("export model.toml --out arm.fmu", 2, "numpy scipy sympy numba matplotlib fmpy control"),
        *((f"{name} nowhere.csv --out out", 2, "scipy sympy numba matplotlib fmpy control") for name in COMMANDS[:2]),
        ("diagnose nowhere.csv --out out", 2, "scipy sympy numba matplotlib fmpy control"),
        ("check nowhere.fmu --log nowhere.csv --max-nrmse 5", 2, "scipy sympy numba matplotlib fmpy control"),
        ("control nowhere.toml --out c2.toml", 2, "scipy numba matplotlib fmpy control"),
        ("identify good.csv --method two-stage --out new.toml", 2, "scipy.signal scipy.stats matplotlib fmpy control"),
        ("identify good.csv --horizon -1 --out new.toml", 2, "scipy.signal scipy.stats matplotlib fmpy control"),
        ("check arm.fmu --log good.csv --max-nrmse 5", 0, "numba matplotlib control"),
        ("export model.toml --out new.fmu", 0, "scipy numba matplotlib control"),
        ("cosim nowhere.fmu c.toml", 2, "scipy numba matplotlib control"),
    ],
)
def test_a_command_imports_only_what_it_needs(bench, command, code, heavy):
    asked = (
        "import sys; from twin.cli.main import main\n"
        "try: code = main(sys.argv[2:])\n"
        "except SystemExit as ended: code = ended.code\n"
        "print(code, *(m for m in sys.argv[1].split() if m in sys.modules))"
    )
    said = subprocess.run(
        [sys.executable, "-c", asked, heavy, *command.split()], capture_output=True, text=True, check=False, cwd=bench,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])},
    )  # fmt: skip
    assert said.stdout.splitlines()[-1:] == [str(code)], said


def test_the_bar_is_drawn_and_then_gone(monkeypatch):
    drawn = io.StringIO()
    monkeypatch.setattr(sys, "stderr", drawn)
    monkeypatch.setattr(output, "LINE", 0.2)
    with output.show_progress(argparse.Namespace(quiet=False)) as tell:
        tell("computing", 0.5)
        deadline = time.monotonic() + 60.0
        while "computing" not in drawn.getvalue() and time.monotonic() < deadline:
            time.sleep(0.05)
    shown, covered, rest = drawn.getvalue().split("\r")[-3:]
    assert "computing" in shown and covered.isspace() and len(covered) >= len(shown) and rest == ""


@pytest.mark.parametrize(
    ("sentence", "share", "says"),
    [("round 1", 0.25, True), ("round 1", 0.01, False), ("1 of 4 axes, about 9 min left", 0.25, False)],
)
def test_the_bar_estimates_what_is_left(monkeypatch, sentence, share, says):
    """From the share that is done, where the sentence does not say it better."""
    drawn = io.StringIO()
    monkeypatch.setattr(sys, "stderr", drawn)
    monkeypatch.setattr(output, "LINE", 0.2)
    monkeypatch.setattr(output, "SETTLED", 0.1)
    with output.show_progress(argparse.Namespace(quiet=False)) as tell:
        tell(sentence, share)
        deadline = time.monotonic() + 60.0
        while sentence not in drawn.getvalue() and time.monotonic() < deadline:
            time.sleep(0.05)
    shown = drawn.getvalue().split("\r")[-3]
    assert bool(re.search(r"\d\d:\d\d, about \d+ s left", shown)) == says


def test_a_poor_console_gets_plain_text(shelf, tmp_path):
    said = program(
        "check", str(shelf / "arm.fmu"), "--log", str(shelf / "good.csv"), "--max-nrmse", "5",
        PYTHONIOENCODING="ascii", PYTHONUTF8="0",
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    assert "The twin fits" in said.stdout


# ---- the vocabulary ----


def test_the_vocabulary_is_shown_and_one_effect_in_full(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = call(capsys, "effects")
    assert code == 0 and "gravity" in out and "coulomb_friction" in out and "unknown_" not in out
    code, out, _ = call(capsys, "effects", "gravity", "--json", "gravity.json")
    assert code == 0 and "gravity_gain*sin(" in out and "travel over more than half a turn" in out
    told = json.loads((tmp_path / "gravity.json").read_text(encoding="utf-8"))["effects"][0]
    assert "sin" in told["equation"] and told["confused_with"].keys() >= {"spring"}
    assert "did you mean gravity" in refused(capsys, tmp_path, "effects", "gravty")
    assert "known are" not in out and "there are" in refused(capsys, tmp_path, "effects", "gravitation")


def test_every_effect_can_be_shown(capsys):
    for effect in EFFECTS:
        if effect not in UNKNOWN:
            code, out, _ = call(capsys, "effects", effect)
            assert code == 0 and "source: " in out


@pytest.mark.parametrize("command", EXAMPLES)
def test_the_example_of_a_command_is_one_that_it_takes(command):
    name, *given = EXAMPLES[command].split()
    assert name == "twin" and _parser().parse_args(given).command == command


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_every_command_and_needs_nothing_but_its_package(shell, capsys, monkeypatch):
    assert main(["--completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(command in script for command in COMMANDS)
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--completion", shell]) == 2
    assert "pip install shtab" in capsys.readouterr().err
