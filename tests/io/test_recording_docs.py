"""docs/recording.md says all that a rig file may, and what it shows can be read."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from twin.errors import BadInput
from twin.io import recording, rig_file, units

DOCS = (Path(__file__).parents[2] / "docs" / "recording.md").read_text(encoding="utf-8")
SHOWN = re.findall(r"```toml\n(.*?)```", DOCS, re.S)
COLUMNS = '[input]\ncolumn = "u"\nunit = "%"\n[output]\ncolumn = "y"\nunit = "rad"\n'


@pytest.mark.parametrize("text", SHOWN)
def test_what_is_shown_can_be_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text if "[input]" in text else COLUMNS + text, encoding="utf-8")
    read = rig_file.read_rig(path)
    shown = tomllib.loads(text)
    assert set(shown.get("optional", {})) == set(read.optional)
    assert read.effects == tuple(shown.get("structure", {}).get("effects", ()))
    assert (read.loop is not None) == ("loop" in shown)


def test_every_unit_and_known_quantity_is_told() -> None:
    tables = [units.TIME_UNITS, units.INPUT_UNITS, units.OUTPUT_UNITS, *units.OPTIONAL_UNITS.values()]
    for unit in {u for table in tables for u in table}:
        assert f'"{unit}"' in DOCS
    assert all(f"[optional.{name}]" in DOCS for name in units.OPTIONAL_UNITS)
    assert all(name in DOCS for name in recording.MEANT)


@pytest.mark.parametrize(
    "section", ["", "time", "input", "input.direction", "output", "optional.speed", "loop", "structure"]
)
def test_every_key_is_told(tmp_path: Path, section: str) -> None:
    """What is offered in the place of a key that nobody knows stands in the text."""
    table = {"input": 'column = "u"\nunit = "%"', "output": 'column = "y"\nunit = "rad"', section: 'qqqqqq = "1"'}
    text = "".join(f"[{name}]\n{keys}\n" for name, keys in table.items() if name)
    path = tmp_path / "rig.toml"
    path.write_text(text if section else 'qqqqqq = "1"\n' + text, encoding="utf-8")
    with pytest.raises(BadInput, match="known keys: ") as refused:
        rig_file.read_rig(path)
    for key in str(refused.value).split("known keys: ")[1].split(", "):
        assert re.search(rf"\b{key}\b", DOCS), key
