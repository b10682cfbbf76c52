"""What every command is made of, and the arguments that several share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from twin.cli.output import Progress
from twin.errors import BadInput

if TYPE_CHECKING:
    from twin.io.recording import Recording, Rig


class Command(NamedTuple):
    """One command of the program: `twin.cli.main.COMMANDS` lists them all."""

    name: str
    #: One line for `twin --help`.
    says: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    #: Does the work; the exit code.
    handler: Callable[[argparse.Namespace], int]


def check_outputs(args: argparse.Namespace, *outputs: Path | None) -> None:
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


def check_bandwidth(args: argparse.Namespace) -> None:
    """Raises BadInput for one that no controller has, before a search takes its minutes."""
    if args.bandwidth is not None and not 0.0 < args.bandwidth < float("inf"):
        raise BadInput(f"--bandwidth is {args.bandwidth:g} Hz: give a number above 0")


def load(args: argparse.Namespace, tell: Progress) -> tuple[list[Recording], Rig]:
    from twin.io.recording import load

    tell("reading the recording", 0.0)
    return load(args.log, args.rig)


def percentage(text: str) -> float:
    try:
        return float(text.rstrip(" %"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a percentage") from None


def add_log(command: argparse.ArgumentParser, *name: str, **more: Any) -> None:
    said = "recordings, or a manifest that lists them"
    command.add_argument(*(name or ("log",)), nargs="+", type=Path, metavar="LOG", help=said, **more)
    said = "what the columns are; default: rig.toml beside LOG, else by their names"
    command.add_argument("--rig", type=Path, help=said)


def add_closed(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--closed", dest="closed_loop", action="store_true",
        help="simulate the rig's own loop ([loop] in the rig file) from the recorded reference, not the recorded input",
    )  # fmt: skip


def add_structure(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--with", dest="include", action="append", default=[], metavar="EFFECT", help="add an effect to the first model"
    )
    command.add_argument(
        "--without", dest="exclude", action="append", default=[], metavar="EFFECT", help="leave one out of it"
    )


def add_out(command: argparse.ArgumentParser, metavar: str, required: bool = True, text: str = "") -> None:
    command.add_argument("--out", type=Path, required=required, metavar=metavar, help=text or "what is written")
