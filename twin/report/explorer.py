"""Linked panels to explore a diagnosis in a browser: the data beside the script in explorer.js.

The page works from disk and asks no network. Every sample of a recording of a minute at 2 ms is there; longer
recordings are thinned, and the page says so.
"""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import model_comparison
from twin.diagnosis.holdout import simulate_recording
from twin.diagnosis.result import Diagnosis, Trace
from twin.display.numbers import capital, unit_text
from twin.io.recording import Recording
from twin.model.fitted_model import Model
from twin.report.wording import title

FloatArray = NDArray[np.float64]

#: Samples that a page holds at most: two minutes at 2 ms, some 0.6 MB with all channels.
SAMPLES = 60_000
#: Recordings that a page holds at most.
RECORDINGS = 6
#: Effects that can be taken out one by one, at most.
EFFECTS_OUT = 4
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
class _Panel:
    title: str
    unit: str
    lines: tuple[tuple[str, str, str, bool], ...]  # channel, line, what it says, drawn wide
    without: str = ""  # prefix of the channels without an effect
    overlay: str = ""  # the channel of a free run that the page around may lay over it

    def told(self, out: Sequence[str]) -> dict[str, Any]:
        lines = [
            {"channel": channel, "line": line, "says": says, "colour": line, "wide": wide}
            for channel, line, says, wide in self.lines
        ]
        without = [
            {"channel": f"{self.without}{e}", "effect": e, "says": f"without {title(e)}"} for e in out if self.without
        ]
        return {
            "title": f"{self.title}, {self.unit}".removesuffix(", "), "unit": self.unit, "lines": lines,
            "without": without, "overlay": self.overlay,
        }  # fmt: skip


def _spliced(recording: Recording, traces: Sequence[Trace], which: str) -> FloatArray:
    """A model's free run (N,) over a recording; where a part is held out, the run that began anew there."""
    run = np.full(len(recording.time), np.nan)
    for trace in sorted(traces, key=lambda t: t.role == "holdout"):
        places = np.searchsorted(recording.time, trace.time)
        run[np.minimum(places, len(run) - 1)] = getattr(trace, which)
    return run


def _alone(model: Model, recording: Recording, held_out: Sequence[Trace]) -> FloatArray:
    """What a model reads (N,) that was not fitted: free from the start, and anew where a part is held out."""
    run = simulate_recording(model, recording)
    for trace in held_out:
        inside = (recording.time >= trace.time[0]) & (recording.time <= trace.time[-1])
        if inside.all():
            continue
        anew = simulate_recording(model, recording.part(float(trace.time[0]), float(trace.time[-1])))
        run[inside] = anew[-int(inside.sum()) :]
    return run


def removable(d: Diagnosis) -> dict[str, Model]:
    """The last model without each effect that was added to the first, the other values kept."""
    out = {}
    for effect in [e for e in d.after.structure.named if e not in d.before.structure][:EFFECTS_OUT]:
        brought = d.after.structure.brought_by(effect, d.before.structure)
        structure = d.after.structure.without(effect, *brought)
        values = {p.name: d.after.values[p.name] for p in structure.parameters}
        empty = np.zeros((0, 0))
        out[effect] = replace(d.after, structure=structure, values=values, fitted=(), covariance=empty)
    return out


def _chosen(d: Diagnosis) -> list[Recording]:
    """The recordings to show, the worst first, as many as a page holds."""

    def error(recording: Recording) -> float:
        worst = [np.nanmean((t.recorded - t.after) ** 2) for t in d.traces if t.name == recording.name]
        return max(map(float, worst), default=0.0)

    return sorted(d.recordings, key=error, reverse=True)[:RECORDINGS]


