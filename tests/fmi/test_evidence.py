"""What an FMU was judged by goes into it, comes out as it was, and disturbs no importer."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from example_diagnosis import model_of, recording_of
from fmpy.util import read_csv
from fmpy.validation import validate_fmu

import twin
from twin.errors import BadInput
from twin.fmi import evidence, python_fmu
from twin.fmi.evidence import Trial
from twin.fmi.fmu_archive import open_fmu, rewritten
from twin.fmi.misfit import misfit
from twin.fmi.related_files import FOLDER
from twin.io.recording import driven
from twin.model import fitted_model

TRUTH = model_of("gravity")
RECORDING = recording_of(TRUTH)
#: The roles that the layered standard knows.
ROLES = "document|model|parameter|testcase|experiment/validation|result|report|meta-data"


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return python_fmu.export(TRUTH, tmp_path_factory.mktemp("fmu") / "arm.fmu")


@pytest.fixture
def fmu(plain: Path, tmp_path: Path) -> Path:
    """An FMU that carries a recording whole, and a part of it."""
    copy = tmp_path / "arm.fmu"
    copy.write_bytes(plain.read_bytes())
    trials = [Trial(RECORDING), Trial(RECORDING.part(1.0, 3.0), 0.5)]
    evidence.attach(copy, trials, {"says": "sound"}, "<!DOCTYPE html><p>the report</p>")
    return copy


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_what_goes_in_comes_out(fmu: Path) -> None:
    trials, figures = evidence.carried(fmu)
    assert [t.judged_from for t in trials] == [0.0, 0.5]
    for trial, given in zip(trials, (RECORDING, RECORDING.part(1.0, 3.0)), strict=True):
        for name in ("time", "input", "output"):
            assert np.array_equal(getattr(trial.recording, name), getattr(driven(given), name), equal_nan=True)
        assert trial.recording.resolution == given.resolution
    for trial, found in zip(trials, figures, strict=True):
        again = misfit(trial.recording, python_fmu.replay(fmu, trial.recording), since=trial.judged_from)
        assert (again.rmse, again.peak) == (found["rmse"], found["peak"])
    assert figures[0]["rmse"] == pytest.approx(RECORDING.resolution / np.sqrt(12.0), rel=0.1)


def test_a_part_amid_the_motion_is_judged_from_its_first_reading(tmp_path: Path) -> None:
    """The lag of an FMU starts at rest, that of the axis does not."""
    model = model_of("motor_lag").with_values({"lag_time": 0.05, "viscous_friction": 6.0})
    made = python_fmu.export(model, tmp_path / "lagged.fmu")
    part = recording_of(model).part(1.0, 4.0)
    assert evidence.judge(made, Trial(part))["peak"] > 0.03
    assert evidence.judge(made, Trial(part, 1.0))["peak"] < 0.003


def test_the_front_door_takes_recordings_as_evidence(fmu: Path, tmp_path: Path) -> None:
    made = twin.export_fmu(TRUTH, tmp_path / "made.fmu", evidence=RECORDING)
    assert len(evidence.carried(made)[0]) == 1
    with pytest.raises(BadInput, match="has its input in %"):
        twin.export_fmu(TRUTH, tmp_path / "none.fmu", evidence=[replace(RECORDING, input_unit="V")])
    assert not (tmp_path / "none.fmu").exists()


def test_other_importers_load_it_and_play_the_recording(fmu: Path, tmp_path: Path) -> None:
    assert validate_fmu(str(fmu)) == []
    table = tmp_path / "1.csv"
    table.write_bytes(members(fmu)[f"{FOLDER}/recordings/1.csv"])
    run = json.loads(members(fmu)[f"{FOLDER}/{evidence.EXPERIMENT}"])["runs"][0]
    played = fmpy.simulate_fmu(
        str(fmu), input=read_csv(table), start_values=run["start"], output=[run["output"]], output_interval=0.002,
        stop_time=1.0, use_event_mode=False,
    )  # fmt: skip
    seen = np.interp(RECORDING.time[:500], played["time"], played[run["output"]])
    assert np.nanmax(np.abs(seen - RECORDING.output[:500])) < 0.05


def test_the_manifest_lists_every_file_with_a_role_of_the_standard(fmu: Path) -> None:
    inside = members(fmu)
    root = ET.fromstring(inside[f"{FOLDER}/fmi-ls-manifest.xml"])
    space = "{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-"
    assert root.tag == "fmiReferences" and root.get(f"{space}name") == "org.fmi-standard.fmi-ls-ref"
    assert {f"{space}version", f"{space}description"} <= set(root.keys())
    listed = {node.get("source"): node.get("role") for node in root}
    assert all(re.fullmatch(ROLES, role or "") for role in listed.values())
    there = {n.removeprefix(f"{FOLDER}/") for n in inside if n.startswith(FOLDER)} - {"fmi-ls-manifest.xml"}
    assert set(listed) == there
    assert listed["report.html"] == "report" and b"the report" in inside[f"{FOLDER}/report.html"]
    assert b"report.html" in inside["documentation/fmi-ls-ref.txt"]
    figures = ET.fromstring(inside[f"{FOLDER}/{evidence.FIGURES}"])
    assert figures.tag.endswith("SimulationResourceMetaData") and len(figures) == 2


def test_the_same_evidence_is_the_same_bytes_and_replaces_the_old(
    fmu: Path, plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = members(plain)
    assert {name: members(fmu)[name] for name in old} == old
    before = fmu.read_bytes()
    evidence.attach(fmu, [Trial(RECORDING)])
    assert len(evidence.carried(fmu)[0]) == 1
    assert not {f"{FOLDER}/recordings/2.csv", f"{FOLDER}/report.html"} & set(members(fmu))
    trials = [Trial(RECORDING), Trial(RECORDING.part(1.0, 3.0), 0.5)]
    evidence.attach(fmu, trials, {"says": "sound"}, "<!DOCTYPE html><p>the report</p>")
    other = tmp_path / "other.fmu"
    other.write_bytes(plain.read_bytes())
    evidence.attach(other, trials, {"says": "sound"}, "<!DOCTYPE html><p>the report</p>")
    assert other.read_bytes() == before
    assert members(fmu) == members(other)
    assert "generationDateAndTime" not in open_fmu(plain).description.attrib
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    dated = python_fmu.export(TRUTH, tmp_path / "dated.fmu")
    assert open_fmu(dated).description.get("generationDateAndTime") == "1970-01-02T00:00:00Z"


def test_an_update_keeps_what_it_replaces_in_the_history(fmu: Path) -> None:
    first = TRUTH.with_values({"gravity_gain": 2.0})
    python_fmu.update(fmu, first)
    python_fmu.update(fmu, first)  # nothing is replaced
    python_fmu.update(fmu, TRUTH.with_values({"gravity_gain": 1.0}))
    inside = members(fmu)
    history = sorted(n.removeprefix(f"{FOLDER}/history/") for n in inside if "/history/" in n)
    assert history == ["0001.ssv", "0001.toml", "0002.ssv", "0002.toml"]
    kept = [fitted_model.loads(inside[f"{FOLDER}/history/000{i}.toml"].decode(), "history") for i in (1, 2)]
    assert [m.values["gravity_gain"] for m in kept] == [TRUTH.values["gravity_gain"], 2.0]
    assert kept[0].std("gravity_gain") == TRUTH.std("gravity_gain")
    assert len(evidence.carried(fmu)[0]) == 2 and validate_fmu(str(fmu)) == []
    assert "--evidence LOG" in evidence.of_old_parameters(fmu)


def test_an_fmu_without_evidence_has_none_of_old_parameters(tmp_path: Path) -> None:
    assert evidence.of_old_parameters(python_fmu.export(TRUTH, tmp_path / "plain.fmu")) == ""


def test_a_long_recording_is_cut(fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evidence, "MOST_STAMPS", 700)
    evidence.attach(fmu, [Trial(RECORDING), Trial(RECORDING)])
    trials, _ = evidence.carried(fmu)
    assert [len(t.recording.time) for t in trials] == [700]


def test_who_made_it_is_in_the_description(fmu: Path) -> None:
    origin = {"author": "A & <B>", "version": "2.1", "license": 'CC "BY"'}
    python_fmu.set_origin(fmu, origin)
    root = open_fmu(fmu).description
    assert {name: root.get(name) for name in origin} == origin
    assert validate_fmu(str(fmu)) == []


SPOILT = {
    "experiment.json": [b"", b"[]", b"{", b"\xff", b'{"format": "twin-experiment/1", "runs": [1]}',
                        b'{"format": "twin-experiment/1", "runs": [{"recording": "../../model.toml"}]}',
                        b'{"format": "twin-experiment/1", "runs": []}'],
    "validation.json": [b"null", b'{"format": "twin-validation/1", "runs": [{"rmse": null, "peak": 1}]}',
                        b'{"format": "twin-validation/1", "runs": []}'],
    "recordings/1.csv": [b"", b"time,duty,position_measured\n", b"a\n0,0\n", b"a\n1,0,0\n0,0,0\n",
                         b"a\n0,nan,0\n1,0,0\n", b"a\nx,0,0\n", b"\xff\n0,0,0\n1,0,0\n"],
}  # fmt: skip


@pytest.mark.parametrize(("source", "content"), [(s, c) for s, spoilt in SPOILT.items() for c in spoilt])
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_evidence_that_cannot_be_read_is_refused(fmu: Path, source: str, content: bytes) -> None:
    fmu.write_bytes(rewritten(open_fmu(fmu), {f"{FOLDER}/{source}": content}))
    with pytest.raises(BadInput, match=r"evidence|experiment\.json"):
        evidence.carried(fmu)


def test_an_fmu_without_a_recording_says_so(plain: Path) -> None:
    with pytest.raises(BadInput, match="carries no recording"):
        evidence.carried(plain)


def test_a_recording_of_another_rig_is_refused_and_leaves_the_fmu(fmu: Path) -> None:
    before = fmu.read_bytes()
    with pytest.raises(BadInput, match="has its input in %"):
        evidence.attach(fmu, [Trial(replace(RECORDING, input_unit="V"))])
    assert fmu.read_bytes() == before
