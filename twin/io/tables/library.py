"""How other people's readers are called: nothing that they print, log or raise reaches the user as it is."""

import gc
import io
import logging
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NoReturn, TypeVar, cast

from twin.errors import BadInput
from twin.io.tables.table import unreadable

T = TypeVar("T")


def call_library(path: Path, kind: str, work: Callable[[], T]) -> T:
    """Run a library's reader.

    Parameters
    ----------
    path, kind
        The file and its format, for the message.
    work
        Calls the library.

    Returns
    -------
    What `work` returns.

    Raises
    ------
    BadInput
        Where the library raises anything.
    """
    hook, level = sys.unraisablehook, logging.root.manager.disable
    sys.unraisablehook = lambda _: None  # half-made readers raise in __del__
    logging.disable(logging.CRITICAL)
    said = ""
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            try:
                return work()
            except BadInput:
                raise
            except Exception as error:
                said = str(error) or type(error).__name__
            gc.collect(1)  # what __del__ has to say is said in here
    finally:
        sys.unraisablehook = hook
        logging.disable(level)
    raise unreadable(path, kind, said)


def call_in_child(path: Path, kind: str, work: Callable[[], T]) -> T:
    """Run a library's reader in a process of its own: some damaged files make it end the process that it runs in.

    Where a process cannot be forked the reader runs in this one.

    Parameters
    ----------
    path, kind, work
        As in `call_library`; what `work` returns must be possible to pickle.

    Returns
    -------
    What `work` returns.

    Raises
    ------
    BadInput
        As `call_library`, and where the reader ends its process.
    """
    if not hasattr(os, "fork"):
        return call_library(path, kind, work)
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        _answer(path, kind, work, write_end)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as stream:
        content = stream.read()
    _, status = os.waitpid(child, 0)
    try:
        sound, answer = pickle.loads(content) if status == 0 else (False, "")
    except Exception:  # cut off, or written by a process whose memory was damaged
        sound, answer = False, ""
    if sound:
        return cast(T, answer)
    raise BadInput(answer) if answer else unreadable(path, kind, "its reader breaks down on it")


def _answer(path: Path, kind: str, work: Callable[[], object], write_end: int) -> NoReturn:
    """Do the work in the child, whose words and memory nobody needs any more."""
    import faulthandler
    import resource

    status = 1
    try:
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        try:
            answer: tuple[bool, object] = (True, call_library(path, kind, work))
        except BadInput as error:
            answer = (False, str(error))
        with os.fdopen(write_end, "wb") as stream:
            pickle.dump(answer, stream, protocol=pickle.HIGHEST_PROTOCOL)
        status = 0
    finally:
        os._exit(status)
