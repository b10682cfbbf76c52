"""A fleet: each axis as `run` leaves it, a failing one costs itself, what is done stays, a cluster gives the same."""

from __future__ import annotations

import csv
import json
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from example_diagnosis import model_of, simulated

import twin
from twin import pipeline
from twin.batch.api import write_overview
from twin.batch.axis_run import AxisResult, Task, inputs_digest, stored_result
from twin.batch.overview import overview, sentences
from twin.cli.main import main
from twin.io.manifest import read_fleet


def write_recording(path: Path, seed: int) -> None:
    """2 s of an axis of the base model."""
    rng = np.random.default_rng(seed)
    t = 0.002 * np.arange(1000)
    u = np.repeat(np.array([45.0, -40.0, 0.0, 30.0, -50.0, 55.0, 0.0, -35.0]) + rng.uniform(-3.0, 3.0, 8), 125)
    count = 2.0 * np.pi / 10000.0
    y = count * np.round(simulated(model_of(), t, u) / count)
    rows = (f"{a:.3f},{b:.3f},{c:.7f}\n" for a, b, c in zip(t, u, y, strict=True))
    path.write_text("t,duty,position\n" + "".join(rows))


def result(axis: str, friction: float, effects: tuple[str, ...] = ()) -> AxisResult:
    return AxisResult(
        axis, "explained" if effects else "nothing_missing", "The figures support the model.", effects,
        {"viscous_friction": friction, "input_gain": 0.3}, {"viscous_friction": 0.01, "input_gain": 0.003},
        {"viscous_friction": "1/s", "input_gain": "rad/s^2/%"},
    )  # fmt: skip


@pytest.fixture
def made() -> list[AxisResult]:
    rng = np.random.default_rng(7)
    results = [result(f"axis{i}", float(2.0 + 0.1 * rng.normal())) for i in range(11)]
    return [*results, result("late <one>", 4.1, ("gravity",)), AxisResult("dumb", "failed", "No such file.")]


def test_the_axis_that_stands_apart_the_missing_effect_and_the_failure_are_said(made):
    found = overview(made)
    assert found.outliers == {"late <one>": ("viscous_friction",)}
    assert found.missing == {"gravity": ("late <one>",)}
    said = " ".join(sentences(found))
    assert "Axis late <one> stands apart: viscous friction 4.10 1/s" in said
    assert "Axis dumb failed: No such file." in said and "12 of 13 axes" in said
    assert "late <one>" in str(found)


