"""`twin run`: the main job on one recording, or several."""

from __future__ import annotations

import argparse

from twin.cli.command import Command, add_log, add_out, add_structure, check_bandwidth, check_outputs, load
from twin.cli.output import answer_user, assumption_lines, fault_lines, parameters_to_json, show_progress


def _run(args: argparse.Namespace) -> int:
    check_outputs(args)
    check_bandwidth(args)
    with show_progress(args) as tell:
        from twin.io.recording import to_fit

        recordings, rig = load(args, tell)
        to_fit(recordings)  # before anything is compiled
        from twin import pipeline
        from twin.control import cosimulation
        from twin.diagnosis import result
        from twin.estimation import estimate
        from twin.report import wording

        structure = estimate.first_structure(recordings, args.include, args.exclude)
        story = pipeline.run(recordings, args.out, structure, args.bandwidth, args.force, tell)
    d = story.diagnosis
    files = {name: str(args.out / name) for name in pipeline.FILES if (args.out / name).exists()}
    says = wording.sentences(d, story.tracking)
    answer = {
        "format": "twin-run/1",
        "out": str(args.out),
        "files": files,
        "says": list(says),
        "diagnosis": result.to_json(d, files.get("next_experiment.csv", "")),
        "parameters": {"before": parameters_to_json(d.before), "after": parameters_to_json(d.after)},
        "fmu": [vars(c) for c in story.checks],
        "tracking": None if story.tracking is None else cosimulation.to_json(story.tracking),
        "seconds": dict(story.seconds),
    }
    said = [*assumption_lines(rig), *fault_lines(recordings), *says, *story.remarks]
    said.append(f"Everything is in {args.out / 'report.html'}; the twin is {args.out / 'improved.fmu'}.")
    answer_user(args, said, answer)
    return 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    add_structure(parser)
    add_out(parser, "DIR", text="the folder for everything that is made")
    parser.add_argument(
        "--bandwidth", type=float, metavar="HZ", help="of the controller; default: what the axis allows"
    )


COMMAND = Command(
    "run", "the main job: identify, export, check, diagnose, control; ends with DIR/report.html", _add_arguments, _run
)
