"""Compiled kernels on disk: what is read is what this user has written, or it is made anew.

Machine code from a file is run. So each file begins with the SHA-256 of its name and its content, belongs to the user,
and may be written by nobody else. Damage of whatever kind means that the file goes and is compiled again. Files appear
whole: processes that compile the same at once do not disturb one another. numba's own cache does none of this.
"""

from __future__ import annotations

import atexit
import hashlib
import marshal
import os
import pickle
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numba
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from twin.errors import BadInput
from twin.io.files import put

_DIGEST = hashlib.sha256().digest_size
#: How a file is opened to be read: no link is followed, no pipe is waited for, and Windows leaves the bytes alone.
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"))


def cache_folder() -> Path:
    """Where compiled kernels are kept: $TWIN_CACHE, or the platform's cache folder.

    Raises RuntimeError for a user without a home: neither HOME nor an entry in passwd.
    """
    if chosen := os.environ.get("TWIN_CACHE"):
        return Path(chosen)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", tempfile.gettempdir())) / "twin"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "twin"


def _is_ours(state: os.stat_result) -> bool:
    """Whether the user owns it, and nobody else may write to it."""
    return not hasattr(os, "geteuid") or (state.st_uid == os.geteuid() and not state.st_mode & 0o022)


def _made(folder: Path) -> bool:
    """Whether the folder is there, is the user's alone, and takes files."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = folder.lstat()
        if not (stat.S_ISDIR(state.st_mode) and _is_ours(state)):
            return False
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


@cache
def _of_this_process() -> Path | None:
    """A folder that goes with the process; None where there is no place for one."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="twin-"))
    except OSError:
        return None
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@cache
def _usable(folder: Path) -> Path | None:
    return folder if _made(folder) else _of_this_process()


def _place() -> Path | None:
    """The folder for kernels, one for each user; None where nothing can be kept."""
    user = f"-{os.geteuid()}" if hasattr(os, "geteuid") else ""
    try:
        return _usable(cache_folder() / f"kernels{user}")
    except RuntimeError:
        return _of_this_process()


def _digest(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + b"\0" + content).digest()


def _drop(path: Path) -> None:
    with suppress(OSError):
        path.unlink()


def _read(name: str) -> bytes | None:
    """The content of a file as it was written; None where there is none, and where it may not be trusted: it goes."""
    folder = _place()
    if folder is None:
        return None
    path = folder / name
    try:
        handle = os.open(path, _FLAGS)
    except FileNotFoundError:
        return None
    except OSError:
        _drop(path)
        return None
    with suppress(OSError), os.fdopen(handle, "rb") as file:
        state = os.fstat(file.fileno())
        if stat.S_ISREG(state.st_mode) and _is_ours(state):
            whole = file.read()
            if whole[:_DIGEST] == _digest(name, whole[_DIGEST:]):
                return whole[_DIGEST:]
    _drop(path)
    return None


def _write(name: str, content: bytes) -> None:
    """Keep a file; where that is not possible the next process compiles again."""
    folder = _place()
    if folder is not None:
        # Another process that writes the same at this moment is as good.
        with suppress(BadInput, OSError):
            put(folder / name, _digest(name, content) + content)
            (folder / name).chmod(0o600)


def _code(name: str, text: Callable[[], str]) -> CodeType:
    """The module's code from the cache, or of its text."""
    file = f"{name}.{sys.implementation.cache_tag}.code"
    stored = _read(file)
    if stored is not None:
        with suppress(ValueError, EOFError, TypeError):
            found = marshal.loads(stored)
            if isinstance(found, CodeType):
                return found
    made = compile(text(), f"<{name}>", "exec")
    _write(file, marshal.dumps(made))
    return made


def module_of(name: str, text: Callable[[], str]) -> ModuleType:
    """The module of this name from the cache; `text` is asked for its source on the first call on a machine."""
    loaded = ModuleType(name)
    sys.modules[name] = loaded
    exec(_code(name, text), loaded.__dict__)  # our own text, or its code under our digest
    return loaded


def is_compiled(name: str) -> bool:
    """Whether machine code of a module of this name is in the cache."""
    folder = _place()
    return folder is not None and any(folder.glob(f"{name}.*.nbc"))


class _Kept(NullCache):  # type: ignore[misc]
    """The machine code of one function, a file for each signature and processor."""

    def __init__(self, function: Any) -> None:
        self._name = f"{function.__module__}.{function.__name__}"
        self._bytecode = hashlib.sha256(function.__code__.co_code).hexdigest()

    def _file(self, signature: Any, codegen: Any) -> str:
        said = (signature, codegen.magic_tuple(), numba.__version__, self._bytecode)
        key = hashlib.sha256(repr(said).encode()).hexdigest()[:16]
        return f"{self._name}.{sys.implementation.cache_tag}-{key}.nbc"

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        target_context.refresh()
        file = self._file(signature, target_context.codegen())
        stored = _read(file)
        if stored is None:
            return None
        try:
            return CompileResult._rebuild(target_context, *pickle.loads(stored))
        except Exception:  # whatever another version of a library makes of it
            folder = _place()
            if folder is not None:
                _drop(folder / file)
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        if not compiled.library.has_dynamic_globals and all(x.can_cache for x in compiled.lifted):
            _write(self._file(signature, compiled.codegen), dumps(compiled._reduce()))


def kept(dispatcher: Any) -> Any:
    """A function of numba whose machine code is kept in the cache; a decorator above `numba.njit`."""
    dispatcher._cache = _Kept(dispatcher.py_func)
    return dispatcher