def _bands(d: Diagnosis, recording: Recording, traces: Sequence[Trace]) -> list[dict[str, Any]]:
    """Stretches of time that are marked: misfit, held out, left out of every fit."""
    held = [t for t in traces if t.role == "holdout" and len(t.time)]
    bands = [
        {"kind": "held", "start": float(t.time[0]), "end": float(t.time[-1]), "says": "held out from every fit"}
        for t in held
    ]
    if recording.name == d.telling:
        bands += [
            {"kind": "misfit", "start": s.start, "end": s.end, "says": f"{s.share:.0%} of the misfit"}
            for s in d.segments
        ]
    return bands + _faults(recording)


def _faults(recording: Recording) -> list[dict[str, Any]]:
    return [
        {"kind": "fault", "start": f.start, "end": f.end, "says": f"{f.kind}, left out"}
        for f in recording.faults[:FAULTS]
    ]


def _places(d: Diagnosis, recording: Recording, traces: Sequence[Trace]) -> list[dict[str, Any]]:
    """Where to look: the worst stretches, and what was held out."""
    places = []
    if recording.name == d.telling:
        worst = sorted(d.segments, key=lambda s: -s.share)[:3]
        for i, s in enumerate(worst):
            room = max(0.5 * (s.end - s.start), 0.25)
            label = "the worst stretch" if i == 0 else f"no. {i + 1}"
            places.append({"label": label, "start": s.start - room, "end": s.end + room})
    for t in traces:
        if t.role == "holdout" and len(t.time) and t.time[0] > recording.time[0]:
            places.append({"label": "held-out part", "start": float(t.time[0]), "end": float(t.time[-1])})
    return places


def _stretch(d: Diagnosis, recording: Recording, without: Mapping[str, Model], stride: int) -> dict[str, Any]:
    """One recording with all its channels."""
    traces = [t for t in d.traces if t.name == recording.name]
    before, after = (_spliced(recording, traces, which) for which in ("before", "after"))
    channels = {
        "time": recording.time, "command": recording.input, "recorded": recording.output,
        "after": after, "error_after": after - recording.output,
    }  # fmt: skip
    if d.before.structure != d.after.structure:
        channels |= {"before": before, "error_before": before - recording.output}
    if recording.name == d.telling:
        for which, missing in (("before", d.missing_before), ("after", d.missing_after)):
            known = np.isfinite(missing.torque)
            if known.any():
                torque = np.interp(recording.time, missing.time[known], missing.torque[known])
                channels[f"missing_{which}"] = np.where(np.isfinite(recording.output), torque, np.nan)
    held_out = [t for t in traces if t.role == "holdout" and len(t.time)]
    for effect, model in without.items():
        run = _alone(model, recording, held_out)
        channels |= {f"run_without_{effect}": run, f"error_without_{effect}": run - recording.output}
    return {
        "name": recording.name,
        "count": len(recording.time[::stride]),
        "channels": {name: packed(np.asarray(v, dtype=float)[::stride]) for name, v in channels.items()},
        "bands": _bands(d, recording, traces),
        "places": _places(d, recording, traces),
    }


def _stride(recordings: Sequence[Recording]) -> int:
    """One sample in how many is shown."""
    return max(1, math.ceil(sum(len(r.time) for r in recordings) / SAMPLES))


def tell_recordings(recordings: Sequence[Recording]) -> dict[str, Any]:
    """What the script needs to show recordings alone, before there is any model."""
    shown = recordings[:RECORDINGS]
    stride, first = _stride(shown), shown[0]
    quantity = "Speed" if first.is_speed else "Position"
    panels = [
        _Panel(quantity, unit_text(first.output_unit), (("recorded", "after", "recorded", False),)),
        _Panel("Command", unit_text(first.input_unit), (("command", "ink", "command", False),)),
    ]
    stretches = [
        {
            "name": r.name, "count": len(r.time[::stride]), "bands": _faults(r), "places": [],
            "channels": {
                name: packed(np.asarray(values[::stride], dtype=float))
                for name, values in (("time", r.time), ("recorded", r.output), ("command", r.input))
            },
        }
        for r in shown
    ]  # fmt: skip
    return _page_data(panels, stretches, stride, [], {})


