"""CAN topics of ROS bags (extra `rosbag`): ROS 1 `.bag` files, ROS 2 bags (a folder, or one `.mcap` or `.db3` file).

Read: `can_msgs/Frame` (ros_canopen, ros2_socketcan, by-wire drivers) and `ros2_socketcan_msgs/FdFrame`, on topics
of any name. Written: a topic /NAME/frames (and /NAME/fd_frames) for each channel. The message definitions are
those of the public packages. The stamp is the header's; the bag's own where a driver left that empty.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import apsw
import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag1 import ReaderError as Reader1Error
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import ReaderError as Reader2Error
from rosbags.rosbag2 import Writer as Writer2
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import (
    BRS,
    ERROR,
    ESI,
    EXTENDED_BIT,
    FD,
    ID_MASK,
    RTR,
    SENT,
    Format,
    Lost,
    Row,
    Survey,
    change,
    leave_out,
    unreadable,
)

CLASSIC_TYPE, FD_TYPE = "can_msgs/msg/Frame", "ros2_socketcan_msgs/msg/FdFrame"
DEFINITIONS = {
    CLASSIC_TYPE: "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\n"
    "uint8[8] data\n",
    FD_TYPE: "std_msgs/Header header\nuint32 id\nbool is_extended\nbool is_error\nuint8 len\nuint8[<=64] data\n",
}
ROS2_VERSION = 9
_ID_OF_NAME = re.compile(r"\w+", re.ASCII)
_FAULTS = (  # what rosbags raises over broken files; it asserts what a record must hold
    AnyReaderError,
    Reader1Error,
    Reader2Error,
    SerdeError,
    apsw.Error,
    AssertionError,
    struct.error,
    LookupError,
    RuntimeError,
    ValueError,
    EOFError,
    OSError,
)


def read(path: Path) -> Iterator[Row]:
    """CAN frames of all topics that have them, in the order of the bag."""
    try:
        with AnyReader([path], default_typestore=_types(ros1=path.suffix == ".bag")) as bag:
            chosen = [connection for connection in bag.connections if connection.msgtype in DEFINITIONS]
            if not chosen:
                raise _no_topic(path, sorted({connection.msgtype for connection in bag.connections}))
            names = _channels([connection.topic for connection in chosen])
            for connection, time_ns, raw in bag.messages(connections=chosen):
                yield _row(bag.deserialize(raw, connection.msgtype), names[connection.topic], time_ns)
    except _FAULTS as error:
        raise unreadable(path, "a ROS bag", error) from error


def _no_topic(path: Path, kinds: list[str]) -> InputError:
    return InputError(
        "no CAN topic in it",
        code="no_can_topic",
        file=str(path),
        hint=f"looked for {' and '.join(DEFINITIONS)}; it has {', '.join(kinds) or 'nothing'}",
    )


def _types(ros1: bool) -> Typestore:
    """The message types of ROS and the two CAN types."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        types: Typesdict = get_types_from_msg(text, name)
        store.register({name: types[name]})
    return store


def _channels(topics: Sequence[str]) -> dict[str, str]:
    """Topic -> channel: the part that names a CAN link, else the whole topic with other signs made '_'."""
    names = {}
    for topic in topics:
        parts = [part for part in topic.split("/") if part]
        link = next((part for part in parts if re.fullmatch(r"v?can\d+", part)), "")
        ours = parts[0] if len(parts) == 2 and parts[1] in ("frames", "fd_frames") else ""
        names[topic] = link or ours or "_".join(parts)
    return names


def _row(message: Any, channel: str, bag_ns: int) -> Row:
    stamp = message.header.stamp
    nanoseconds = getattr(stamp, "nanosec", 0) + stamp.sec * 10**9
    time_ns = nanoseconds or bag_ns
    fd = hasattr(message, "len")
    length = message.len if fd else message.dlc
    flags = FD if fd else RTR if message.is_rtr else 0
    can_id = int(message.id) & ID_MASK
    if message.is_error:
        flags |= ERROR
    elif message.is_extended:
        can_id |= EXTENDED_BIT
    data = b"" if flags & RTR else bytes(bytearray(message.data[:length]))
    return Row(
        time_ns // 10**9 + time_ns % 10**9 / 1e9, channel, can_id, data, flags, int(length) if flags & RTR else 0
    )


