"""The main job: recordings in; models, FMUs, diagnosis, controller and report out."""

from __future__ import annotations

import io
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.validation import validate_fmu

from twin import control, controller, cosim, extend, finding, identify, kernel, model, package
from twin import two_stage as stages
from twin.axis import Structure
from twin.effects.catalogue import EFFECTS
from twin.errors import BadInput
from twin.files import check_place, json_text, plain, put
from twin.finding import Diagnosis, Experiment
from twin.model import Model
from twin.recording import Recording, Rig, driven, load
from twin.report import Check, Story, html

Progress = Callable[[str, float], None]

#: What `twin run` writes into its folder.
FILES = (
    "model.toml", "arm.fmu", "improved.toml", "improved.fmu", "diagnosis.json", "next_experiment.csv",
    "controller.toml", "report.html",
)  # fmt: skip


# ---- parts ----


def known_effect(name: str, where: str) -> str:
    """An effect id. Raises BadInput, with the id that may have been meant."""
    if name in EFFECTS:
        return name
    close = get_close_matches(name.replace("-", "_").lower(), EFFECTS, 1, 0.5)
    meant = f"did you mean {close[0]}?" if close else f"known are {', '.join(EFFECTS)}"
    raise BadInput(f"{where}: there is no effect {name!r}; {meant}")


def first_structure(
    rig: Rig, more: Iterable[str] = (), fewer: Iterable[str] = (), given: Structure | None = None
) -> Structure:
    """What the first model contains: `given`, or the base and the rig file's effects; then the user's changes.

    Raises BadInput.
    """
    named = [known_effect(e, f"{rig.name} [structure]") for e in rig.effects]
    structure = identify.base_structure().with_(*named) if given is None else given
    structure = structure.with_(*(known_effect(e, "--with") for e in more))
    for effect in fewer:
        if known_effect(effect, "--without") == "inertia":
            raise BadInput("--without inertia: every model has an input gain; leave that out")
        if effect not in structure:
            raise BadInput(f"--without {effect}: the first model has no such effect; it has {', '.join(structure.ids)}")
        leaning = [e.id for e in structure.effects if effect in e.includes]
        structure = structure.without(effect, *leaning)
    return structure


def compile_kernel(tell: Progress) -> None:
    """Compile where this machine has not yet; that takes half a minute, once."""
    loaded = kernel.compiled()
    if not any(kernel.cache_folder().glob(f"**/{loaded.__name__}*.nbi")):
        tell("compiling the kernel, once on this machine (half a minute)", 0.0)
    count = 8
    ramp = np.arange(count, dtype=float)
    drive = kernel.Drive(
        np.arange(count, dtype=float), ramp, ramp.copy(), False, kernel.known_vector({}), np.zeros(5), 0.5
    )
    everything = identify.base_structure()
    p = kernel.vector(everything, {q.name: q.start for q in everything.parameters})
    gains, _ = kernel.kalman(drive, 1.0, np.ones(count), (1.0, 1.0))
    start = kernel.start_state(0.0, 0.0, 0.0)
    kernel.predict_with_slopes(drive, p, start, np.zeros((len(start), 1)), ("input_gain",), gains)
    kernel.predict(drive, p, start, gains)


def with_largest_command(found: Model, recordings: Sequence[Recording]) -> Model:
    """The model, with the largest command of its recordings as the limit for a controller to keep."""
    largest = max(float(np.max(np.abs(r.input))) for r in recordings)
    return replace(found, provenance={**found.provenance, "largest_command": f"{largest:.6g}"})


def held_of(found: Model) -> dict[str, float]:
    """The parameters that a model holds fixed: those without a standard error in a model that has some."""
    if not found.fitted:
        return {}
    estimated = [p.name for p in found.structure.parameters if p.estimated]
    return {name: found.values[name] for name in estimated if name not in found.fitted}


def check(fmu: Path, name: str, log: Recording) -> Check:
    """Validate an FMU with FMPy and replay a recording through it."""
    began = time.perf_counter()
    problems = tuple(str(p) for p in validate_fmu(str(fmu)))
    ran = package.replay(fmu, driven(log))
    return Check(name, log.name, ran.rmse(log), ran.nrmse_percent(log), time.perf_counter() - began, problems)


def experiment_csv(experiment: Experiment, input_name: str) -> str:
    """What to feed the rig next, as CSV; empty where there is nothing to try."""
    if experiment.time.size == 0:
        return ""
    out = io.StringIO()
    out.write(f"time,{input_name}\n")
    for t, u in zip(experiment.time, experiment.input, strict=True):
        out.write(f"{t:.6g},{u:.6g}\n")
    return out.getvalue()


