"""The kernel is compiled once, before xdist's workers start, rather than by each of them at once."""

from __future__ import annotations

import pytest


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput") or config.option.collectonly:
        return
    from twin.fitting import compile_kernel

    compile_kernel(lambda sentence, share: None)
