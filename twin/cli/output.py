"""What a command shows: progress on stderr, sentences on the console, JSON in a file."""

from __future__ import annotations

import argparse
import sys
import threading
import time
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.io.recording import Recording, Rig
    from twin.model.fitted_model import Model

Progress = Callable[[str, float], None]
Answer = Mapping[str, Any]
#: In a log each time that a bar is drawn is a line: so many seconds apart.
LINE = 30.0
#: From such a share of the work on, and after so many seconds, what is left is estimated from what is done.
ESTIMATED_FROM, SETTLED = 0.05, 10.0
#: So many lines on what was found in the recordings.
MOST_LINES = 12


@contextmanager
def show_progress(args: argparse.Namespace) -> Iterator[Progress]:
    """A bar on stderr once the work takes over a second; gone when it is done."""
    if args.quiet:
        yield lambda sentence, share: None
        return
    from tqdm import tqdm

    from twin.display.numbers import time_left

    tty = sys.stderr.isatty()
    shape = "{desc} {bar} {percentage:3.0f} % {elapsed}{postfix}"
    bar = tqdm(total=100, delay=1e9, leave=False, file=sys.stderr, ncols=None if tty else 90, bar_format=shape)
    done = threading.Event()
    began = time.monotonic()

    def refresh() -> None:
        seconds, share = time.monotonic() - began, bar.n / 100.0
        estimated = share >= ESTIMATED_FROM and seconds >= SETTLED and not bar.desc.rstrip().endswith(" left")
        left = time_left(seconds, share, 1.0) if estimated else ""
        bar.set_postfix_str(left.removeprefix(", "), refresh=False)
        bar.refresh()

    def draw() -> None:
        # The work says little while it computes: a bar whose clock stands still looks like one that hangs.
        if not done.wait(1.0 if tty else LINE):
            bar.delay = 0.0  # else tqdm takes the bar for one that was never drawn, and leaves it standing
            refresh()
            while not done.wait(0.25 if tty else LINE):
                refresh()

    drawing = threading.Thread(target=draw, daemon=True)
    drawing.start()

    def tell(sentence: str, share: float) -> None:
        bar.set_description_str(sentence, refresh=False)
        bar.n = max(100.0 * share, bar.n)

    try:
        yield tell
    finally:
        done.set()
        drawing.join()
        bar.close()


def printable(text: str) -> str:
    """The text with its control characters shown, not sent: a name in a file could else command the terminal.

    Line breaks and tabs stay. Characters that turn the direction of writing are shown, too.
    """
    return "".join(
        c if c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cf", "Cs", "Zl", "Zp") else _shown(c) for c in text
    )


def _shown(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def answer_user(args: argparse.Namespace, said: Sequence[str], answer: Answer) -> None:
    """The sentences for people, and the JSON for programs; with `--json -` the sentences go to stderr."""
    from twin.io.files import json_text, put

    if args.json == "-":
        sys.stdout.write(json_text(answer))
    elif args.json is not None:
        put(Path(args.json), json_text(answer))
    if not args.quiet:
        # Consoles that know only a few characters get plain ones, and never an error.
        text = printable("\n".join(said)).translate({ord("\u202f"): " ", ord("−"): "-"})
        stream = sys.stderr if args.json == "-" else sys.stdout
        coding = stream.encoding or "ascii"
        print(text.encode(coding, "replace").decode(coding), file=stream)


def assumption_lines(rig: Rig) -> list[str]:
    return [f"Assumed, for want of a rig file: {a}" for a in rig.assumed]


def fault_lines(recordings: Sequence[Recording]) -> list[str]:
    """What was found and left out in each recording, by its name where there are several."""
    from twin.io.faults import summarise

    several = len(recordings) > 1
    lines = [line for r in recordings for line in [*_preflight_lines(r), *((r.name, s) for s in summarise(r.faults))]]
    said = [f"{name}: {line}" if several else line for name, line in lines[:MOST_LINES]]
    more = len(lines) - len(said)
    return [*said, f"and {more} more lines of this kind; --json FILE holds them all"] if more else said


def _preflight_lines(recording: Recording) -> list[tuple[str, str]]:
    return [(f.about or recording.name, f"{f.says[0].upper()}{f.says[1:]}.") for f in recording.preflight]


def parameters_to_json(model: Model) -> dict[str, Any]:
    found = {}
    for p in model.structure.parameters:
        entry: dict[str, Any] = {
            "value": model.values[p.name], "std": model.std(p.name), "unit": model.unit(p.name), "meaning": p.meaning
        }  # fmt: skip
        if p.name in model.intervals:
            entry["interval"] = list(model.intervals[p.name])
        if p.name in model.notes:
            entry["note"] = model.notes[p.name]
        found[p.name] = entry
    return found


def parameter_lines(model: Model, rig: Rig) -> list[str]:
    """A line for each parameter, with the rig's own unit beside SI."""
    from twin.display.numbers import measure
    from twin.report.wording import in_rig_unit, undetermined_sentence

    width = max(len(p.name) for p in model.structure.parameters)
    lines = []
    for p in model.structure.parameters:
        if p.name in model.undetermined:
            continue
        value = measure(model.values[p.name], model.std(p.name), model.unit(p.name))
        same = [t for t in (in_rig_unit(model, p.name, rig), model.torque(p.name)) if t]
        note = f"  ({model.notes[p.name]})" if p.name in model.notes else ""
        lines.append(f"  {p.name:<{width}}  {' = '.join([value, *same])}{note}")
    if lost := undetermined_sentence(model):
        lines.append(f"  {lost}")
    return lines


def prior_sentences(model: Model) -> list[str]:
    """What the siblings of a unit had to say, where they were asked."""
    told = model.provenance
    if "prior" not in told:
        return []
    unlike = told.get("unlike_siblings", "").replace("_", " ")
    apart = f" It is unlike them in {unlike}: there the recording alone counts." if unlike else ""
    return [f"The values hold what {told['prior']} say of such an axis.{apart}"]
