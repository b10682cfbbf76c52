"""Effects that mask each other: the concealed one is named and its mask is not.

All groups with all candidates are a study, `scripts/masked_pairs.py`. Here stand a lag among what it is confused with,
and a wide dead-band beside dry friction, of which the answer is that nothing is missing.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="the recordings' generator needs the extra 'mujoco'")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import masked_pairs
from masked_pairs import DEAD_BANDS, Answer


@pytest.mark.parametrize(
    ("concealed", "candidates"),
    [("motor_lag", ("input_delay", "motor_lag")), ("dead_band", ("coulomb_friction",))],
)
def test_the_true_one_is_named_and_its_mask_is_not(concealed: str, candidates: tuple[str, ...]) -> None:
    answer, found = masked_pairs.ask((concealed,), candidates)
    assert answer.right, masked_pairs.line(answer)
    assert found.telling == "masked"


LAG = Answer(("motor_lag",), (("motor_lag", 0.97),), frozenset(), "explained", (1.0, 1.0))
PAIR = ("drive_saturation", "quadratic_drag")


@pytest.mark.parametrize(
    ("answer", "right"),
    [
        (LAG, True),
        (replace(LAG, named=()), False),
        (replace(LAG, named=(("motor_lag", 0.8),)), False),
        (replace(LAG, named=(("motor_lag", 0.97), ("input_delay", 0.5))), False),
        (replace(LAG, undecided=frozenset({"motor_lag", "input_delay"})), False),
        (replace(LAG, named=(("motor_lag", 0.97), ("gravity", 0.95))), True),
        (replace(LAG, concealed=("dead_band",), named=(), verdict="nothing_missing", dead_bands=DEAD_BANDS), True),
        (replace(LAG, concealed=("dead_band",), named=(), verdict="nothing_missing"), False),
        (replace(LAG, concealed=("dead_band",), dead_bands=DEAD_BANDS), False),
        (replace(LAG, concealed=PAIR, named=tuple((i, 0.97) for i in PAIR)), True),
        (replace(LAG, concealed=PAIR, named=((PAIR[0], 0.97),)), False),
    ],
)
def test_an_answer_is_right_only_where_the_mask_is_left_out(answer: Answer, right: bool) -> None:
    """The table of the study would show a wrong one."""
    assert answer.right is right
    assert masked_pairs.line(answer).endswith("right" if right else "WRONG")
