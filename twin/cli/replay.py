"""`twin simulate` and `twin check`: an FMU against recordings."""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.cli.command import Command, add_closed, add_log, add_out, check_outputs, load, percentage
from twin.cli.output import answer_user, assumption_lines, fault_lines, show_progress
from twin.errors import BadInput

if TYPE_CHECKING:
    from twin.io.recording import Recording, Rig


def replay_all(args: argparse.Namespace) -> tuple[list[Recording], Rig, list[Any]]:
    with show_progress(args) as tell:
        recordings, rig = load(args, tell)
        from twin.fmi import python_fmu

        ran = []
        for i, r in enumerate(recordings):
            tell(f"simulating {r.name}", i / len(recordings))
            ran.append(python_fmu.replay(args.fmu, r, closed=args.closed_loop))
    return recordings, rig, ran


def _fits(recordings: Sequence[Recording], ran: Sequence[Any]) -> list[dict[str, Any]]:
    return [
        {"recording": r.name, "role": r.role, "rmse": s.rmse(r), "nrmse_percent": s.nrmse_percent(r),
         "unit": r.output_unit}
        for r, s in zip(recordings, ran, strict=True)
    ]  # fmt: skip


def _fit_lines(fits: Sequence[Mapping[str, Any]]) -> list[str]:
    from twin.display.numbers import number, unit_text

    return [
        f"{f['recording']}: RMSE {number(f['rmse'])} {unit_text(f['unit'])}, "
        f"{number(f['nrmse_percent'])} % of the recorded range."
        for f in fits
    ]


def _simulate(args: argparse.Namespace) -> int:
    check_outputs(args, args.out)
    recordings, rig, ran = replay_all(args)
    from twin.io.files import put
    from twin.io.recording import faults_of

    fits = _fits(recordings, ran)
    if args.out is not None:
        put(args.out, _simulation_csv(recordings, ran, args.closed_loop))
    answer = {
        "format": "twin-simulate/1", "fmu": str(args.fmu), "file": args.out and str(args.out), "fit": fits,
        "recording_faults": faults_of(recordings),
    }  # fmt: skip
    answer_user(args, [*assumption_lines(rig), *fault_lines(recordings), *_fit_lines(fits)], answer)
    return 0


def _simulation_csv(recordings: Sequence[Recording], ran: Sequence[Any], closed: bool) -> str:
    """One row per stamp; with several recordings, their name in a first column. The input is the recorded one, or
    where the loop is closed what it commanded.
    """
    several = len(recordings) > 1
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    names = ["time", "input", "recorded", "position_measured", "velocity"]
    rows.writerow(["recording", *names] if several else names)
    for r, s in zip(recordings, ran, strict=True):
        columns = (r.time, s.input if closed else r.input, r.output, s.position_measured, s.velocity)
        for row in zip(*(c.tolist() for c in columns), strict=True):
            cells = ["" if v != v else f"{v:.10g}" for v in row]
            rows.writerow([r.name, *cells] if several else cells)
    return out.getvalue()


def _check(args: argparse.Namespace) -> int:
    if not args.max_nrmse > 0.0:
        raise BadInput(f"--max-nrmse is {args.max_nrmse:g}: give a percentage above 0")
    check_outputs(args)
    recordings, rig, ran = replay_all(args)
    from twin.io.recording import faults_of

    fits = _fits(recordings, ran)
    bad = [f for f in fits if not f["nrmse_percent"] <= args.max_nrmse]
    verdict = (
        f"The twin fits: no recording is above {args.max_nrmse:g} %."
        if not bad
        else f"The twin does not fit: {len(bad)} of {len(fits)} above {args.max_nrmse:g} %."
    )
    answer = {
        "format": "twin-check/1", "holds": not bad, "max_nrmse_percent": args.max_nrmse, "fit": fits,
        "recording_faults": faults_of(recordings),
    }  # fmt: skip
    answer_user(args, [*assumption_lines(rig), *fault_lines(recordings), *_fit_lines(bad or fits), verdict], answer)
    return 1 if bad else 0


def _add_simulate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fmu", type=Path, metavar="ARM.fmu")
    add_log(parser, "--log", required=True)
    add_closed(parser)
    add_out(parser, "CSV", required=False, text="recorded and simulated at every stamp")


def _add_check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fmu", type=Path, metavar="ARM.fmu")
    add_log(parser, "--log", required=True)
    add_closed(parser)
    parser.add_argument("--max-nrmse", type=percentage, required=True, metavar="PERCENT", help="of the recorded range")


SIMULATE = Command(
    "simulate", "replay the recorded input through the FMU in FMPy, and compare", _add_simulate_arguments, _simulate
)

CHECK = Command("check", "for CI: exit 1 when the twin no longer fits", _add_check_arguments, _check)
