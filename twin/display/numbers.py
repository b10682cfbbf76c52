"""Numbers with as many digits as they deserve, their units, and lists of words."""

from __future__ import annotations

import math
from collections.abc import Sequence

_NICE = {"N*m": "N·m", "kg*m^2": "kg·m²", "kg*m": "kg·m", "^2": "²", "^3": "³"}


def unit_text(unit: str) -> str:
    """A unit as it is printed; nothing for the unit one."""
    return "" if unit == "1" else pretty(unit)


def pretty(text: str) -> str:
    """A sentence with its units as they are printed."""
    for plain, nice in _NICE.items():
        text = text.replace(plain, nice)
    return text


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def number(value: float, digits: int = 3) -> str:
    """A number with so many digits that count, without an exponent where it reads well without."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if -4 <= size < 6:
        text = f"{value:.{max(digits - 1 - size, 0)}f}"
        return text.replace("-", "−")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa}·10{_raised(int(exponent))}".replace("-", "−")


def measure(value: float, std: float = math.nan, unit: str = "1") -> str:
    """Value, standard error to two digits, unit: 3.102 ± 0.021 rad/s²."""
    shown = unit_text(unit)
    tail = "" if not shown else ("\u202f%" if shown == "%" else f" {shown}")
    if not (math.isfinite(std) and std > 0.0 and math.isfinite(value)):
        return number(value, 4) + tail
    size = math.floor(math.log10(max(abs(value), std)))
    if -4 <= size < 6:
        return _both(value, std) + tail
    return f"({_both(value / 10.0**size, std / 10.0**size)})·10{_raised(size)}{tail}"


def _both(value: float, std: float) -> str:
    kept = min(max(1 - math.floor(math.log10(std)), 0), 9)
    return f"{value:.{kept}f} ± {std:.{kept}f}".replace("-", "−")


def _raised(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def percent(share: float) -> str:
    """A share of one as a percentage that claims no certainty it does not have."""
    if not math.isfinite(share):
        return "–"
    if share > 0.99:
        return "over 99\u202f%"
    if share < 0.01:
        return "under 1\u202f%"
    return f"{100.0 * share:.0f}\u202f%"


def time_left(seconds: float, done: float, total: float) -> str:
    """What the rest of so many like pieces of work takes, where `done` of them took `seconds`: ", about 4 min left".

    Nothing before the first is done, and after the last.
    """
    if not 0 < done < total:
        return ""
    left = seconds / done * (total - done)
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if left > 1.5 * length:
            return f", about {left / length:.0f} {unit} left"
    return f", about {max(left, 1.0):.0f} s left"


def listed(words: Sequence[str]) -> str:
    """a, b and c."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
