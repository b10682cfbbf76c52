"""What an FMU was judged by, carried inside it: recordings, experiment, result, report; and the same judged again.

All of it lies in the folder of FMI-LS-REF (`twin.fmi.related_files`). A recording there is a CSV with the names of the
FMU's variables, so that any importer can play it: FMPy takes it as its input file.
"""

from __future__ import annotations

import io
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import BadInput
from twin.fmi.fmu_archive import Fmu, open_fmu, rewritten
from twin.fmi.misfit import Misfit, misfit
from twin.fmi.model_description import text
from twin.fmi.python_fmu import read_model, replay, start_values
from twin.fmi.related_files import FOLDER, Related, files, member, related
from twin.io.files import json_text, put
from twin.io.recording import Recording, as_told, driven
from twin.model.fitted_model import INPUT_NAMES

EXPERIMENT, RESULT, FIGURES, REPORT = "experiment.json", "validation.json", "validation.srmd", "report.html"
#: How far ahead (s) predictions are judged beside the free run.
AHEAD = 0.1
#: Stamps that an archive carries at most, in all.
MOST_STAMPS = 500_000
#: A figure is the one that was found where it is no larger than this many times that: machines round differently.
REPEATED = 1.01
_SRMD = "http://ssp-standard.org/SSPTraceability1/SimulationResourceMetaData"
_STC = "http://ssp-standard.org/SSPTraceability1/SSPTraceabilityCommon"


@dataclass(frozen=True, eq=False)
class Trial:
    """A recording that an FMU is judged by.

    Attributes
    ----------
    recording
        What drives the FMU, and what was measured.
    judged_from
        s: what comes before only leads there.
    """

    recording: Recording
    judged_from: float = 0.0


def _figures(found: Misfit) -> dict[str, float]:
    return {"rmse": found.rmse, "peak": found.peak, "nrmse_percent": found.nrmse_percent}


def judge(fmu: Path, trial: Trial) -> dict[str, Any]:
    """The figures of one trial: of the free run, and of the prediction 0.1 s ahead where it is long enough."""
    recording = trial.recording
    ran = replay(fmu, recording)
    figures: dict[str, Any] = {"recording": recording.name, "unit": recording.output_unit}
    figures |= _figures(misfit(recording, ran, since=trial.judged_from))
    if recording.time[-1] - trial.judged_from > AHEAD:
        ahead = misfit(recording, ran, AHEAD, trial.judged_from)
        figures["ahead"] = {"seconds": AHEAD, **_figures(ahead)}
    return figures


def _table(recording: Recording) -> bytes:
    """The recording as CSV: each number as short as it can be read back from."""
    reads = "velocity" if recording.is_speed else "position_measured"
    columns = (recording.time.tolist(), recording.input.tolist(), recording.output.tolist())
    rows = [f"time,{INPUT_NAMES[recording.input_unit]},{reads}"]
    rows += [f"{t!r},{u!r},{y!r}" for t, u, y in zip(*columns, strict=True)]
    return ("\n".join(rows) + "\n").encode()


def _described(trial: Trial, source: str, start: tuple[float, float]) -> dict[str, Any]:
    r = trial.recording
    return {
        "recording": source, "name": r.name, "role": r.role, "input": INPUT_NAMES[r.input_unit],
        "input_unit": r.input_unit, "output": "velocity" if r.is_speed else "position_measured",
        "output_unit": r.output_unit, "resolution": r.resolution, "known": dict(r.known),
        "start": {"position_start": start[0], "velocity_start": start[1]}, "judged_from": trial.judged_from,
    }  # fmt: skip


def _srmd(results: Sequence[Mapping[str, Any]]) -> bytes:
    """The figures as simulation resource meta data (SSP Traceability 1.0), one classification a recording."""
    ET.register_namespace("srmd", _SRMD)
    ET.register_namespace("stc", _STC)
    root = ET.Element(f"{{{_SRMD}}}SimulationResourceMetaData", version="1.0.0", name="validation")
    for found in results:
        kept = ET.SubElement(root, f"{{{_STC}}}Classification", type="twin.validation")
        for keyword, value in found.items():
            if not isinstance(value, Mapping):
                ET.SubElement(kept, f"{{{_STC}}}ClassificationEntry", keyword=keyword).text = str(value)
    return text(root)


def _bounded(trials: Sequence[Trial]) -> list[Trial]:
    """As many trials as an archive carries, the first one cut where it alone is too long."""
    first = trials[0].recording
    if len(first.time) > MOST_STAMPS:
        cut = first.part(0.0, float(first.time[MOST_STAMPS - 1]))
        return [Trial(cut, min(trials[0].judged_from, 0.5 * float(cut.time[-1])))]
    counts = np.cumsum([len(t.recording.time) for t in trials])
    return [t for t, count in zip(trials, counts.tolist(), strict=True) if count <= MOST_STAMPS]


