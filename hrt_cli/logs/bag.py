"""ROS 1 and ROS 2 bags: the few topics that tell of a drive, as arrays.

Only the connections of `_KINDS` are read, so that pictures and point clouds stay where they are. Message layouts are
those that the bag brings along; where it brings none, those of the distributions, which are the same for these types.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import HrtError, InputError
from hrt_cli.logs.kinds import BAG, SQLITE, Kind, files_of

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.typesys.store import Typestore

Floats = NDArray[np.float64]

_COMMANDS = re.compile(r"cmd|command", re.IGNORECASE)
_SQLITE_HEADER = 100
_MOST_OFTEN_S = 0.02
"""Of wheels and IMU, which may send a thousand times a second, messages closer together than this are left out."""


@dataclass(frozen=True)
class Topic:
    """A topic that was read.

    Attributes
    ----------
    name : str
    frame : str
        Its first frame; empty where its messages have no header.
    recorded_s, stamp_s : float64 [n]
        Unix seconds of the recording, and of the message's header (NaN where it has none).
    values : float64 [n, k]
        What `FIX`, `ODOMETRY`, `IMU` or `COMMAND` say, in this order.
    """

    name: str
    frame: str
    recorded_s: Floats
    stamp_s: Floats
    values: Floats


@dataclass(frozen=True)
class Bag:
    """What a bag holds.

    Attributes
    ----------
    read : dict of str to list of Topic
        By `FIX`, `ODOMETRY`, `IMU` and `COMMAND`; topics without messages are left out.
    other_twists : list of str
        Topics of velocities that are not named as commands.
    lacking : list of str
        Topics with fewer messages than the index of the bag says, a clause each.
    """

    read: dict[str, list[Topic]]
    other_twists: list[str]
    lacking: list[str]


FIX, ODOMETRY, IMU, COMMAND = "fix", "odometry", "imu", "command"
_TWIST = "geometry_msgs/msg/Twist"
_KINDS = {
    "sensor_msgs/msg/NavSatFix": FIX,
    "nav_msgs/msg/Odometry": ODOMETRY,
    "sensor_msgs/msg/Imu": IMU,
    _TWIST: COMMAND,
    "geometry_msgs/msg/TwistStamped": COMMAND,
}


def read_bag(path: Path, kind: Kind) -> Bag:
    """Read the topics of a bag that tell of a drive.

    Raises
    ------
    InputError
        The bag is cut off, damaged, not indexed or of a kind that cannot be read, or rosbags is not installed.
    """
    with _opened(path, kind) as reader:
        wanted, other_twists = [], []
        for each in reader.connections:
            if _KINDS.get(each.msgtype) == COMMAND and not _COMMANDS.search(each.topic):
                other_twists.append(each.topic)
            elif each.msgtype in _KINDS and each.msgcount:
                wanted.append(each)
        counts: Counter[str] = Counter()
        rows = _rows(reader, wanted, kind, counts) if wanted else {}
    read: dict[str, list[Topic]] = {each: [] for each in (FIX, ODOMETRY, IMU, COMMAND)}
    for (name, msgtype), (frame, found) in sorted(rows.items()):
        table = np.array(found, np.float64)
        read[_KINDS[msgtype]].append(Topic(name, frame, table[:, 0], table[:, 1], table[:, 2:]))
    promised: Counter[str] = Counter()
    for each in wanted:
        promised[each.topic] += each.msgcount
    lacking = [f"{name} has {counts[name]} of {n} messages" for name, n in sorted(promised.items()) if counts[name] < n]
    return Bag(read, sorted(set(other_twists)), lacking)


def topics_of(path: Path, kind: Kind) -> list[dict[str, Any]]:
    """Return name, type and number of messages of every topic, as JSON values in the order of their names.

    Raises
    ------
    InputError
        See `read_bag`.
    """
    with _opened(path, kind) as reader:
        found = [
            {"topic": name, "type": topic.msgtype or "several", "messages": topic.msgcount}
            for name, topic in reader.topics.items()
        ]
    return sorted(found, key=lambda each: str(each["topic"]))


@contextmanager
def _opened(path: Path, kind: Kind) -> Iterator[Reader1 | Reader2]:
    """Open a bag; whatever goes wrong in reading it is one refusal."""
    _check_databases(path, kind)
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError as error:
        raise InputError(path, "needs rosbags: pip install 'hrt[ros]'") from error
    try:
        with Reader1(path) if kind == BAG else Reader2(path) as reader:
            yield reader
    except HrtError:
        raise
    except Exception as error:  # damage shows as anything: assertions, struct and zstd errors, missing keys
        what = " ".join(str(error).split()).rstrip(".")[:200] or type(error).__name__
        remedy = "`rosbag reindex`" if "indexed" in what else ""
        raise InputError(path, f"is not a bag that can be read: {what}", remedy) from error


def _check_databases(path: Path, kind: Kind) -> None:
    """Refuse SQLite files that are cut off or have their last messages in a journal: SQLite would leave them out."""
    for file in () if kind == BAG else files_of("", path).values():
        if kind != SQLITE and file.suffix != ".db3":
            continue
        if set("%?#") & set(str(file)):
            raise InputError(path, "cannot be opened: rosbags takes %, ? and # in a path for marks", "rename it")
        for side in ("-wal", "-journal"):
            journal = file.with_name(file.name + side)
            if journal.is_file() and journal.stat().st_size:
                remedy = f"`sqlite3 {file.name} 'pragma wal_checkpoint(truncate)'` in its folder closes it"
                raise InputError(path, f"was not closed: its last messages are in {journal.name}", remedy)
        with open(file, "rb") as data:
            header = data.read(_SQLITE_HEADER)
        if len(header) == _SQLITE_HEADER and header[24:28] == header[92:96]:
            # https://www.sqlite.org/fileformat.html: size of a page (1: 65536), number of pages.
            page, pages = int.from_bytes(header[16:18]), int.from_bytes(header[28:32])
            if file.stat().st_size < pages * (65_536 if page == 1 else page):
                raise InputError(path, f"is cut off: {file.name} is shorter than it says")


def _rows(
    reader: Reader1 | Reader2, wanted: Sequence[Connection], kind: Kind, counts: Counter[str]
) -> dict[tuple[str, str], tuple[str, list[tuple[float, ...]]]]:
    """Return the first frame and the rows of every topic: recording time, stamp, values. Count all messages."""
    store = _layouts(wanted, kind)
    decode = store.deserialize_ros1 if kind == BAG else store.deserialize_cdr
    rows: dict[tuple[str, str], tuple[str, list[tuple[float, ...]]]] = {}
    for connection, recorded, data in reader.messages(connections=wanted):
        key, time = (connection.topic, connection.msgtype), recorded / 1e9
        what = _KINDS[connection.msgtype]
        counts[connection.topic] += 1
        if what in (ODOMETRY, IMU) and key in rows and 0 <= time - rows[key][1][-1][0] < _MOST_OFTEN_S:
            continue
        message: Any = decode(data, connection.msgtype)
        header = getattr(message, "header", None)
        stamp = np.nan if header is None else header.stamp.sec + header.stamp.nanosec / 1e9
        values = _VALUES[what](message)
        rows.setdefault(key, ("" if header is None else header.frame_id, []))[1].append((time, stamp, *values))
    return rows


def _layouts(wanted: Sequence[Connection], kind: Kind) -> Typestore:
    """Return the message layouts of the topics: the bag's own, and the usual ones of types that it brings none of."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    found: Any = {}
    if any(each.msgdef.format == MessageDefinitionFormat.NONE for each in wanted):
        found = dict(get_typestore(Stores.ROS1_NOETIC if kind == BAG else Stores.LATEST).fielddefs)
    for each in wanted:
        if each.msgdef.format == MessageDefinitionFormat.MSG:
            found |= get_types_from_msg(each.msgdef.data, each.msgtype)
        elif each.msgdef.format == MessageDefinitionFormat.IDL:
            for part in each.msgdef.data.split("=" * 80 + "\n"):
                found |= get_types_from_idl(re.sub(r"^IDL: .*\n", "", part)) if part.strip() else {}
    store = get_typestore(Stores.EMPTY)
    store.register(found)
    return store


def _fix(message: Any) -> tuple[float, ...]:
    return message.longitude, message.latitude, message.status.status


def _odometry(message: Any) -> tuple[float, ...]:
    pose, speed = message.pose.pose, message.twist.twist.linear
    turn = pose.orientation
    return pose.position.x, pose.position.y, speed.x, speed.y, turn.x, turn.y, turn.z, turn.w


def _imu(message: Any) -> tuple[float, ...]:
    turn = message.orientation
    # sensor_msgs/Imu: a first covariance of -1 says that there is no orientation.
    return (turn.x, turn.y, turn.z, turn.w) if message.orientation_covariance[0] != -1 else (0.0, 0.0, 0.0, 0.0)


def _command(message: Any) -> tuple[float, ...]:
    speed = getattr(message, "twist", message).linear
    return speed.x, speed.y


_VALUES: dict[str, Callable[[Any], tuple[float, ...]]] = {
    FIX: _fix,
    ODOMETRY: _odometry,
    IMU: _imu,
    COMMAND: _command,
}
