"""The gallery's recordings are of the kinds that it shows."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import gallery

import twin


@pytest.mark.parametrize("name", gallery.CASES)
def test_each_recording_can_be_loaded_and_has_the_faults_that_were_planted(tmp_path: Path, name: str) -> None:
    (recording,) = twin.load(gallery.record(name, tmp_path / name, 20.0))
    kinds = {f.kind for f in recording.faults}
    assert kinds == ({"freeze", "outlier", "missing"} if name == "faults" else set())
    assert recording.is_speed == (name == "speed-only")
    assert np.ptp(recording.output[np.isfinite(recording.output)]) > 1.0
