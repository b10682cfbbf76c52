"""Structures and recordings made ready for a fit: what is estimated, where it starts, in what steps it is run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from twin.effects.catalogue import BASE
from twin.estimation import contact_masking, parameter_bounds, prepared_recording
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem
from twin.io.recording import Recording
from twin.model.stepper import Structure


def base_structure() -> Structure:
    """The base effects with teeth that give, which is what a real gap is made of."""
    return Structure.of([*BASE, "tooth_compliance"])


def with_tooth_compliance(structure: Structure) -> Structure:
    """The structure with teeth that give, unless a softer joint already stands for them."""
    return structure.with_("tooth_compliance") if structure.toothed else structure.without("tooth_compliance")


def _tooth_values_of_joint(values: Mapping[str, float]) -> dict[str, float]:
    """What stands for teeth in an elastic joint's values."""
    if "joint_frequency" not in values:
        return {}
    softest, _ = parameter_bounds.bounds_of("tooth_frequency")
    return {"tooth_frequency": softest, "tooth_damping": values["joint_damping"]}


def complete_values(structure: Structure, values: Mapping[str, float]) -> dict[str, float]:
    """Values of all the structure's parameters and of no others: those given, and the usual start of the rest.

    Teeth that take the place of an elastic joint begin as the same spring, as soft as teeth can be.
    """
    known = {**_tooth_values_of_joint(values), **values}
    return {p.name: known.get(p.name, p.start) for p in structure.parameters}


def prepare_recordings(
    recordings: Sequence[Recording],
    structure: Structure,
    held: Mapping[str, float] | None = None,
    closed: bool = False,
) -> FitProblem:
    """Make recordings ready, `closed` under the rig's own loop, with some parameters held.

    One sensor read them all. A quick motion between few or late stamps makes its readings look noisy. A slow motion
    shows how good they are.
    """
    cases = [prepared_recording.prepare_recording(r, structure, closed) for r in recordings]
    least = min((c.reading_variance for c in cases), default=0.0)
    cases = [replace(c, reading_variance=least) for c in cases]
    if "backlash" in structure:
        cases = [
            replace(c, rattle_mask=contact_masking.find_rattling(c), start_mask=contact_masking.find_first_contact(c))
            for c in cases
        ]
    return FitProblem(cases, held or {})


def excerpt(case: PreparedRecording, structure: Structure, begin: float, end: float) -> PreparedRecording:
    """What was recorded between two moments (s), read by the same sensor."""
    cut = prepared_recording.prepare_recording(case.recording.part(begin, end), structure)
    inside = (case.recording.time >= begin) & (case.recording.time <= end)
    rattling, beginning = (None if m is None else m[inside] for m in (case.rattle_mask, case.start_mask))
    return replace(cut, reading_variance=case.reading_variance, rattle_mask=rattling, start_mask=beginning)
