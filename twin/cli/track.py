"""`twin track`: a twin against recordings made since."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.cli.command import Command, add_out
from twin.cli.output import Progress, answer_user, show_progress
from twin.errors import BadInput

if TYPE_CHECKING:
    from twin.diagnosis.tracking import Forecast, Track
    from twin.model.fitted_model import Model

#: What is written beside the fits.
_RESULTS = ("track.json", "track.html")
#: How often a folder is looked at for new recordings, s.
POLL = 2.0
#: A file that was written to later than this is not read yet, s.
SETTLED = 1.0


def _logs(given: Sequence[Path]) -> list[Path]:
    """The recordings in the order in which they are given; those of a folder by name."""
    found: list[Path] = []
    for path in given:
        if path.is_dir():
            found += sorted(p for p in path.iterdir() if p.is_file() and p.suffix not in (".toml", ".md"))
        else:
            found.append(path)
    return found


def _fit(model: Model, log: Path, rig: Path | None, kept: Path | None) -> Model:
    """The fit of the model's structure to one recording; one that was made before is read, not made again."""
    from twin.diagnosis.api import fit_again
    from twin.io import files
    from twin.io.recording import load
    from twin.model import fitted_model
    from twin.report.origin import file_digest

    if not log.exists():
        raise BadInput(f"{log} does not exist: give the name of a recording")
    cached = None if kept is None else kept / f"{file_digest(log)}.toml"
    if cached is not None and cached.exists():
        return fitted_model.read(cached)
    recordings, _ = load([log], rig)
    found = fit_again(model, recordings)
    if cached is not None:
        cached.parent.mkdir(parents=True, exist_ok=True)
        files.put(cached, fitted_model.dumps(found))
    return found


def _limits(given: Sequence[str], model: Model) -> dict[str, float]:
    """NAME=VALUE as a mapping. Raises BadInput."""
    limits = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            limits[name] = float(value)
        except ValueError:
            raise BadInput(f"--limit {text}: give NAME=VALUE, as in viscous_friction=2.5") from None
        if name not in model.values:
            raise BadInput(f"--limit {text}: the model has no parameter {name!r}; it has {', '.join(model.values)}")
    return limits


def _json(history: Track, forecasts: Sequence[Forecast], args: argparse.Namespace) -> dict[str, Any]:
    """The history for programs."""
    from twin.diagnosis.change import to_json

    return {
        "format": "twin-track/1",
        "model": str(args.model),
        "false_alarms_per_recording": args.false_alarms,
        "recordings": [
            {
                "name": name,
                "standardised": dict(standardised),
                "values": {n: fit.values[n] for n in fit.fitted},
                "std": {n: fit.std(n) for n in fit.fitted},
            }
            for name, fit, standardised in zip(history.names, history.fits, history.standardised, strict=True)
        ],
        "alarms": [
            {
                "since": history.names[a.since],
                "seen": history.names[a.seen],
                "changes": to_json(a.changes),
            }
            for a in history.alarms
        ],
        "forecasts": [
            {"parameter": f.parameter, "limit": f.limit, "recordings": f.recordings, "interval": list(f.interval)}
            for f in forecasts
        ],
    }  # fmt: skip


def _sentences(history: Track, forecasts: Sequence[Forecast]) -> list[str]:
    from twin.diagnosis.change import DRIVE
    from twin.display.numbers import capital, listed

    count = len(history.fits)
    said = [f"{count} recording{'s' if count != 1 else ''}."]
    for a in history.alarms:
        said.append(
            f"{capital(listed([c.says for c in a.changes]))}: since {history.names[a.since]}, "
            f"seen with {history.names[a.seen]}."
        )
        rivals = sorted({r.replace("_", " ") for c in a.changes for r in c.rivals})
        if rivals:
            tells = " A known weight at the axis would." if DRIVE.replace("_", " ") in rivals else ""
            said.append(f"These recordings cannot tell that from a change of the {listed(rivals)}.{tells}")
    if not history.alarms:
        said.append("Nothing has changed.")
    for f in forecasts:
        name, (low, high) = f.parameter.replace("_", " "), f.interval
        if f.recordings == float("inf"):
            said.append(f"The {name} does not move towards {f.limit:g}.")
        else:
            said.append(f"The {name} reaches {f.limit:g} in {f.recordings:.3g} recordings ({low:.3g} to {high:.3g}).")
    return said


