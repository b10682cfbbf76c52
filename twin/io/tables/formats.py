"""Which reader opens which file."""

from collections.abc import Callable
from pathlib import Path

from twin.errors import BadInput
from twin.io.tables.hdf5 import open_hdf5
from twin.io.tables.mat import open_mat
from twin.io.tables.mcap import open_mcap
from twin.io.tables.mdf4 import open_mdf
from twin.io.tables.parquet import open_parquet
from twin.io.tables.rosbag import is_rosbag, open_rosbag
from twin.io.tables.sysid import open_sysid
from twin.io.tables.table import Table
from twin.io.tables.text import open_text
from twin.io.tables.wpilog import open_wpilog

_ONE: dict[str, Callable[[Path], Table]] = {
    ".parquet": open_parquet,
    ".pq": open_parquet,
    ".mat": open_mat,
    ".h5": open_hdf5,
    ".hdf5": open_hdf5,
    ".mf4": open_mdf,
    ".mdf": open_mdf,
    ".mcap": open_mcap,
    ".db3": open_rosbag,
}
_SEVERAL: dict[str, Callable[[Path], list[Table]]] = {".json": open_sysid, ".wpilog": open_wpilog}


def open_tables(path: Path) -> list[Table]:
    """Open a file of any format we know, told apart by the ending of its name (that before `.gz`).

    Returns
    -------
    list of Table: one, or one a test where the format keeps several tests in a file.

    Raises
    ------
    BadInput
        Where there is no such file, or it cannot be read as that format.
    """
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: no such file; check the path")
    if path.is_dir():
        if not is_rosbag(path):
            raise BadInput(f"{path}: is a folder; give a recording, a manifest or a ROS 2 bag")
        return [open_rosbag(path)]
    suffixes = [suffix.lower() for suffix in path.suffixes]
    suffix = suffixes[-2] if suffixes[-1:] == [".gz"] and len(suffixes) > 1 else "".join(suffixes[-1:])
    if suffix in _SEVERAL:
        return _SEVERAL[suffix](path)
    return [_ONE.get(suffix, open_text)(path)]


def open_table(path: Path, test: str = "") -> Table:
    """Open a file that holds one recording, or one test of a file that holds several.

    Raises
    ------
    BadInput
        As `open_tables`, and where there is no such test or several to choose from.
    """
    tables = open_tables(path)
    if not test and len(tables) == 1:
        return tables[0]
    tests = ", ".join(table.test for table in tables if table.test) or "none"
    for table in tables:
        if table.test == test:
            return table
    said = f"no test '{test}'" if test else "holds several tests"
    raise BadInput(f"{path}: {said}; name one of: {tests}")
