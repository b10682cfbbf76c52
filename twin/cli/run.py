"""`twin run`: the main job on one recording, or several."""

from __future__ import annotations

import argparse

from twin.cli.command import Command, add_log, add_out, add_structure, check_bandwidth, check_outputs, load
from twin.cli.output import answer_user, assumption_lines, fault_lines, parameters_to_json, show_progress
from twin.errors import StageFailed

#: What a user opens first, and what is said of it.
_SHOWN = {
    "report.html": "Everything is in",
    "improved.fmu": "the twin is",
    "improved-native.fmu": "for hosts without Python it is",
}


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
        from twin.display.numbers import listed
        from twin.estimation import estimate
        from twin.report import wording

        structure = estimate.first_structure(recordings, args.include, args.exclude)
        try:
            story = pipeline.run(recordings, args.out, structure, args.bandwidth, args.force, tell)
        except StageFailed as failed:
            incomplete: StageFailed | None = failed
        else:
            incomplete = None
    if incomplete is not None:
        return _answer_without_diagnosis(args, [*assumption_lines(rig), *fault_lines(recordings)], incomplete)
    d = story.diagnosis
    files = _written(args)
    says = [*wording.sentences(d, story.tracking), *story.failures.values()]
    answer = {
        "format": "twin-run/1",
        "out": str(args.out),
        "files": files,
        "says": says,
        "failures": dict(story.failures),
        "diagnosis": result.to_json(d, files.get("next_experiment.csv", "")),
        "parameters": {"before": parameters_to_json(d.before), "after": parameters_to_json(d.after)},
        "fmu": [vars(c) for c in story.checks],
        "tracking": None if story.tracking is None else cosimulation.to_json(story.tracking),
        "seconds": dict(story.seconds),
    }
    said = [*assumption_lines(rig), *fault_lines(recordings), *says, *story.remarks]
    runs_on = {c.fmu: f" ({listed(c.platforms)})" for c in story.checks if "native" in c.fmu}
    where = [f"{what} {files[name]}{runs_on.get(name, '')}" for name, what in _SHOWN.items() if name in files]
    answer_user(args, [*said, f"{'; '.join(where)}."], answer)
    # A bandwidth asks for a controller; else the verdict is what was asked for.
    return 1 if args.bandwidth is not None and story.controller is None else 0


def _written(args: argparse.Namespace) -> dict[str, str]:
    """The files of the run, by name."""
    from twin import pipeline

    return {name: str(args.out / name) for name in pipeline.FILES if (args.out / name).exists()}


def _answer_without_diagnosis(args: argparse.Namespace, said: list[str], failed: StageFailed) -> int:
    """What a run without a diagnosis has come to: the first model; exit 1."""
    says = list(failed.failures.values())
    answer = {
        "format": "twin-run/1", "out": str(args.out), "files": _written(args), "says": says,
        "failures": dict(failed.failures), "parameters": {"before": parameters_to_json(failed.model)},
    }  # fmt: skip
    answer_user(args, [*said, *says, f"The first model is {args.out / 'model.toml'}."], answer)
    return 1


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
