"""Damaged files of every kind are read or refused in one line: no traceback, no crash, no nan."""

import runpy
from collections import Counter
from pathlib import Path

import pytest

FUZZ = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "fuzz.py"))
MUTATIONS = 540  # 30 of each kind; the script tries more


def test_damaged_files_are_read_or_refused(tmp_path: Path) -> None:
    """The sound file of each kind is read; of the damaged ones some are read and some refused."""
    for package in ("asammdf", "h5py", "mcap", "pyarrow", "rosbags"):
        pytest.importorskip(package)
    became: Counter[str] = Counter()
    for kind, seed, outcome in FUZZ["attempts"](tmp_path, MUTATIONS, 1):
        assert outcome in ("read", "refused"), f"{kind}, seed {seed}: {outcome}"
        assert outcome == "read" or seed >= 0, f"the sound {kind} file is refused"
        became[outcome] += 1
    assert min(became["read"], became["refused"]) > 50


@pytest.mark.parametrize("found", [ValueError("x"), MemoryError(), RecursionError(), SystemExit(3)])
def test_a_reader_that_raises_anything_else_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: BaseException
) -> None:
    """The search for faults is not blind to them."""

    def broken(path: Path) -> None:
        raise found

    monkeypatch.setitem(FUZZ["outcome"].__globals__, "load", broken)
    assert type(found).__name__ in FUZZ["outcome"](tmp_path, "csv", "log.csv", b"t,duty,pos\n")
