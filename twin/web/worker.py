"""The process beside the page's server: it reads the log, searches, and runs models. Its owner may end it at any time.

What is asked comes through a pipe as (action, argument). What goes back is ("event", dict) any number of times, then
("answer", dict) or ("refused", sentence).
"""

from __future__ import annotations

import math
import re
import signal
from collections.abc import Callable, Mapping
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from twin.display.numbers import capital
from twin.errors import BadInput, StageFailed
from twin.io import manifest
from twin.io.faults import summarise
from twin.io.preflight.finding import Severity
from twin.io.recording import Recording, load
from twin.io.rig_draft import draft
from twin.io.rig_guess import Section, guess, numeric_columns, write_sections
from twin.io.tables.formats import open_tables
from twin.io.tables.table import Table
from twin.io.units import OPTIONAL_UNITS
from twin.report.panels import tell_columns, tell_recordings

#: Tables of a rig file that the page may set, and the keys that would name other files.
TITLES = ("time", "input", "input.direction", "output", *(f"optional.{key}" for key in OPTIONAL_UNITS))
ELSEWHERE = ("file", "time_column", "time_unit")
#: The folder of results beside the log.
RESULTS = "results"
#: What is made when it is asked for, by name, and the version of FMI.
EXPORTS = {"improved-native-fmi3.fmu": 3, "controller.fmu": 2}


