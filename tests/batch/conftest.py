"""A Dask scheduler and two workers on this machine."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]


class Cluster(NamedTuple):
    address: str
    workers: list[subprocess.Popen[str]]


def _program(kind: str, *arguments: str) -> subprocess.Popen[str]:
    paths = (str(ROOT), str(Path(__file__).parent), os.environ.get("PYTHONPATH", ""))
    environment = {
        **os.environ, "PYTHONPATH": os.pathsep.join(p for p in paths if p), "OMP_NUM_THREADS": "1",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "3",
    }  # fmt: skip
    place = ("--no-dashboard", "--host", "127.0.0.1")
    command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *place, *arguments]
    said = subprocess.PIPE if kind == "scheduler" else subprocess.DEVNULL
    return subprocess.Popen(command, stderr=said, stdout=subprocess.DEVNULL, text=True, env=environment)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """Two workers of one thread each, which are not started anew where they die."""
    pytest.importorskip("distributed")
    started = [_program("scheduler", "--port", "0")]
    try:
        assert started[0].stderr is not None
        said = (line for line in started[0].stderr)
        address = next(m.group() for line in said if (m := re.search(r"tcp://127\.0\.0\.1:\d+", line)))
        for i in range(2):
            place = ["--local-directory", str(tmp_path / f"dask{i}")]
            started.append(_program("worker", address, "--nthreads", "1", "--no-nanny", "--memory-limit", "0", *place))
        yield Cluster(address, started[1:])
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()
            if process.stderr is not None:
                process.stderr.close()
