"""The main job: recordings in; models, FMUs, diagnosis, controller and report out."""

from __future__ import annotations

import os
import shlex
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from fmpy.validation import validate_fmu

from twin.control import controller, cosimulation, design
from twin.control.controller import Controller
from twin.control.cosimulation import Tracking
from twin.diagnosis import adequacy, data_split, result
from twin.diagnosis.api import diagnose
from twin.diagnosis.result import Diagnosis
from twin.errors import BadInput, StageFailed
from twin.estimation import estimate, two_stage
from twin.fmi import evidence, native_fmu, python_fmu
from twin.io.api import as_list
from twin.io.files import json_text, new_folder, put
from twin.io.recording import Recording
from twin.model import fitted_model
from twin.model.fitted_model import Model
from twin.model.stepper import Structure
from twin.report.html import Check, Story, html
from twin.report.origin import Origin, files_of, trace_origin

Progress = Callable[[str, float], None]
T = TypeVar("T")

#: What `twin run` writes into its folder.
FILES = (
    "model.toml", "arm.fmu", "improved.toml", "improved.fmu", "improved-native.fmu", "diagnosis.json",
    "next_experiment.csv", "controller.toml", "report.html",
)  # fmt: skip


def check(fmu: Path, name: str, log: Recording) -> Check:
    """Validate an FMU with FMPy and replay a recording through it."""
    began = time.perf_counter()
    problems = tuple(str(p) for p in validate_fmu(str(fmu)))
    ran = python_fmu.replay(fmu, log)
    return Check(name, log.name, ran.rmse(log), ran.nrmse_percent(log), time.perf_counter() - began, problems)


@dataclass
class Stages:
    """Runs the stages of a run; one that fails costs its own result only.

    Attributes
    ----------
    failures
        What failed, by the name of the stage, in a sentence.
    """

    failures: dict[str, str] = field(default_factory=dict)

    def attempt(self, stage: str, work: Callable[[], T]) -> T | None:
        """The result of a stage, or None where it failed for whatever reason: the results of the others stay."""
        try:
            return work()
        except BadInput as error:
            self.failures[stage] = f"There is no {stage}: {error}."
        except Exception as error:
            if os.environ.get("TWIN_DEBUG"):
                traceback.print_exc()
            said = " ".join(str(error).split()) or "no more is known"
            self.failures[stage] = (
                f"There is no {stage}: an internal error ended it ({type(error).__name__}: {said}); "
                "all else is as it should be."
            )
        return None


def _export(
    stages: Stages, folder: Path, model: Model, fmu: str, recording: Recording, platforms: tuple[str, ...] = ()
) -> Check | None:
    """The model's FMU in the folder, native where platforms are named, and how it replays a recording."""
    write = native_fmu.export_native if platforms else python_fmu.export
    if stages.attempt(fmu, lambda: write(model, folder / fmu)) is None:
        return None
    found = stages.attempt(f"check of {fmu}", lambda: check(folder / fmu, fmu, recording))
    return found and replace(found, platforms=platforms or python_fmu.PLATFORMS)


