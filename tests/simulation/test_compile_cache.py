"""Compiled kernels on disk: whatever happens to the files, the user gets the right numbers and no word of it."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from twin.simulation import compile_cache

ROOT = Path(__file__).resolve().parents[2]
TEXT = """from numba import njit
from twin.simulation.compile_cache import kept

@njit(forceinline=True)
def inner(x):
    return 2.0 * x

@kept
@njit
def twice(x):
    return inner(x)
"""
#: The same in a process of its own, which says its result and whether it compiled.
SCRIPT = f"""
import sys
if "--no-user" in sys.argv:
    import pwd
    def getpwuid(uid): raise KeyError(uid)
    pwd.getpwuid = getpwuid
from twin.simulation import compile_cache
module = compile_cache.module_of("small", lambda: {TEXT!r})
print(module.twice(3.0), sum(module.twice.stats.cache_misses.values()))
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def small(calls: list[str] | None = None) -> ModuleType:
    """A module with one kept function, which was called once."""

    def text() -> str:
        (calls if calls is not None else []).append("text")
        return TEXT

    module = compile_cache.module_of("small", text)
    assert module.twice(3.0) == 6.0
    return module


def was_read(module: ModuleType) -> bool:
    return sum(module.twice.stats.cache_hits.values()) == 1


def kept_files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("small.*") if p.is_file())


def in_process(*arguments: str, **environment: str) -> subprocess.Popen[str]:
    clean = {k: v for k, v in os.environ.items() if k not in ("HOME", "XDG_CACHE_HOME", "TWIN_CACHE")}
    told = [sys.executable, "-c", SCRIPT, *arguments]
    return subprocess.Popen(told, env=clean | {"PYTHONPATH": str(ROOT)} | environment, text=True, stdout=-1, stderr=-1)


def test_what_was_compiled_once_is_read(folder: Path) -> None:
    calls: list[str] = []
    assert not was_read(small(calls)) and was_read(small(calls))
    assert calls == ["text"] and compile_cache.is_compiled("small") and not compile_cache.is_compiled("other")
    (place,) = folder.iterdir()
    assert stat.S_IMODE(place.stat().st_mode) == 0o700
    files = kept_files(folder)
    assert len(files) == 2 and all(stat.S_IMODE(p.stat().st_mode) == 0o600 for p in files)
    assert len(list(place.iterdir())) == 2


def test_no_flipped_bit_and_no_cut_reaches_the_user(folder: Path) -> None:
    small()
    for number, path in enumerate(kept_files(folder)):
        whole = path.read_bytes()
        places = [0, 31, 32, 33, len(whole) // 3, len(whole) // 2, len(whole) - 1]
        for at in places:
            path.write_bytes(whole[:at] + bytes([whole[at] ^ (1 << (at + number) % 8)]) + whole[at + 1 :])
            module = small()
            assert was_read(module) == path.name.endswith(".code")
            assert was_read(small())
        for damaged in (b"", whole[:32], whole[:-1], b"\0" * len(whole)):
            path.write_bytes(damaged)
            small()
            assert was_read(small())


def test_a_file_under_another_ones_name_is_not_taken(folder: Path) -> None:
    small()
    code, machine = kept_files(folder) if kept_files(folder)[0].suffix == ".code" else kept_files(folder)[::-1]
    code.write_bytes(machine.read_bytes())
    calls: list[str] = []
    small(calls)
    assert calls == ["text"]


@pytest.mark.skipif(os.name != "posix", reason="owners and modes are those of POSIX")
@pytest.mark.parametrize("how", ["group", "others", "link", "folder", "pipe", "foreign"])
def test_what_others_may_have_written_is_not_run(folder: Path, how: str) -> None:
    small()
    path = next(p for p in kept_files(folder) if p.suffix == ".nbc")
    content = path.read_bytes()
    if how == "foreign":
        if os.geteuid() != 0:
            pytest.skip("only root gives files away")
        os.chown(path, 12345, -1)
    elif how in ("group", "others"):
        path.chmod(0o660 if how == "group" else 0o606)
    else:
        path.unlink()
        elsewhere = folder / "elsewhere"
        elsewhere.write_bytes(content)
        {"link": lambda: path.symlink_to(elsewhere), "folder": path.mkdir, "pipe": lambda: os.mkfifo(path)}[how]()
    assert not was_read(small())
    if how != "folder":
        assert was_read(small())


@pytest.mark.skipif(os.name != "posix", reason="owners and modes are those of POSIX")
def test_a_folder_that_others_may_write_to_is_not_used(folder: Path) -> None:
    place = folder / f"kernels-{os.geteuid()}"
    place.mkdir(parents=True)
    place.chmod(0o777)
    small()
    assert list(place.iterdir()) == []


@pytest.mark.parametrize("given", ["no place", "no user"])
def test_without_a_place_it_runs_and_leaves_nothing_behind(tmp_path: Path, given: str) -> None:
    environment = {"TMPDIR": str(tmp_path)} | ({"TWIN_CACHE": "/proc/none"} if given == "no place" else {})
    out, err = in_process(*(["--no-user"] if given == "no user" else []), **environment).communicate()
    assert (out, err) == ("6.0 1\n", "") and list(tmp_path.iterdir()) == []


def test_processes_that_compile_at_once_all_succeed(folder: Path) -> None:
    started = [in_process(TWIN_CACHE=str(folder)) for _ in range(3)]
    said = [p.communicate() for p in started]
    assert set(said) <= {("6.0 1\n", ""), ("6.0 0\n", "")} and ("6.0 1\n", "") in said
    assert was_read(small())
