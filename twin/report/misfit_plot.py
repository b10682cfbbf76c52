"""The picture of a check that failed: recording and FMU in the second where they are furthest apart."""

from __future__ import annotations

import io

import matplotlib.figure
import numpy as np

from twin.display.numbers import unit_text
from twin.fmi.misfit import Misfit
from twin.fmi.python_fmu import Replay
from twin.io.recording import Recording
from twin.report.style import AFTER, MUTED, RECORDED

#: What the worst second is shown with on either side, s.
_ROOM = 0.25


def worst_second(recording: Recording, ran: Replay, found: Misfit, title: str) -> bytes:
    """A PNG: the input, the recorded and the simulated output, and the error that was judged.

    Parameters
    ----------
    recording
        What was measured.
    ran
        The free run of the FMU over it.
    found
        The errors that were judged.
    title
        Stands above the picture.
    """
    begin, end = found.worst()
    near = slice(*np.searchsorted(recording.time, (begin - _ROOM, end + _ROOM)))
    judged = slice(*np.searchsorted(found.time, (begin - _ROOM, end + _ROOM)))
    unit = unit_text(recording.output_unit)
    figure = matplotlib.figure.Figure(figsize=(9, 7), layout="constrained")
    figure.suptitle(title, fontsize=10, x=0.01, ha="left", parse_math=False)
    drive, above, below = figure.subplots(3, 1, sharex=True, height_ratios=(0.5, 1.2, 1.0))
    drive.step(recording.time[near], ran.input[near], where="post", color=MUTED)
    drive.set_ylabel(f"input, {unit_text(recording.input_unit)}")
    above.plot(recording.time[near], recording.output[near], color=RECORDED, linewidth=3.2, label="recorded")
    above.plot(recording.time[near], ran.output(recording)[near], color=AFTER, label="FMU")
    above.set_ylabel(f"{'speed' if recording.is_speed else 'position'}, {unit}")
    above.legend(loc="best", frameon=False)
    below.plot(found.time[judged], found.error[judged], color=AFTER)
    below.axhline(0.0, color=MUTED, linewidth=0.6)
    below.set_ylabel(f"error, {unit}" if found.ahead is None else f"error {found.ahead:g} s ahead, {unit}")
    below.set_xlabel("time, s")
    for axes in (drive, above, below):
        axes.grid(alpha=0.3)
        axes.axvspan(begin, end, color=MUTED, alpha=0.1, linewidth=0.0)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()
