"""`twin diagnose`: what a first model leaves out."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.cli.command import Command, add_closed, add_log, add_out, add_structure, check_outputs, load
from twin.cli.output import answer_user, assumption_lines, fault_lines, show_progress


def _diagnose(args: argparse.Namespace) -> int:
    experiment_file = args.out.with_name(f"{args.out.stem}_next_experiment.csv")
    check_outputs(args, args.out, args.report, experiment_file)
    with show_progress(args) as tell:
        from twin.io.recording import to_fit

        recordings, rig = load(args, tell)
        to_fit(recordings)  # before anything is compiled
        from twin.diagnosis import api, result
        from twin.io import files
        from twin.model import fitted_model
        from twin.report import wording

        given = None if args.model is None else fitted_model.read(args.model)
        d = api.diagnose(
            recordings, given, args.closed_loop, lambda s, x: tell(s, 0.95 * x), args.include, args.exclude
        )
        page = ""
        if args.report is not None:
            from twin.report import html
            from twin.report.origin import files_of, trace_origin

            tell("writing the report", 0.97)
            made = trace_origin(
                [*files_of(recordings), *filter(None, [args.model])],
                [str(args.out), str(args.report)],
                [f"twin export {args.out} --out axis.fmu", f"twin control {args.out} --out controller.toml"],
            )
            page = html.html(html.Story(d, rig, origin=made))
    experiment = result.experiment_csv(d.experiment, d.after.input_name)
    files.put(args.out, fitted_model.dumps(d.after))
    if experiment:
        files.put(experiment_file, experiment)
    if args.report is not None:
        files.put(args.report, page)
    said = [*assumption_lines(rig), *fault_lines(recordings), *wording.sentences(d), *d.remarks]
    said += [wording.doubt(u) for u in d.undecided]
    if experiment:
        said.append(f"Next: {d.experiment.why} The input to play is in {experiment_file}.")
    answer_user(args, said, result.to_json(d, str(experiment_file) if experiment else ""))
    return 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    add_structure(parser)
    add_closed(parser)
    parser.add_argument("--model", type=Path, metavar="MODEL.toml", help="the first model; default: the base effects")
    add_out(parser, "IMPROVED.toml")
    parser.add_argument("--report", type=Path, metavar="HTML", help="the report, one self-contained file")


COMMAND = Command("diagnose", "locate, name and model what a first model leaves out", _add_arguments, _diagnose)
