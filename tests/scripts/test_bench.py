"""The benchmarks run and print every line; how fast that is, is for their reader."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import bench
import fmu_cost
import long_recording
import modestpy_comparison

from twin.diagnosis import diagnose
from twin.io.recording import load


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler is installed")
def test_what_a_step_costs_is_printed(monkeypatch, capsys):
    monkeypatch.setattr(fmu_cost, "PIECES", (1, 3))
    monkeypatch.setattr(fmu_cost, "COMMANDS", [40.0] * 100)
    motor = "first-order motor"
    monkeypatch.setattr(fmu_cost, "STRUCTURES", {motor: fmu_cost.STRUCTURES[motor]})
    fmu_cost.bench_fmu(repeat=1)
    head, *rows = capsys.readouterr().out.splitlines()
    assert head == "first-order motor: us a communication step of 1,  3 internal steps"
    assert [row[2:45].strip() for row in rows] == [
        "bare C loop", "native FMI 2, from C", "native FMI 3, from C", "FMPy's own share, whatever the steps",
        "plainest pythonfmu slave, less FMPy", "pythonfmu FMU, less FMPy", "the same where nothing compiled loads",
    ]  # fmt: skip


def test_time_and_memory_of_a_recording_are_printed(capsys):
    long_recording.bench_long([0.2])
    said = capsys.readouterr().out
    found = re.fullmatch(
        r"twin identify, +0 min, +6000 samples: +\d+ s .* memory +(\d+) MB; .*: (\w+), \S+ %, .*\n", said
    )
    assert found, said
    assert int(found[1]) > 100 and found[2] in long_recording.VALUES


def test_time_of_a_diagnosis_is_printed_by_stage(monkeypatch, capsys):
    found = SimpleNamespace(seconds={"search": 3.0, "x": 0.5})
    monkeypatch.setattr(diagnose, "diagnose", lambda recordings, first: found)
    bench.bench_diagnose(trials=1, seconds=4.0)
    single, one, pair, two = capsys.readouterr().out.splitlines()
    assert single.endswith(": 3.5 s (search 3.0, x 0.5)") and " + " not in single and " + " in pair
    assert one == "single, 4 s at 2 ms: median 3.5 s, longest 3.5 s" and two.startswith("pair, ")


def test_the_fit_that_others_are_compared_with_finds_the_truth(capsys):
    values, seconds = modestpy_comparison.ours(modestpy_comparison.made(3000))
    assert modestpy_comparison.error(values) < 1e-9 and seconds > 0.0


def test_a_missing_modestpy_is_named(tmp_path):
    without = tmp_path / "python"
    without.write_text("#!/bin/sh\nexit 1\n")
    without.chmod(0o755)
    with pytest.raises(SystemExit, match="ModestPy is not installed"):
        modestpy_comparison.theirs(modestpy_comparison.made(100), str(without))


def test_a_short_recording_among_others_is_not_taken_for_reversed(tmp_path: Path) -> None:
    """Two changes of the command in 2 s: by themselves they say the opposite of what all the others say."""
    logs = [long_recording.record(tmp_path, 2.0 / 60.0, seed) for seed in (0, 1, 2, 3, 38)]
    recordings, _ = load(logs, long_recording.RIG)
    assert not [f for r in recordings for f in r.preflight if f.kind == "sign"]
