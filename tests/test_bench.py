"""The benchmark of the FMU runs and prints every line; how fast that is, is for its reader."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

import fmu_cost


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