def diagnosis_json(found: Diagnosis, experiment_file: str = "") -> dict[str, Any]:
    return dict(plain(finding.to_json(found, experiment_file)))


# ---- the whole ----


def check_folder(out: Path, force: bool) -> None:
    """Raises BadInput where the results may not or cannot go into this folder."""
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out} is a file: give the name of a folder with --out")
    there = [name for name in FILES if (out / name).exists()]
    if there and not force:
        raise BadInput(f"{out} holds {there[0]} already: choose another folder, or overwrite with --force")
    check_place(out if out.is_dir() else out.parent)


def estimate(
    recordings: Sequence[Recording], structure: Structure, method: str, tell: Progress, horizon: float | None = None,
    closed: bool = False,
) -> Model:  # fmt: skip
    """A model by either method, with the values that predict best over a horizon (s) if one is given, from the recorded
    input or, `closed`, under the rig's own loop.

    Raises BadInput where the recordings do not allow it.
    """
    if horizon is not None and method != "joint":
        raise BadInput(f"--horizon goes with --method joint, not {method}: leave one of them out")
    if closed and horizon is None:
        raise BadInput("--closed says how to predict over a horizon: add --horizon SECONDS")
    if method == "joint":
        compile_kernel(tell)
        found = identify.identify(recordings, structure, progress=lambda s, x: tell(s, 0.05 + 0.85 * x))
        if horizon is not None:
            tell(f"the best values over {horizon:g} s", 0.9)
            found = identify.for_horizon(found, recordings, horizon, closed)
    else:
        tell("steady states and transients", 0.1)
        train = [r for r in recordings if r.role == "train"]
        simple = stages.two_stage(train)
        if not simple.ok:
            raise BadInput(f"{train[0].name}: no two-stage estimate: {simple.says}; or use --method joint")
        found = stages.to_model(simple, train)
    return with_largest_command(found, recordings)


def _closed_loop(found: Model, fmu: Path, bandwidth: float | None) -> tuple[Any, Any, tuple[str, ...]]:
    """Controller, tracking, and why there is none where there is none."""
    try:
        made = control.design(found, bandwidth)
    except BadInput as error:
        return None, None, (f"No controller could be made: {error}.",)
    try:
        return made, cosim.run(fmu, made), ()
    except BadInput as error:
        return made, None, (f"The closed loop could not be run: {error}.",)


def run(
    logs: Sequence[Path], rig: Path | None, out: Path, more: Sequence[str] = (), fewer: Sequence[str] = (),
    bandwidth: float | None = None, force: bool = False, progress: Progress | None = None,
) -> Story:  # fmt: skip
    """Everything on one recording, or several; the results go into the folder `out` at the end, all at once.

    Raises BadInput; then nothing is written.
    """
    check_folder(out, force)
    tell = progress or (lambda sentence, share: None)
    began = time.perf_counter()
    tell("reading the recording", 0.0)
    recordings, described = load(logs, rig)
    structure = first_structure(described, more, fewer)
    compile_kernel(tell)
    tell("steady states and transients", 0.03)
    training, _ = extend.split(recordings)
    simple = stages.two_stage(training)
    diagnosis = extend.diagnose(recordings, structure, progress=lambda s, x: tell(s, 0.05 + 0.75 * x))
    before, after = (with_largest_command(m, recordings) for m in (diagnosis.before, diagnosis.after))
    diagnosis = replace(diagnosis, before=before, after=after)
    scratch = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name[:50]}-"))
    try:
        longest = max(recordings, key=lambda r: len(r.time))
        checks = []
        for name, kept, fmu in (("model", before, "arm.fmu"), ("improved", after, "improved.fmu")):
            tell(f"checking {fmu} in FMPy", 0.82)
            put(scratch / f"{name}.toml", model.dumps(kept))
            package.export(kept, scratch / fmu)
            checks.append(check(scratch / fmu, fmu, longest))
        tell("controller and closed loop", 0.9)
        made, tracking, remarks = _closed_loop(after, scratch / "improved.fmu", bandwidth)
        if made is not None:
            put(scratch / "controller.toml", controller.dumps(made))
        experiment = experiment_csv(diagnosis.experiment, after.input_name)
        if experiment:
            put(scratch / "next_experiment.csv", experiment)
        name = "next_experiment.csv" if experiment else ""
        put(scratch / "diagnosis.json", json_text(diagnosis_json(diagnosis, name)))
        seconds = {**diagnosis.seconds, "in all": time.perf_counter() - began}
        story = Story(diagnosis, described, simple, tuple(checks), made, tracking, name, seconds, remarks)
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
        raise BadInput(f"{out} cannot be written ({error.strerror}): choose another place with --out") from None
