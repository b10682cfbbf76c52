"""`twin simulate` and `twin check`: an FMU against recordings."""

from __future__ import annotations

import argparse
import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.cli.command import Command, add_closed, add_log, add_out, check_outputs, load, percentage
from twin.cli.output import answer_user, assumption_lines, fault_lines, show_progress
from twin.errors import BadInput

if TYPE_CHECKING:
    from twin.fmi.misfit import Misfit
    from twin.fmi.python_fmu import Replay
    from twin.io.recording import Recording, Rig

#: The figures that can be limited, and the argument that does so.
GATES = {"rmse": "max_rmse", "peak": "max_peak", "nrmse_percent": "max_nrmse"}


@dataclass(frozen=True, eq=False)
class _Judged:
    """A recording, the FMU over it, the errors that are judged, and what they may be."""

    recording: Recording
    ran: Replay
    found: Misfit
    limits: Mapping[str, float]
    since: float = 0.0

    @property
    def holds(self) -> bool:
        return all(getattr(self.found, name) <= limit for name, limit in self.limits.items())


def replay_all(args: argparse.Namespace) -> tuple[list[Recording], Rig, list[Replay]]:
    with show_progress(args) as tell:
        recordings, rig = load(args, tell)
        from twin.fmi import python_fmu

        ran = []
        for i, r in enumerate(recordings):
            tell(f"simulating {r.name}", i / len(recordings))
            ran.append(python_fmu.replay(args.fmu, r, closed=args.closed_loop))
    return recordings, rig, ran


def _fits(recordings: Sequence[Recording], ran: Sequence[Replay], since: Sequence[float] = ()) -> list[dict[str, Any]]:
    from twin.fmi.misfit import misfit

    begins = since or [0.0] * len(recordings)
    found = [(r, misfit(r, s, since=begin)) for r, s, begin in zip(recordings, ran, begins, strict=True)]
    return [{"recording": r.name, "role": r.role, **_figures(m), "unit": r.output_unit} for r, m in found]


def _figures(found: Misfit) -> dict[str, float]:
    return {name: getattr(found, name) for name in GATES}


def _fit_lines(fits: Sequence[Mapping[str, Any]]) -> list[str]:
    from twin.display.numbers import number, unit_text

    lines = []
    for f in fits:
        ahead = f.get("ahead")
        judged, what = (ahead, f", {ahead['seconds']:g} s ahead") if ahead else (f, "")
        error = f"RMSE {number(judged['rmse'])} {unit_text(f['unit'])}, {number(judged['nrmse_percent'])} %"
        of = "of the range of the change over that time" if ahead else "of the recorded range"
        lines.append(f"{f['recording']}{what}: {error} {of}; peak {number(judged['peak'])} {unit_text(f['unit'])}.")
    return lines


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


def _limits(args: argparse.Namespace) -> dict[str, float]:
    """The limits that are given, by the figure that each is for. Raises BadInput."""
    limits = {name: getattr(args, argument) for name, argument in GATES.items() if getattr(args, argument) is not None}
    for name, limit in limits.items():
        if not limit > 0.0:
            raise BadInput(f"{_flag(name)} is {limit:g}: give a number above 0")
    if not limits and (args.log or args.ahead is not None):
        raise BadInput("there is nothing to hold the twin to: give --max-nrmse, --max-rmse or --max-peak")
    return limits


def _flag(name: str) -> str:
    return f"--{GATES[name].replace('_', '-')}"


def _check(args: argparse.Namespace) -> int:
    limits = _limits(args)
    check_outputs(args)
    judged, assumed = _judged(args) if args.log else (_judged_again(args, limits), [])
    from twin.io.recording import faults_of

    recordings = [j.recording for j in judged]
    bad = [j for j in judged if not j.holds]
    fits = _fits(recordings, [j.ran for j in judged], [j.since for j in judged])
    if args.ahead is not None:
        far = [{"seconds": args.ahead, **_figures(j.found)} for j in judged]
        fits = [f | {"ahead": ahead} for f, ahead in zip(fits, far, strict=True)]
    pictures = [_picture(args, j) for j in bad]
    beyond = " or ".join(f"{_flag(name)} {limit:g}" for name, limit in limits.items()) or "the figures that it carries"
    verdict = f"The twin does not fit: {len(bad)} of {len(fits)} beyond" if bad else "The twin fits: none is beyond"
    answer = {
        "format": "twin-check/1", "holds": not bad, "max_nrmse_percent": args.max_nrmse, "limits": limits, "fit": fits,
        "plots": [str(p) for p, _ in pictures if p is not None], "recording_faults": faults_of(recordings),
    }  # fmt: skip
    shown = [f for f, j in zip(fits, judged, strict=True) if not j.holds] or fits
    said = [*assumed, *fault_lines(recordings), *_fit_lines(shown), *(says for _, says in pictures)]
    answer_user(args, [*said, f"{verdict} {beyond}."], answer)
    return 1 if bad else 0


