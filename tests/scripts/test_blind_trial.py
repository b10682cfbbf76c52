"""The judge is judged: seals, draws, the arithmetic on answers of known quality, and two trials of the whole."""

from __future__ import annotations

import hashlib
import json
import math
import re
import sys
from concurrent.futures import Future
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import blind_trial
import mujoco_rig
from blind_trial import (
    FAILED,
    FLOOR,
    KINDS,
    NOTHING,
    UNKNOWN,
    Answer,
    Label,
    Outcome,
    Planted,
    Study,
    calibration_error,
    chance_error,
    claims,
    confusion,
    main,
    make,
    read,
    reliability,
    seal,
    share,
    summary,
    write,
)
from concealed import Trip
from mujoco_rig import OUTSIDE, VOCABULARY
from simulators import SIMULATORS


def outcome(
    truth: dict[str, float],
    said: dict[str, float],
    verdict: str = "explained",
    kind: str = "single",
    errors: tuple[float, float, float] = (1.0, 0.1, 0.1),
) -> Outcome:
    """Truth: id to visibility; said: id to probability; errors: before, after, possible."""
    planted = tuple(Planted(i, 0.1, v, {"torque": 1.0}) for i, v in truth.items())
    label = Label(1, 0, "mujoco", kind, "rich", 20.0, {"backlash": 0.1}, planted)
    answer = Answer(verdict, tuple(said.items()), errors[0], errors[1], 10.0)
    return Outcome(label, "salt", seal(label, "salt"), answer, errors[2])


def line(text: str, start: str) -> str:
    (found,) = [row for row in text.splitlines() if row.startswith(start)]
    return found.removeprefix(start).strip()


def test_the_vocabulary_is_the_tools() -> None:
    from twin.effects.catalogue import CANDIDATES

    for simulator in SIMULATORS.values():
        assert simulator.VOCABULARY == VOCABULARY
        assert set(VOCABULARY) <= set(CANDIDATES)
        assert not set(simulator.OUTSIDE) & set(CANDIDATES)


