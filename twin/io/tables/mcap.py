"""MCAP: messages in JSON or in ROS 2's CDR, on topics that each have a clock of their own."""

import json
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from twin.errors import BadInput
from twin.io.tables.cdr import Decoder, make_decoder
from twin.io.tables.library import call_library
from twin.io.tables.messages import Messages, table_of_messages
from twin.io.tables.table import Table, missing_package

_KIND = "MCAP"


def open_mcap(path: Path) -> Table:
    """Open an MCAP file. Raises BadInput as `open_mcaps` does."""
    return open_mcaps(path, [path])


def open_mcaps(path: Path, parts: list[Path]) -> Table:
    """Open the parts of one recording in MCAP.

    Parameters
    ----------
    path
        What the user named, for messages.
    parts
        The files, in the order of time.

    Raises
    ------
    BadInput
        Where a package is missing, the file is damaged, or no message holds a number.
    """
    try:
        from mcap.reader import make_reader
    except ImportError:
        raise missing_package(path, "mcap") from None
    decoders: dict[str, Decoder] = {}
    refused: dict[str, str] = {}

    def messages(topics: list[str] | None) -> Iterator[tuple[str, int, list[tuple[str, float]]]]:
        """Decoded messages; of all topics one each where none is named."""
        seen: set[str] = set()
        for part in parts:
            with part.open("rb") as stream:
                reader = make_reader(stream)
                for schema, channel, message in reader.iter_messages(topics=topics):
                    topic = channel.topic
                    if topic in refused or (topics is None and topic in seen):
                        continue
                    try:
                        if topic not in decoders:
                            decoders[topic] = _decoder(path, schema, channel)
                        yield topic, message.log_time, decoders[topic](message.data)
                        seen.add(topic)
                    except Exception as error:  # a message that does not follow its definition
                        if topics is not None:
                            raise
                        refused[topic] = textwrap.shorten(str(error), 100, placeholder=" ...") or type(error).__name__

    def of_topic(topic: str) -> Messages:
        return call_library(path, _KIND, lambda: list(messages([topic])))

    return table_of_messages(path, call_library(path, _KIND, lambda: list(messages(None))), of_topic, refused)


def _decoder(path: Path, schema: Any, channel: Any) -> Decoder:
    encoding = channel.message_encoding
    if encoding == "json":
        return _decode_json
    if encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
        return make_decoder(path, schema.name, schema.data.decode("utf-8", "replace"), channel.topic)
    raise BadInput(f"its messages are {encoding}, of which we read json and ROS 2's cdr")


def _decode_json(raw: bytes) -> list[tuple[str, float]]:
    found: list[tuple[str, float]] = []

    def collect(value: Any, name: str, depth: int) -> None:
        if isinstance(value, dict) and depth < 10:
            for key, inner in value.items():
                collect(inner, f"{name}.{key}" if name else str(key), depth + 1)
        elif isinstance(value, int | float):
            try:
                found.append((name, float(value)))
            except OverflowError:
                found.append((name, float("nan")))

    collect(json.loads(raw), "", 0)
    return found
