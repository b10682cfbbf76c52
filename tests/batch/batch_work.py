"""Work for other processes: quick, slow, failing, fatal."""

from __future__ import annotations

import os
import signal
import time


def square(x: int) -> int:
    print("what the work prints disturbs nobody")
    return x * x


def slow_square(x: int) -> int:
    time.sleep(0.25)
    return x * x


def fails_at_two(x: int) -> int:
    if x == 2:
        raise ValueError("two is not wanted")
    return x


def dies_at_two(x: int) -> int:
    if x == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return x
