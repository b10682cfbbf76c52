"""A payload that nobody told of: its ratios come back from a planted change, and from the servo that was recorded."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from example_diagnosis import model_of

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import payload_change  # noqa: E402
from payload_change import Payload  # noqa: E402

DATA = ROOT.parent / "shared" / "data" / "sts3215_pendulum"


def test_a_planted_payload_is_in_the_table_with_its_ratios():
    light, heavy = Payload(0.5, 0.1, 0.0), Payload(1.0, 0.1, 0.0)
    model = replace(model_of("gravity", "coulomb_friction"), notes={}, intervals={})
    over = {n: 0.5 * model.values[n] for n in ("input_gain", "viscous_friction", "coulomb_friction")}
    found = payload_change.pairs({light: model}, {light: model, heavy: model.with_values(over)})
    assert [p.gravity for p in found] == pytest.approx([1.0, 2.0])
    assert found[1].inertia_bounds[0] == pytest.approx(2.0) and found[1].inertia_bounds[1] < 2.0
    same, other = payload_change.table(found).splitlines()[1:]
    assert same.endswith("unchanged") and other.count("2.00 (") == 2
    assert "unchanged in 1 of 1" in payload_change.summary(found)
    assert "interval holds it in 1 of 1" in payload_change.summary(found)


def test_the_servo_says_by_itself_that_its_payload_was_changed(tmp_path):
    if not DATA.exists():
        pytest.skip("the real recordings are not here")
    rig = payload_change.rig_without_loop(tmp_path)
    before, after = (payload_change.files(DATA, repetition) for repetition in ("1", "2"))
    light, heavy = Payload(0.741177, 0.1, 0.036), Payload(0.969, 0.15, 0.05)
    light, heavy = (min(before, key=lambda p, q=q: abs(p.mass - q.mass) + abs(p.arm - q.arm)) for q in (light, heavy))
    twin = {light: payload_change.twin_of(before[light], rig)}
    same, other = payload_change.pairs(twin, {p: payload_change.twin_of(after[p], rig) for p in (light, heavy)})
    assert same.changes.found == ()
    assert other.ratio("gravity_gain")[0] == pytest.approx(other.gravity, rel=0.15)
    assert other.ratio("inertia_ratio")[0] > 1.3
