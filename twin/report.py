"""One page that says what was wrong with the first model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape

from twin import phrases
from twin.controller import Controller
from twin.cosim import Tracking
from twin.finding import Diagnosis
from twin.recording import Rig
from twin.two_stage import TwoStage


@dataclass(frozen=True)
class Check:
    """An FMU checked in FMPy: how it replays a recording, and what the validator says."""

    fmu: str
    recording: str
    rmse: float
    nrmse_percent: float
    seconds: float
    problems: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Story:
    """What a report can show; what was not done is None or empty."""

    diagnosis: Diagnosis
    rig: Rig
    two_stage: TwoStage | None = None
    checks: tuple[Check, ...] = ()
    controller: Controller | None = None
    tracking: Tracking | None = None
    experiment_file: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def html(story: Story) -> str:
    """The report as one self-contained page."""
    return f"<!DOCTYPE html><title>{escape(phrases.headline(story.diagnosis))}</title>"
