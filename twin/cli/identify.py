"""`twin identify`: the parameters of a model with their standard errors."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.cli.command import Command, add_closed, add_log, add_out, add_structure, check_outputs, load
from twin.cli.output import (
    answer_user,
    assumption_lines,
    fault_lines,
    parameter_lines,
    parameters_to_json,
    prior_sentences,
    show_progress,
)


def _identify(args: argparse.Namespace) -> int:
    check_outputs(args, args.out)
    with show_progress(args) as tell:
        from twin.io.recording import faults_of, preflight_of, to_fit

        recordings, rig = load(args, tell)
        to_fit(recordings)  # before anything is compiled
        from twin.estimation import estimate, prior
        from twin.io import files
        from twin.model import fitted_model
        from twin.report import wording

        structure = estimate.first_structure(recordings, args.include, args.exclude)
        siblings = None if args.prior is None else prior.read_prior(args.prior, structure)
        found = estimate.identify(recordings, structure, args.method, args.horizon, args.closed_loop, tell)
        if siblings is not None:
            found = prior.with_prior(found, siblings)
        from twin.diagnosis import free_run_error  # late: bad input is refused without it

        errors = free_run_error.free_run_errors(found, to_fit(recordings), args.closed_loop)
        compared = None
        if args.horizon is not None:
            tell("both kinds of values on held-out data", 0.95)
            compared = free_run_error.compare_horizon(found, recordings, args.horizon, args.closed_loop)
    files.put(args.out, fitted_model.dumps(found))
    said = [
        *assumption_lines(rig),
        wording.recordings_sentence(recordings),
        *fault_lines(recordings),
        f"{args.out}: {found.structure}, by the {args.method} method:",
        *parameter_lines(found, rig),
        *prior_sentences(found),
        *free_run_error.sentences(errors, found, recordings[0].output_unit),
    ]
    if compared is not None:
        said.append(compared.sentence(args.horizon, recordings[0].output_unit))
    answer = {
        "format": "twin-identify/1",
        "model": str(args.out),
        "method": args.method,
        "horizon": args.horizon,
        "effects": list(found.structure.ids),
        "parameters": parameters_to_json(found),
        "preflight": preflight_of(recordings),
        "free_run": [
            {
                "recording": e.recording,
                "rmse": e.rmse,
                "nrmse_percent": e.nrmse_percent,
                "missing_torque_depends_on": list(e.depends_on),
            }
            for e in errors
        ],
        "held_out": None if compared is None else vars(compared),
        "recording_faults": faults_of(recordings),
        "assumed": list(rig.assumed),
    }
    answer_user(args, said, answer)
    return 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    add_structure(parser)
    add_out(parser, "MODEL.toml")
    parser.add_argument(
        "--method", choices=("joint", "two-stage"), default="joint",
        help="joint: maximum likelihood on everything (default); two-stage: steady states, then transients",
    )  # fmt: skip
    parser.add_argument(
        "--horizon", type=float, metavar="SECONDS",
        help="the values that predict best this far ahead, for a model that lacks something; default: the likeliest",
    )  # fmt: skip
    parser.add_argument(
        "--prior", type=Path, metavar="FLEET", help="a folder of twin fleet, whose axes say what to expect of this one"
    )
    add_closed(parser)


COMMAND = Command("identify", "parameters with standard errors", _add_arguments, _identify)
