"""The run of one axis of a fleet, wherever it takes place; its result is kept beside what the run leaves."""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from twin import pipeline
from twin.errors import BadInput, StageFailed
from twin.io.files import check_folder, json_text, put
from twin.io.manifest import Axis, expand
from twin.io.recording import load_entries
from twin.model.fitted_model import Model
from twin.parallel import THREADS

FORMAT = "twin-fleet-axis/1"
#: The result of one axis, in its folder.
RESULT = "axis.json"
#: Of a failed axis.
FAILED = "failed"
#: One run at a time in a process: figures are drawn with settings that a process has only once.
_TURN = threading.Lock()


@dataclass(frozen=True)
class Task:
    """What one axis' run needs to know."""

    axis: Axis
    out: Path
    force: bool = False


@dataclass(frozen=True)
class AxisResult:
    """What one axis has come to.

    Attributes
    ----------
    axis : str
    verdict : str
        Of the diagnosis, or "failed".
    says : str
        One sentence.
    effects : tuple of str
        Ids of the effects that the first model left out.
    values, stds, units : mapping
        Of each parameter of the improved model; standard errors of those that were fitted.
    undetermined : tuple of str
        Parameters that the recordings cannot fix.
    inputs : str
        Hash of all files that went in.
    seconds : float
    """

    axis: str
    verdict: str
    says: str
    effects: tuple[str, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    stds: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    undetermined: tuple[str, ...] = ()
    inputs: str = ""
    seconds: float = 0.0

    @property
    def failed(self) -> bool:
        return self.verdict == FAILED


def inputs_digest(axis: Axis) -> str:
    """SHA-256 of all that a run's result follows from: the recordings, their roles and windows, and the rig file.

    Raises BadInput where a file cannot be read.
    """
    told = hashlib.sha256()
    entries = expand(axis.entries)
    rigs = {axis.rig} if axis.rig is not None else {e.path.parent / "rig.toml" for e in entries}
    try:
        for e in entries:
            told.update(e.path.read_bytes())
            told.update(repr((e.path.name, e.role, sorted(e.known.items()), e.start, e.end, e.test)).encode())
        for rig in sorted(rigs):
            if rig.exists() or axis.rig is not None:
                told.update(rig.read_bytes())
    except OSError as error:
        raise BadInput(f"{error.filename} cannot be read ({error.strerror}): correct its name in the list") from None
    return told.hexdigest()


def stored_result(task: Task) -> AxisResult | None:
    """The result that a run of the same inputs has left; None where there is none, or an input is not to be seen."""
    with suppress(BadInput):
        return _stored(task.out / task.axis.name, inputs_digest(task.axis))
    return None


def _stored(folder: Path, digest: str) -> AxisResult | None:
    with suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
        found = json.loads((folder / RESULT).read_text(encoding="utf-8"))
        if found.pop("format") == FORMAT and found["inputs"] == digest:
            found |= {name: tuple(found[name]) for name in ("effects", "undetermined")}
            return AxisResult(**found)
    return None


def _of_model(model: Model) -> dict[str, Any]:
    """What a result holds of the improved model."""
    names = tuple(p.name for p in model.structure.parameters)
    stds = {n: model.std(n) for n in names}
    return {
        "values": {n: model.values[n] for n in names},
        "stds": {n: s for n, s in stds.items() if math.isfinite(s)},
        "units": {n: model.unit(n) for n in names},
        "undetermined": model.undetermined,
    }


def _attempt(task: Task, began: float) -> AxisResult:
    """The result of a run. Raises what the run raises."""
    axis, folder = task.axis, task.out / task.axis.name
    digest = inputs_digest(axis)
    stored = _stored(folder, digest)
    if stored is not None:
        return stored
    check_folder(folder, pipeline.FILES, task.force)
    (folder / RESULT).unlink(missing_ok=True)  # it tells of what is now made anew
    recordings, _ = load_entries(axis.entries, axis.rig)
    story = pipeline.run(recordings, folder, force=task.force)
    d = story.diagnosis
    says = d.adequacy.says if d.adequacy is not None and d.adequacy.says else d.verdict.replace("_", " ")
    result = AxisResult(
        axis.name, d.verdict, " ".join([says, *story.failures.values()]), tuple(f.id for f in d.findings),
        **_of_model(d.after), inputs=digest, seconds=time.perf_counter() - began,
    )  # fmt: skip
    put(folder / RESULT, json_text({"format": FORMAT, **asdict(result)}))
    return result


def run_axis(task: Task) -> AxisResult:
    """Do the whole job on one axis, or take the result that an earlier run has left.

    Whatever ends the run is said in the result and raised to nobody: the other axes go on.
    """
    began = time.perf_counter()
    threads = THREADS.set(1)
    try:
        with _TURN:
            return _attempt(task, began)
    except BadInput as error:
        says = f"{error}."
    except StageFailed as error:
        says = str(error)
    except Exception as error:
        if os.environ.get("TWIN_DEBUG"):
            traceback.print_exc()
        says = f"An internal error ended it ({type(error).__name__}: {' '.join(str(error).split())})."
    finally:
        THREADS.reset(threads)
    return AxisResult(task.axis.name, FAILED, says, seconds=time.perf_counter() - began)
