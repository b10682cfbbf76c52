"""What a first model takes over: of a change that it has numbers for everything, of one that it has none for little."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

import absorbed
import circuit_rig
import concealed
from absorbed import left, main, summary
from blind_trial import Answer, Label, Outcome, Planted, draw, seal, write
from concealed import Concealed, unabsorbed, visibility
from excitations import EXCITATIONS, FREE
from simulators import SIMULATORS


def opened(kind: str = "single", trial: int = 3, said: str = "") -> Outcome:
    """A trial of the fast simulator, and an answer to it."""
    label = draw(5, trial, (kind,), 4.0, "circuit").label
    findings = ((said, 0.9),) if said else ()
    verdict = "explained" if said else "nothing_missing"
    return Outcome(label, "salt", seal(label, "salt"), Answer(verdict, findings, 1.0, 0.1, 1.0), 0.1)


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_a_rig_s_own_numbers_can_be_chosen_anew(simulator: str) -> None:
    source = SIMULATORS[simulator]
    for seed in range(20):
        rig = source.draw_rig(np.random.default_rng(seed))
        moved = rig.with_(**{n: 0.9 * value for n, (value, _) in rig.own.items()})
        assert all(moved.own[n][0] == 0.9 * value < most for n, (value, most) in rig.own.items())
        assert moved.counts_per_revolution == rig.counts_per_revolution


def test_a_torque_that_dead_bands_may_be_is_taken_over_and_a_shake_is_not() -> None:
    rig = circuit_rig.draw_rig(np.random.default_rng(2))
    time, duty = EXCITATIONS["square"](8.0, np.random.default_rng(1), FREE)
    torque = 0.1 * rig.half_torque
    shake = {"shake": torque, "shake_frequency": 1.3, "shake_phase": 0.2}
    of = {"constant_offset": {"offset_motor": torque}, "periodic_disturbance": shake}
    seen, kept = {}, {}
    for id, parameters in of.items():
        effects = [Concealed(id, parameters)]
        seen[id] = visibility(circuit_rig.simulate, rig, effects, time, duty, 7)
        kept[id] = unabsorbed(circuit_rig.simulate, rig, effects, time, duty, 7)
    assert min(seen.values()) > 3.0
    assert kept["constant_offset"] < 0.1 * seen["constant_offset"]
    assert kept["periodic_disturbance"] > 0.7 * seen["periodic_disturbance"]


def test_what_is_left_is_that_of_a_linear_oracle(monkeypatch: pytest.MonkeyPatch) -> None:
    """An axis that only runs at a speed, with a gain of its own: of a change along the gain nothing is left, of one
    across it all, and of one at an angle its sine."""
    rng = np.random.default_rng(0)
    time = 0.002 * np.arange(2000)
    along, across, noise = (np.cumsum(rng.standard_normal(len(time))) for _ in range(3))

    class Rig:
        counts_per_revolution = 2.0 * np.pi

        def __init__(self, gain: float = 1.0) -> None:
            self.own = {"gain": (gain, np.inf)}
            self.gain = gain

        def with_(self, gain: float) -> Rig:
            return Rig(gain)

    def simulate(rig, effects, time, duty, seed):
        position = rig.gain * along + 0.1 * noise * (seed - 1)
        for e in effects:
            position = position + e.parameters["along"] * along + e.parameters["across"] * across
        return type("Run", (), {"position": position})

    def travel(x):
        return (x[250:] - x[:-250])[:: concealed.THIN]

    a, b, n = travel(along), travel(across), travel(0.1 * noise)
    for one, other in ((0.3, 0.0), (0.0, 0.4), (0.2, 0.4)):
        got = unabsorbed(simulate, Rig(), [Concealed("x", {"along": one, "across": other})], time, time, 1)
        rest = other * (b - a * (a @ b) / (a @ a))
        want = np.sqrt(np.mean(rest**2)) / max(np.sqrt(np.mean(n**2)), 0.5)
        assert got == pytest.approx(want, rel=1e-3, abs=1e-6)


def test_each_visible_trial_is_computed_once(tmp_path, monkeypatch, capsys) -> None:
    found = [opened(trial=t) for t in range(3, 9)]
    visible = [o for o in found if o.visible]
    assert 0 < len(visible) < len(found)
    for o in found:
        write(tmp_path / "trials.jsonl", o)
    arguments = [str(tmp_path / "trials.jsonl"), "--json", str(tmp_path / "left.jsonl"), "--processes", "1"]
    monkeypatch.setattr(absorbed, "KINDS", ("single",))
    monkeypatch.setattr(absorbed, "ProcessPoolExecutor", lambda *_: ThreadPoolExecutor(1))
    main(arguments)
    first = capsys.readouterr().out
    assert len((tmp_path / "left.jsonl").read_text(encoding="utf-8").splitlines()) == len(visible)
    monkeypatch.setattr(absorbed, "left", None)
    main(arguments)
    assert capsys.readouterr().out == first and "said nothing" in first


def test_a_trial_that_is_drawn_otherwise_is_refused(tmp_path, monkeypatch, capsys) -> None:
    one = next(o for o in (opened(trial=t) for t in range(3, 9)) if o.visible)
    other = replace(one.label, trial=one.label.trial + 1)
    with pytest.raises(ValueError, match="is drawn otherwise here"):
        left(other)
    write(tmp_path / "trials.jsonl", replace(one, label=other, seal=seal(other, "salt")))
    monkeypatch.setattr(absorbed, "ProcessPoolExecutor", lambda *_: ThreadPoolExecutor(1))
    with pytest.raises(SystemExit) as stopped:
        main([str(tmp_path / "trials.jsonl"), "--json", str(tmp_path / "left.jsonl")])
    assert stopped.value.code == 2 and "is drawn otherwise here" in capsys.readouterr().err
    assert not (tmp_path / "left.jsonl").exists()


def test_the_tables_divide_by_what_is_left() -> None:
    label = Label(1, 0, "circuit", "single", "rich", 20.0, {}, (Planted("gravity", 0.1, 9.0, {}),))

    def answered(trial: int, said: str) -> Outcome:
        own = replace(label, trial=trial)
        return Outcome(own, "s", seal(own, "s"), Answer("explained", ((said, 0.9),), 1.0, 0.1, 1.0), 0.1)

    right, wrong, hidden = answered(0, "gravity"), answered(1, "spring"), answered(2, "spring")
    text = summary([right, wrong, hidden], {right.seal: (5.0,), wrong.seal: (4.0,), hidden.seal: (0.5,)})
    rows = {row[:48].strip(): row[49:] for row in text.splitlines()}
    assert rows["single, at least 3 is left, exact set"].startswith("50.0 % (1 of 2")
    assert rows["single, less is left, exact set"].startswith("0.0 % (0 of 1")
    assert "circuit 2: gravity 9 0.5; said spring" in text and "circuit 0" not in text
