"""The command line: what other people's scripts call.

Exit codes: 0 done, 1 a check that was asked for did not hold, 2 bad input with one line on stderr, 3 a fault of ours.
A command imports what it needs once it has read what it was given: help is there at once, and so is the word on a
file that cannot be used.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from twin.errors import BadInput

if TYPE_CHECKING:
    from twin.control.controller import Controller
    from twin.io.recording import Recording, Rig
    from twin.model.fitted_model import Model

Progress = Callable[[str, float], None]
Answer = Mapping[str, Any]
#: In a log each time that a bar is drawn is a line: so many seconds apart.
LINE = 30.0


# ---- talking to the user ----


class _Parser(argparse.ArgumentParser):
    """Wrong arguments are bad input too: one line."""

    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{message.replace(chr(10), ' ')}; see {self.prog} --help")


def _check_command(name: str, names: Sequence[str]) -> None:
    if name not in names and not name.startswith("-"):
        close = get_close_matches(name, names, 1)
        meant = f"did you mean {close[0]}?" if close else f"there are {', '.join(names)}"
        raise BadInput(f"there is no command {name!r}; {meant}")


@contextmanager
def _progress(args: argparse.Namespace) -> Iterator[Progress]:
    """A bar on stderr once the work takes over a second; gone when it is done."""
    if args.quiet:
        yield lambda sentence, share: None
        return
    from tqdm import tqdm

    tty = sys.stderr.isatty()
    shape = "{desc} {bar} {percentage:3.0f} % {elapsed}"
    bar = tqdm(total=100, delay=1e9, leave=False, file=sys.stderr, ncols=None if tty else 90, bar_format=shape)
    done = threading.Event()

    def draw() -> None:
        # The work says little while it computes: a bar whose clock stands still looks like one that hangs.
        if not done.wait(1.0 if tty else LINE):
            bar.delay = 0.0  # else tqdm takes the bar for one that was never drawn, and leaves it standing
            bar.refresh()
            while not done.wait(0.25 if tty else LINE):
                bar.refresh()

    drawing = threading.Thread(target=draw, daemon=True)
    drawing.start()

    def tell(sentence: str, share: float) -> None:
        bar.set_description_str(sentence, refresh=False)
        bar.n = max(100.0 * share, bar.n)

    try:
        yield tell
    finally:
        done.set()
        drawing.join()
        bar.close()


def _answer(args: argparse.Namespace, said: Sequence[str], answer: Answer) -> None:
    """The sentences for people, and the JSON for programs; with `--json -` the sentences go to stderr."""
    from twin.io.files import json_text, put

    if args.json == "-":
        sys.stdout.write(json_text(answer))
    elif args.json is not None:
        put(Path(args.json), json_text(answer))
    if not args.quiet:
        # Consoles that know only a few characters get plain ones, and never an error.
        text = "\n".join(said).translate({ord("\u202f"): " ", ord("−"): "-"})
        stream = sys.stderr if args.json == "-" else sys.stdout
        coding = stream.encoding or "ascii"
        print(text.encode(coding, "replace").decode(coding), file=stream)


def _check_outputs(args: argparse.Namespace, *outputs: Path | None) -> None:
    """Before any work: every file that will be written may be written, is none that is read, and no two are one."""
    from twin.io.files import check_free

    named = [p for p in (*outputs, None if args.json in (None, "-") else Path(args.json)) if p is not None]
    given = [getattr(args, name, None) for name in ("rig", "model", "fmu", "controller")]
    read = [p.absolute() for p in (*getattr(args, "log", []), *given) if p is not None]
    for path in named:
        if path.absolute() in read:
            raise BadInput(f"{path} is read by this command: give what is written another name")
        check_free(path, args.force)
    doubled = [str(p) for i, p in enumerate(named) if p.absolute() in [q.absolute() for q in named[:i]]]
    if doubled:
        raise BadInput(f"{doubled[0]} is named for two different outputs: give two names")


def _check_bandwidth(args: argparse.Namespace) -> None:
    """Raises BadInput for one that no controller has, before a search takes its minutes."""
    if args.bandwidth is not None and not 0.0 < args.bandwidth < float("inf"):
        raise BadInput(f"--bandwidth is {args.bandwidth:g} Hz: give a number above 0")


def _assumptions(rig: Rig) -> list[str]:
    return [f"Assumed, for want of a rig file: {a}" for a in rig.assumed]


def _fault_lines(recordings: Sequence[Recording]) -> list[str]:
    """What was left out of each recording, by its name where there are several."""
    several = len(recordings) > 1
    return [f"{r.name}: {f.says}" if several else f.says for r in recordings for f in r.faults]


def _load(args: argparse.Namespace, tell: Progress) -> tuple[list[Recording], Rig]:
    from twin.io.recording import load

    tell("reading the recording", 0.0)
    return load(args.log, args.rig)


def _parameters(model: Model) -> dict[str, Any]:
    found = {}
    for p in model.structure.parameters:
        entry: dict[str, Any] = {
            "value": model.values[p.name], "std": model.std(p.name), "unit": model.unit(p.name), "meaning": p.meaning
        }  # fmt: skip
        if p.name in model.intervals:
            entry["interval"] = list(model.intervals[p.name])
        if p.name in model.notes:
            entry["note"] = model.notes[p.name]
        found[p.name] = entry
    return found


def _parameter_lines(model: Model) -> list[str]:
    from twin.report.wording import measure

    width = max(len(p.name) for p in model.structure.parameters)
    lines = []
    for p in model.structure.parameters:
        value = measure(model.values[p.name], model.std(p.name), model.unit(p.name))
        torque = model.torque(p.name)
        note = f"  ({model.notes[p.name]})" if p.name in model.notes else ""
        lines.append(f"  {p.name:<{width}}  {value}{torque and f' = {torque}'}{note}")
    return lines


# ---- commands ----


def _run(args: argparse.Namespace) -> int:
    _check_outputs(args)
    _check_bandwidth(args)
    with _progress(args) as tell:
        recordings, rig = _load(args, tell)
        from twin import pipeline
        from twin.control import cosimulation
        from twin.diagnosis import result
        from twin.report import wording

        story = pipeline.run(recordings, rig, args.out, args.more, args.fewer, args.bandwidth, args.force, tell)
    d = story.diagnosis
    files = {name: str(args.out / name) for name in pipeline.FILES if (args.out / name).exists()}
    says = wording.sentences(d, story.tracking)
    answer = {
        "format": "twin-run/1",
        "out": str(args.out),
        "files": files,
        "says": list(says),
        "diagnosis": result.to_json(d, files.get("next_experiment.csv", "")),
        "parameters": {"before": _parameters(d.before), "after": _parameters(d.after)},
        "fmu": [vars(c) for c in story.checks],
        "tracking": None if story.tracking is None else cosimulation.to_json(story.tracking),
        "seconds": dict(story.seconds),
    }
    said = [*_assumptions(story.rig), *says, *story.remarks]
    said.append(f"Everything is in {args.out / 'html.html'}; the twin is {args.out / 'improved.fmu'}.")
    _answer(args, said, answer)
    return 0


def _identify(args: argparse.Namespace) -> int:
    _check_outputs(args, args.out)
    with _progress(args) as tell:
        recordings, rig = _load(args, tell)
        from twin.estimation import estimate
        from twin.io import files
        from twin.io.recording import faults_of
        from twin.model import fitted_model
        from twin.report import wording

        structure = estimate.first_structure(rig, args.more, args.fewer)
        found = estimate.estimate(recordings, structure, args.method, tell, args.horizon, args.closed)
    files.put(args.out, fitted_model.dumps(found))
    said = [
        *_assumptions(rig),
        wording.recordings_sentence(recordings),
        *_fault_lines(recordings),
        f"{args.out}: {found.structure}, by the {args.method} method:",
        *_parameter_lines(found),
    ]
    answer = {
        "format": "twin-identify/1",
        "model": str(args.out),
        "method": args.method,
        "horizon": args.horizon,
        "effects": list(found.structure.ids),
        "parameters": _parameters(found),
        "recording_faults": faults_of(recordings),
        "assumed": list(rig.assumed),
    }
    _answer(args, said, answer)
    return 0


def _export(args: argparse.Namespace) -> int:
    _check_outputs(args, args.out, args.ssv, args.ssp, args.modelica)
    if args.controller is not None and args.ssp is None:
        raise BadInput("--controller goes into a system: add --ssp FILE, or export the CONTROLLER.toml by itself")
    if args.target == "python" and args.fmi == 3:
        raise BadInput("--target python writes FMI 2 only, through pythonfmu: add --target native for FMI 3")
    from twin.io import toml

    text = toml.load(args.model, "model", "MODEL.toml", "twin identify")
    from twin.codegen import modelica
    from twin.control import controller
    from twin.fmi import ssp
    from twin.io.files import put
    from twin.model import fitted_model

    answer = {"format": "twin-export/1", "fmu": str(args.out), "target": args.target, "fmi": args.fmi}
    if toml.format_of(text) == controller.FORMAT:
        for option in ("ssv", "ssp", "modelica"):
            if getattr(args, option) is not None:
                raise BadInput(f"--{option} needs the MODEL.toml of the axis, {args.model} is a controller")
        made = controller.loads(text, str(args.model))
        _export_controller(args, made, args.out)
        _answer(args, [f"{args.out}: FMI {args.fmi} co-simulation ({args.target}) of the {made!r}."], answer)
        return 0
    found = fitted_model.loads(text, str(args.model))
    designed = None if args.controller is None else controller.read(args.controller)
    offers = _export_axis(args, found)
    said = [f"{args.out}: FMI {args.fmi} ({args.target}) of {found.structure}, for {offers}."]
    if args.ssv is not None:
        ssp.write_ssv(found, args.ssv, args.force)
        said.append(f"{args.ssv}: the parameters as an SSP set.")
    if args.ssp is not None:
        with tempfile.TemporaryDirectory() as folder:
            packed = None if designed is None else Path(folder) / "controller.fmu"
            if designed is not None and packed is not None:
                _export_controller(args, designed, packed)
            ssp.write_ssp(args.ssp, args.out, packed, found, args.force)
        said.append(f"{args.ssp}: the system with its parameters.")
    if args.modelica is not None:
        put(args.modelica, modelica.write(found))
        said.append(f"{args.modelica}: the same equations in Modelica.")
    _answer(args, said, answer)
    return 0


def _export_axis(args: argparse.Namespace, found: Model) -> str:
    """Write the FMU; what it offers."""
    from twin.fmi import native_fmu, python_fmu

    with _progress(args) as tell:
        tell("compiling the FMU", 0.0)
        if args.target == "native":
            native_fmu.export_native(found, args.out, args.fmi, args.force)
            return native_fmu.offers(found.structure)
        python_fmu.export(found, args.out, args.force)
        return "co-simulation"


def _export_controller(args: argparse.Namespace, made: Controller, out: Path) -> None:
    from twin.control import controller_fmu

    if args.target == "native":
        with _progress(args) as tell:
            tell("compiling the controller", 0.0)
            controller_fmu.export_native(made, out, args.fmi, args.force)
    else:
        controller_fmu.export_controller(made, out, args.force)


def _update(args: argparse.Namespace) -> int:
    _check_outputs(args, None if args.out is None or args.out == args.fmu else args.out)
    from twin.fmi import python_fmu
    from twin.model import fitted_model

    old, new = python_fmu.read_model(args.fmu), fitted_model.read(args.model)
    out = python_fmu.update(args.fmu, new, args.out)
    changed = {n: [old.values[n], v] for n, v in new.values.items() if n in old.values and old.values[n] != v}
    said = [f"{out}: {len(changed)} of {len(new.values)} parameters changed."]
    _answer(args, said, {"format": "twin-update/1", "fmu": str(out), "changed": changed})
    return 0


def _replays(args: argparse.Namespace) -> tuple[list[Recording], Rig, list[Any]]:
    with _progress(args) as tell:
        recordings, rig = _load(args, tell)
        from twin.fmi import python_fmu

        ran = []
        for i, r in enumerate(recordings):
            tell(f"simulating {r.name}", i / len(recordings))
            ran.append(python_fmu.replay(args.fmu, r, closed=args.closed))
    return recordings, rig, ran


def _fits(recordings: Sequence[Recording], ran: Sequence[Any]) -> list[dict[str, Any]]:
    return [
        {"recording": r.name, "role": r.role, "rmse": s.rmse(r), "nrmse_percent": s.nrmse_percent(r),
         "unit": r.output_unit}
        for r, s in zip(recordings, ran, strict=True)
    ]  # fmt: skip


def _fit_lines(fits: Sequence[Mapping[str, Any]]) -> list[str]:
    from twin.report.wording import number, unit_text

    return [
        f"{f['recording']}: RMSE {number(f['rmse'])} {unit_text(f['unit'])}, "
        f"{number(f['nrmse_percent'])} % of the recorded range."
        for f in fits
    ]


def _simulate(args: argparse.Namespace) -> int:
    _check_outputs(args, args.out)
    recordings, rig, ran = _replays(args)
    from twin.io.files import put
    from twin.io.recording import faults_of

    fits = _fits(recordings, ran)
    if args.out is not None:
        put(args.out, _simulation_csv(recordings, ran, args.closed))
    answer = {
        "format": "twin-simulate/1", "fmu": str(args.fmu), "file": args.out and str(args.out), "fit": fits,
        "recording_faults": faults_of(recordings),
    }  # fmt: skip
    _answer(args, [*_assumptions(rig), *_fault_lines(recordings), *_fit_lines(fits)], answer)
    return 0


def _simulation_csv(recordings: Sequence[Recording], ran: Sequence[Any], closed: bool) -> str:
    """One row per stamp; with several recordings, their name in a first column. The input is the recorded one, or
    where the loop is closed what it commanded.
    """
    several = len(recordings) > 1
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    names = ["time", "input", "recorded", "position_measured", "velocity"]
    rows.writerow(["recording", *names] if several else names)
    for r, s in zip(recordings, ran, strict=True):
        columns = (r.time, s.input if closed else r.input, r.output, s.position_measured, s.velocity)
        for row in zip(*(c.tolist() for c in columns), strict=True):
            cells = ["" if v != v else f"{v:.10g}" for v in row]
            rows.writerow([r.name, *cells] if several else cells)
    return out.getvalue()


def _check(args: argparse.Namespace) -> int:
    if not args.max_nrmse > 0.0:
        raise BadInput(f"--max-nrmse is {args.max_nrmse:g}: give a percentage above 0")
    _check_outputs(args)
    recordings, rig, ran = _replays(args)
    from twin.io.recording import faults_of

    fits = _fits(recordings, ran)
    bad = [f for f in fits if not f["nrmse_percent"] <= args.max_nrmse]
    verdict = (
        f"The twin fits: no recording is above {args.max_nrmse:g} %."
        if not bad
        else f"The twin does not fit: {len(bad)} of {len(fits)} above {args.max_nrmse:g} %."
    )
    answer = {
        "format": "twin-check/1", "holds": not bad, "max_nrmse_percent": args.max_nrmse, "fit": fits,
        "recording_faults": faults_of(recordings),
    }  # fmt: skip
    _answer(args, [*_assumptions(rig), *_fault_lines(recordings), *_fit_lines(bad or fits), verdict], answer)
    return 1 if bad else 0


def _diagnose(args: argparse.Namespace) -> int:
    experiment_file = args.out.with_name(f"{args.out.stem}_next_experiment.csv")
    _check_outputs(args, args.out, args.report, experiment_file)
    with _progress(args) as tell:
        recordings, rig = _load(args, tell)
        from twin.diagnosis import diagnose, result
        from twin.estimation import estimate
        from twin.io import files
        from twin.io.recording import as_told, check_units
        from twin.model import fitted_model
        from twin.report import wording

        given = None if args.model is None else fitted_model.read(args.model)
        if given is not None:
            for r in recordings:
                check_units(r, str(args.model), given.input_unit, given.axis_unit)
            recordings = [as_told(r, given.known) for r in recordings]
        structure = estimate.first_structure(rig, args.more, args.fewer, None if given is None else given.structure)
        estimate.compile_kernel(tell)
        d = diagnose.diagnose(
            recordings, structure, {} if given is None else estimate.held_of(given),
            progress=lambda s, x: tell(s, 0.05 + 0.9 * x), closed=args.closed,
        )  # fmt: skip
        page = ""
        if args.report is not None:
            from twin.report import html

            tell("writing the report", 0.97)
            page = html.html(html.Story(d, rig))
    experiment = result.experiment_csv(d.experiment, d.after.input_name)
    files.put(args.out, fitted_model.dumps(estimate.with_largest_command(d.after, recordings)))
    if experiment:
        files.put(experiment_file, experiment)
    if args.report is not None:
        files.put(args.report, page)
    said = [*_assumptions(rig), *wording.sentences(d), *d.remarks]
    said += [wording.doubt(u) for u in d.undecided]
    if experiment:
        said.append(f"Next: {d.experiment.why} The input to play is in {experiment_file}.")
    _answer(args, said, result.to_json(d, str(experiment_file) if experiment else ""))
    return 0


def _control(args: argparse.Namespace) -> int:
    _check_outputs(args, args.out)
    _check_bandwidth(args)
    from twin.model import fitted_model

    known = fitted_model.read(args.model)
    if args.max_peak is not None:
        if not args.max_peak > 0.0:
            raise BadInput(f"--max-peak is {args.max_peak:g}: give an error above 0, in {known.axis_unit}")
        if not known.fitted:
            raise BadInput(f"{args.model} has no covariance to draw from, which --max-peak needs: identify it")
        if not args.draws:
            raise BadInput("--max-peak is asked of the draws, and --draws is 0: leave one of them out")
    from twin.control import controller, design, monte_carlo
    from twin.io import files

    made = design.design(known, args.bandwidth, args.limit)
    says, found = [f"{args.out}: {made!r}.", *made.remarks], None
    if known.fitted and args.draws:
        with _progress(args) as tell:
            tell("compiling the closed loop (once on a machine)", 0.0)
            monte_carlo.compiled()
            found = monte_carlo.robustness(
                known, made, draws=args.draws, specification=args.max_peak,
                progress=lambda done: tell("trying what the axis may be", done / args.draws),
            )  # fmt: skip
        says += found.says
    elif not known.fitted:
        says.append("The model has no covariance, so the controller was not tried on what else the axis may be.")
    files.put(args.out, controller.dumps(made))
    answer = {
        "format": "twin-control/1", "controller": str(args.out), "bandwidth": made.bandwidth,
        "margins": vars(made.margins),
        "limit_cycle": None if made.limit_cycle is None else vars(made.limit_cycle), "remarks": list(made.remarks),
        "robustness": None if found is None else {
            "draws": len(found.peak), "median": found.median, "worst": found.worst, "share": found.share,
            "specification": found.specification, "learn": found.learn, "says": list(found.says),
        },
    }  # fmt: skip
    _answer(args, says, answer)
    return 1 if args.max_peak is not None and found is not None and found.share < monte_carlo.ENOUGH else 0


def _mapping(pairs: Sequence[str]) -> dict[str, str]:
    """NAME=NAME options. Raises BadInput."""
    found = {}
    for pair in pairs:
        ours, _, theirs = pair.partition("=")
        if not (ours and theirs):
            raise BadInput(f"--map is {pair!r}: write it as OURS=THEIRS, such as duty=motor_command")
        found[ours] = theirs
    return found


def _cosim(args: argparse.Namespace) -> int:
    _check_outputs(args, args.out, args.plot)
    from twin.control import controller, reference
    from twin.io import files

    names = _mapping(args.map)
    made = controller.read(args.controller)
    kind = args.reference or "minimum-jerk"
    if kind in reference.KINDS:
        wanted = reference.make_reference(kind, made, args.amplitude, args.duration)
    elif args.amplitude is not None or args.duration is not None:
        raise BadInput(f"--amplitude and --duration shape {', '.join(reference.KINDS)}, not a file like {kind}")
    else:
        wanted = reference.read_reference(Path(kind), made.sample_time)
    from twin.control import cosimulation

    with _progress(args) as tell:
        tell("closing the loop around the FMU", 0.0)
        ran = cosimulation.run(args.fmu, made, wanted, names, not args.other_structure)
    if args.out is not None:
        columns = (ran.time, ran.reference, ran.position, ran.input)
        lines = [",".join(f"{v:.10g}" for v in row) for row in zip(*(c.tolist() for c in columns), strict=True)]
        files.put(args.out, "\n".join(["time,reference,position,input", *lines]) + "\n")
    if args.plot is not None:
        from twin.report import figures

        files.put(args.plot, figures.tracking(ran, made.axis_unit, made.input_unit))
    _answer(args, ran.says, cosimulation.to_json(ran))
    return 0


# ---- arguments ----


def _percentage(text: str) -> float:
    try:
        return float(text.rstrip(" %"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a percentage") from None


def _common() -> _Parser:
    common = _Parser(add_help=False)
    common.add_argument("--quiet", action="store_true", help="no progress bar and no sentences")
    common.add_argument("--json", metavar="FILE", help="write the result as JSON; - for stdout")
    common.add_argument("--force", action="store_true", help="overwrite what is there")
    return common


def _add_log(command: argparse.ArgumentParser, *name: str, **more: Any) -> None:
    said = "recordings, or a manifest that lists them"
    command.add_argument(*(name or ("log",)), nargs="+", type=Path, metavar="LOG", help=said, **more)
    said = "what the columns are; default: rig.toml beside LOG, else by their names"
    command.add_argument("--rig", type=Path, help=said)


def _add_closed(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--closed", action="store_true",
        help="simulate the rig's own loop ([loop] in the rig file) from the recorded reference, not the recorded input",
    )  # fmt: skip


def _add_structure(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--with", dest="more", action="append", default=[], metavar="EFFECT", help="add an effect to the first model"
    )
    command.add_argument(
        "--without", dest="fewer", action="append", default=[], metavar="EFFECT", help="leave one out of it"
    )


def _add_out(command: argparse.ArgumentParser, metavar: str, required: bool = True, text: str = "") -> None:
    command.add_argument("--out", type=Path, required=required, metavar=metavar, help=text or "what is written")


def _parser() -> tuple[argparse.ArgumentParser, list[str]]:
    """The parser, and the names of the commands."""
    parser = _Parser(
        prog="twin",
        description="From one recording of a motor-driven axis to its digital twin, "
        "and to the physics that its model left out.",
    )
    parser.add_argument("--version", action="store_true", help="the version, and no more")
    made: dict[str, argparse.ArgumentParser] = {}
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=_Parser)

    def add(name: str, does: Callable[[argparse.Namespace], int], says: str) -> argparse.ArgumentParser:
        made[name] = commands.add_parser(name, parents=[_common()], help=says, description=says)
        made[name].set_defaults(does=does)
        return made[name]

    run = add("run", _run, "the main job: identify, export, check, diagnose, control; ends with DIR/report.html")
    _add_log(run)
    _add_structure(run)
    _add_out(run, "DIR", text="the folder for everything that is made")
    run.add_argument("--bandwidth", type=float, metavar="HZ", help="of the controller; default: what the axis allows")

    identify = add("identify", _identify, "parameters with standard errors")
    _add_log(identify)
    _add_structure(identify)
    _add_out(identify, "MODEL.toml")
    identify.add_argument(
        "--method", choices=("joint", "two-stage"), default="joint",
        help="joint: maximum likelihood on everything (default); two-stage: steady states, then transients",
    )  # fmt: skip
    identify.add_argument(
        "--horizon", type=float, metavar="SECONDS",
        help="the values that predict best this far ahead, for a model that lacks something; default: the likeliest",
    )  # fmt: skip
    _add_closed(identify)

    export = add("export", _export, "a model, or a controller, as an FMU")
    export.add_argument("model", type=Path, metavar="MODEL.toml", help="a model, or a CONTROLLER.toml")
    _add_out(export, "ARM.fmu")
    export.add_argument(
        "--target", choices=("python", "native"), default="python",
        help="python: through pythonfmu (default); native: compiled, needs no Python in the host",
    )  # fmt: skip
    export.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="FMI version; 3 with --target native only")
    export.add_argument("--ssv", type=Path, metavar="FILE", help="also write the parameters as an SSP parameter set")
    export.add_argument("--ssp", type=Path, metavar="FILE", help="also pack FMU and parameters as an SSP system")
    export.add_argument(
        "--controller", type=Path, metavar="CONTROLLER.toml", help="goes into --ssp, as an FMU of the same kind"
    )
    export.add_argument("--modelica", type=Path, metavar="FILE", help="also write the model as a Modelica package")

    update = add("update", _update, "write parameters into an existing FMU, in place or as --out")
    update.add_argument("fmu", type=Path, metavar="ARM.fmu")
    update.add_argument("--from", dest="model", type=Path, required=True, metavar="MODEL.toml")
    _add_out(update, "NEW.fmu", required=False, text="leave ARM.fmu as it is and write this one")

    simulate = add("simulate", _simulate, "replay the recorded input through the FMU in FMPy, and compare")
    simulate.add_argument("fmu", type=Path, metavar="ARM.fmu")
    _add_log(simulate, "--log", required=True)
    _add_closed(simulate)
    _add_out(simulate, "CSV", required=False, text="recorded and simulated at every stamp")

    diagnose = add("diagnose", _diagnose, "locate, name and model what a first model leaves out")
    _add_log(diagnose)
    _add_structure(diagnose)
    _add_closed(diagnose)
    diagnose.add_argument("--model", type=Path, metavar="MODEL.toml", help="the first model; default: the base effects")
    _add_out(diagnose, "IMPROVED.toml")
    diagnose.add_argument("--report", type=Path, metavar="HTML", help="the report, one self-contained file")

    control = add("control", _control, "a feedback-linearising controller")
    control.add_argument("model", type=Path, metavar="MODEL.toml")
    _add_out(control, "CONTROLLER.toml")
    control.add_argument("--bandwidth", type=float, metavar="HZ", help="default: what the axis allows")
    control.add_argument("--limit", type=float, help="largest command; default: the drive's, or the largest recorded")
    control.add_argument(
        "--draws", type=int, default=200, metavar="N", help="axes drawn from the parameters' covariance; 0: none"
    )
    control.add_argument(
        "--max-peak", type=float, metavar="ERROR",
        help="acceptable peak tracking error, in the axis' unit; exit 1 where fewer than 95 %% of the draws keep it",
    )  # fmt: skip

    cosim = add("cosim", _cosim, "the closed loop in FMPy co-simulation")
    cosim.add_argument("fmu", type=Path, metavar="ARM.fmu")
    cosim.add_argument("controller", type=Path, metavar="CONTROLLER.toml")
    cosim.add_argument("--reference", metavar="CSV", help="a CSV with time and position, or minimum-jerk, sine, step")
    cosim.add_argument("--amplitude", type=float, help="travel of a made reference, in the axis' unit")
    cosim.add_argument("--duration", type=float, metavar="S", help="of the whole of a made reference")
    cosim.add_argument(
        "--map", action="append", default=[], metavar="OURS=THEIRS",
        help="the FMU's own name of duty (or voltage, ...), position or position_measured; may be repeated",
    )  # fmt: skip
    cosim.add_argument("--other-structure", action="store_true", help="take an FMU with other effects than the design")
    cosim.add_argument("--plot", type=Path, metavar="SVG", help="reference, link, error and command as a figure")
    _add_out(cosim, "CSV", required=False, text="reference, position and input at every sample")

    check = add("check", _check, "for CI: exit 1 when the twin no longer fits")
    check.add_argument("fmu", type=Path, metavar="ARM.fmu")
    _add_log(check, "--log", required=True)
    _add_closed(check)
    check.add_argument("--max-nrmse", type=_percentage, required=True, metavar="PERCENT", help="of the recorded range")

    return parser, list(made)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit code."""
    debug = bool(os.environ.get("TWIN_DEBUG"))
    # Where matrices are small, the threads of the linear algebra only wait for one another.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if not debug:
        warnings.simplefilter("ignore")  # what a library warns of is for those who develop with it
    try:
        parser, names = _parser()
        given = list(sys.argv[1:] if argv is None else argv)
        _check_command(given[0] if given else "-", names)
        args = parser.parse_args(given)
        if args.version:
            from importlib.metadata import version

            print(f"twin {version('twin')}")
            return 0
        if args.command is None:
            parser.error("name a command, such as run")
        return int(args.does(args))
    except BadInput as error:
        print(f"twin: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("twin: stopped; nothing is half-written", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123
        return 0
    except OSError as error:
        # A full disk, a name that is too long: no fault of ours, and told in one line.
        where = f"{error.filename}: " if error.filename else ""
        print(f"twin: {where}{error.strerror or error}: give another place or make room", file=sys.stderr)
        if debug:
            traceback.print_exc()
        return 2
    except Exception as error:
        print(f"twin: internal error, {type(error).__name__}: {' '.join(str(error).split())}; "
              "set TWIN_DEBUG=1 for the traceback", file=sys.stderr)  # fmt: skip
        if debug:
            traceback.print_exc()
        return 3


if __name__ == "__main__":
    sys.exit(main())