def test_page_and_tables_hold_every_axis(made, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    assert write_overview(overview(made), tmp_path) == ["fleet.html", "fleet.json", "fleet.csv", "fleet.parquet"]
    page = (tmp_path / "fleet.html").read_text(encoding="utf-8")
    assert "late &lt;one&gt;" in page and "late <one>" not in page and 'href="late%20%3Cone%3E/report.html"' in page
    assert page.count('<line class="apart"') == 1 and "dumb/report.html" not in page
    rows = list(csv.DictReader((tmp_path / "fleet.csv").open(encoding="utf-8")))
    table = parquet.read_table(tmp_path / "fleet.parquet").to_pylist()
    assert [r["axis"] for r in rows] == [r["axis"] for r in table] == [r.axis for r in made]
    assert float(rows[11]["viscous_friction"]) == table[11]["viscous_friction"] == 4.1
    assert rows[12]["viscous_friction"] == ""
    answer = json.loads((tmp_path / "fleet.json").read_text())
    assert answer["parameters"]["viscous_friction"]["outliers"] == ["late <one>"]


@pytest.mark.parametrize(
    "text, said",
    [
        ("axis,log\na,x.csv\n", "no column 'file'"),
        ("file\nx.csv\n", "no column 'axis'"),
        ("axis,file\n../up,x.csv\n", "line 2, column 'axis': '../up' cannot name a folder"),
        ("axis,file\n,x.csv\n", "line 2, column 'axis': is empty"),
        ("axis,file\na,x.csv\nfleet.json,x.csv\n", "line 3, column 'axis'"),
        ("axis,file\na,\n", "line 2, column 'file': is empty"),
        ("axis,file,rig\na,x.csv,one.toml\na,y.csv,two.toml\n", "line 3, column 'rig': 'two.toml', where axis a has"),
        ("axis,file,role\na,x.csv,test\n", "line 2, column 'role'"),
    ],
)
def test_a_list_that_cannot_be_used_is_refused_in_one_line(tmp_path, capsys, text, said):
    (tmp_path / "fleet.csv").write_text(text)
    assert main(["fleet", str(tmp_path / "fleet.csv"), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_rows_of_one_axis_are_its_recordings(tmp_path):
    (tmp_path / "fleet.csv").write_text(
        "axis,file,role,payload_mass [g]\n1,a.csv,train,5\n2,b.csv,,\n1,c.csv,holdout,7\n"
    )
    one, two = read_fleet(tmp_path / "fleet.csv")
    assert [(e.path.name, e.role, dict(e.known)) for e in one.entries] == [
        ("a.csv", "train", {"payload_mass": 0.005}), ("c.csv", "holdout", {"payload_mass": 0.007}),
    ]  # fmt: skip
    assert two.name == "2" and two.rig is None


def test_a_result_is_taken_only_for_the_same_inputs(tmp_path):
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(f"t,duty,position\n0,0,{name}\n")
    (tmp_path / "fleet.csv").write_text("axis,file\na,a.csv\nb,b.csv\n")
    a, b = read_fleet(tmp_path / "fleet.csv")
    assert inputs_digest(a) != inputs_digest(b)
    before = inputs_digest(a)
    (tmp_path / "rig.toml").write_text("[time]\n")
    assert inputs_digest(a) != before  # the rig file beside the recording has its part in the result
    assert stored_result(Task(a, tmp_path)) is None


def _processing(address: str) -> int:
    """The process of the worker that is at work."""
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        ids = client.run(os.getpid)
        for _ in range(600):
            busy = [worker for worker, tasks in client.processing().items() if tasks]
            if busy:
                return int(ids[busy[0]])
            time.sleep(0.05)
    raise AssertionError("no worker has begun")


def test_a_cluster_that_loses_a_worker_does_all_axes_and_this_machine_takes_them_over(tmp_path, cluster):
    from concurrent.futures import ThreadPoolExecutor

    write_recording(tmp_path / "good.csv", 1)
    (tmp_path / "fleet.csv").write_text("axis,file\ngood,good.csv\nlost,nowhere.csv\n")
    listing, out = tmp_path / "fleet.csv", tmp_path / "out"
    with ThreadPoolExecutor(1) as pool:
        job = pool.submit(twin.fleet, listing, out, scheduler=cluster.address)
        while not (out / ".good.draft").exists() and not job.done():
            time.sleep(0.02)
        os.kill(_processing(cluster.address), signal.SIGKILL)
        there = job.result()
    assert [r.axis for r in there.failed] == ["lost"] and "nowhere.csv" in there.failed[0].says
    made = {p: p.stat().st_mtime_ns for p in (out / "good").iterdir()}
    assert {p.name for p in made} - {"axis.json"} <= set(pipeline.FILES)
    assert out / "good" / "report.html" in made
    assert not list(out.glob(".*"))  # nor does the worker that died leave anything
    # What is there is not done again, and says the same.
    assert twin.fleet(listing, out).results[0] == there.results[0]
    assert {p: p.stat().st_mtime_ns for p in (out / "good").iterdir()} == made
    # Other inputs ask for another run, which takes the place of the first only where that may go.
    write_recording(tmp_path / "good.csv", 2)
    again = twin.fleet(listing, out)
    assert [r.axis for r in again.failed] == ["good", "lost"] and "force" in again.failed[0].says
