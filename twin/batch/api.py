"""What `import twin` offers for many axes at once."""

from __future__ import annotations

import csv
import io
import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from twin.batch.axis_run import FAILED, AxisResult, Task, run_axis, stored_result
from twin.batch.execution import WorkerDied, run_local, run_on_cluster
from twin.batch.overview import Fleet, columns, overview, to_json
from twin.batch.page import fleet_page
from twin.display.numbers import time_left
from twin.errors import BadInput
from twin.io.files import json_text, put
from twin.io.manifest import read_fleet

Progress = Callable[[str, float], None]


def _processes() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _csv(fleet: Fleet) -> str:
    """The table of the fleet; what an axis does not have is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    table = columns(fleet)
    writer.writerow(table)
    for row in zip(*table.values(), strict=True):
        writer.writerow("" if isinstance(v, float) and math.isnan(v) else v for v in row)
    return out.getvalue()


def _parquet(fleet: Fleet) -> bytes | None:
    """The same table as Parquet; None without pyarrow."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return None
    out = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(columns(fleet)), out)
    return out.getvalue()


def write_overview(fleet: Fleet, out: Path) -> list[str]:
    """fleet.html, fleet.json, fleet.csv and, where pyarrow is installed, fleet.parquet; their names.

    They follow from the axes' folders alone, so that they are written anew each time.
    """
    written: dict[str, str | bytes | None] = {
        "fleet.html": fleet_page(fleet), "fleet.json": json_text(to_json(fleet)), "fleet.csv": _csv(fleet),
        "fleet.parquet": _parquet(fleet),
    }  # fmt: skip
    for name, content in written.items():
        if content is not None:
            put(out / name, content)
    return [name for name, content in written.items() if content is not None]


def fleet(
    listing: str | Path, out: str | Path, scheduler: str | None = None, force: bool = False,
    progress: Progress | None = None,
) -> Fleet:  # fmt: skip
    """Do the whole job on many axes, and compare them.

    Parameters
    ----------
    listing
        A CSV with the columns ``axis`` and ``file`` (relative to it). Optional are ``rig`` and the columns of a
        manifest. Rows of one axis are recordings of it.
    out
        The folder. It gets a folder for each axis, as `run` leaves it. Beside them are ``fleet.html``, ``fleet.json``,
        ``fleet.csv`` and, with pyarrow, ``fleet.parquet``. An axis whose folder holds the result of the same files is
        not run again.
    scheduler
        Address of a Dask scheduler; its workers read the recordings and write the results, so that both must lie
        where they see them. By default, processes of this machine, one for each core.
    force
        Overwrite the folders of axes whose files have changed.
    progress
        Is called with what is being done and the share of the work that is done, 0 to 1.

    Returns
    -------
    Fleet
        ``.results`` by axis, ``.populations`` by parameter, ``.outliers``, ``.missing``, ``.failed``.

    Raises
    ------
    BadInput
        The list cannot be used, the folder cannot be written, or the scheduler does not answer. An axis that fails
        raises nothing: its result says why.
    """
    axes, folder = read_fleet(Path(listing).absolute()), Path(out).absolute()
    tell = progress or (lambda sentence, share: None)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInput(f"{out} cannot be made ({error.strerror}): choose another folder as `out`") from None
    tasks = [Task(axis, folder, force) for axis in axes]
    results = {t.axis.name: r for t in tasks if (r := stored_result(t)) is not None}
    left = [t for t in tasks if t.axis.name not in results]
    tell(f"{len(results)} of {len(tasks)} axes", len(results) / len(tasks))
    began = time.perf_counter()
    for done, (i, outcome) in enumerate(_outcomes(left, scheduler), start=1):
        name = left[i].axis.name
        results[name] = outcome if isinstance(outcome, AxisResult) else _ended(name, outcome)
        rest = time_left(time.perf_counter() - began, done, len(left))
        tell(f"{len(results)} of {len(tasks)} axes{rest}", len(results) / len(tasks))
    found = overview([results[axis.name] for axis in axes])
    write_overview(found, folder)
    return found


def _outcomes(tasks: Sequence[Task], scheduler: str | None) -> Iterator[tuple[int, AxisResult | Exception]]:
    """What becomes of each task, as they end."""
    if not tasks:
        return iter(())
    if scheduler is None:
        return run_local(run_axis, tasks, _processes())
    return run_on_cluster(run_axis, tasks, scheduler)


def _ended(axis: str, error: Exception) -> AxisResult:
    """The result of an axis whose worker did not come back."""
    said = " ".join(str(error).split())
    kind = "" if isinstance(error, WorkerDied) else f"{type(error).__name__}: "
    return AxisResult(axis, FAILED, f"{kind}{said}.")
