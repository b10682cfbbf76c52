"""ROS 2 bags: a folder of MCAP or SQLite files, or one SQLite file (.db3)."""

import sqlite3
import textwrap
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from twin.errors import BadInput
from twin.io.tables.cdr import Decoder, make_decoder
from twin.io.tables.library import call_library
from twin.io.tables.mcap import open_mcaps
from twin.io.tables.messages import Messages, table_of_messages
from twin.io.tables.table import Table

_KIND = "a ROS 2 bag"


def is_rosbag(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag."""
    return (path / "metadata.yaml").is_file() or bool(_parts(path))


def _parts(path: Path) -> list[Path]:
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return [file for file in files if file.suffix in (".mcap", ".db3", ".zstd")]


def open_rosbag(path: Path) -> Table:
    """Open a ROS 2 bag.

    Raises
    ------
    BadInput
        Where a package is missing, the bag is empty, packed or damaged, or no message holds a number.
    """
    parts = _parts(path)
    if not parts:
        raise BadInput(f"{path}: the bag holds no .mcap or .db3 file; copy them beside metadata.yaml")
    if any(part.suffix == ".zstd" for part in parts):
        raise BadInput(f"{path}: the bag's files are packed; unpack them with zstd -d, or convert the bag")
    if parts[0].suffix == ".mcap":
        return open_mcaps(path, parts)
    return _open_sqlite(path, parts)


def _open_sqlite(path: Path, parts: list[Path]) -> Table:
    decoders: dict[str, Decoder] = {}
    refused: dict[str, str] = {}

    def messages(wanted: str | None) -> Iterator[tuple[str, int, list[tuple[str, float]]]]:
        """Decoded messages of a topic; where none is named one message of each."""
        for part in parts:
            with closing(sqlite3.connect(f"file:{part.resolve()}?mode=ro&immutable=1", uri=True)) as base:
                definitions = _definitions(base)
                for number, topic, kind in base.execute("select id, name, type from topics").fetchall():
                    if topic in refused or (wanted is not None and topic != wanted):
                        continue
                    limit = -1 if wanted is not None else 1
                    rows = base.execute(
                        "select timestamp, data from messages where topic_id = ? order by timestamp limit ?",
                        (number, limit),
                    )
                    try:
                        if topic not in decoders:
                            decoders[topic] = make_decoder(path, kind, definitions.get(kind, ""), topic)
                        for stamp, raw in rows:
                            yield topic, int(stamp), decoders[topic](raw)
                    except Exception as error:  # a message that does not follow its definition
                        if wanted is not None:
                            raise
                        refused[topic] = textwrap.shorten(str(error), 100, placeholder=" ...") or type(error).__name__

    def of_topic(topic: str) -> Messages:
        return call_library(path, _KIND, lambda: list(messages(topic)))

    return table_of_messages(path, call_library(path, _KIND, lambda: list(messages(None))), of_topic, refused)


def _definitions(base: sqlite3.Connection) -> dict[str, str]:
    """The definitions of message types, which bags carry from ROS 2 Iron on."""
    tables = {name for (name,) in base.execute("select name from sqlite_master where type = 'table'")}
    if "message_definitions" not in tables:
        return {}
    return {
        str(kind): str(text)
        for kind, text in base.execute("select topic_type, encoded_message_definition from message_definitions")
    }
