"""The command line: what other people's scripts call.

Exit codes: 0 done, 1 a check that was asked for did not hold, 2 bad input with one line on stderr, 3 a fault of ours. A
command imports what it needs after it has read its arguments. So help comes at once, and so does the message on a file
that cannot be used.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import traceback
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from typing import NoReturn

from twin.cli import control, cosim, diagnose, effects, export, fleet, identify, init, replay, run, serve, track
from twin.cli.command import Command
from twin.cli.output import printable
from twin.errors import BadInput, install

#: Every command of the program, in the order of `twin --help`.
COMMANDS: tuple[Command, ...] = (
    run.COMMAND,
    init.COMMAND,
    identify.COMMAND,
    export.EXPORT,
    export.UPDATE,
    replay.SIMULATE,
    diagnose.COMMAND,
    control.COMMAND,
    cosim.COMMAND,
    replay.CHECK,
    track.COMMAND,
    fleet.COMMAND,
    serve.COMMAND,
    effects.COMMAND,
)


#: One call of each command, shown below its --help.
EXAMPLES = {
    "run": "twin run recording.csv --rig rig.toml --out out",
    "identify": "twin identify recording.csv --with gravity --out model.toml",
    "export": "twin export model.toml --target native --fmi 3 --out arm.fmu",
    "update": "twin update arm.fmu --from model.toml",
    "simulate": "twin simulate arm.fmu --log recording.csv --out simulated.csv",
    "diagnose": "twin diagnose recording.csv --out improved.toml --report report.html",
    "control": "twin control improved.toml --bandwidth 2 --out controller.toml",
    "cosim": "twin cosim improved.fmu controller.toml --reference step --plot step.svg",
    "check": "twin check arm.fmu --log recording.csv --max-nrmse 5",
    "track": "twin track model.toml monday.csv tuesday.csv --out history",
    "fleet": "twin fleet fleet.csv --out fleet",
    "serve": "twin serve --port 8080",
    "effects": "twin effects gravity",
}

#: The options by the arguments of the library that they set, where the two have different names.
FLAGS = {
    "include": "--with", "exclude": "--without", "closed_loop": "--closed", "first": "--model", "names": "--map",
    "same_structure": "--other-structure",
}  # fmt: skip
#: Arguments of the library whose options have the same name.
SAME = (
    "ahead", "amplitude", "bandwidth", "draws", "duration", "fmi", "force", "horizon", "log", "method", "out", "port",
    "rig", "scheduler", "target",
)  # fmt: skip


def with_flags(message: str) -> str:
    """A message of the library with the command line's options in the place of the arguments.

    Arguments stand in backticks: `method="joint"` becomes --method joint, `force=True` becomes --force.
    """

    def flag(found: re.Match[str]) -> str:
        name, value = found["name"], found["value"]
        if name not in FLAGS and name not in SAME:
            return found.group()
        return FLAGS.get(name, f"--{name}") + ("" if value in (None, "True", "False") else f" {value.strip(chr(34))}")

    return re.sub(r"`(?P<name>\w+)(?:=(?P<value>[^`]*))?`", flag, message)


#: The shells that a script for completion can be had for.
SHELLS = ("bash", "zsh", "tcsh")


class _Parser(argparse.ArgumentParser):
    """Wrong arguments are bad input too: one line."""

    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{message.replace(chr(10), ' ')}; see {self.prog} --help")


def _check_command(name: str) -> None:
    names = [command.name for command in COMMANDS]
    if name not in names and not name.startswith("-"):
        close = get_close_matches(name, names, 1)
        meant = f"did you mean {close[0]}?" if close else f"there are {', '.join(names)}"
        raise BadInput(f"there is no command {name!r}; {meant}")


def _common_arguments() -> _Parser:
    common = _Parser(add_help=False)
    common.add_argument("--quiet", action="store_true", help="no progress bar and no sentences")
    common.add_argument("--json", metavar="FILE", help="write the result as JSON; - for stdout")
    common.add_argument("--force", action="store_true", help="overwrite what is there")
    return common


def _parser() -> _Parser:
    parser = _Parser(
        prog="twin",
        description="From one recording of a motor-driven axis to its digital twin, "
        "and to the physics that its model left out.",
    )
    parser.add_argument("--version", action="store_true", help="the version, and no more")
    parser.add_argument(
        "--completion", choices=SHELLS, metavar="SHELL", help="a script for the shell's completion: bash, zsh or tcsh"
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=_Parser)
    for command in COMMANDS:
        example = EXAMPLES.get(command.name)
        own = commands.add_parser(
            command.name, parents=[_common_arguments()], help=command.says, description=command.says,
            epilog=example and f"example: {example}",
        )  # fmt: skip
        own.set_defaults(handler=command.handler)
        command.add_arguments(own)
    return parser


def _completion(parser: _Parser, shell: str) -> str:
    try:
        import shtab
    except ImportError:
        raise BadInput(f"--completion needs shtab: {install('completion', 'shtab')}") from None
    return str(shtab.complete(parser, shell))


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit code."""
    debug = bool(os.environ.get("TWIN_DEBUG"))
    # Where matrices are small, the threads of the linear algebra only wait for one another.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if not debug:
        warnings.simplefilter("ignore")  # what a library warns of is for those who develop with it
    try:
        parser = _parser()
        given = list(sys.argv[1:] if argv is None else argv)
        _check_command(given[0] if given else "-")
        args = parser.parse_args(given)
        if args.version:
            from importlib.metadata import version

            print(f"twin {version('twin')}")
            return 0
        if args.completion:
            print(_completion(parser, args.completion))
            return 0
        if args.command is None:
            parser.error("name a command, such as run")
        return int(args.handler(args))
    except BadInput as error:
        print(f"twin: {printable(with_flags(str(error)))}", file=sys.stderr)
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
        print(printable(f"twin: {where}{error.strerror or error}: give another place or make room"), file=sys.stderr)
        if debug:
            traceback.print_exc()
        return 2
    except Exception as error:
        print(f"twin: internal error, {type(error).__name__}: {printable(' '.join(str(error).split()))}; "
              "set TWIN_DEBUG=1 for the traceback", file=sys.stderr)  # fmt: skip
        if debug:
            traceback.print_exc()
        return 3


if __name__ == "__main__":
    sys.exit(main())
