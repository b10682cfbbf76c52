"""One log on the server: its private folder, and the process that works on it."""

from __future__ import annotations

import multiprocessing
import shutil
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.errors import BadInput
from twin.web import worker

#: Seconds after which reading a log, or a run of a model, is given up.
PATIENCE = 300.0


class Session:
    """A log that was dropped, from its upload until the next one or the end of the server.

    Parameters
    ----------
    name : str
        What the user calls the log; nothing is opened by that name.
    ending : str
        Of the name, which says what format it is, such as ``.csv``.

    Attributes
    ----------
    state : str
        ``choosing``, ``searching``, ``finishing`` (the search was stopped) or ``done``.
    """

    def __init__(self, name: str, ending: str) -> None:
        self.name, self.state, self.problem = name, "choosing", ""
        self.folder = Path(tempfile.mkdtemp(prefix="twin-"))  # for its owner alone
        self.log = self.folder / f"recording{ending}"
        self.looked: dict[str, Any] = {}
        self.sections: Mapping[str, Any] = {}
        self.result: dict[str, Any] = {}
        self.events: list[dict[str, Any]] = []
        self.models: list[str] = []
        self._turn, self._change = threading.Lock(), threading.Lock()  # of the process; of the state
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=worker.main, args=(theirs, self.log, self.name), daemon=True)
        self._process.start()
        theirs.close()

    def close(self) -> None:
        """End the process and remove all that was kept."""
        self._process.kill()
        self._process.join()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _ask(self, action: str, argument: Any = None, patience: float | None = PATIENCE) -> dict[str, Any]:
        """What the process answers. Raises BadInput where it refuses, breaks down or takes longer than its time (s)."""
        with self._turn:
            if not self.folder.exists():
                raise BadInput("another recording was dropped meanwhile: load the page anew")
            if not self._process.is_alive():
                self._start()
                if self.sections:
                    self._exchange("choose", self.sections, PATIENCE)
            return self._exchange(action, argument, patience)

    def _exchange(self, action: str, argument: Any, patience: float | None) -> dict[str, Any]:
        try:
            self._pipe.send((action, argument))
            while self._pipe.poll(patience):
                kind, said = self._pipe.recv()
                if kind == "answer":
                    return dict(said)
                if kind == "refused":
                    raise BadInput(said)
                self._keep(said)
        except (EOFError, OSError):
            pass
        self._process.kill()
        self._process.join()
        raise BadInput(
            f"the work on {self.name} took too long or broke down: try once more, or drop a shorter recording"
        )

    def _keep(self, event: dict[str, Any]) -> None:
        if event["kind"] == "model":
            self.models.append(event.pop("model"))
        self.events.append(event)

    def look(self) -> dict[str, Any]:
        """The columns and a first draft of the rig file. Raises BadInput."""
        self.looked = self._ask("look")
        self.sections = {title: table["keys"] for title, table in self.looked["sections"].items()}
        return self.looked

    def choose(self, sections: Mapping[str, Any]) -> dict[str, Any]:
        """What comes of these columns and units. Raises BadInput."""
        self._check_free()
        chosen = self._ask("choose", sections)
        tables = {title: {"keys": keys, "remarks": {}} for title, keys in sections.items()}
        # What the user has set is no longer unsure.
        settled = [word for title, keys in sections.items() for word in self._set_now(title, keys)]
        chosen["unsure"] = [u for u in self.looked["unsure"] if not any(word in u for word in settled)]
        self.sections, self.state, self.result = sections, "choosing", {}
        self.looked = {**self.looked, "problem": "", **chosen, "sections": tables}
        return chosen

    def _set_now(self, title: str, keys: Mapping[str, Any]) -> list[str]:
        """What names, in a doubt, that which these keys of a section set anew."""
        before = self.sections.get(title, {})
        changed = [key for key, value in keys.items() if before.get(key) != value]
        return [*changed, f"'{keys.get('column')}'", f"the unit of {title}"] if changed else []

    def _check_free(self) -> None:
        if self.state in ("searching", "finishing"):
            raise BadInput(f"the search on {self.name} is running: stop it first")

    def search(self) -> None:
        """Begin the search, in the background. Raises BadInput where it runs already or the columns do not serve."""
        self._check_free()
        if self.looked.get("problem"):
            raise BadInput(self.looked["problem"])
        self.state, self.problem, self.events, self.models, self.result = "searching", "", [], [], {}
        threading.Thread(target=self._search, daemon=True).start()

    def _search(self) -> None:
        try:
            self.result = self._ask("search", patience=None)
            problem = ""
        except BadInput as error:
            problem = str(error)
        with self._change:
            if self.state == "searching":
                self.state, self.problem = "choosing" if problem else "done", problem
        if self.state == "finishing":
            self._finish()

    def stop(self) -> None:
        """End the search; what follows from its best model so far is made in the background. Raises BadInput."""
        with self._change:
            if self.state != "searching":
                raise BadInput("no search is running")
            self.state = "finishing" if self.models else "choosing"
            self.problem = "" if self.models else "the search was stopped before it had a model"
            self.events.append({"kind": "stage", "says": "stopped; going on with the best model so far", "share": 0.0})
            self._process.kill()

    def _finish(self) -> None:
        """In a process anew, which has nothing of the search but the models that were told."""
        self._process.join()
        try:
            self.result = self._ask("finish", (self.models[0], self.models[-1]), patience=None)
            self.state = "done"
        except BadInput as error:
            self.state, self.problem = "choosing", str(error)

    def simulate(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The free run of the result with some parameters changed. Raises BadInput."""
        self._check_done()
        return self._ask("simulate", values)

    def export(self, name: str) -> Path:
        """One of `worker.EXPORTS`, made at the first time. Raises BadInput."""
        self._check_done()
        out = self.folder / worker.RESULTS / name
        if not out.is_file():
            self._ask("export", name, patience=None)
        return out

    def _check_done(self) -> None:
        if self.state != "done":
            raise BadInput("there is no result yet: begin the search, or wait for its end")

    def files(self) -> dict[str, Path]:
        """What can be downloaded, by name."""
        results = self.folder / worker.RESULTS
        made = list(results.iterdir()) if self.state == "done" and results.is_dir() else []
        return {path.name: path for path in (self.folder / "rig.toml", *made) if path.is_file()}