def write(path: Path, rows: Iterable[Row], seen: Survey) -> None:
    """Write rows that `hold` has given: ROS 1 to `.bag`, else a ROS 2 folder."""
    ros1 = path.suffix == ".bag"
    store = _types(ros1)
    stamped = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    writer: Any = Writer1(path) if ros1 else Writer2(path, version=ROS2_VERSION)
    with writer:
        topics: dict[tuple[str, str], Any] = {}
        for number, row in enumerate(rows):
            kind = FD_TYPE if row.flags & FD else CLASSIC_TYPE
            if (row.channel, kind) not in topics:
                topic = f"/{row.channel}/{'fd_frames' if row.flags & FD else 'frames'}"
                topics[row.channel, kind] = writer.add_connection(topic, kind, typestore=store)
            time_ns = to_ns(row.time_s)
            message = _message(store.types[kind], row, _header(stamped, time_ns, number, ros1))
            raw = store.serialize_ros1(message, kind) if ros1 else store.serialize_cdr(message, kind)
            writer.write(topics[row.channel, kind], time_ns, raw)


def to_ns(time_s: float) -> int:
    """Whole nanoseconds; the seconds apart, for their product with 1e9 is more than a double holds."""
    seconds = math.floor(time_s)
    return seconds * 10**9 + round((time_s - seconds) * 1e9)


def _header(stamped: tuple[Any, Any], time_ns: int, number: int, ros1: bool) -> Any:
    time_type, header_type = stamped
    stamp = time_type(sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return header_type(seq=number, stamp=stamp, frame_id="") if ros1 else header_type(stamp=stamp, frame_id="")


def _message(kind: Any, row: Row, header: Any) -> Any:
    common = {
        "header": header,
        "id": row.can_id & ID_MASK,
        "is_extended": bool(row.can_id & EXTENDED_BIT),
        "is_error": bool(row.flags & ERROR),
    }
    if row.flags & FD:
        return kind(**common, len=len(row.data), data=np.frombuffer(row.data, dtype=np.uint8))
    dlc = row.dlc if row.flags & RTR else len(row.data)
    data = np.frombuffer(row.data.ljust(8, b"\0"), dtype=np.uint8)
    return kind(**common, is_rtr=bool(row.flags & RTR), dlc=dlc, data=data)


def hold(rows: Iterable[Row], seen: Survey, lost: Lost) -> Iterable[Row]:
    """ROS 2: directions and the bits BRS and ESI are lost. Stamps below 0 cannot be."""
    later = leave_out(rows, lambda row: row.time_s < 0.0, "a stamp below 0 is left out: ROS has none", lost)
    plain = change(later, lambda row: _without(row, SENT), "the direction (sent) is not kept in a ROS bag", lost)
    bare = change(
        plain, lambda row: _without(row, BRS | ESI), "the CAN FD bits BRS and ESI are not kept in a ROS bag", lost
    )
    return change(bare, _named, "the channel's name is changed to one that a topic may have", lost)


def hold_ros1(rows: Iterable[Row], seen: Survey, lost: Lost) -> Iterable[Row]:
    """As `hold`; CAN FD frames have no message in ROS 1 and are left out."""
    text = "a CAN FD frame is left out: ROS 1 has no message for it"
    return hold(leave_out(rows, lambda row: bool(row.flags & FD), text, lost), seen, lost)


def _without(row: Row, bits: int) -> Row:
    return row._replace(flags=row.flags & ~bits) if row.flags & bits else row


def _named(row: Row) -> Row:
    name = row.channel if _ID_OF_NAME.fullmatch(row.channel) else re.sub(r"\W+", "_", row.channel, flags=re.ASCII)
    name = name if not name[:1].isdigit() else f"can_{name}"
    return row if name == row.channel else row._replace(channel=name)


FORMAT = Format("ros2", read, write, hold)
ROS1 = Format("ros1", read, write, hold_ros1)
