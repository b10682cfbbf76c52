"""twin: from one recording of a motor-driven axis to its digital twin.

Everything that a user's script needs is offered here; a name is imported from its package on its first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from twin.batch.api import fleet
    from twin.batch.overview import Fleet
    from twin.control.api import cosimulate, design_controller, export_controller, make_reference
    from twin.control.controller import Controller
    from twin.control.cosimulation import Tracking
    from twin.diagnosis.api import diagnose, track
    from twin.diagnosis.result import Diagnosis
    from twin.diagnosis.tracking import Track
    from twin.effects.catalogue import EFFECTS
    from twin.errors import BadInput
    from twin.estimation.estimate import first_structure, identify
    from twin.estimation.free_run import Simulation, simulate
    from twin.fmi.api import export_fmu
    from twin.io.api import load
    from twin.io.recording import Recording
    from twin.model.fitted_model import Model
    from twin.model.stepper import Structure
    from twin.pipeline import run
    from twin.report.api import write_report

    __version__: str

#: The module that holds each name.
_MODULES = {
    "BadInput": "twin.errors",
    "Controller": "twin.control.controller",
    "Diagnosis": "twin.diagnosis.result",
    "EFFECTS": "twin.effects.catalogue",
    "Fleet": "twin.batch.overview",
    "Model": "twin.model.fitted_model",
    "Recording": "twin.io.recording",
    "Simulation": "twin.estimation.free_run",
    "Structure": "twin.model.stepper",
    "Track": "twin.diagnosis.tracking",
    "Tracking": "twin.control.cosimulation",
    "cosimulate": "twin.control.api",
    "design_controller": "twin.control.api",
    "diagnose": "twin.diagnosis.api",
    "export_controller": "twin.control.api",
    "export_fmu": "twin.fmi.api",
    "first_structure": "twin.estimation.estimate",
    "fleet": "twin.batch.api",
    "identify": "twin.estimation.estimate",
    "load": "twin.io.api",
    "make_reference": "twin.control.api",
    "run": "twin.pipeline",
    "simulate": "twin.estimation.free_run",
    "track": "twin.diagnosis.api",
    "write_report": "twin.report.api",
}

__all__ = [
    "EFFECTS", "BadInput", "Controller", "Diagnosis", "Fleet", "Model", "Recording", "Simulation", "Structure",
    "Track", "Tracking", "__version__", "cosimulate", "design_controller", "diagnose", "export_controller",
    "export_fmu", "first_structure", "fleet", "identify", "load", "make_reference", "run", "simulate", "track",
    "write_report",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version  # takes longer to import than the rest

        return version("twin")
    if name not in _MODULES:
        raise AttributeError(f"module 'twin' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
