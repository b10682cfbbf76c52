"""What pytest finds where this package is installed: the fixture `twin`, with the checks in `twin.testing.checks`.

It is read at every start of pytest, also by projects that never ask for the fixture. So what the checks need is
imported with the first of them.
"""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from twin.errors import BadInput

if TYPE_CHECKING:
    from twin.testing.checks import Checks


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("twin")
    group.addoption("--twin-plots", default="twin-plots", help="folder for the plots of failed checks")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A file that cannot be used is one line, not a way through our modules."""
    report = yield
    if call.excinfo is not None and isinstance(call.excinfo.value, BadInput):
        report.longrepr = str(call.excinfo.value)
    return report


@pytest.fixture
def twin(request: pytest.FixtureRequest) -> Checks:
    """Load an FMU, replay a recording, and assert fit, tracking and rest."""
    from twin.testing.checks import Checks

    return Checks(Path(request.config.getoption("--twin-plots")), request.node.name)
