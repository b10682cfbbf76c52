"""A diagnosis to explore in a browser, in the linked panels of `twin.report.panels`.

The page works from disk and asks no network. Every sample of a recording of a minute at 2 ms is there; longer
recordings are thinned, and the page says so.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np

from twin.diagnosis import model_comparison
from twin.diagnosis.holdout import simulate_recording
from twin.diagnosis.residual_torque import MissingTorque
from twin.diagnosis.result import Diagnosis, Trace
from twin.display.numbers import capital, unit_text
from twin.io.recording import Recording
from twin.model.fitted_model import Model
from twin.report.panels import RECORDINGS, FloatArray, Panel, View, fault_bands, packed, script, stretch, stride_of
from twin.report.wording import title

#: Effects that can be taken out one by one, at most.
EFFECTS_OUT = 4


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
    return bands + fault_bands(recording)


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
                torque = np.interp(recording.time, missing.time[known], missing.torque[known], np.nan, np.nan)
                channels[f"missing_{which}"] = np.where(np.isfinite(recording.output), torque, np.nan)
    held_out = [t for t in traces if t.role == "holdout" and len(t.time)]
    for effect, model in without.items():
        run = _alone(model, recording, held_out)
        channels |= {f"run_without_{effect}": run, f"error_without_{effect}": run - recording.output}
    return {
        **stretch(recording.name, channels, stride),
        "bands": _bands(d, recording, traces),
        "places": _places(d, recording, traces),
    }


def tell_missing_torque(unit: str, first: MissingTorque, last: MissingTorque) -> dict[str, Any]:
    """What the script needs to show the torque that two models lack, over inertia, in `unit` of acceleration.

    They are averaged over some samples (`MissingTorque.averages`); of one model alone there is one line.
    """
    before, after = first.averages(), last.averages()
    lines = [("missing_before", "before", "first model", False), ("missing_after", "after", "model so far", False)]
    channels = {"time": before["time"], "missing_before": before["torque"], "missing_after": after["torque"]}
    if first is last:
        del channels["missing_after"]
    panel = Panel("Missing torque over inertia", unit_text(unit), tuple(lines))
    return View([panel], [stretch("", channels)]).told()


def tell_free_run(d: Diagnosis, model: Model) -> dict[str, Any]:
    """A model's free run over the recording that the explorer shows first: what its event `overlay` takes.

    `rmse` is in the output's unit, over all of that recording; `nrmse_percent` is the same of the recorded range.
    """
    recordings = _chosen(d)
    recording, stride = recordings[0], stride_of(recordings)
    run = _alone(model, recording, [t for t in d.traces if t.name == recording.name and t.role == "holdout"])
    value, percent = model_comparison.rmse(recording.output, run)
    channels = {"run": run, "error": run - recording.output}
    return {"rmse": value, "nrmse_percent": percent, **{n: packed(v[::stride]) for n, v in channels.items()}}


def _told(d: Diagnosis) -> dict[str, Any]:
    """All that the script needs for a diagnosis."""
    recordings, without = _chosen(d), removable(d)
    stride = stride_of(recordings)
    first = d.recordings[0]
    output, axis, drive = unit_text(first.output_unit), unit_text(f"{d.after.axis_unit}/s^2"), d.after.input_unit
    changed = d.before.structure != d.after.structure
    models = [("before", "first model"), ("after", "improved model")] if changed else [("after", "model")]
    panels = [
        Panel(
            "Speed" if first.is_speed else "Position", output,
            (("recorded", "recorded", "recorded", True), *((w, w, says, False) for w, says in models)),
            "run_without_", "run",
        ),
        Panel(
            "Error of the free run", output, tuple((f"error_{w}", w, says, False) for w, says in models),
            "error_without_", "error",
        ),
        Panel("Missing torque over inertia", axis, tuple((f"missing_{w}", w, says, False) for w, says in models)),
        Panel("Command", unit_text(drive), (("command", "ink", "command", False),)),
    ]  # fmt: skip
    lines, legend = (("recorded", "recorded"), *models), "Shaded: misfit, held out, left out."
    stretches = [_stretch(d, r, without, stride) for r in recordings]
    return View(panels, stretches, stride, legend, lines, {e: title(e) for e in without}).told()


def explorer(d: Diagnosis) -> str:
    """The explorer as HTML: an empty place, its data, the script that fills it."""
    data = json.dumps(_told(d), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    label = escape(capital("recording and models, to explore"), quote=True)
    return (
        f'<div id="explorer" class="explorer" role="group" aria-label="{label}" hidden></div>'
        f'<script type="application/json" id="explorer-data">{data}</script><script>{script()}</script>'
    )
