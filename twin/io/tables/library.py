"""How other people's readers are called: nothing that they print, log or raise reaches the user as it is."""

import gc
import io
import logging
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import TypeVar

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
