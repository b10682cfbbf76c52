"""The main job: recordings in; models, FMUs, diagnosis, controller and report out."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from fmpy.validation import validate_fmu

from twin.control import controller, cosimulation, design
from twin.control.controller import Controller
from twin.control.cosimulation import Tracking
from twin.diagnosis import data_split, diagnose, result
from twin.errors import BadInput
from twin.estimation import estimate, two_stage
from twin.fmi import python_fmu
from twin.io.api import as_list
from twin.io.files import check_place, json_text, put
from twin.io.recording import Recording
from twin.model import fitted_model
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.report.html import Check, Story, html

Progress = Callable[[str, float], None]

#: What `twin run` writes into its folder.
FILES = (
    "model.toml", "arm.fmu", "improved.toml", "improved.fmu", "diagnosis.json", "next_experiment.csv",
    "controller.toml", "report.html",
)  # fmt: skip


def check(fmu: Path, name: str, log: Recording) -> Check:
    """Validate an FMU with FMPy and replay a recording through it."""
    began = time.perf_counter()
    problems = tuple(str(p) for p in validate_fmu(str(fmu)))
    ran = python_fmu.replay(fmu, log)
    return Check(name, log.name, ran.rmse(log), ran.nrmse_percent(log), time.perf_counter() - began, problems)


def _check_folder(out: Path, force: bool) -> None:
    """Raises BadInput where the results may not or cannot go into this folder."""
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out} is a file: give the name of a folder as `out`")
    there = [name for name in FILES if (out / name).exists()]
    if there and not force:
        raise BadInput(f"{out} holds {there[0]} already: choose another folder, or overwrite with `force=True`")
    check_place(out if out.is_dir() else out.parent)


def _closed_loop(
    found: Model, fmu: Path, bandwidth: float | None
) -> tuple[Controller | None, Tracking | None, tuple[str, ...]]:
    """Controller, tracking, and why there is none where there is none."""
    try:
        made = design.design(found, bandwidth)
    except BadInput as error:
        return None, None, (f"No controller could be made: {error}.",)
    try:
        return made, cosimulation.run(fmu, made), ()
    except BadInput as error:
        return made, None, (f"The closed loop could not be run: {error}.",)


def run(
    recordings: Recording | Sequence[Recording], out: str | Path, structure: Structure | None = None,
    bandwidth: float | None = None, force: bool = False, progress: Progress | None = None,
) -> Story:  # fmt: skip
    """Do the whole job: identify, export, check, diagnose, design a controller, write the report.

    Parameters
    ----------
    recordings
        One recording of the axis, or several.
    out
        The folder for everything that is made; it appears at the end, whole.
    structure
        What the first model contains; by default `first_structure` of the recordings.
    bandwidth
        Hz, of the controller; by default what the axis allows.
    force
        Overwrite what an earlier run left in the folder.
    progress
        Is called with what is being done and the share of the work that is done, 0 to 1.

    Returns
    -------
    Story
        ``.diagnosis``, ``.controller``, ``.tracking`` and what else the report shows.

    Raises
    ------
    BadInput
        The recordings do not allow it, or the folder cannot be used. Then nothing is written.
    """
    recordings, out = as_list(recordings), Path(out)
    _check_folder(out, force)
    tell = progress or (lambda sentence, share: None)
    began = time.perf_counter()
    structure = estimate.first_structure(recordings) if structure is None else structure
    estimate.compile_kernel(tell)
    tell("steady states and transients", 0.03)
    training, _ = data_split.split(recordings)
    simple = two_stage.two_stage(training)
    diagnosis = diagnose.diagnose(recordings, structure, progress=lambda s, x: tell(s, 0.05 + 0.75 * x))
    before, after = (estimate.with_largest_command(m, recordings) for m in (diagnosis.before, diagnosis.after))
    diagnosis = replace(diagnosis, before=before, after=after)
    scratch = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name[:50]}-"))
    try:
        longest = max(recordings, key=lambda r: len(r.time))
        checks = []
        for name, kept, fmu in (("model", before, "arm.fmu"), ("improved", after, "improved.fmu")):
            tell(f"checking {fmu} in FMPy", 0.82)
            put(scratch / f"{name}.toml", fitted_model.dumps(kept))
            python_fmu.export(kept, scratch / fmu)
            checks.append(check(scratch / fmu, fmu, longest))
        tell("controller and closed loop", 0.9)
        made, tracking, remarks = _closed_loop(after, scratch / "improved.fmu", bandwidth)
        if made is not None:
            put(scratch / "controller.toml", controller.dumps(made))
        experiment = result.experiment_csv(diagnosis.experiment, after.input_name)
        if experiment:
            put(scratch / "next_experiment.csv", experiment)
        experiment_file = "next_experiment.csv" if experiment else ""
        put(scratch / "diagnosis.json", json_text(result.to_json(diagnosis, experiment_file)))
        seconds = {**diagnosis.seconds, "in all": time.perf_counter() - began}
        story = Story(
            diagnosis, recordings[0].rig, simple, tuple(checks), made, tracking, experiment_file, seconds, remarks
        )
        tell("writing the report", 0.96)
        put(scratch / "report.html", html(story))
        _publish(scratch, out)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    tell("done", 1.0)
    return story


def _publish(scratch: Path, out: Path) -> None:
    """Move the results into the folder; what an earlier run left there goes. Raises BadInput."""
    try:
        out.mkdir(exist_ok=True)
        for name in FILES:
            if (scratch / name).exists():
                (scratch / name).replace(out / name)
            else:
                (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise BadInput(f"{out} cannot be written ({error.strerror}): choose another place") from None
