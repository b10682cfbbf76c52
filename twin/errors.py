"""The exceptions that a user is meant to see."""

from collections.abc import Mapping
from typing import Any


class BadInput(Exception):
    """Something the user gave cannot be used.

    The message is one line: what is wrong, where (file, line, column, value) and what to do.
    The command line prints it on stderr and exits with 2. Line breaks, which a name in a file may hold, become blanks.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.splitlines()))


def install(extra: str, *packages: str) -> str:
    """The commands that install an extra: from a clone of twin, or the packages by themselves."""
    return f"pip install '.[{extra}]' in the clone of twin, or pip install {' '.join(packages)}"


class StageFailed(Exception):
    """The main stage of a run failed; what could be done without it is in the run's folder.

    Attributes
    ----------
    failures
        The stages that failed, each with a sentence that says why.
    model
        The first model.
    """

    def __init__(self, failures: Mapping[str, str], model: Any) -> None:
        super().__init__(" ".join(failures.values()))
        self.failures = failures
        self.model = model
