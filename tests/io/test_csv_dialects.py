"""Delimited text as loggers, spreadsheets and serial monitors write it: the same numbers come out of every dialect."""

import gzip
import itertools
import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from twin.errors import BadInput
from twin.io.recording import load

RIG = '[time]\ncolumn = "t"\n[input]\ncolumn = "duty"\nunit = "%"\n[output]\ncolumn = "pos"\nunit = "rad"\n'
ROWS = [(0.01 * k, 12.5 * (k // 20 % 2), round(math.sin(0.05 * k), 5)) for k in range(80)]
NAMES = ("t", "duty", "pos")
numbers = itertools.count()


def written(
    rows: Sequence[Sequence[float]] = ROWS, names: Sequence[str] = NAMES, mark: str = ",", comma: bool = False
) -> str:
    lines = [mark.join(names), *(mark.join(f"{value:.12g}" for value in row) for row in rows)]
    text = "\n".join(lines) + "\n"
    return text.replace(".", ",") if comma else text


def columns_of(folder: Path, content: str | bytes, rig: str = RIG, name: str = "log.csv") -> np.ndarray:
    """Time, input and output as they are loaded, a row a sample."""
    path = folder / f"{next(numbers)}" / name
    path.parent.mkdir()
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    (path.parent / "rig.toml").write_text(rig, encoding="utf-8")
    (recording,), _ = load([path])
    return np.column_stack([recording.time, recording.input, recording.output])


HEADS = [
    "",
    "# made by a logger\n# second line\n",
    "ets Jul 29 2019 12:21:46\n\nrst:0x1 (POWERON),boot:0x13\nReady.\n",
    "% 3\n",
]
UNITS = ["", "s{m}%{m}rad\n", "[s]{m}[%]{m}[rad]\n"]
DIALECTS = [(mark, comma) for mark in (";", "\t", ",", "|") for comma in (False, True) if not (mark == "," and comma)]


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(DIALECTS),
    st.sampled_from(HEADS),
    st.sampled_from(UNITS),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"]),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.booleans(),
    st.integers(0, 60),
    st.booleans(),
)
def test_every_dialect_gives_the_same_numbers(
    tmp_path: Path,
    dialect: tuple[str, bool],
    head: str,
    units: str,
    encoding: str,
    newline: str,
    trailing: bool,
    late: int,
    packed: bool,
) -> None:
    """`late` rows are whole numbers, so that a decimal comma shows only below them."""
    mark, comma = dialect
    rows = [(k, 0, 0) for k in range(late)] + [(t + late, u, y) for t, u, y in ROWS]
    text = written(rows, mark=mark, comma=comma)
    names, body = text.split("\n", 1)
    text = f"{head}{names}\n{units.format(m=mark)}{body}"
    if trailing:
        text = head + text.removeprefix(head).replace("\n", f"{mark}\n")
    content = text.replace("\n", newline).encode(encoding)
    found = columns_of(tmp_path, gzip.compress(content) if packed else content, name="log.csv" + ".gz" * packed)
    np.testing.assert_allclose(found, rows, atol=1e-9)


def test_a_line_that_names_the_separator(tmp_path: Path) -> None:
    np.testing.assert_allclose(columns_of(tmp_path, "sep=;\n" + written(mark=";", comma=True)), ROWS, atol=1e-9)


@pytest.mark.parametrize("mark", [",", ";", "\t", " "])
def test_without_a_header_columns_are_called_by_their_numbers(tmp_path: Path, mark: str) -> None:
    text = written(mark=mark).split("\n", 1)[1]
    rig = RIG.replace('"t"', "1").replace('"duty"', "2").replace('"pos"', "3")
    np.testing.assert_allclose(columns_of(tmp_path, text, rig), ROWS, atol=1e-9)


@pytest.mark.parametrize("header", ["# t duty pos", "% t,duty,pos", "// t, duty, pos"])
def test_a_header_in_a_comment(tmp_path: Path, header: str) -> None:
    text = header + "\n" + written(mark=" ").split("\n", 1)[1]
    np.testing.assert_allclose(columns_of(tmp_path, text), ROWS, atol=1e-9)


@pytest.mark.parametrize("cell", ["", "null", "NULL", "None", "N/A", "-", "nan", "#N/A", "inf"])
def test_cells_that_say_that_there_is_no_value(tmp_path: Path, cell: str) -> None:
    lines = written().splitlines()
    for k in range(40, 45):
        lines[k + 1] = lines[k + 1].rsplit(",", 1)[0] + f",{cell}"
    found = columns_of(tmp_path, "\n".join(lines))
    expected = np.array(ROWS)
    expected[40:45, 2] = np.nan
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_last_line_that_breaks_off_is_left_out(tmp_path: Path) -> None:
    np.testing.assert_allclose(columns_of(tmp_path, written() + "0.8,1"), ROWS, atol=1e-9)
    with pytest.raises(BadInput, match="line 82 has 2 cells"):
        columns_of(tmp_path, written() + "0.8,1\n")


@pytest.mark.parametrize("start", ["2024-02-29 23:59:59.5", "12:00:00.000"])
def test_dates_and_times_of_day_are_seconds(tmp_path: Path, start: str) -> None:
    day, _, clock = start.rpartition(" ")
    lines = ["t,duty,pos"]
    for t, u, y in ROWS:
        seconds = sum(60**k * float(x) for k, x in enumerate(reversed(clock.split(":")))) + t
        stamp = f"{int(seconds // 3600) % 24:02d}:{int(seconds // 60) % 60:02d}:{seconds % 60:06.3f}"
        date = day if seconds < 86400 else "2024-03-01"
        lines.append(f"{date} {stamp},{u},{y}".strip())
    np.testing.assert_allclose(columns_of(tmp_path, "\n".join(lines)), ROWS, atol=1e-6)


def test_a_unit_of_the_file_stands_in_for_the_rig_file(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [(1000 * t, u, 180 / math.pi * y) for t, u, y in ROWS]
    path.write_text("time,duty,angle\nms,%,deg\n" + written(rows).split("\n", 1)[1])
    (recording,), rig = load([path])
    np.testing.assert_allclose(np.column_stack([recording.time, recording.output]), np.array(ROWS)[:, ::2], atol=1e-9)
    assert "the output is column 'angle', in deg" in rig.assumed


def test_columns_that_nobody_asks_for_may_hold_anything(tmp_path: Path) -> None:
    lines = [f"{line},idle #3,{line}" for line in written().splitlines()]
    lines[0] = "t,duty,pos,state,note,note,note"
    np.testing.assert_allclose(columns_of(tmp_path, "\n".join(lines)), ROWS, atol=1e-9)


def test_many_columns_are_looked_through_once(tmp_path: Path) -> None:
    """A check that compares each name with every other would take hours."""
    width = 200_000
    path = tmp_path / "wide.csv"
    path.write_text("\n".join([",".join(f"c{k}" for k in range(width)), *[",".join(["1"] * width)] * 3]))
    began = time.process_time()
    with pytest.raises(BadInput, match="and 199980 more"):
        load([path])
    assert time.process_time() - began < 10.0


def test_a_sheet_of_excel_is_named(tmp_path: Path) -> None:
    (tmp_path / "log.xlsx").write_bytes(b"PK\3\4" + bytes(100))
    with pytest.raises(BadInput, match=r"Excel or zip file.*save the sheet as CSV"):
        load([tmp_path / "log.xlsx"])
