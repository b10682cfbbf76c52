"""The kernel is compiled once, before xdist's workers start, rather than by each of them at once; long files come
first, so that at the end no worker waits for another.
"""

from __future__ import annotations

import pytest

#: Files that take half a minute and more, the longest first.
LONG = (
    "test_masked_pairs", "test_effects", "test_fmu_platforms", "test_undecided", "test_experiment", "test_blind_trial",
    "test_modelica", "test_control_table",
)  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput") or config.option.collectonly:
        return
    from twin.fitting import compile_kernel

    compile_kernel(lambda sentence, share: None)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    place = {name: number for number, name in enumerate(LONG)}
    items.sort(key=lambda item: place.get(item.path.stem, len(LONG)))
