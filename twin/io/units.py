"""The units that a rig file may name, and the unit that each is converted to.

A table maps the unit as the user writes it to the unit that is kept and the factor between them. A count's factor
still has to be divided by the counts per revolution.
"""

import math
from collections.abc import Mapping

Units = Mapping[str, tuple[str, float]]

TIME_UNITS: Units = {"s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9)}
INPUT_UNITS: Units = {
    "%": ("%", 1.0),
    "1": ("%", 100.0),
    "V": ("V", 1.0),
    "A": ("A", 1.0),
    "N*m": ("N*m", 1.0),
    "N": ("N", 1.0),
}
POSITION_UNITS: Units = {
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180),
    "rev": ("rad", 2 * math.pi),
    "count": ("rad", 2 * math.pi),
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
}
SPEED_UNITS: Units = {
    **{f"{unit}/s": (f"{kept}/s", factor) for unit, (kept, factor) in POSITION_UNITS.items()},
    "rpm": ("rad/s", 2 * math.pi / 60),
}
OUTPUT_UNITS: Units = {**POSITION_UNITS, **SPEED_UNITS}
OPTIONAL_UNITS: Mapping[str, Units] = {
    "motor_position": POSITION_UNITS,
    "speed": SPEED_UNITS,
    "current": {"A": ("A", 1.0), "mA": ("A", 1e-3)},
    "supply": {"V": ("V", 1.0), "mV": ("V", 1e-3)},
    "temperature": {"degC": ("K", 1.0), "K": ("K", 1.0)},
}
ZERO_CELSIUS = 273.15  # K

#: Units of what is known of a recording, and how many of the unit that we keep each is.
KNOWN_UNITS: Mapping[str, float] = {
    "kg": 1.0,
    "g": 1e-3,
    "m": 1.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "kg*m": 1.0,
    "kg*m^2": 1.0,
    "kg m^2": 1.0,
    "kg m2": 1.0,
    "g*cm^2": 1e-7,
    "g cm^2": 1e-7,
    "kg*mm^2": 1e-6,
    "V": 1.0,
    "mV": 1e-3,
    "s": 1.0,
    "ms": 1e-3,
    "min": 60.0,
}

#: Other ways to write a unit, in small letters.
SPELLINGS = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "milliseconds": "ms",
    "µs": "us",
    "μs": "us",
    "usec": "us",
    "pct": "%",
    "percent": "%",
    "v": "V",
    "volt": "V",
    "volts": "V",
    "a": "A",
    "amp": "A",
    "amps": "A",
    "ma": "mA",
    "mv": "mV",
    "nm": "N*m",
    "n*m": "N*m",
    "n·m": "N*m",
    "n": "N",
    "counts": "count",
    "ticks": "count",
    "counts/s": "count/s",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "°/s": "deg/s",
    "dps": "deg/s",
    "degs": "deg/s",
    "deg_s": "deg/s",
    "rad_s": "rad/s",
    "rads": "rad/s",
    "radps": "rad/s",
    "radian": "rad",
    "radians": "rad",
    "1/min": "rpm",
    "u/min": "rpm",
    "min-1": "rpm",
    "m_s": "m/s",
    "mps": "m/s",
    "mm_s": "mm/s",
    "turn": "rev",
    "turns": "rev",
    "rotation": "rev",
    "rotations": "rev",
    "rps": "rev/s",
    "°c": "degC",
    "degc": "degC",
    "k": "K",
}
_KNOWN = {
    unit.lower(): unit
    for table in (TIME_UNITS, INPUT_UNITS, OUTPUT_UNITS, *OPTIONAL_UNITS.values())
    for unit in table
    if unit != "1"
}


def spelled_unit(text: str) -> str | None:
    """The unit that a text stands for, as the rig file writes it; "" for what is plainly none; None for no unit."""
    small = text.strip().strip("[]()").strip().lower()
    if small in ("", "-", "1", "n/a", "none", "bool"):
        return ""
    return SPELLINGS.get(small) or _KNOWN.get(small)
