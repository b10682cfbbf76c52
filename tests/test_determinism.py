"""The same input gives the same bytes, whatever the hash seed, the language, the time zone and the number of cores."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
#: All that a run makes, behind a diagnosis that is there; and before that, a fit by the command line.
SCRIPT = """
import os, sys
from pathlib import Path
cores = sorted(os.sched_getaffinity(0))
os.sched_setaffinity(0, cores[: int(sys.argv[1])])
from twin.cli.main import main
log, model = Path("log.csv"), Path("identified.toml")
assert main(["identify", str(log), "--out", str(model), "--json", "identified.json", "--quiet"]) == 0
from example_diagnosis import example
from twin import pipeline
from twin.fmi import compilers
compilers.has_zig = lambda: False  # one platform is enough here, and five take long
diagnosis = example()
story = pipeline.finish(diagnosis.recordings, diagnosis, Path("out"))
assert not story.failures, story.failures
"""
SETTINGS = {
    "one": {"PYTHONHASHSEED": "0", "LC_ALL": "C", "TZ": "UTC"},
    "two": {"PYTHONHASHSEED": "4242", "LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8", "TZ": "Asia/Kathmandu"},
}


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores are taken away by a call of Linux")
def test_models_fmus_report_and_json_are_the_same_bytes(tmp_path: Path) -> None:
    from example_diagnosis import model_of, recording_of

    recording = recording_of(model_of("gravity"))
    rows = zip(recording.time, recording.input, recording.output, strict=True)
    text = "t,duty,q\n" + "".join(f"{t:.4f},{u:g},{'' if y != y else f'{y:.8f}'}\n" for t, u, y in rows)
    started = []
    for cores, (name, settings) in enumerate(SETTINGS.items(), 1):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "log.csv").write_text(text)
        path = os.pathsep.join((str(TESTS.parent), str(TESTS)))
        more = os.environ | settings | {"SOURCE_DATE_EPOCH": "1700000000", "PYTHONPATH": path}
        told = [sys.executable, "-c", SCRIPT, str(cores)]
        started.append(subprocess.Popen(told, cwd=folder, env=more, stdout=-1, stderr=-1, text=True))
    for process in started:
        out, err = process.communicate()
        assert process.returncode == 0, out + err
    one, two = (
        {str(p.relative_to(tmp_path / name)): p.read_bytes() for p in (tmp_path / name).rglob("*") if p.is_file()}
        for name in SETTINGS
    )
    assert {"identified.toml", "out/report.html", "out/improved-native.fmu", "out/diagnosis.json"} <= set(one)
    assert [name for name in one if one[name] != two.get(name)] == [] and set(one) == set(two)
