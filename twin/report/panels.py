"""What explorer.js shows: linked panels over one time axis, and the samples of each channel, packed.

A diagnosis in such panels is in `twin.report.explorer`; here is what needs no model.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.display.numbers import unit_text
from twin.io.recording import Recording

FloatArray = NDArray[np.float64]

#: Samples that a page holds at most: two minutes at 2 ms, some 0.6 MB with all channels.
SAMPLES = 60_000
#: Recordings that a page holds at most.
RECORDINGS = 6
#: Columns that are shown as they stand in a file, at most.
COLUMNS = 6
#: Faults of the sensor that are banded, at most; more of them would hide the curves.
FAULTS = 200
#: Codes that a sample may have; the last stands for one that is left out.
_CODES = 65_535


def packed(values: FloatArray) -> dict[str, Any]:
    """Samples (N,) in 16 bits: differences modulo 65535 of a linear scale, deflated, base64. NaN is code 65535.

    The error is at most half a step, 1/131,068 of the range.
    """
    seen = np.isfinite(values)
    low = float(np.min(values[seen])) if seen.any() else 0.0
    high = float(np.max(values[seen])) if seen.any() else 0.0
    step = (high - low) / (_CODES - 1) or 1.0
    codes = np.rint((values[seen] - low) / step).astype(np.int64)
    out = np.full(len(values), _CODES, dtype="<u2")
    out[seen] = np.diff(codes, prepend=0) % _CODES
    return {"low": low, "step": step, "data": base64.b64encode(zlib.compress(out.tobytes(), 9)).decode("ascii")}


@dataclass(frozen=True)
class Panel:
    """One panel: its lines, and what may be laid over them.

    Attributes
    ----------
    title, unit : str
        Of the vertical axis.
    lines : tuple of (channel, line, what it says, drawn wide)
        A line is a colour of the page's style sheet, too.
    without : str
        Prefix of the channels of a model without an effect; "" where there are none.
    overlay : str
        The channel of a free run that the page around may lay over the panel; "" where it may not.
    """

    title: str
    unit: str
    lines: tuple[tuple[str, str, str, bool], ...]
    without: str = ""
    overlay: str = ""

    def told(self, out: Mapping[str, str]) -> dict[str, Any]:
        """The panel as the script reads it; `out` are the effects that can be taken out, with their titles."""
        lines = [
            {"channel": channel, "line": line, "says": says, "colour": line, "wide": wide}
            for channel, line, says, wide in self.lines
        ]
        without = [
            {"channel": f"{self.without}{e}", "effect": e, "says": f"without {title}"}
            for e, title in out.items()
            if self.without
        ]
        return {
            "title": f"{self.title}, {self.unit}".removesuffix(", "), "unit": self.unit, "lines": lines,
            "without": without, "overlay": self.overlay,
        }  # fmt: skip


@dataclass(frozen=True)
class View:
    """All that the script reads.

    Attributes
    ----------
    panels : sequence of Panel
    stretches : list of dict
        One recording each: its name, the count of samples, channels, bands and places to go to.
    stride : int
        One sample in how many is there.
    legend : str
        What the bands are.
    models : sequence of (line, label)
        Lines that can be switched off.
    without : mapping
        Effects that can be taken out, with their titles.
    """

    panels: Sequence[Panel]
    stretches: list[dict[str, Any]]
    stride: int = 1
    legend: str = ""
    models: Sequence[tuple[str, str]] = ()
    without: Mapping[str, str] = field(default_factory=dict)

    def told(self) -> dict[str, Any]:
        thinned = "" if self.stride == 1 else f" One sample in {self.stride} is shown."
        return {
            "panels": [panel.told(self.without) for panel in self.panels],
            "lines": [{"key": line, "label": label} for line, label in self.models],
            "without": [{"key": e, "label": title} for e, title in self.without.items()],
            "legend": f"{self.legend}{thinned}",
            "stretches": self.stretches,
        }


def stride_of(recordings: Sequence[Recording]) -> int:
    """One sample in how many of these fits into a page."""
    return max(1, math.ceil(sum(len(r.time) for r in recordings) / SAMPLES))


def stretch(name: str, channels: Mapping[str, FloatArray], stride: int = 1) -> dict[str, Any]:
    """A recording of a `View`: channels (N,), each thinned, without bands and places; `time` is one of them."""
    return {
        "name": name,
        "count": len(channels["time"][::stride]),
        "channels": {c: packed(np.asarray(v, dtype=float)[::stride]) for c, v in channels.items()},
        "bands": [],
        "places": [],
    }


def fault_bands(recording: Recording) -> list[dict[str, Any]]:
    """Where readings are left out."""
    return [
        {"kind": "fault", "start": f.start, "end": f.end, "says": f"{f.kind}, left out"}
        for f in recording.faults[:FAULTS]
    ]


def tell_columns(columns: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Columns (N,) of a file as they stand in it, a panel each over the row, as the script reads them."""
    shown = dict(list(columns.items())[:COLUMNS])
    titles = [f"column {name}" if name.isdecimal() else name for name in shown]  # a file without a header
    panels = [Panel(name, "", ((f"column {i}", "ink", name, False),)) for i, name in enumerate(titles)]
    count = max(map(len, shown.values()), default=0)
    channels = {f"column {i}": values for i, values in enumerate(shown.values())}
    stride = max(1, math.ceil(count / SAMPLES))
    view = View(panels, [stretch("", {"time": np.arange(count, dtype=float), **channels}, stride)], stride)
    return {**view.told(), "time_unit": "rows"}


def tell_recordings(recordings: Sequence[Recording]) -> dict[str, Any]:
    """Recordings alone, before there is any model, as the script reads them."""
    shown, first = recordings[:RECORDINGS], recordings[0]
    stride = stride_of(shown)
    quantity = "Speed" if first.is_speed else "Position"
    panels = [
        Panel(quantity, unit_text(first.output_unit), (("recorded", "after", "recorded", False),)),
        Panel("Command", unit_text(first.input_unit), (("command", "ink", "command", False),)),
    ]
    stretches = [
        {
            **stretch(r.name, {"time": r.time, "recorded": r.output, "command": r.input}, stride),
            "bands": fault_bands(r),
        }
        for r in shown
    ]
    legend = "Shaded: left out." if any(r.faults for r in shown) else ""
    return View(panels, stretches, stride, legend).told()


@cache
def script() -> str:
    """The viewer's source."""
    return files("twin.report").joinpath("explorer.js").read_text(encoding="utf-8")
