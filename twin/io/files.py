"""Files and folders that appear whole or not at all.

What is written is first a draft beside its place, `.NAME.draft`, which its writer holds a lock on. So a second writer
to the same name is refused. What a killed writer has left is taken over by the next one.
"""

from __future__ import annotations

import ctypes
import hashlib
import io
import json
import math
import os
import shutil
import stat
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from twin.errors import BadInput

try:
    import fcntl
except ImportError:  # Windows: two writers to one name are not told of each other
    fcntl = None  # type: ignore[assignment]

#: Bytes of a file's name, of which file systems allow 255: a longer one's draft is named by its hash.
_LONGEST_NAME = 200
_RENAME_EXCHANGE = 2  # of renameat2 in Linux
_HERE = -100  # AT_FDCWD
_FOLDER = getattr(os, "O_DIRECTORY", 0)


def check_free(out: Path, force: bool) -> None:
    """Raises BadInput where a file may not or cannot be written."""
    if out.is_dir():
        raise BadInput(f"{out} is a folder: give the name of a file")
    if out.exists() and not force:
        raise BadInput(f"{out} is there already: choose another name, or overwrite it with `force=True`")
    check_place(out.parent)


def check_place(folder: Path) -> None:
    """Raises BadInput where nothing can be written into a folder."""
    if not folder.is_dir():
        raise BadInput(f"{folder} is not a folder: make it first, or choose another place")
    if not os.access(folder, os.W_OK):
        raise BadInput(f"{folder} may not be written to: choose another place")


def _draft_of(out: Path) -> Path:
    name = out.name if len(os.fsencode(out.name)) <= _LONGEST_NAME else hashlib.sha256(out.name.encode()).hexdigest()
    return out.parent / f".{name}.draft"


def _lock(handle: int) -> bool:
    """Whether this process now holds the lock, or the file system has none."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # some network file systems have no locks
        return True
    return True


def _open_draft(out: Path, flags: int) -> tuple[Path, int]:
    """The draft of `out` and its open handle, held by nobody else. Raises BadInput where another program writes it."""
    draft = _draft_of(out)
    while True:
        if flags == _FOLDER:
            with suppress(FileExistsError):
                draft.mkdir()
            if fcntl is None:  # nor does Windows open folders
                return draft, os.open(os.devnull, os.O_RDONLY)
        try:
            handle = os.open(draft, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except FileNotFoundError:
            if flags == _FOLDER:  # that was another's, who is done with it now
                continue
            raise
        if not _lock(handle):
            os.close(handle)
            raise BadInput(f"{out} is being written by another program: wait for it, or choose another name")
        # The one that held it may have put it in its place meanwhile.
        with suppress(FileNotFoundError):
            if os.path.samestat(draft.lstat(), os.fstat(handle)):
                return draft, handle
        os.close(handle)


def _write_all(handle: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(handle, view) :]
    os.fsync(handle)


def put(out: Path, content: str | bytes) -> None:
    """The file appears whole or not at all; text is UTF-8. Raises BadInput."""
    data = content.encode() if isinstance(content, str) else content
    try:
        if out.exists() and not stat.S_ISREG(out.stat().st_mode):
            out.write_bytes(data)  # a pipe or a device: nothing to replace
            return
        draft, handle = _open_draft(out, os.O_RDWR | os.O_CREAT)
        try:
            os.ftruncate(handle, 0)
            _write_all(handle, data)
            draft.replace(out)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
        finally:
            os.close(handle)
    except OSError as error:
        raise BadInput(f"{out} cannot be written ({error.strerror}): choose another place") from None


def _exchange(one: Path, other: Path) -> None:
    """Each folder takes the other's name, at once where the system can. Raises OSError."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if os.name == "posix" else None
    if rename is not None and rename(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return
    aside = one.with_name(f"{one.name}-aside")
    other.rename(aside)
    try:
        one.rename(other)
    except OSError:
        aside.rename(other)
        raise
    aside.rename(one)


def _empty(folder: Path) -> None:
    """What a killed writer has left in its draft goes."""
    for entry in folder.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def _must_stay(folder: Path) -> bool:
    """Whether a folder cannot change its name: a mount, where somebody works, or in a place that is not ours."""
    return folder.is_dir() and (
        folder == Path.cwd() or os.path.ismount(folder) or not os.access(folder.parent, os.W_OK)
    )


@contextmanager
def new_folder(out: Path, names: tuple[str, ...], force: bool) -> Iterator[Path]:
    """An empty folder to fill, which takes the place of `out` at once when all is done, or goes if that fails.

    Parameters
    ----------
    out
        Where the results go. What is there beside `names` stays there.
    names
        Every name that may be written. An earlier result of that name goes, whether there is a new one or not.
    force
        Whether earlier results may go.

    Raises
    ------
    BadInput
        An earlier result is there and may not go, the place cannot be written, or another program writes there.
    """
    check_folder(out, names, force)
    place = out.resolve()
    inside = _must_stay(place)
    try:
        draft, handle = _open_draft(place / place.name if inside else place, _FOLDER)
        try:
            _empty(draft)
            yield draft
            check_folder(out, names, force)  # another program may have been there meanwhile
            if inside:
                _move_into(draft, place, names)
            else:
                _take_place(draft, place, names)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise
        finally:
            os.close(handle)
    except OSError as error:
        raise BadInput(f"{out} cannot be written ({error.strerror or error}): choose another place") from None


def check_folder(out: Path, names: tuple[str, ...], force: bool) -> None:
    """Raises BadInput where results of these names may not or cannot go into a folder."""
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out} is a file: give the name of a folder as `out`")
    there = [name for name in names if (out / name).exists()]
    if there and not force:
        raise BadInput(f"{out} holds {there[0]} already: choose another folder, or overwrite with `force=True`")
    check_place(out if out.is_dir() else out.parent)


def _move_into(draft: Path, out: Path, names: tuple[str, ...]) -> None:
    """File by file, for a folder that cannot change its name; earlier results without a new one go."""
    for name in names:
        if (draft / name).exists():
            (draft / name).replace(out / name)
        else:
            (out / name).unlink(missing_ok=True)
    shutil.rmtree(draft, ignore_errors=True)


def _take_place(draft: Path, out: Path, names: tuple[str, ...]) -> None:
    """The draft takes the name of the folder, whose other files go with it; then nothing of that name is ours.

    Raises OSError.
    """
    if not out.exists():
        draft.rename(out)
        return
    old = os.open(out, os.O_RDONLY)
    try:
        _lock(old)  # it becomes the draft, which nobody may take for one that is left, until it is gone
        shutil.copytree(
            out, draft, symlinks=True, copy_function=os.link, ignore=lambda at, _: names if Path(at) == out else (),
            dirs_exist_ok=True,
        )  # fmt: skip
        _exchange(draft, out)
        shutil.rmtree(draft, ignore_errors=True)
    finally:
        os.close(old)


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip archive in that order; the same files give the same bytes. What lies in `binaries` may be executed."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name)
            entry.create_system = 3
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o100755 if name.startswith("binaries/") else 0o100644) << 16
            archive.writestr(entry, content)
    return out.getvalue()


def _plain(value: Any) -> Any:
    """A value as JSON can hold it: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if hasattr(value, "item"):  # a number of numpy's, which would be long to import here
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def json_text(value: Any) -> str:
    return json.dumps(_plain(value), indent=1, ensure_ascii=False) + "\n"