def _closed_loop(
    stages: Stages, folder: Path, model: Model, bandwidth: float | None
) -> tuple[Controller | None, Tracking | None]:
    """A controller for the model, in the folder, and its run against the improved FMU there."""
    made = stages.attempt("controller", lambda: design.design(model, bandwidth))
    if made is None:
        return None, None
    put(folder / "controller.toml", controller.dumps(made))
    if not (folder / "improved.fmu").exists():
        return made, None
    return made, stages.attempt("closed loop", lambda: cosimulation.run(folder / "improved.fmu", made))


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
        ``.diagnosis``, ``.controller``, ``.tracking`` and what else the report shows; ``.failures`` says which stages
        failed, and why.

    Raises
    ------
    BadInput
        The recordings do not allow it, or the folder cannot be used. Then nothing is written.
    StageFailed
        There is no diagnosis. The first model and its FMU are in the folder.
    """
    recordings, out = as_list(recordings), Path(out)
    tell = progress or (lambda sentence, share: None)
    began = time.perf_counter()
    structure = estimate.first_structure(recordings) if structure is None else structure
    longest = max(recordings, key=lambda r: len(r.time))
    stages = Stages()
    with new_folder(out, FILES, force) as folder:
        estimate.compile_kernel(tell)
        tell("steady states and transients", 0.03)
        simple = stages.attempt("two-stage estimate", lambda: two_stage.two_stage(data_split.split(recordings)[0]))
        diagnosis = stages.attempt(
            "diagnosis", lambda: diagnose(recordings, structure, progress=lambda s, x: tell(s, 0.05 + 0.75 * x))
        )
        if diagnosis is None:
            model = estimate.identify(recordings, structure, progress=lambda s, x: tell(s, 0.8 + 0.1 * x))
            put(folder / "model.toml", fitted_model.dumps(model))
            _export(stages, folder, model, "arm.fmu", longest)
        else:
            story = _tell_story(stages, recordings, diagnosis, folder, bandwidth, tell)
            story = replace(story, two_stage=simple, seconds={**story.seconds, "in all": time.perf_counter() - began})
            tell("writing the report", 0.96)
            _write_report(stages, folder, story, recordings)
    tell("done", 1.0)
    if diagnosis is None:
        raise StageFailed(stages.failures, model)
    return story


def finish(recordings: Sequence[Recording], diagnosis: Diagnosis, out: Path, progress: Progress | None = None) -> Story:
    """What `run` does with a diagnosis, for one that is there: models, FMUs, controller and report into a folder, which
    may hold those of an earlier run. Raises BadInput where it cannot be written.
    """
    stages, tell = Stages(), progress or (lambda sentence, share: None)
    with new_folder(out, FILES, force=True) as folder:
        story = _tell_story(stages, recordings, diagnosis, folder, None, tell)
        _write_report(stages, folder, story, recordings)
    return story


def _write_report(stages: Stages, folder: Path, story: Story, recordings: Sequence[Recording]) -> None:
    """The report, and in each FMU of the folder what it was judged by; times only where bytes may differ."""
    story = replace(story, origin=_origin(folder, story, recordings))
    shown = _without_times(story) if os.environ.get("SOURCE_DATE_EPOCH") else story
    page = stages.attempt("report", lambda: html(shown))
    if page is not None:
        put(folder / "report.html", page)
    stages.attempt("evidence in the FMUs", lambda: _attach(folder, recordings, story.diagnosis, page or ""))


def _origin(folder: Path, story: Story, recordings: Sequence[Recording]) -> Origin:
    """Where the report comes from, and what to do with what stands beside it."""
    written = [name for name in FILES if (folder / name).exists() or name == "report.html"]
    log = next((str(r.file) for r in recordings if r.file), "LOG")
    following = [f"twin simulate improved.fmu --log {shlex.quote(log)} --out simulated.csv"]
    if story.controller is not None:
        following.append("twin cosim improved.fmu controller.toml --reference step")
    following.append("twin export improved.toml --target native --fmi 3 --out native.fmu")
    if story.experiment_file:
        following.append("twin diagnose NEW_LOG --model improved.toml --out next.toml  # after next_experiment.csv")
    following.append("twin track improved.toml LATER_LOG --out history")
    return trace_origin(files_of(recordings), written, following)


def _without_times(story: Story) -> Story:
    """The story without what differs from run to run."""
    checks = tuple(replace(c, seconds=None) for c in story.checks)
    return replace(story, seconds={}, checks=checks, diagnosis=replace(story.diagnosis, seconds={}))


def _attach(folder: Path, recordings: Sequence[Recording], diagnosis: Diagnosis, page: str) -> None:
    """Put what was held out, how well it is met, and the report into the FMUs."""
    figures, held_out = adequacy.to_json(diagnosis.adequacy), data_split.split(recordings)[1]
    for name in FILES:
        if name.endswith(".fmu") and (folder / name).exists():
            model = diagnosis.before if name == "arm.fmu" else diagnosis.after
            runs, parts = data_split.led(held_out, model.structure, data_split.lead_of(model.values))
            trials = [evidence.Trial(r, part.begin) for r, part in zip(runs, parts, strict=True) if part.is_read]
            evidence.attach(folder / name, trials, figures, page if model is diagnosis.after else "")


def _tell_story(
    stages: Stages, recordings: Sequence[Recording], diagnosis: Diagnosis, folder: Path, bandwidth: float | None,
    tell: Progress,
) -> Story:  # fmt: skip
    """What follows from a diagnosis, with the files that hold it in the folder."""
    longest = max(recordings, key=lambda r: len(r.time))
    tell("checking the FMUs in FMPy", 0.82)
    models = (("model", diagnosis.before, "arm.fmu"), ("improved", diagnosis.after, "improved.fmu"))
    for name, model, _ in models:
        put(folder / f"{name}.toml", fitted_model.dumps(model))
    checks = [_export(stages, folder, model, fmu, longest) for _, model, fmu in models]
    native = "improved-native.fmu"
    platforms = stages.attempt(native, native_fmu.platforms)
    if platforms:
        checks.append(_export(stages, folder, diagnosis.after, native, longest, platforms))
    tell("controller and closed loop", 0.9)
    made, tracking = _closed_loop(stages, folder, diagnosis.after, bandwidth)
    experiment = result.experiment_csv(diagnosis.experiment, diagnosis.after.input_name)
    if experiment:
        put(folder / "next_experiment.csv", experiment)
    experiment_file = "next_experiment.csv" if experiment else ""
    put(folder / "diagnosis.json", json_text(result.to_json(diagnosis, experiment_file)))
    return Story(
        diagnosis, recordings[0].rig, None, tuple(c for c in checks if c is not None), made, tracking, experiment_file,
        diagnosis.seconds, failures=stages.failures,
    )  # fmt: skip
