"""Bags of every kind, written by rosbags' own writers for the tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
T0 = 1_700_000_000.0
KINDS = ("bag", "folder", "mcap folder", "mcap", "db3")

Turn = Sequence[float]
FLAT = (0.0, 0.0, 0.0, 1.0)


@dataclass
class Said:
    """A message of a topic: when it was recorded, its stamp (None: a message without header), and what it says."""

    topic: str
    kind: str
    time_s: float
    values: dict[str, Any] = field(default_factory=dict)
    stamp_s: float | None = None
    frame: str = "odom"


def fix(t: float, lon: float, lat: float, *, status: int = 0, topic: str = "/fix", **more: Any) -> Said:
    return Said(topic, "fix", t, {"lon": lon, "lat": lat, "status": status}, **{"stamp_s": t, **more})


def odometry(
    t: float, x: float, y: float, v: Turn = (0.0, 0.0), *, turn: Turn = FLAT, topic: str = "/odom", **more: Any
) -> Said:
    return Said(topic, "odometry", t, {"x": x, "y": y, "v": v, "turn": turn}, **{"stamp_s": t, **more})


def imu(t: float, turn: Turn, *, known: bool = True, topic: str = "/imu", **more: Any) -> Said:
    return Said(topic, "imu", t, {"turn": turn, "known": known}, **{"stamp_s": t, **more})


def command(t: float, v: float, *, topic: str = "/cmd_vel", stamped: bool = False) -> Said:
    return Said(topic, "stamped" if stamped else "twist", t, {"v": (v, 0.0)}, t if stamped else None)


TYPES = {
    "fix": "sensor_msgs/msg/NavSatFix",
    "odometry": "nav_msgs/msg/Odometry",
    "imu": "sensor_msgs/msg/Imu",
    "twist": "geometry_msgs/msg/Twist",
    "stamped": "geometry_msgs/msg/TwistStamped",
    "image": "sensor_msgs/msg/Image",
}


def write(folder: Path, said: Sequence[Said], kind: str, name: str = "drive", compression: str = "") -> Path:
    """Write a bag of one of `KINDS` in a folder and return what is to be read."""
    folder.mkdir(parents=True, exist_ok=True)
    if kind == "bag":
        path = folder / f"{name}.bag"
        writer = Writer1(path)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression])
        with writer:
            _fill(writer, ROS1, said)
        return path
    path = folder / name
    plugin = StoragePlugin.MCAP if kind in ("mcap", "mcap folder") else StoragePlugin.SQLITE3
    writer2 = Writer2(path, version=9, storage_plugin=plugin)
    if compression:
        writer2.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer2:
        _fill(writer2, ROS2, said)
    return path / f"{name}.{kind}" if kind in ("mcap", "db3") else path


def _fill(writer: Any, store: Any, said: Sequence[Said]) -> None:
    connections: dict[str, Any] = {}
    for index, each in enumerate(said):
        if each.topic not in connections:
            connections[each.topic] = writer.add_connection(each.topic, TYPES[each.kind], typestore=store)
        message = _message(store, each, index)
        encode = store.serialize_ros1 if store is ROS1 else store.serialize_cdr
        writer.write(connections[each.topic], round((T0 + each.time_s) * 1e9), encode(message, TYPES[each.kind]))


def _message(store: Any, said: Said, index: int) -> Any:
    known, values = store.types, said.values

    def make(name: str, *args: Any) -> Any:
        return known[name](*args)

    def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        return make("geometry_msgs/msg/Vector3", float(x), float(y), float(z))

    stamp = 0 if said.stamp_s is None else round((T0 + said.stamp_s) * 1e9)
    time = make("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)
    number = (index,) if store is ROS1 else ()
    header = make("std_msgs/msg/Header", *number, time, said.frame)
    if said.kind == "fix":
        status = make("sensor_msgs/msg/NavSatStatus", values["status"], 1)
        place = (float(values["lat"]), float(values["lon"]), 0.0)
        return make("sensor_msgs/msg/NavSatFix", header, status, *place, np.zeros(9), 0)
    if said.kind == "image":
        return make("sensor_msgs/msg/Image", header, 2, 2, "mono8", 0, 2, np.zeros(4, np.uint8))
    if said.kind == "imu":
        orientation = make("geometry_msgs/msg/Quaternion", *map(float, values["turn"]))
        covariance = np.array([0.0 if values["known"] else -1.0, *[0.0] * 8])
        rest = (vector(), np.zeros(9), vector(), np.zeros(9))
        return make("sensor_msgs/msg/Imu", header, orientation, covariance, *rest)
    twist = make("geometry_msgs/msg/Twist", vector(*values["v"]), vector())
    if said.kind == "twist":
        return twist
    if said.kind == "stamped":
        return make("geometry_msgs/msg/TwistStamped", header, twist)
    point = make("geometry_msgs/msg/Point", float(values["x"]), float(values["y"]), 0.0)
    pose = make("geometry_msgs/msg/Pose", point, make("geometry_msgs/msg/Quaternion", *map(float, values["turn"])))
    with_pose = make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    with_twist = make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
    return make("nav_msgs/msg/Odometry", header, "base_link", with_pose, with_twist)
