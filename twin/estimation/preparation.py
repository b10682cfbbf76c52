"""Structures and recordings made ready for a fit: what is estimated, where it starts, in what steps it is run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from twin.effects.catalogue import BASE
from twin.estimation import contact_masking, parameter_bounds, prepared_recording
from twin.estimation.prepared_recording import PreparedRecording
from twin.io.recording import Recording
from twin.model.stepper import Structure


def free_parameters(structure: Structure) -> tuple[str, ...]:
    """Everything that is estimated unless the user holds it."""
    return tuple(p.name for p in structure.parameters if p.estimated)


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
    recordings: Sequence[Recording], structure: Structure, closed: bool = False
) -> list[PreparedRecording]:
    """The recordings made ready; `closed` under the rig's own loop.

    One sensor read them all: where a quick motion between few or late stamps makes its readings look noisy, those of a
    slow one say how good they are.
    """
    cases = [prepared_recording.prepare_recording(r, structure, closed) for r in recordings]
    least = min((c.reading_variance for c in cases), default=0.0)
    cases = [replace(c, reading_variance=least) for c in cases]
    if "backlash" not in structure:
        return cases
    return [
        replace(c, rattle_mask=contact_masking.find_rattling(c), start_mask=contact_masking.find_first_contact(c))
        for c in cases
    ]


def with_internal_step(cases: Sequence[PreparedRecording], structure: Structure) -> list[PreparedRecording]:
    """The cases with the internal step that the structure needs."""
    longest = 0.002 / structure.substeps * (1.0 + 1e-9)
    # What a case has worked out about itself goes with it.
    return [c if c.drive.longest == longest else replace(c, drive=replace(c.drive, longest=longest)) for c in cases]


def excerpt(case: PreparedRecording, structure: Structure, begin: float, end: float) -> PreparedRecording:
    """What was recorded between two moments (s), read by the same sensor."""
    cut = prepared_recording.prepare_recording(case.recording.part(begin, end), structure)
    inside = (case.recording.time >= begin) & (case.recording.time <= end)
    rattling, beginning = (None if m is None else m[inside] for m in (case.rattle_mask, case.start_mask))
    return replace(cut, reading_variance=case.reading_variance, rattle_mask=rattling, start_mask=beginning)
