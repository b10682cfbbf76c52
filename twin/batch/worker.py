"""The program of a worker process: work comes in on stdin, outcomes go out on stdout, until stdin ends."""

from __future__ import annotations

import os
import pickle
import signal
import sys
from typing import Any


def _attempt(work: Any, item: Any) -> tuple[bool, Any]:
    try:
        return True, work(item)
    except Exception as error:
        return False, error


def serve() -> None:
    """Do what is asked for. What the work itself prints goes to stderr."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who asks is told, and ends this process
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as answers:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        while True:
            try:
                work, item = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            try:
                answer = pickle.dumps(_attempt(work, item))
            except Exception as error:
                answer = pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}")))
            answers.write(answer)
            answers.flush()


if __name__ == "__main__":
    serve()
