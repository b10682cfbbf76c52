"""What a first model takes over: of a change that it has numbers for everything, of one that it has none for little."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import absorbed
import circuit_rig
import concealed
from absorbed import Left, left, main, summary
from blind_trial import Answer, Label, Outcome, Planted, draw, seal, write
from concealed import Concealed, Trip, unabsorbed, unanswered, visibility
from excitations import EXCITATIONS, FREE
from simulators import SIMULATORS


def opened(trial: int, said: str = "") -> Outcome:
    """A trial of the fast simulator, and an answer to it."""
    label = draw(5, trial, tuple(absorbed.KINDS), 4.0, "circuit").label
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


def test_a_torque_that_dead_bands_may_be_is_taken_over_and_neither_a_shake_nor_an_encoder_is() -> None:
    rig = circuit_rig.draw_rig(np.random.default_rng(2))
    time, duty = EXCITATIONS["square"](5.0, np.random.default_rng(1), FREE)
    torque = 0.1 * rig.half_torque
    shake = {"shake": torque, "shake_frequency": 1.3, "shake_phase": 0.2}
    off_centre = {"eccentricity": 0.05, "eccentricity_phase": 0.4}
    of = {
        "constant_offset": {"offset_motor": torque}, "periodic_disturbance": shake, "encoder_eccentricity": off_centre,
    }  # fmt: skip
    seen, kept = {}, {}
    for id, parameters in of.items():
        effects = [Concealed(id, parameters)]
        seen[id] = visibility(Trip(circuit_rig.simulate, time, duty, 7), rig, effects)
        kept[id] = unabsorbed(Trip(circuit_rig.simulate, time, duty, 7), rig, effects)
    assert min(seen.values()) > 3.0
    assert kept["constant_offset"] < 0.1 * seen["constant_offset"]
    assert kept["periodic_disturbance"] > 0.7 * seen["periodic_disturbance"]
    assert kept["encoder_eccentricity"] > 0.7 * seen["encoder_eccentricity"]


def test_what_is_left_is_that_of_a_linear_oracle() -> None:
    """An axis that only runs at a speed, with a gain of its own: of a change along the gain nothing is left, of one
    across it all, and of one at an angle its sine. What stands in its place takes what lies in its plane, at any size.
    """
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
        shown = rig.gain * along + 0.1 * noise * (seed - 1)
        for e in effects:
            shown = shown + e.parameters["along"] * along + e.parameters["across"] * across
        return type("Run", (), {"shown": shown})

    def travel(x):
        return (x[250:] - x[:-250])[:: concealed.THIN]

    a, b, n = travel(along), travel(across), travel(0.1 * noise)
    trip, helps = Trip(simulate, time, time, 1), [Concealed("y", {"along": 0.1, "across": 0.1})]
    no_help = [Concealed("y", {"along": 0.1, "across": 0.0})]
    for one, other in ((0.3, 0.0), (0.0, 0.4), (0.2, 0.4)):
        planted = [Concealed("x", {"along": one, "across": other})]
        rest = other * (b - a * (a @ b) / (a @ a))
        want = np.sqrt(np.mean(rest**2)) / max(np.sqrt(np.mean(n**2)), 0.5)
        assert unabsorbed(trip, Rig(), planted) == pytest.approx(want, rel=1e-3, abs=1e-6)
        assert unanswered(trip, Rig(), planted, [no_help]) == pytest.approx(want, rel=1e-3, abs=1e-6)
        assert unanswered(trip, Rig(), planted, [no_help, helps]) == pytest.approx(0.0, abs=1e-6)
        assert unabsorbed(trip, Rig(), planted, beside=helps) == pytest.approx(0.0, abs=1e-6)


def test_of_two_the_one_may_keep_the_axis_from_the_other() -> None:
    rig = circuit_rig.draw_rig(np.random.default_rng(2))
    time, duty = EXCITATIONS["square"](5.0, np.random.default_rng(1), FREE)
    trip = Trip(circuit_rig.simulate, time, duty, 7)
    reached = float(trip.simulate(rig, [], time, duty, 7).position.max())
    stiff = {"stop_stiffness": 400.0 * rig.half_torque, "stop_damping": 4.0 * rig.half_torque}
    stop = Concealed("end_stop", {"stop_upper": 0.8 * reached, **stiff})
    held = Concealed("constant_offset", {"offset_link": -0.5 * rig.half_torque})
    assert unabsorbed(trip, rig, [stop]) > 3.0
    assert float(trip.simulate(rig, [held], time, duty, 7).position.max()) < 0.8 * reached
    assert unabsorbed(trip, rig, [stop], beside=[held]) < 0.1


def test_a_carrier_grows_with_what_it_carries() -> None:
    carried = Concealed("x", {"a": 2.0, "none": 0.0}, Concealed("y", {"b": 3.0}))
    assert concealed._numbers([carried]) == 2
    (grown,) = concealed._grown([carried], iter([10.0, 100.0]))
    assert grown == Concealed("x", {"a": 200.0, "none": 0.0}, Concealed("y", {"b": 30.0}))


def test_each_visible_trial_is_computed_once(tmp_path, capsys) -> None:
    found = [opened(trial) for trial in (10, 13, 19)]
    visible = [o for o in found if o.visible]
    assert len(visible) == 2
    for o in found:
        write(tmp_path / "trials.jsonl", o)
    arguments = [str(tmp_path / "trials.jsonl"), "--json", str(tmp_path / "left.jsonl"), "--processes", "1"]
    main(arguments)
    first, kept = capsys.readouterr().out, (tmp_path / "left.jsonl").read_bytes()
    assert len(kept.splitlines()) == len(visible)
    main(arguments)
    assert capsys.readouterr().out == first and "said nothing" in first
    assert (tmp_path / "left.jsonl").read_bytes() == kept


def test_a_trial_that_is_drawn_otherwise_is_refused(tmp_path, capsys) -> None:
    one = opened(13)
    assert one.visible
    other = replace(one.label, trial=one.label.trial + 1)
    with pytest.raises(ValueError, match="is drawn otherwise here"):
        left(replace(one, label=other))
    write(tmp_path / "trials.jsonl", replace(one, label=other, seal=seal(other, "salt")))
    with pytest.raises(SystemExit) as stopped:
        main([str(tmp_path / "trials.jsonl"), "--json", str(tmp_path / "left.jsonl"), "--processes", "1"])
    assert stopped.value.code == 2 and "is drawn otherwise here" in capsys.readouterr().err
    assert not (tmp_path / "left.jsonl").exists()


def test_the_tables_divide_by_what_is_left() -> None:
    label = Label(1, 0, "circuit", "single", "rich", 20.0, {}, (Planted("gravity", 0.1, 9.0, {}),))

    def answered(trial: int, said: str) -> Outcome:
        own = replace(label, trial=trial)
        return Outcome(own, "s", seal(own, "s"), Answer("explained", ((said, 0.9),), 1.0, 0.1, 1.0), 0.1)

    right, wrong, hidden = answered(0, "gravity"), answered(1, "spring"), answered(2, "spring")
    remains = {right.seal: Left((5.0,), math.nan), wrong.seal: Left((4.0,), 3.5), hidden.seal: Left((0.5,), 0.4)}
    text = summary([right, wrong, hidden], remains)
    rows = {row[:48].strip(): row[49:] for row in text.splitlines()}
    assert rows["single, at least 3 is left, exact set"].startswith("50.0 % (1 of 2")
    assert rows["single, less is left, exact set"].startswith("0.0 % (0 of 1")
    assert rows["not exact, the answer leaves less than that"].startswith("50.0 % (1 of 2")
    assert "circuit 2: gravity 9 0.5; said spring 0.4" in text and "circuit 0" not in text


def test_an_answer_that_names_too_much_leaves_little_and_a_wrong_one_does_not() -> None:
    wrong = opened(13, said="motor_lag")
    assert wrong.label.names == ("coulomb_friction",) and wrong.visible
    both = (*wrong.answer.findings, ("coulomb_friction", 0.5))
    more = replace(wrong, answer=replace(wrong.answer, findings=both))
    assert left(more).answer < 0.3 * left(wrong).answer
