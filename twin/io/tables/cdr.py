"""ROS 2 messages: how the bytes become named numbers. rosbags decodes them; the flattening is ours.

`std_msgs/Float64` on `/duty` is the column `duty`; a field of another message is called by its name, `twist.linear.x`.
The entries of an array that stands beside `name`, as in `sensor_msgs/JointState`, are called by it: `position[elbow]`;
where there is one entry only, `position`.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import BadInput
from twin.io.tables.table import missing_package

#: What a message of a topic holds: name and number.
Decoder = Callable[[bytes], list[tuple[str, float]]]

_LONGEST = 64  # entries of an array; an image or a scan is no signal of an axis
STAMP = "header.stamp"


def make_decoder(path: Path, kind: str, definition: str, topic: str) -> Decoder:
    """What decodes the messages of one topic.

    Parameters
    ----------
    path, topic
        For messages.
    kind
        The type, `sensor_msgs/msg/JointState`.
    definition
        The text of its definition as the file carries it; empty for a type of ROS 2 itself.

    Raises
    ------
    BadInput
        Where rosbags is not installed. From the decoder: what the library makes of a damaged message.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise missing_package(path, "rosbags") from None
    kind = kind if kind.count("/") > 1 else kind.replace("/", "/msg/")
    store = get_typestore(Stores.LATEST)
    if kind not in store.types and definition:
        store = get_typestore(Stores.EMPTY)
        blocks = definition.split("=" * 80)
        types = get_types_from_msg(blocks[0], kind)
        for block in blocks[1:]:
            head, _, body = block.strip().partition("\n")
            types |= get_types_from_msg(
                body, head.removeprefix("MSG:").strip().replace("/msg/", "/").replace("/", "/msg/")
            )
        standard = get_typestore(Stores.LATEST).fielddefs
        for name in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration", "std_msgs/msg/Header"):
            types.setdefault(name, standard[name])
        store.register(types)
    if kind not in store.types:
        raise BadInput(f"{path}: topic {topic}: the type {kind} is not defined in the file; export the topic as CSV")

    def decode(raw: bytes) -> list[tuple[str, float]]:
        return list(_flatten(store.deserialize_cdr(raw, kind), ""))

    return decode


def _flatten(message: Any, prefix: str) -> Iterator[tuple[str, float]]:
    labels = getattr(message, "name", None)
    for name, value in vars(message).items():
        full = f"{prefix}.{name}" if prefix else name
        if name == "__msgtype__" or isinstance(value, str | bytes):
            continue
        if isinstance(value, bool | int | float | np.number | np.bool_):
            yield full, float(value)
        elif isinstance(value, np.ndarray | list | tuple):
            yield from _entries(full, value, labels)
        elif {"sec", "nanosec"} <= vars(value).keys():
            yield full, value.sec + 1e-9 * value.nanosec
        else:
            yield from _flatten(value, full)


def _entries(name: str, values: Any, labels: Any) -> Iterator[tuple[str, float]]:
    if not 0 < len(values) <= _LONGEST:
        return
    named = isinstance(labels, list) and len(labels) == len(values)
    for k, value in enumerate(values):
        full = name if len(values) == 1 else f"{name}[{labels[k] if named else k}]"
        if isinstance(value, bool | int | float | np.number | np.bool_):
            yield full, float(value)
        elif not isinstance(value, str | bytes):
            yield from _flatten(value, full)
