"""How the suite is shared among xdist's workers: kernels are compiled once, before these start, rather than by each."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import PurePosixPath

import pytest
from xdist.scheduler import LoadScopeScheduling

#: Files whose tests share nothing and take long each: they go one by one to whichever worker is free. Tests of any
#: other file share fixtures that take long to make, and one worker.
LONG = ("test_masked_pairs", "test_undecided")


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput") or config.option.collectonly or not config.getoption("numprocesses", 0):
        return
    import controlled_axis

    from twin.estimation import preparation
    from twin.simulation import kernel

    base = preparation.base_structure()
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        compiled = [pool.submit(kernel.warm, structure) for structure in (base, base.with_("unknown_time"))]
        compiled.append(pool.submit(controlled_axis.run_loop))
        for one in compiled:
            one.result()


class ByFile(LoadScopeScheduling):
    """Whole files, and the long tests by themselves."""

    def _split_scope(self, nodeid: str) -> str:
        path, _, _ = nodeid.partition("::")
        return nodeid if PurePosixPath(path).stem in LONG else path


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ByFile:
    return ByFile(config, log)


@pytest.fixture
def no_zig() -> Iterator[None]:
    """Native FMUs for this machine alone."""
    from native_axis import without_zig

    with without_zig():
        yield
