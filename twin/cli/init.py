"""`twin init`: the rig file, written from a log."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from twin.cli.command import Command, check_outputs
from twin.cli.output import answer_user


def _init(args: argparse.Namespace) -> int:
    out = args.out or args.log[0].parent / "rig.toml"
    check_outputs(args, out)
    from twin.io import files, rig_draft

    found = rig_draft.draft(args.log)
    files.put(out, found.text)
    said = [f"{out} says what the columns of {args.log[0]} are.", *(f"Check: {u}." for u in found.unsure)]
    said.append(f"Next: {shlex.join(['twin', 'run', *map(str, args.log), '--rig', str(out), '--out', 'out'])}")
    answer = {"format": "twin-init/1", "rig": str(out), "text": found.text, "unsure": list(found.unsure)}
    answer_user(args, said, answer)
    return 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", nargs="+", type=Path, metavar="LOG", help="recordings, or a manifest")
    parser.add_argument("--out", type=Path, metavar="RIG.toml", help="what is written; default: rig.toml beside LOG")


COMMAND = Command("init", "looks at a log and writes the rig file: columns, units, sample time", _add_arguments, _init)
