"""Rules are switched off one by one and stand again after it; the table counts what became right or wrong."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import ablation
from ablation import RULES, Asked

from twin.diagnosis import verdict
from twin.diagnosis.adequacy import Adequacy, Comparison, FreeRun


@pytest.mark.parametrize("name", RULES)
def test_a_rule_is_off_inside_and_stands_again_after_it(name: str) -> None:
    rule = RULES[name]
    stood = getattr(rule.module, rule.name)
    with ablation.without(name):
        assert getattr(rule.module, rule.name) is rule.without and rule.without is not stood
    assert getattr(rule.module, rule.name) is stood


def test_the_table_counts_answers_that_became_right_or_wrong() -> None:
    asked = [
        Asked("a", "", True, ("gravity",), "explained"),
        Asked("a", "veto", False, ("spring",), "explained"),
        Asked("a", "min_gain", True, ("gravity",), "explained"),
        Asked("b", "", False, (), "nothing_missing"),
        Asked("b", "veto", True, ("spring",), "explained"),
        Asked("b", "curves", False, (), "nothing_missing", acted=False),
        Asked("b", "min_gain", False, (), "unexplained"),
    ]
    rows = {line.split("  ")[0]: line.split()[-5:] for line in ablation.table(asked).splitlines()[1:]}
    assert rows[RULES["veto"].says] == ["2", "2", "2", "1", "1"]
    assert rows[RULES["min_gain"].says] == ["2", "2", "1", "0", "0"]
    assert rows[RULES["curves"].says] == ["1", "0", "0", "0", "0"]


@pytest.mark.parametrize(("after", "vetoes"), [(0.9, True), (0.1, False)])
def test_a_rule_has_acted_where_it_says_other_than_what_stands_without_it(after: float, vetoes: bool) -> None:
    numbers = {name for name, rule in RULES.items() if not callable(rule.without)}
    runs = Comparison(FreeRun(0.3, 0.3, 0.5, 0.6), FreeRun(after, 0.1, 1e-9, 0.2), 5.0)
    with ablation.watched() as acted:
        assert acted == numbers
        assert verdict.vetoed(Adequacy({"holdout": runs})) is vetoes
        assert acted - numbers == ({"veto"} if vetoes else set())
