"""`twin cosim`: the closed loop of an FMU and a controller in co-simulation."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from twin.cli.command import Command, add_out, check_outputs
from twin.cli.output import answer_user, show_progress
from twin.errors import BadInput


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
    check_outputs(args, args.out, args.plot)
    from twin.control import controller, reference
    from twin.io import files

    names = _mapping(args.map)
    made = controller.read(args.controller)
    kind = args.reference or "minimum-jerk"
    if kind in reference.KINDS:
        wanted = reference.make_reference(kind, made, args.amplitude, args.duration)
    elif args.amplitude is not None or args.duration is not None:
        raise BadInput(f"--amplitude and --duration shape {', '.join(reference.KINDS)}, not a file like {kind}")
    elif not Path(kind).suffix and not Path(kind).exists():
        raise BadInput(f"--reference is {kind!r}: give one of {', '.join(reference.KINDS)}, or a file that there is")
    else:
        wanted = reference.read_reference(Path(kind), made)
    from twin.control import cosimulation

    with show_progress(args) as tell:
        tell("closing the loop around the FMU", 0.0)
        ran = cosimulation.run(args.fmu, made, wanted, names, not args.other_structure)
    if args.out is not None:
        columns = (ran.time, ran.reference, ran.position, ran.input)
        lines = [",".join(f"{v:.10g}" for v in row) for row in zip(*(c.tolist() for c in columns), strict=True)]
        files.put(args.out, "\n".join(["time,reference,position,input", *lines]) + "\n")
    if args.plot is not None:
        from twin.report import figures

        files.put(args.plot, figures.tracking(ran, made.axis_unit, made.input_unit))
    answer_user(args, ran.says, cosimulation.to_json(ran))
    return 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fmu", type=Path, metavar="ARM.fmu")
    parser.add_argument("controller", type=Path, metavar="CONTROLLER.toml")
    parser.add_argument("--reference", metavar="CSV", help="a CSV with time and position, or minimum-jerk, sine, step")
    parser.add_argument("--amplitude", type=float, help="travel of a made reference, in the axis' unit")
    parser.add_argument("--duration", type=float, metavar="S", help="of the whole of a made reference")
    parser.add_argument(
        "--map", action="append", default=[], metavar="OURS=THEIRS",
        help="the FMU's own name of duty (or voltage, ...), position or position_measured; may be repeated",
    )  # fmt: skip
    parser.add_argument("--other-structure", action="store_true", help="take an FMU with other effects than the design")
    parser.add_argument("--plot", type=Path, metavar="SVG", help="reference, link, error and command as a figure")
    add_out(parser, "CSV", required=False, text="reference, position and input at every sample")


COMMAND = Command("cosim", "the closed loop in FMPy co-simulation", _add_arguments, _cosim)
