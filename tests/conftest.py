"""How the suite is shared among xdist's workers: kernels are compiled once, before these start, rather than by each."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import pytest

#: Files whose tests share nothing and take long each: they go one by one to whichever worker is free. Tests of any
#: other file share fixtures that take long to make, and one worker.
LONG = ("test_masked_pairs", "test_undecided")


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput") or config.option.collectonly:
        return
    from twin import kernel, ready

    base = ready.base_structure()
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(kernel.warm, (base, base.with_("unknown_time"))))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.stem not in LONG:
            item.add_marker(pytest.mark.xdist_group(item.path.stem))
