"""What a check before any fit says."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Severity(Enum):
    """What a finding means for what follows."""

    BLOCKS = "blocks"  # nothing can be concluded from a fit
    WARNS = "warns"  # a fit is possible; the user should know


@dataclass(frozen=True)
class Finding:
    """One finding: its kind, and a sentence with the place, the value and the cure.

    `about` is the name of the recording, where that is not the one which carries the finding.
    """

    kind: str
    says: str
    severity: Severity
    about: str = ""