def _judge(args: argparse.Namespace, model: Model, tell: Progress) -> None:
    """Fit what is new, judge all, and write the answer."""
    from twin.diagnosis.tracking import forecast, track
    from twin.display.numbers import time_left
    from twin.fmi import evidence, python_fmu
    from twin.io.files import json_text, new_folder
    from twin.report.trend import trend_page

    logs = _logs(args.log)
    if not logs:
        raise BadInput(f"{args.log[0]} holds no recordings")
    kept = None if args.out is None else args.out / "fits"
    fits: list[Model] = []
    began = time.perf_counter()
    for i, log in enumerate(logs):
        left = time_left(time.perf_counter() - began, i, len(logs))
        tell(f"fitting {log.name}, {i + 1} of {len(logs)}{left}", 0.05 + 0.9 * i / len(logs))
        fits.append(_fit(model, log, args.rig, kept))
    history = track(model, fits, [log.name for log in logs], args.false_alarms)
    limits = _limits(args.limit, model)
    forecasts = [forecast(history, name, limit) for name, limit in limits.items()] if len(fits) > 2 else []
    answer, said = _json(history, forecasts, args), _sentences(history, forecasts)
    if args.out is not None:
        # Both at once: a page beside the figures of another run would be wrong. The fits stay.
        with new_folder(args.out, _RESULTS, force=True) as draft:
            (draft / _RESULTS[0]).write_text(json_text(answer), encoding="utf-8")
            (draft / _RESULTS[1]).write_text(trend_page(history, said), encoding="utf-8")
    if args.update is not None:
        python_fmu.update(args.update, model.with_values(history.latest.values))
        said.append(f"{args.update} holds the parameters since the last change.")
        said += filter(None, [evidence.of_old_parameters(args.update)])
    answer_user(args, said, answer)


def _news(given: Sequence[Path]) -> Iterator[None]:
    """Once for each time that something new has settled in the folders; for ever."""
    seen: set[Path] = set()
    while True:
        now = time.time()
        there = {p for p in _logs(given) if p.exists() and now - p.stat().st_mtime > SETTLED}
        if there - seen:
            seen |= there
            yield
        time.sleep(POLL)


def _track(args: argparse.Namespace) -> int:
    from twin.model import fitted_model

    model = fitted_model.read(args.model)
    _limits(args.limit, model)
    if not 0.0 < args.false_alarms < 1.0:
        raise BadInput(f"--false-alarms is {args.false_alarms:g}: give a share between 0 and 1")
    for _ in _news(args.log) if args.follow else [None]:
        with show_progress(args) as tell:
            _judge(args, model, tell)
    return 0


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml", help="the twin, with standard errors")
    parser.add_argument("log", nargs="+", type=Path, metavar="LOG", help="recordings, the oldest first; or a folder")
    parser.add_argument("--rig", type=Path, help="what the columns are; default: rig.toml beside LOG")
    add_out(parser, "DIR", required=False, text="the folder for track.json, track.html and the fits")
    parser.add_argument("--update", type=Path, metavar="ARM.fmu", help="write the newest parameters into this FMU")
    parser.add_argument(
        "--false-alarms", type=float, default=1e-3, metavar="SHARE", help="per recording; default: 0.001"
    )
    parser.add_argument(
        "--limit", action="append", default=[], metavar="NAME=VALUE", help="say when a parameter will reach this"
    )
    parser.add_argument(
        "--follow", action="store_true", help="go on as recordings are added to a folder; end by Ctrl-C"
    )


COMMAND = Command(
    "track", "which parameters changed since the model was made, when, by how much", _add_arguments, _track
)
