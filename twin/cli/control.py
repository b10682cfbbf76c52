"""`twin control`: a controller from a model."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.cli.command import Command, add_out, check_bandwidth, check_outputs
from twin.cli.output import answer_user, show_progress
from twin.errors import BadInput


def _control(args: argparse.Namespace) -> int:
    check_outputs(args, args.out)
    check_bandwidth(args)
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
    says, found = [f"{args.out}: {made.summary}.", *made.remarks], None
    if known.fitted and args.draws:
        with show_progress(args) as tell:
            tell("compiling the closed loop (once on a machine)", 0.0)
            monte_carlo.serving(known, made)
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
    answer_user(args, says, answer)
    return 1 if args.max_peak is not None and found is not None and found.share < monte_carlo.ENOUGH else 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml")
    add_out(parser, "CONTROLLER.toml")
    parser.add_argument("--bandwidth", type=float, metavar="HZ", help="default: what the axis allows")
    parser.add_argument("--limit", type=float, help="largest command; default: the drive's, or the largest recorded")
    parser.add_argument(
        "--draws", type=int, default=200, metavar="N", help="axes drawn from the parameters' covariance; 0: none"
    )
    parser.add_argument(
        "--max-peak", type=float, metavar="ERROR",
        help="acceptable peak tracking error, in the axis' unit; exit 1 where fewer than 95 %% of the draws keep it",
    )  # fmt: skip


COMMAND = Command("control", "a feedback-linearising controller", _add_arguments, _control)