def _judged(args: argparse.Namespace) -> tuple[list[_Judged], list[str]]:
    """The FMU on the recordings that are given, and what was assumed of their columns."""
    recordings, rig, ran = replay_all(args)
    from twin.fmi.misfit import misfit

    pairs = zip(recordings, ran, strict=True)
    return [_Judged(r, s, misfit(r, s, args.ahead), _limits(args)) for r, s in pairs], assumption_lines(rig)


def _judged_again(args: argparse.Namespace, limits: Mapping[str, float]) -> list[_Judged]:
    """The FMU on the recordings that it carries; without limits of the user's, by the figures that it carries."""
    with show_progress(args) as tell:
        from twin.fmi import evidence, python_fmu
        from twin.fmi.misfit import misfit

        trials, figures = evidence.carried(args.fmu)
        judged = []
        for i, (trial, found) in enumerate(zip(trials, figures, strict=True)):
            tell(f"simulating {trial.recording.name}", i / len(trials))
            ran = python_fmu.replay(args.fmu, trial.recording)
            own = {name: evidence.REPEATED * found[name] for name in ("rmse", "peak")}
            errors = misfit(trial.recording, ran, args.ahead, trial.judged_from)
            judged.append(_Judged(trial.recording, ran, errors, limits or own, trial.judged_from))
    return judged


def _picture(args: argparse.Namespace, judged: _Judged) -> tuple[Path | None, str]:
    """A picture of the worst second: its file, None where it cannot be written, and what is said of it."""
    from twin.io.files import put
    from twin.report.misfit_plot import worst_second

    r, (begin, end) = judged.recording, judged.found.worst()
    where = f"{r.name} is missed most from {begin:.3f} to {end:.3f} s"
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", f"{args.fmu.stem}-{r.name}")
    path = args.plots / f"{name}.png"
    try:
        args.plots.mkdir(parents=True, exist_ok=True)
        put(path, worst_second(r, judged.ran, judged.found, f"{args.fmu.name} and {r.name}"))
    except (OSError, BadInput):
        return None, f"{where}; {args.plots} takes no picture of it: name another folder with --plots."
    return path, f"{where}: {path}"


def _add_simulate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fmu", type=Path, metavar="ARM.fmu")
    add_log(parser, "--log", required=True)
    add_closed(parser)
    add_out(parser, "CSV", required=False, text="recorded and simulated at every stamp")


def _add_check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fmu", type=Path, metavar="ARM.fmu")
    add_log(parser, "--log", default=[])
    add_closed(parser)
    parser.add_argument("--max-nrmse", type=percentage, metavar="PERCENT", help="RMSE, of the recorded range")
    parser.add_argument("--max-rmse", type=float, metavar="ERROR", help="RMSE, in the unit of the output (rad, m)")
    parser.add_argument("--max-peak", type=float, metavar="ERROR", help="largest error, in the unit of the output")
    parser.add_argument(
        "--ahead", type=float, metavar="SECONDS",
        help="judge the prediction so far ahead, not the free run: it sees lag and dead time",
    )  # fmt: skip
    parser.add_argument(
        "--plots", type=Path, default=Path("twin-plots"), metavar="DIR",
        help="where the worst second of what fails is drawn; default: twin-plots",
    )  # fmt: skip


SIMULATE = Command(
    "simulate", "replay the recorded input through the FMU in FMPy, and compare", _add_simulate_arguments, _simulate
)

CHECK = Command("check", "for CI: exit 1 when the twin no longer fits", _add_check_arguments, _check)
