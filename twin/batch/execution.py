"""Work on many items at once: in processes of this machine, or on a Dask cluster.

Both ways take a function of a module and give pairs (index, outcome) as they end. The outcome is the function's result,
or the exception that ended it. A worker that dies costs its item only. On this machine a new process takes its place;
on a cluster the scheduler gives the item to another worker.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from queue import SimpleQueue
from typing import Any, TypeVar

from twin.errors import BadInput, install

T = TypeVar("T")
R = TypeVar("R")

#: For a scheduler to answer, s.
ANSWER_TIME = 5.0
#: For the first worker of a cluster, s.
WORKER_TIME = 30.0


class WorkerDied(Exception):
    """The process that did the work ended before it was done."""


class _Worker:
    """A process of this machine that does one piece of work after the other.

    It is started as a program, so that a user's script is not read again, which the processes of `multiprocessing` do.
    """

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        command = [sys.executable, "-m", "twin.batch.worker"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)

    def do(self, work: Callable[[T], R], item: T) -> R:
        """What the work makes of the item. Raises WorkerDied, and what the work raises."""
        assert self.process.stdin is not None and self.process.stdout is not None
        try:
            pickle.dump((work, item), self.process.stdin)
            self.process.stdin.flush()
            good, outcome = pickle.load(self.process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            self.end()
            code = self.process.returncode
            raise WorkerDied(f"the process that worked on it ended with code {code}") from None
        if not good:
            raise outcome
        return outcome  # type: ignore[no-any-return]

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


def _outcome(future: Any) -> Any:
    """What a future holds: a result, or the exception that ended it."""
    error = future.exception()
    return future.result() if error is None else error


def run_local(work: Callable[[T], R], items: Sequence[T], processes: int) -> Iterator[tuple[int, R | Exception]]:
    """Work on the items in so many processes of this machine.

    Parameters
    ----------
    work : callable
        A function of a module, which the processes can import.
    items : sequence
    processes : int

    Yields
    ------
    (int, outcome)
        The index of an item and what became of it, as they end.
    """
    idle: SimpleQueue[_Worker] = SimpleQueue()
    started = [_Worker() for _ in range(min(processes, len(items)))]
    for worker in started:
        idle.put(worker)

    def attempt(item: T) -> R:
        worker = idle.get()
        try:
            return worker.do(work, item)
        except WorkerDied:
            worker = _Worker()
            started.append(worker)
            raise
        finally:
            idle.put(worker)

    threads = ThreadPoolExecutor(max(1, len(started)))
    try:
        futures = {threads.submit(attempt, item): i for i, item in enumerate(items)}
        for future in as_completed(futures):
            yield futures[future], _outcome(future)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for worker in started:
            worker.end()


def importable() -> bool:
    """Whether the caller's process can import this module."""
    return True


def run_on_cluster(work: Callable[[T], R], items: Sequence[T], address: str) -> Iterator[tuple[int, R | Exception]]:
    """Work on the items on the workers of a Dask cluster.

    Parameters
    ----------
    work : callable
        A function of a module, which the workers can import.
    items : sequence
    address : str
        Of the scheduler, such as tcp://127.0.0.1:8786.

    Yields
    ------
    (int, outcome)
        The index of an item and what became of it, as they end.

    Raises
    ------
    BadInput
        Dask is not installed, no scheduler answers, it has no workers, or they cannot import twin.
    """
    try:
        from distributed import Client
        from distributed import as_completed as completed
    except ImportError:
        raise BadInput(f"`scheduler` needs {install('fleet', 'dask', 'distributed')}") from None
    try:
        client = Client(address, timeout=ANSWER_TIME, set_as_default=False)
    except (OSError, ValueError) as error:
        said = " ".join(str(error).split())
        raise BadInput(
            f"no Dask scheduler answers at {address} ({said}): start one with `dask scheduler`, or correct the address"
        ) from None
    try:
        try:
            client.wait_for_workers(1, timeout=WORKER_TIME)
        except TimeoutError:
            raise BadInput(
                f"the scheduler at {address} has no workers: start some with `dask worker {address}`"
            ) from None
        try:
            client.run(importable)
        except Exception as error:
            raise BadInput(f"a worker of {address} cannot import twin ({error}): install it there") from None
        futures = {client.submit(work, item, pure=False): i for i, item in enumerate(items)}
        for future in completed(list(futures), loop=client.loop):
            yield futures[future], _outcome(future)
    finally:
        client.close()