def tell_missing_torque(unit: str, time: FloatArray, before: FloatArray, after: FloatArray) -> dict[str, Any]:
    """What the script needs to show the torque (N,) that two models lack, over inertia, in `unit` of acceleration."""
    lines = (("missing_before", "before", "first model", False), ("missing_after", "after", "model so far", False))
    channels = {"time": packed(time), "missing_before": packed(before), "missing_after": packed(after)}
    stretch = {"name": "", "count": len(time), "bands": [], "places": [], "channels": channels}
    return _page_data([_Panel("Missing torque over inertia", unit_text(unit), lines)], [stretch], 1, [], {})


def tell_free_run(d: Diagnosis, model: Model) -> dict[str, Any]:
    """A model's free run over the recording that the explorer shows first: what its event `overlay` takes.

    `rmse` is in the output's unit, over all of that recording; `nrmse_percent` is the same of the recorded range.
    """
    recordings = _chosen(d)
    recording, stride = recordings[0], _stride(recordings)
    run = _alone(model, recording, [t for t in d.traces if t.name == recording.name and t.role == "holdout"])
    value, percent = model_comparison.rmse(recording.output, run)
    channels = {"run": run, "error": run - recording.output}
    return {"rmse": value, "nrmse_percent": percent, **{n: packed(v[::stride]) for n, v in channels.items()}}


def _page_data(
    panels: Sequence[_Panel], stretches: list[dict[str, Any]], stride: int, models: Sequence[tuple[str, str]],
    without: Mapping[str, Model],
) -> dict[str, Any]:  # fmt: skip
    """What explorer.js reads; `models` are the lines that can be switched off beside the recorded one."""
    thinned = "" if stride == 1 else f" One sample in {stride} is shown."
    return {
        "panels": [panel.told(list(without)) for panel in panels],
        "lines": [{"key": w, "label": says} for w, says in models],
        "without": [{"key": e, "label": title(e)} for e in without],
        "legend": f"Shaded: misfit, held out, left out.{thinned}",
        "stretches": stretches,
    }


def _told(d: Diagnosis) -> dict[str, Any]:
    """All that the script needs for a diagnosis."""
    recordings, without = _chosen(d), removable(d)
    stride = _stride(recordings)
    first = d.recordings[0]
    output, axis, drive = unit_text(first.output_unit), unit_text(f"{d.after.axis_unit}/s^2"), d.after.input_unit
    changed = d.before.structure != d.after.structure
    models = [("before", "first model"), ("after", "improved model")] if changed else [("after", "model")]
    panels = [
        _Panel(
            "Speed" if first.is_speed else "Position", output,
            (("recorded", "recorded", "recorded", True), *((w, w, says, False) for w, says in models)),
            "run_without_", "run",
        ),
        _Panel(
            "Error of the free run", output, tuple((f"error_{w}", w, says, False) for w, says in models),
            "error_without_", "error",
        ),
        _Panel("Missing torque over inertia", axis, tuple((f"missing_{w}", w, says, False) for w, says in models)),
        _Panel("Command", unit_text(drive), (("command", "ink", "command", False),)),
    ]  # fmt: skip
    lines = (("recorded", "recorded"), *models)
    return _page_data(panels, [_stretch(d, r, without, stride) for r in recordings], stride, lines, without)


@cache
def script() -> str:
    """The viewer's source."""
    return files("twin.report").joinpath("explorer.js").read_text(encoding="utf-8")


def explorer(d: Diagnosis) -> str:
    """The explorer as HTML: an empty place, its data, the script that fills it."""
    data = json.dumps(_told(d), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    label = escape(capital("recording and models, to explore"), quote=True)
    return (
        f'<div id="explorer" class="explorer" role="group" aria-label="{label}" hidden></div>'
        f'<script type="application/json" id="explorer-data">{data}</script><script>{script()}</script>'
    )
