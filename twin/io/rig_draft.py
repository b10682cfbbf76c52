"""A rig file written from a log, with the faults corrected that the checks before a fit find."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twin.io.manifest import entries_of
from twin.io.recording import guess_of, load_guessed
from twin.io.rig_guess import Section, write_sections


@dataclass(frozen=True)
class Draft:
    """A rig file as text, what the user should check in it, and its tables by their titles, as `input.direction`."""

    text: str
    unsure: tuple[str, ...]
    sections: Mapping[str, Section]


def draft(logs: Sequence[Path]) -> Draft:
    """Look at a log and write its rig file.

    Parameters
    ----------
    logs
        Recordings of one rig, of any format that can be read, or manifests.

    Returns
    -------
    Draft
        The text of a rig file that loads the recordings. Faults that the checks before a fit find, such as a reversed
        sensor or a lost sign, are corrected in it. What a log cannot show is said as a comment. Where it has no time,
        the rig file loads nothing before the sample time is written in it.

    Raises
    ------
    BadInput
        A log cannot be read, or has no column that can be the input or the output.
    """
    entries = [entry for path in logs for entry in entries_of(Path(path))]
    guessed = guess_of(entries)
    reading = guessed.sections["output"]
    if "sample_time" not in guessed.sections["time"].keys:
        recordings, _ = load_guessed(entries, guessed)
        refresh = next((r.refresh for r in recordings if r.refresh is not None), None)
        if refresh is not None:
            reading.keys["refresh"] = float(f"{refresh:.3g}")
            reading.remarks["refresh"] = "s; the sensor is read anew only so often"
            guessed.unsure.append("the sensor is read more slowly than it is logged (refresh)")
    text = write_sections(guessed.sections, Path(logs[0]).name, guessed.columns, guessed.unsure)
    if "sample_time" in guessed.sections["time"].keys:
        # No log shows it, and every speed would be wrong by a wrong one: the user has to write it.
        text = text.replace("\nsample_time = ", "\n# sample_time = ", 1)
    return Draft(text, tuple(guessed.unsure), guessed.sections)
