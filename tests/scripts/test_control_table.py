"""The table of controllers, in small: what a modelling error costs, and what the extended model gives back."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "control_table.py"
spec = importlib.util.spec_from_file_location("control_table", SCRIPT)
assert spec is not None and spec.loader is not None
control_table = importlib.util.module_from_spec(spec)
sys.modules["control_table"] = control_table
spec.loader.exec_module(control_table)


def test_extended_model_controls_as_the_truth_does_and_the_first_one_does_not() -> None:
    found = control_table.table(bandwidth=2.5, seed=1, seconds=12.0)
    smooth = {name: runs[0] for name, runs in found.items()}
    beyond = {name: control_table.overshoot(runs[1]) for name, runs in found.items()}
    assert smooth["extended model"].rms < 1.3 * smooth["true model"].rms
    assert smooth["first model"].rms > 5.0 * smooth["true model"].rms
    assert smooth["PID (SIMC)"].rms > 5.0 * smooth["true model"].rms
    assert beyond["first model"] > beyond["extended model"]


def test_gap_aware_mode_ends_what_the_describing_function_predicts() -> None:
    found = control_table.hunting(rings=235.0, damping=1.3, gap=0.02)
    assert found.verdict == "confirmed" and found.aware is None
    assert found.unaware.amplitude == pytest.approx(found.predicted.amplitude, rel=0.25)
