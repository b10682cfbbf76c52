"""What `import twin` offers for reports."""

from __future__ import annotations

from pathlib import Path

from twin.diagnosis.result import Diagnosis
from twin.io.files import check_free, put
from twin.report.html import Story, html


def write_report(diagnosis: Diagnosis, out: str | Path, force: bool = False) -> Path:
    """Write a diagnosis as one self-contained HTML file.

    Parameters
    ----------
    diagnosis
        What `diagnose` found.
    out
        The file, whose name ends in ``.html``.
    force
        Overwrite what is there.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    BadInput
        The file cannot be written.
    """
    check_free(Path(out), force)
    put(Path(out), html(Story(diagnosis, diagnosis.recordings[0].rig)))
    return Path(out)