@pytest.mark.parametrize("simulator", SIMULATORS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_trial_is_drawn_by_seed_and_number_and_shows_its_effects(kind: str, simulator: str) -> None:
    label, salt, recording = make(5, 1, (kind,), 4.0, simulator)
    again, same_salt, same = make(5, 1, (kind,), 4.0, simulator)
    other, other_salt, _ = make(5, 2, (kind,), 4.0, simulator)
    assert (label, salt) == (again, same_salt) and np.array_equal(recording.output, same.output)
    assert seal(label, salt) != seal(other, other_salt)
    assert len(label.effects) == {"single": 1, "pair": 2, "none": 0, "outside": 1}[kind]
    assert len(label.names) == {"single": 1, "pair": 2, "none": 0, "outside": 0}[kind]
    assert label.visibility >= FLOOR and np.ptp(recording.output) > 0.0
    assert recording.time[-1] == pytest.approx(4.0, abs=0.003)
    assert not any(word in repr(vars(recording)) for word in (*VOCABULARY, *OUTSIDE))


def test_a_pair_in_which_one_brings_the_other_is_not_drawn() -> None:
    rng = np.random.default_rng(0)
    drawn = {frozenset(blind_trial._ids(rng, "pair", OUTSIDE)) for _ in range(5000)}
    assert {frozenset({one, "gravity"}) for one in ("coulomb_friction", "stribeck_friction")} <= drawn
    assert frozenset({"coulomb_friction", "stribeck_friction"}) not in drawn


def test_an_effect_that_cannot_show_is_not_planted() -> None:
    """On a rig that moves the same with it and without."""
    label, _, recording = make(5, 1, ("none",), 6.0)
    rig = mujoco_rig.Rig(**label.rig)
    runs = {seed: mujoco_rig.simulate(rig, [], recording.time, recording.input, seed) for seed in (1, 2)}
    sizes = []

    def simulate(rig, effects, time, duty, seed):
        sizes.extend(e.parameters["gain"] for e in effects)
        return runs[seed]

    numb = SimpleNamespace(draw_effect=mujoco_rig.draw_effect, simulate=simulate)
    rng, trip = np.random.default_rng(0), Trip(simulate, recording.time, recording.input, 1)
    assert blind_trial._plant(rng, "gravity", numb, rig, trip, 6.0) is None
    assert len(sizes) == blind_trial.REDRAWS and np.all(np.diff(sizes) > 0.0)


def test_the_seal_is_sha256_of_label_and_salt_and_binds_both(tmp_path: Path) -> None:
    one = outcome({"gravity": 10.0}, {"gravity": 0.9})
    assert one.seal == hashlib.sha256((one.label.text() + "salt").encode()).hexdigest()
    path = tmp_path / "trials.jsonl"
    failed = outcome({"spring": 4.0}, {}, FAILED, errors=(math.nan,) * 3)
    write(path, one)
    write(path, failed)
    assert read(path)[0] == one and read(path)[1].label == failed.label and math.isnan(read(path)[1].possible)
    for old, new in (('"gravity"', '"spring"'), ('"salt": "salt"', '"salt": "pepper"')):
        path.write_text(json.dumps(json.loads(json.dumps(asdict(one)).replace(old, new))) + "\n", encoding="utf-8")
        with pytest.raises(ValueError, match="trial 0: label and salt do not give the seal"):
            read(path)
    write(tmp_path / "twice.jsonl", one)
    write(tmp_path / "twice.jsonl", one)
    with pytest.raises(SystemExit) as stopped:
        main(["--summarise", str(tmp_path / "twice.jsonl")])
    assert stopped.value.code == 2


@pytest.mark.parametrize(
    ("truth", "said", "verdict", "kind", "first", "exact"),
    [
        (["gravity"], ["gravity"], "explained", "single", True, True),
        (["gravity"], ["gravity", "spring"], "explained", "single", True, False),
        (["gravity"], ["spring", "gravity"], "explained", "single", False, False),
        (["gravity"], [], "nothing_missing", "single", False, False),
        (["gravity"], [], "unexplained", "single", False, False),
        (["stribeck_friction"], ["stribeck_friction"], "explained", "single", True, True),
        (["stribeck_friction"], ["coulomb_friction"], "explained", "single", False, False),
        (["gravity", "motor_lag"], ["motor_lag"], "partly_explained", "pair", True, False),
        (["gravity", "motor_lag"], ["motor_lag", "gravity"], "explained", "pair", True, True),
        ([], [], "nothing_missing", "none", True, True),
        ([], [], "unexplained", "none", False, False),
        ([], [], FAILED, "none", False, False),
        ([], ["gravity"], "explained", "none", False, False),
        (["other_speed_hump"], [], "unexplained", "outside", True, True),
        (["other_speed_hump"], [], "nothing_missing", "outside", False, False),
        (["other_speed_hump"], ["gravity"], "explained", "outside", False, False),
    ],
)
def test_right_and_wrong(truth, said, verdict, kind, first, exact) -> None:
    o = outcome(dict.fromkeys(truth, 9.0), dict.fromkeys(said, 0.9), verdict, kind)
    assert (o.first_right, o.exact) == (first, exact)


def test_calibration_of_claims_that_are_as_right_as_they_say_and_of_boasts() -> None:
    rng = np.random.default_rng(0)
    given = rng.uniform(0.0, 1.0, 20000)
    honest = [(float(p), bool(rng.uniform() < p)) for p in given]
    assert calibration_error(honest) < 0.02
    boasts = [(p, right and rng.uniform() < 0.5) for p, right in honest]
    assert calibration_error(boasts) == pytest.approx(0.25, abs=0.02)
    assert sum(n for n, _, _ in reliability(honest)) == len(honest) and len(reliability(honest)) == 10
    assert reliability([(1.0, True), (0.95, False)]) == [(2, pytest.approx(0.975), 0.5)]
    assert math.isnan(calibration_error([]))


def test_what_chance_makes_of_few_claims_that_are_as_right_as_they_say() -> None:
    """Twenty claims of a half miss it by as much as a coin thrown twenty times does: sqrt(2 / pi) standard errors."""
    few = [(0.55, False)] * 20
    assert chance_error(few, 2000) == pytest.approx(math.sqrt(2.0 / math.pi * 0.55 * 0.45 / 20), rel=0.05)
    assert chance_error([(1.0, False)] * 20) == 0.0 and math.isnan(chance_error([]))


def test_a_name_on_a_null_rig_or_for_a_nameless_effect_is_a_wrong_claim() -> None:
    outcomes = [
        outcome({}, {"gravity": 0.8}, kind="none"),
        outcome({"other_speed_hump": 9.0}, {"spring": 0.7}, kind="outside"),
        outcome({"gravity": 1.5}, {"gravity": 0.6}),
    ]
    assert claims(outcomes) == [(0.8, False), (0.7, False), (0.6, True)]


def test_share_has_its_interval() -> None:
    # Wilson's interval solved as its definition says: |p - k/n| = z sqrt(p (1 - p) / n).
    low, high = (float(x) for x in share([True] * 90 + [False] * 10).split(";")[1].rstrip(" %)").split(" to "))
    for p in (low, high):
        assert abs(p / 100 - 0.9) == pytest.approx(1.96 * math.sqrt(p / 100 * (1 - p / 100) / 100), abs=0.008)
    assert share([]) == "- (none drawn)"


def test_the_summary_counts_visible_and_faint_apart() -> None:
    outcomes = [
        *[outcome({"gravity": 10.0}, {"gravity": 0.9}) for _ in range(3)],
        outcome({"gravity": 10.0}, {"spring": 0.9}, errors=(1.0, 0.55, 0.1)),
        outcome({"gravity": 1.5}, {}, "nothing_missing"),
        outcome({"gravity": 9.0, "motor_lag": 2.0}, {"gravity": 0.9}, kind="pair"),
        outcome({"gravity": 9.0, "motor_lag": 3.0}, {"gravity": 0.9, "motor_lag": 0.9}, kind="pair"),
        outcome({}, {}, "nothing_missing", "none"),
        outcome({}, {"spring": 0.9}, "explained", "none"),
        outcome({"other_speed_hump": 9.0}, {}, "unexplained", "outside"),
        outcome({"other_speed_hump": 9.0}, {"spring": 0.3}, "partly_explained", "outside"),
    ]
    text = summary(outcomes)
    for start, expected in (
        ("single, visible, first name right", "75.0 % (3 of 4;"),
        ("single, near the floor, exact set", "0.0 % (0 of 1;"),
        ("pair, visible, exact set", "100.0 % (1 of 1;"),
        ("pair, near the floor, first name right", "100.0 % (1 of 1;"),
        ("pair, near the floor, exact set", "0.0 % (0 of 1;"),
        ("nothing there, false alarms", "50.0 % (1 of 2;"),
        ("outside, visible, recognised as unknown", "50.0 % (1 of 2;"),
        ("outside, visible, that or partly explained", "100.0 % (2 of 2;"),
        ("single, visible, hold-out improvement, median", "100.0 % (of 4 trials)"),
    ):
        assert line(text, start).startswith(expected), start
    assert outcomes[3].achieved == pytest.approx(0.5)
    assert math.isnan(outcome({"gravity": 9.0}, {}, errors=(1.0, 1.0, 1.2)).achieved)


def test_what_is_said_not_to_be_told_apart_is_counted_beside_what_is_right() -> None:
    missed = outcome({"constant_offset": 9.0}, {}, "nothing_missing")
    doubtful = replace(missed, answer=replace(missed.answer, undecided=(("dead_band", "constant_offset"),)))
    elsewhere = replace(missed, answer=replace(missed.answer, undecided=(("gravity", "spring"),)))
    assert [o.doubted for o in (missed, doubtful, elsewhere)] == [False, True, False]
    assert not any(o.first_right or o.exact for o in (missed, doubtful, elsewhere))
    singles = summary([missed, doubtful, elsewhere]).split("pair, visible, hold-out")[0]
    assert line(singles, "  all named, or said not to be told apart") == "1 of the 3 not exact"


def test_the_confusion_matrix_holds_every_trial_and_only_what_occurred() -> None:
    outcomes = [
        outcome({"gravity": 9.0}, {"gravity": 0.9}),
        outcome({"gravity": 9.0}, {"spring": 0.9}),
        outcome({"other_speed_hump": 9.0}, {}, "unexplained", "outside"),
        outcome({}, {}, "nothing_missing", "none"),
    ]
    head, *rows = confusion(outcomes).splitlines()
    columns = [int(n) for n in head.split()]
    names = {int(row.split()[0]): row.split()[1] for row in rows}
    assert set(names.values()) == {NOTHING, "gravity", "spring", "other_speed_hump", UNKNOWN}
    cells = {
        (row.split()[1], names[column]): int(cell)
        for row in rows
        for column, cell in zip(columns, row.split()[2:], strict=True)
        if cell != "."
    }
    assert cells == {
        ("gravity", "gravity"): 1,
        ("gravity", "spring"): 1,
        ("other_speed_hump", UNKNOWN): 1,
        (NOTHING, NOTHING): 1,
    }


class Witness:
    """In the pool's place: keeps what the tool is given, and answers as told."""

    def __init__(self, *answers: Answer) -> None:
        self.given: list[tuple[object, ...]] = []
        self.answers = list(answers)

    def submit(self, work: object, *given: object) -> Future[Answer]:
        assert work is blind_trial.ask
        self.given.append(given)
        future: Future[Answer] = Future()
        future.set_result(self.answers.pop(0))
        return future


def test_the_tool_gets_the_recording_alone_and_the_truth_only_after_a_wrong_answer() -> None:
    label, _, recording = make(5, 8, ("single",), 4.0)
    (name,) = label.names
    right = Answer("explained", ((name, 0.9),), 1.0, 0.1, 1.0)
    wrong = Answer("nothing_missing", (), 1.0, 0.7, 1.0)
    for answers, possible in (((right,), 0.1), ((wrong, right), 0.1), ((wrong, wrong), math.nan)):
        pool = Witness(*answers)
        opened = blind_trial._trial(pool, Study(5, ("single",), 4.0, "mujoco"), 8)
        assert opened.answer is answers[0] and opened.possible == pytest.approx(possible, nan_ok=True)
        (alone,), *after = pool.given
        assert np.array_equal(alone.output, recording.output) and [names for _, names in after] == [(name,)] * (
            len(answers) - 1
        )


def test_two_trials(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "trials.jsonl"
    options = ["--trials", "2", "--seed", "3", "--duration", "6", "--processes", "1", "--kinds", "single,none"]
    main([*options, "--json", str(path)])
    printed = capsys.readouterr().out
    outcomes = read(path)
    assert sorted(o.label.trial for o in outcomes) == [0, 1]
    for o in outcomes:
        sealed, opened = printed.index(f"sealed {o.seal}"), printed.index(f"label {o.label.text()} salt {o.salt}")
        assert sealed < opened
        label, salt, _ = make(3, o.label.trial, ("single", "none"), 6.0)
        assert (label, salt) == (o.label, o.salt)
        assert o.answer.verdict != FAILED and o.answer.before > 0.0 and o.answer.after > 0.0, o.answer
    assert not any(word in printed[: printed.index("opened")] for word in VOCABULARY)
    main(["--summarise", str(path)])
    assert capsys.readouterr().out.strip() in printed


def test_a_tool_that_fails_loses_the_trial_and_not_the_study() -> None:
    recording = make(5, 1, ("none",), 4.0)[2]
    answer = blind_trial.ask(replace(recording, output=recording.output[:0]))
    assert (answer.verdict, answer.first) == (FAILED, FAILED)
    assert re.fullmatch(r"\w+Error: .+", answer.says)
    lost = replace(outcome({}, {}, kind="none"), answer=answer)
    assert not lost.exact and answer.says in summary([lost])
