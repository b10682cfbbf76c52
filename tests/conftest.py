"""Both kernels are compiled once, before xdist's workers start, rather than by each of them at once."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import pytest


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput") or config.option.collectonly:
        return
    from twin import kernel, ready

    base = ready.base_structure()
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(kernel.warm, (base, base.with_("unknown_time"))))
