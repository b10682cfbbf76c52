"""TOML as the model and the controller file use it: written as text, read with one line on what is wrong."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from twin.errors import BadInput

#: So many digits are more than an integer may have.
_TOO_LONG = re.compile(r"\d{4300}")


def number(value: float) -> str:
    """A float that reads back as the same bits."""
    return repr(float(value))


def quoted(value: str) -> str:
    """A basic string, quoted and escaped."""
    escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\t", "\\t")
    return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'


def texts(values: tuple[str, ...]) -> str:
    """A list of strings."""
    return f"[{', '.join(map(quoted, values))}]"


def pairs(table: Mapping[str, float]) -> list[str]:
    """Lines of a table of numbers."""
    return [f"{quoted(k)} = {number(v)}" if not k.isidentifier() else f"{k} = {number(v)}" for k, v in table.items()]


def load(path: Path, kind: str, usual: str, maker: str) -> str:
    """The text of a file of a kind ("model"), usually named `usual`, made by the command `maker`. Raises BadInput."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such {kind} file: check the name, or make one with {maker}") from None
    except IsADirectoryError:
        raise BadInput(f"{path} is a folder, not a {kind} file: name the {usual} in it") from None
    except UnicodeDecodeError:
        raise BadInput(f"{path} is not UTF-8 text, so not a {kind} file: give a {usual}") from None
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): check its permissions") from None


def parse_toml(content: str) -> dict[str, Any]:
    """A TOML document.

    Raises
    ------
    ValueError
        In one line what is wrong and where. This includes two errors that the parser of the standard library does not
        place: integers of thousands of digits and tables nested too deep.
    """
    try:
        return tomllib.loads(content)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(" ".join(str(error).split())) from None
    except ValueError:
        line = next((n for n, text in enumerate(content.splitlines(), 1) if _TOO_LONG.search(text)), 0)
        raise ValueError(f"an integer in it has too many digits (at line {line})") from None
    except RecursionError:
        raise ValueError("its tables are nested too deep") from None


def format_of(content: str) -> str:
    """What a text says of its format; empty where it says nothing or is not TOML."""
    try:
        return str(parse_toml(content).get("format", ""))
    except ValueError:
        return ""


def check_keys(where: str, table: Mapping[str, Any], allowed: Iterable[str]) -> None:
    """Raises BadInput for a key that nothing reads: it would be left out in silence."""
    known = list(allowed)
    for key in table:
        if key not in known:
            near = get_close_matches(key, known, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"known keys: {', '.join(known)}"
            raise BadInput(f"{where}: unknown key {key!r}; {hint}")


def parse(content: str, where: str, wanted: str, advice: str, keys: Iterable[str]) -> dict[str, Any]:
    """The document, whose `format` must be the wanted one, and whose other keys are among these. Raises BadInput, for
    another format with the advice.
    """
    try:
        document = parse_toml(content)
    except ValueError as error:
        raise BadInput(f"{where}: {error}; it is not valid TOML: mend that line") from None
    if document.get("format") != wanted:
        raise BadInput(f"{where}: format is {document.get('format')!r}, not {wanted!r}: {advice}")
    check_keys(where, document, ("format", *keys))
    return document


def section(where: str, document: Mapping[str, Any], key: str, allowed: Iterable[str] = ()) -> Mapping[str, Any]:
    """A table of the document, empty where it is absent; its keys are among those allowed, if any are said. Raises
    BadInput.
    """
    found = document.get(key, {})
    if not isinstance(found, dict):
        raise BadInput(f"{where}: {key} is {found!r}, which is not a table: write it as [{key}]")
    if allowed:
        check_keys(f"{where}: [{key}]", found, allowed)
    return found


def real(where: str, value: Any) -> float:
    """A number, which may be infinite or NaN. Raises BadInput."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadInput(f"{where} is {value!r}, which is not a number: give one")
    try:
        return float(value)
    except OverflowError:
        raise BadInput(f"{where} is too large for a number: give another") from None


def finite(where: str, value: Any) -> float:
    """A finite number. Raises BadInput."""
    found = real(where, value)
    if not math.isfinite(found):
        raise BadInput(f"{where} is {value!r}, which is not a finite number: give one")
    return found


def size(where: str, value: Any) -> float:
    """A finite number that is not negative. Raises BadInput."""
    found = finite(where, value)
    if found < 0.0:
        raise BadInput(f"{where} is {found:g}: give 0 or more")
    return found
