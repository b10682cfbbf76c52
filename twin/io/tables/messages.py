"""Logs of messages on topics (MCAP, ROS 2 bags): how their fields become signals."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.errors import BadInput
from twin.io.tables.cdr import STAMP
from twin.io.tables.table import Signal, Table, from_signals, unique_names

#: The messages of some topics: topic, stamp in ns, and the named numbers.
Messages = Iterable[tuple[str, int, Sequence[tuple[str, float]]]]

#: How far the stamp that a message carries may lie from the time of its logging, s; else its clock is another.
_SAME_CLOCK = 60.0


@dataclass(frozen=True)
class _Field:
    topic: str
    name: str

    @property
    def full(self) -> str:
        return f"{self.topic}/{self.name}"

    @property
    def short(self) -> str:
        """`std_msgs` call their only field `data`, which says nothing: there the topic is the name."""
        return self.topic.strip("/").rsplit("/", 1)[-1] if self.name == "data" else self.name


def table_of_messages(
    path: Path, first: Messages, of_topic: Callable[[str], Messages], says_why_not: Mapping[str, str]
) -> Table:
    """A table of the fields of all messages.

    Parameters
    ----------
    path
        The file, for messages.
    first
        One message of each topic, or some: they say which fields there are.
    of_topic
        All messages of one topic, read when one of its fields is asked for.
    says_why_not
        Topics that cannot be read, and why.

    Raises
    ------
    BadInput
        Where there is no number in any message; the topics that could not be read are listed.
    """
    fields = list(dict.fromkeys(_Field(topic, name) for topic, _, found in first for name, _ in found))
    if not fields and says_why_not:
        topics = "; ".join(f"{topic}: {why}" for topic, why in list(says_why_not.items())[:5])
        raise BadInput(f"{path}: none of its topics can be read ({topics}); export the topics as CSV")
    names = unique_names([(f.full, f.short) for f in fields])
    places = dict(zip(names, fields, strict=True))
    starts = [stamp for _, stamp, _ in first]
    origin = min(starts, default=0)
    read: dict[str, dict[str, Signal]] = {}

    def signal(name: str) -> Signal:
        field = places[name]
        if field.topic not in read:
            read[field.topic] = _signals(of_topic(field.topic), origin)
        empty = np.empty(0)
        return read[field.topic].get(field.name, (empty, empty))

    return from_signals(str(path), names, signal)


def _signals(messages: Messages, origin: int) -> dict[str, Signal]:
    """The signals of one topic; stamps in s from the origin, those that the messages carry where they carry any."""
    logged: dict[str, list[int]] = {}
    carried: dict[str, list[float]] = {}
    values: dict[str, list[float]] = {}
    for _, stamp, found in messages:
        named = dict(found)
        for name, value in named.items():
            logged.setdefault(name, []).append(stamp)
            carried.setdefault(name, []).append(named.get(STAMP, np.nan))
            values.setdefault(name, []).append(value)
    signals = {}
    for name, numbers in values.items():
        # subtracted as integers: a double cannot hold nanoseconds since 1970
        stamps = 1e-9 * (np.array(logged[name], dtype=np.int64) - origin).astype(np.float64)
        own = np.array(carried[name]) - 1e-9 * origin
        if np.all(np.abs(own - stamps) < _SAME_CLOCK) and np.all(np.diff(own) > 0):
            stamps = own
        signals[name] = (stamps, np.array(numbers))
    return signals