def attach(
    fmu: Path, trials: Sequence[Trial], adequacy: Mapping[str, Any] | None = None, report: str = ""
) -> dict[str, Any]:
    """Judge an FMU of ours by these recordings, and put them, the experiment and the result into it.

    Parameters
    ----------
    fmu
        The file; it is replaced whole.
    trials
        What it is judged by, at least one; 500,000 stamps are kept.
    adequacy
        Figures of a diagnosis on how good the model is.
    report
        An HTML page.

    Returns
    -------
    dict
        The result as it stands in the archive: `runs`, a mapping of figures for each recording.

    Raises
    ------
    BadInput
        The FMU cannot be run over a recording, or cannot be written.
    """
    opened, model = open_fmu(fmu), read_model(fmu)
    kept = [replace(t, recording=driven(as_told(t.recording, model.known))) for t in _bounded(trials)]
    results = [judge(fmu, t) for t in kept]
    added: dict[Related, bytes] = {}
    described = []
    for i, trial in enumerate(kept, 1):
        source = f"recordings/{i}.csv"
        added[Related(source, "text/csv", "testcase", f"Recording {trial.recording.name}")] = _table(trial.recording)
        described.append(_described(trial, source, start_values(trial.recording, model)))
    experiment = {
        "format": "twin-experiment/1",
        "says": "Set the start values, hold the recorded input from stamp to stamp, and compare the output.",
        "runs": described,
    }
    result = {"format": "twin-validation/1", "twin": version("twin"), "runs": results, "adequacy": adequacy}
    says = "How far the FMU is from each recording"
    plain = "application/json"
    added[Related(EXPERIMENT, plain, "experiment/validation", "How the recordings are replayed")] = json_text(
        experiment
    ).encode()
    added[Related(RESULT, plain, "result", says)] = json_text(result).encode()
    added[Related(FIGURES, "application/x-srmd-meta-data", "meta-data", says)] = _srmd(results)
    if report:
        added[Related(REPORT, "text/html", "report", "How the model was found")] = report.encode()
    # Earlier evidence goes; what updates have replaced stays.
    gone = [r.source for r in related(opened) if r.source == REPORT or r.source.startswith("recordings/")]
    put(fmu, rewritten(opened, files(opened, added, gone), [member(source) for source in gone]))
    return result


# ---- read back ----


def _json(fmu: Fmu, source: str, format_of: str) -> dict[str, Any]:
    name = member(source)
    try:
        found = json.loads(fmu.read(name).decode("utf-8"))
    except (ValueError, RecursionError):
        raise BadInput(f"{fmu.path}: {name} is not JSON: put the evidence into the FMU again") from None
    if not isinstance(found, dict) or found.get("format") != format_of or not isinstance(found.get("runs"), list):
        raise BadInput(f"{fmu.path}: {name} is not {format_of}: put the evidence into the FMU again")
    return found


def _recording(fmu: Fmu, run: Mapping[str, Any]) -> Trial:
    source = str(run["recording"])
    content = fmu.read(member(source)).decode("utf-8")
    table = np.loadtxt(io.StringIO(content), delimiter=",", skiprows=1, ndmin=2)
    time, command, output = table.T
    begin, resolution = float(run["judged_from"]), float(run["resolution"])
    known = {str(name): float(value) for name, value in run["known"].items()}
    sound = np.isfinite(time).all() and np.isfinite(command).all() and bool((np.diff(time) > 0.0).all())
    if not (sound and len(time) > 1 and all(map(math.isfinite, (begin, resolution, *known.values())))):
        raise ValueError("stamps or inputs that are none")
    role, units = str(run["role"]), (str(run["input_unit"]), str(run["output_unit"]))
    return Trial(Recording(str(run["name"]), time, command, output, *units, resolution, role, known), begin)


def of_old_parameters(fmu: Path) -> str:
    """What is to be said where an FMU carries recordings that its parameters were not compared with; else nothing.

    Parameters
    ----------
    fmu
        It has just got new parameters.
    """
    if member(EXPERIMENT) not in open_fmu(fmu).members:
        return ""
    return (
        f"{fmu} still carries recordings and figures of the old parameters, by which twin check judges it. To replace "
        "them, give twin update a newer recording: --evidence LOG."
    )


def carried(fmu: Path) -> tuple[list[Trial], list[dict[str, Any]]]:
    """The recordings that an FMU carries, and what was found with each of them.

    Raises BadInput where it carries none, or what cannot be read.
    """
    opened = open_fmu(fmu)
    if member(EXPERIMENT) not in opened.members:
        raise BadInput(f"{fmu} carries no recording: give one as `log`, or export it with evidence")
    runs, results = (
        _json(opened, source, kind)["runs"]
        for source, kind in ((EXPERIMENT, "twin-experiment/1"), (RESULT, "twin-validation/1"))
    )
    try:
        trials = [_recording(opened, run) for run in runs]
        figures = [{name: float(found[name]) for name in ("rmse", "peak")} for found in results]
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise BadInput(
            f"{fmu}: the recordings in {FOLDER} cannot be read ({error}): put the evidence into the FMU again"
        ) from None
    if not trials or len(trials) != len(figures):
        raise BadInput(f"{fmu}: {RESULT} is not of the recordings in {EXPERIMENT}: put the evidence in again")
    return trials, figures
