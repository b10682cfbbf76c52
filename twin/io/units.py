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
