"""What a file brings in its names reaches the terminal as text, never as a command to it."""

import unicodedata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.cli.main import main
from twin.cli.output import printable


@given(st.text())
def test_no_control_character_is_sent(text: str) -> None:
    sent = printable(text)
    assert not {c for c in sent if unicodedata.category(c) in ("Cc", "Cf", "Cs")} - {"\n", "\t"}
    assert printable(sent) == sent


@given(st.text(st.characters(categories=["L", "N", "P", "S"])))
def test_letters_numbers_and_signs_are_sent_as_they_are(text: str) -> None:
    assert printable(text) == text


def test_escape_sequences_in_a_name_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log.csv").write_text("t,duty,\x1b]0;owned\x07\x1b[31mred\n0,1,2\n1,2,3\n")
    assert main(["identify", str(tmp_path / "log.csv"), "--out", str(tmp_path / "m.toml")]) == 2
    said = capsys.readouterr().err
    assert "\x1b" not in said and "\x07" not in said
    assert r"\x1b]0;owned\x07\x1b[31mred" in said
