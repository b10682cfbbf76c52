"""`twin fleet`: many axes at once, on this machine or on a Dask cluster."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.cli.command import Command, add_out
from twin.cli.output import answer_user, show_progress
from twin.errors import install


def _fleet(args: argparse.Namespace) -> int:
    with show_progress(args) as tell:
        from twin.io.manifest import read_fleet

        read_fleet(args.fleet)  # a list that cannot be used is told before anything is imported
        from twin.batch.api import fleet
        from twin.batch.overview import sentences, to_json

        found = fleet(args.fleet, args.out, args.scheduler, args.force, tell)
    said = [*sentences(found), f"Everything is in {args.out / 'fleet.html'}."]
    if not (args.out / "fleet.parquet").exists():
        said.append(f"There is no fleet.parquet, but fleet.csv: {install('formats', 'pyarrow')}.")
    answer_user(args, said, to_json(found))
    return 1 if found.failed else 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fleet", type=Path, metavar="FLEET.csv", help="columns axis, file; optional rig")
    add_out(parser, "DIR", text="the folder: DIR/AXIS/ as twin run leaves it, DIR/fleet.html")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster; default: the cores of this machine")


COMMAND = Command("fleet", "many axes at once: the spread of each parameter, who stands apart", _add_arguments, _fleet)
