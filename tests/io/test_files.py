"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from twin.errors import BadInput
from twin.io.files import new_folder, put

NAMES = ("one", "two", "three")
#: Writes folders or files until it is killed, each of one letter.
WRITER = """
import sys
from pathlib import Path
from twin.io.files import new_folder, put
out, letter = Path(sys.argv[1]), sys.argv[2]
print("ready", flush=True)
while True:
    with new_folder(out / "folder", ("one", "two", "three"), True) as folder:
        for name in ("one", "two", "three"):
            put(folder / name, letter * 5000)
    put(out / "file", letter * 50000)
"""
#: Writes one folder again and again for a second beside another that does the same, and prints how each attempt ended.
RIVAL = """
import sys, time
from collections import Counter
from pathlib import Path
from twin.errors import BadInput
from twin.io.files import new_folder, put
out, letter, force = Path(sys.argv[1]), sys.argv[2], sys.argv[3] == "force"
print("ready", flush=True)
sys.stdin.readline()
ended, until = Counter(), time.monotonic() + 1.0
while time.monotonic() < until:
    try:
        with new_folder(out / "folder", ("one", "two", "three"), force) as folder:
            for name in ("one", "two", "three"):
                put(folder / name, letter)
        ended["written"] += 1
    except BadInput as error:
        ended[str(error)] += 1
print(dict(ended))
"""


def fill(folder: Path, letter: str) -> None:
    for name in NAMES:
        put(folder / name, letter)


def names_in(folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir()}


def test_a_folder_is_replaced_whole_and_keeps_what_is_not_ours(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with new_folder(out, NAMES, False) as folder:
        fill(folder, "a")
    (out / "notes").mkdir()
    (out / "notes" / "mine.txt").write_text("mine")
    with pytest.raises(BadInput, match="force"), new_folder(out, NAMES, False):
        pytest.fail("it is not to be written")
    with new_folder(out, NAMES, True) as folder:
        put(folder / "two", "b")
        assert (out / "one").read_text() == "a"
    assert names_in(out) == {"two", "notes"} and (out / "two").read_text() == "b"
    assert (out / "notes" / "mine.txt").read_text() == "mine"
    assert names_in(tmp_path) == {"out"}


def test_what_fails_in_the_middle_leaves_the_earlier_result(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with new_folder(out, NAMES, False) as folder:
        fill(folder, "a")
    with pytest.raises(ZeroDivisionError), new_folder(out, NAMES, True) as folder:
        put(folder / "one", "b")
        raise ZeroDivisionError
    assert names_in(out) == set(NAMES) and (out / "one").read_text() == "a" and names_in(tmp_path) == {"out"}


def test_the_folder_that_somebody_works_in_keeps_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one").write_text("old")
    with new_folder(Path(), NAMES, True) as folder:
        put(folder / "two", "b")
    assert names_in(Path.cwd()) == {"two"} and Path.cwd().samefile(tmp_path)


def test_a_second_writer_is_refused_and_the_first_is_whole(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with new_folder(out, NAMES, False) as folder:
        with pytest.raises(BadInput, match="another program"), new_folder(out, NAMES, False):
            pytest.fail("there is a writer already")
        fill(folder, "a")
    assert names_in(out) == set(NAMES)


@pytest.mark.parametrize("force", [True, False])
def test_of_two_programs_that_write_one_folder_each_succeeds_or_is_refused(tmp_path: Path, force: bool) -> None:
    """What lies there meanwhile is whole, and of one of them; nobody takes what the other is at work on."""
    command = [sys.executable, "-c", RIVAL, str(tmp_path)]
    rivals = [
        subprocess.Popen(
            [*command, letter, "force" if force else "no"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for letter in "ab"
    ]
    for rival in rivals:
        assert rival.stdout is not None and rival.stdout.readline() == "ready\n"
    ended: Counter[str] = Counter()
    for rival in rivals:
        assert rival.stdin is not None
        rival.stdin.write("go\n")
        rival.stdin.flush()
    for rival in rivals:
        ended.update(ast.literal_eval(rival.communicate()[0]))
    refusals = [said for said in ended if said != "written"]
    known = ("is being written by another program", *(() if force else ("already: choose another folder",)))
    assert not [s for s in refusals if not any(k in s for k in known)]
    assert ended["written"] > 1 if force else ended["written"] == 1
    assert names_in(tmp_path) == {"folder"} and names_in(tmp_path / "folder") == set(NAMES)
    assert len({(tmp_path / "folder" / name).read_text() for name in NAMES}) == 1


def test_who_finds_a_result_at_the_end_that_was_not_there_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(BadInput, match="holds one already"), new_folder(out, NAMES, False) as folder:
        fill(folder, "a")
        out.mkdir()
        (out / "one").write_text("theirs")
    assert (out / "one").read_text() == "theirs" and names_in(tmp_path) == {"out"}


def test_killed_writers_leave_whole_results_and_nothing_after_the_next(tmp_path: Path) -> None:
    for i in range(4):
        command = [sys.executable, "-c", WRITER, str(tmp_path), "ab"[i % 2]]
        writer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert writer.stdout is not None and writer.stdout.readline() == "ready\n"
        time.sleep(0.03 + 0.017 * i)
        writer.send_signal(signal.SIGKILL if os.name == "posix" else signal.SIGTERM)
        writer.wait()
        if (tmp_path / "folder").exists():
            assert len({(tmp_path / "folder" / name).read_text() for name in NAMES}) == 1
        if (tmp_path / "file").exists():
            assert (tmp_path / "file").read_text() in ("a" * 50000, "b" * 50000)
    with new_folder(tmp_path / "folder", NAMES, True) as folder:
        fill(folder, "c")
    put(tmp_path / "file", "c")
    assert names_in(tmp_path) == {"folder", "file"} and names_in(tmp_path / "folder") == set(NAMES)


def test_a_device_is_written_to_and_not_replaced() -> None:
    put(Path(os.devnull), "nothing")
    assert not Path(os.devnull).is_file()


def test_names_as_long_as_the_file_system_allows(tmp_path: Path) -> None:
    out = tmp_path / ("\u00e4" * 127)
    put(out, "a")
    put(out, "b")
    assert out.read_text() == "b" and names_in(tmp_path) == {out.name}
