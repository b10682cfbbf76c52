"""The p-value of a free run: uniform where nothing is missing, next to nothing where something is."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import adequacy_study
from adequacy_study import Kind, judge, record, study


@pytest.mark.parametrize("kind", [Kind(gap=False), Kind()], ids=["gapless", "with a gap"])
def test_sound_rigs_have_uniform_chances(kind: Kind) -> None:
    for runs in study(range(1001, 1009), kind, 15.0).values():
        chances = np.array([r.p_value for r in runs])
        assert kstest(chances, "uniform").pvalue > 1e-3
        assert chances.min() > 1e-4


def test_a_missing_offset_has_no_chance() -> None:
    recording, structure, values = record(1003, Kind(gap=False), 15.0)
    pulled = replace(recording, output=recording.output + 0.2 * np.maximum(recording.time - 3.0, 0.0))
    seen, unseen, _ = judge(pulled, structure, values)
    assert min(seen.p_value, unseen.p_value) < 1e-3


def test_the_report_has_a_line_for_each_part(capsys: pytest.CaptureFixture[str]) -> None:
    text = adequacy_study.report(study(range(2), Kind(gap=False), 8.0))
    assert text.count("KS p") == 2