class Work:
    """One log, from the first look to the models.

    Parameters
    ----------
    log : Path
        Where it lies, in a folder that holds nothing but what this class writes.
    name : str
        What the user calls it.
    send : callable
        Takes the events of a search, each a dict.
    """

    def __init__(self, log: Path, name: str, send: Callable[[dict[str, Any]], None]) -> None:
        self.log, self.name, self.send = log, name, send
        self.recordings: list[Recording] = []

    def look(self, _: None) -> dict[str, Any]:
        """The columns, a first draft of the rig file, and what comes of it."""
        if manifest.is_manifest(self.log):
            raise BadInput(f"{self.log} is a list of recordings: drop one recording, or give the list to twin run")
        table = open_tables(self.log)[0]
        sections, unsure = self._draft(table)
        tables = {title: {"keys": s.keys, "remarks": s.remarks} for title, s in sections.items()}
        columns = [*table.names[:200], *([table.clock] if table.clock else [])]
        told = {"name": self.name, "columns": columns, "sections": tables, "unsure": [self._said(u) for u in unsure]}
        return {**told, **self.choose({title: dict(s.keys) for title, s in sections.items()})}

    def _draft(self, table: Table) -> tuple[Mapping[str, Section], list[str]]:
        try:
            guessed = guess(table)
        except BadInput:
            return {}, ["no column looks like the input or the output by its name: choose them"]
        try:
            found = draft([self.log])
        except BadInput:  # what is wrong is said of the choice
            return guessed.sections, guessed.unsure
        return found.sections, list(found.unsure)

    def choose(self, sections: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """Load the log with this rig file: a preview, what the checks before any fit find, and the rig file's text."""
        table = open_tables(self.log)[0]
        checked = {title: Section(_checked(title, keys)) for title, keys in sections.items()}
        text = write_sections(checked, self.name, table.names[:200])
        rig = self.log.parent / "rig.toml"
        rig.write_text(text, encoding="utf-8")
        self.recordings = []
        try:
            _check_chosen(checked)
            loaded, _ = load([self.log], rig)
        except BadInput as error:
            return {"text": text, "problem": self._said(str(error)), "panels": self._raw(table, checked)}
        self.recordings = [replace(r, name=r.name.replace(self.log.name, self.name)) for r in loaded]
        findings = [f for r in self.recordings for f in r.preflight]
        blocks = [f.says for f in findings if f.severity is Severity.BLOCKS]
        notes = [f.says for f in findings if f.severity is not Severity.BLOCKS]
        return {
            "text": text,
            "says": f"{len(loaded)} recordings; the first: {loaded[0]!r}" if len(loaded) > 1 else repr(loaded[0]),
            "problem": self._said("; ".join(blocks)),
            "notes": [capital(self._said(n)) for n in notes],
            "faults": [line for r in self.recordings for line in summarise(r.faults)],
            "panels": tell_recordings(self.recordings),
        }

    def _said(self, sentence: str) -> str:
        """A sentence of the library with the user's name for the log in it, and none of our folders."""
        folder = str(self.log.parent)
        sentence = sentence.replace(str(self.log), self.name).replace(f"{folder}/rig.toml", "the rig file")
        return sentence.replace(f"{folder}/", "")

    def _raw(self, table: Table, sections: Mapping[str, Section]) -> dict[str, Any] | None:
        """The chosen columns as they stand in the file, or all that hold numbers while not all are chosen."""
        found = numeric_columns(table)
        names = [sections[key].keys.get("column") for key in ("input", "output") if key in sections]
        chosen = {str(name): found[str(name)] for name in names if str(name) in found}
        shown = chosen if len(chosen) == 2 else found
        return tell_columns(shown) if shown else None

    def search(self, _: None) -> dict[str, Any]:
        """The main job, as `twin run` does it."""
        from twin import pipeline
        from twin.diagnosis import events
        from twin.web.watching import Watch

        watch = Watch(self.recordings, self.send)
        with events.observing(watch.observe):
            story = pipeline.run(self.recordings, self.log.parent / RESULTS, force=True, progress=watch.progress)
        return self._done(story)

    def finish(self, models: tuple[str, str]) -> dict[str, Any]:
        """What a search that was stopped has come to: its first model and the best one so far, as TOML."""
        from twin import pipeline
        from twin.diagnosis.unfinished import unfinished
        from twin.estimation import estimate
        from twin.model import fitted_model
        from twin.web.watching import Watch

        watch = Watch(self.recordings, self.send)
        estimate.compile_kernel(watch.progress)
        watch.progress("comparing the models with the recording", 0.3)
        before, after = (estimate.with_largest_command(fitted_model.loads(m), self.recordings) for m in models)
        diagnosis = unfinished(self.recordings, before, after)
        return self._done(pipeline.finish(self.recordings, diagnosis, self.log.parent / RESULTS, watch.progress))

    def _done(self, story: Any) -> dict[str, Any]:
        from twin.web import trying

        self.story = story
        return {"failures": list(story.failures.values()), "sliders": trying.sliders(story.diagnosis)}

    def simulate(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The free run of the last model with some parameters changed."""
        from twin.web import trying

        return trying.free_run(self.story.diagnosis, values)

    def export(self, name: str) -> dict[str, Any]:
        """An FMU of the last model, or of its controller, in the folder of results; `name` is one of `EXPORTS`."""
        from twin.control.api import export_controller
        from twin.fmi.api import export_fmu

        out = self.log.parent / RESULTS / name
        if name == "controller.fmu":
            if self.story.controller is None:
                raise BadInput("there is no controller of this model: the report says why")
            export_controller(self.story.controller, out, force=True)
        else:
            export_fmu(self.story.diagnosis.after, out, "native", EXPORTS[name], force=True)
        return {"file": name}


def _check_chosen(sections: Mapping[str, Section]) -> None:
    """Raises BadInput where the user has yet to choose."""
    for key in ("input", "output"):
        keys = sections[key].keys if key in sections else {}
        if "column" not in keys or not keys.keys() & {"unit", "full_scale"}:
            raise BadInput(f"choose the column and the unit of the {key}")


def _checked(title: str, keys: Mapping[str, Any]) -> dict[str, str | float]:
    """The keys of one table of the rig file. Raises BadInput for what the page does not set."""
    if title not in TITLES or not isinstance(keys, Mapping):
        raise BadInput(f"[{title[:40]}] is no table that this page sets: write the rig file by hand")
    kept: dict[str, str | float] = {}
    for key, value in keys.items():
        if key in ELSEWHERE:
            raise BadInput(f"[{title}] {key}: a log in several files is for twin run; drop one file that holds all")
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if re.fullmatch("[a-z_]{1,40}", key) is None or not (number or isinstance(value, str)):
            raise BadInput(f"[{title}] {key[:40]!r} = {str(value)[:40]!r}: give a name with a number or a text")
        kept[key] = value
    return kept


def main(connection: Connection, log: Path, name: str) -> None:
    """Answer what comes through the pipe until its other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server ends this process
    work = Work(log, name, lambda event: connection.send(("event", event)))
    actions: dict[str, Callable[[Any], dict[str, Any]]] = {
        "look": work.look, "choose": work.choose, "search": work.search, "finish": work.finish,
        "simulate": work.simulate, "export": work.export,
    }  # fmt: skip
    while True:
        try:
            action, argument = connection.recv()
        except EOFError:
            return
        try:
            answer: tuple[str, Any] = ("answer", actions[action](argument))
        except BadInput as error:
            answer = ("refused", work._said(str(error)))
        except StageFailed as failed:
            answer = ("refused", " ".join(failed.failures.values()))
        except MemoryError:
            answer = ("refused", "the recording does not fit into memory: cut it into smaller ones")
        except Exception as error:
            said = work._said(" ".join(str(error).split()))
            answer = ("refused", f"an internal error ended it ({type(error).__name__}: {said})")
        connection.send(answer)
