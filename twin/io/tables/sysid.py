"""WPILib SysId's JSON: several tests in one file, each a recording of its own.

Rows hold time, volts, position and velocity; of a drivetrain those of its two sides, and the angle that the gyroscope
read. Whatever `units` says, positions are rotations, of which `unitsPerRotation` makes the unit: so does SysId itself.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import BadInput
from twin.io.tables.table import FloatArray, Table, read_bytes

_ONE_SIDE = ("time", "voltage", "position", "velocity")
_TWO_SIDES = (
    "time",
    "left_voltage",
    "right_voltage",
    "left_position",
    "right_position",
    "left_velocity",
    "right_velocity",
    "angle",
    "angular_rate",
)
#: What SysId calls its units: the unit of the table, and how many of that one is.
_UNITS = {
    "radians": ("rad", 1.0),
    "degrees": ("deg", 1.0),
    "rotations": ("rev", 1.0),
    "meters": ("m", 1.0),
    "feet": ("m", 0.3048),
    "inches": ("m", 0.0254),
}


def open_sysid(path: Path) -> list[Table]:
    """Open a file of SysId's, of a mechanism with one motor or of a drivetrain.

    Returns
    -------
    list of Table, one a test, in the order of the file.

    Raises
    ------
    BadInput
        Where the file is no JSON, no SysId file, or a row is no row of numbers.
    """
    try:
        document = json.loads(read_bytes(path).decode("utf-8-sig"))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        said = f"line {error.lineno}: {error.msg}" if isinstance(error, json.JSONDecodeError) else "not UTF-8 JSON"
        raise BadInput(f"{path}: is no JSON ({said}); give SysId's JSON, or export the recording as CSV") from None
    tests = {
        name: rows
        for name, rows in (document.items() if isinstance(document, dict) else ())
        if isinstance(rows, list) and rows and all(isinstance(row, list) for row in rows)
    }
    if not tests:
        raise BadInput(f"{path}: holds no tests of SysId's; give SysId's JSON, or export the recording as CSV")
    unit, factor = _unit(path, document)
    return [_table(path, name, rows, unit, factor) for name, rows in tests.items()]


def _unit(path: Path, document: Mapping[str, Any]) -> tuple[str, float]:
    """The unit of positions, and how many of it a rotation makes."""
    name = str(document.get("units", "Rotations"))
    if name.lower() not in _UNITS:
        raise BadInput(f"{path}: units = '{name}' is not known; use one of {', '.join(_UNITS)}")
    unit, factor = _UNITS[name.lower()]
    per = document.get("unitsPerRotation", 1.0)
    if isinstance(per, bool) or not isinstance(per, int | float) or not 0 < per < 1e9:
        raise BadInput(f"{path}: unitsPerRotation = {per!r} must be a number greater than 0")
    return unit, factor * per


def _table(path: Path, test: str, rows: Sequence[Any], unit: str, factor: float) -> Table:
    where = f"{path}: test '{test}'"
    width = len(rows[0])
    names = _ONE_SIDE if width < len(_TWO_SIDES) else _TWO_SIDES
    if width < len(names):
        raise BadInput(f"{where}: row 1 has {width} numbers; SysId writes {len(_ONE_SIDE)} or {len(_TWO_SIDES)}")
    numbers = np.empty((len(rows), len(names)))
    for k, row in enumerate(rows):
        if len(row) != width:
            raise BadInput(f"{where}: row {k + 1} has {len(row)} numbers and the first {width}; correct or delete it")
        for i, value in enumerate(row[: len(names)]):
            if isinstance(value, bool) or not isinstance(value, int | float | None):
                raise BadInput(f"{where}: row {k + 1}, {names[i]}: {value!r:.40} is no number; correct it")
            try:
                numbers[k, i] = np.nan if value is None else value
            except OverflowError:
                numbers[k, i] = np.nan
    units = {"time": "s", "angle": "rad", "angular_rate": "rad/s"}
    factors = {}
    for name in names:
        if name.endswith("voltage"):
            units[name] = "V"
        elif name.endswith(("position", "velocity")):
            units[name] = unit if name.endswith("position") else f"{unit}/s"
            factors[name] = factor
    columns = {name: numbers[:, i] * factors.get(name, 1.0) for i, name in enumerate(names)}

    def read(wanted: Sequence[str]) -> list[FloatArray]:
        return [columns[name] for name in wanted]

    def where_is(row: int) -> str:
        return f"row {row + 1}"

    return Table(f"{path}: {test}", names, read, where=where_is, units=units, test=test)
