from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
import yaml
from mission_samples import (
    DIAGONAL,
    LAWNMOWER,
    SQUARE,
    UTM_SOUTH,
    WGS84,
    assert_at_cells,
    distance_m,
    sample_plan,
    true_lonlat,
    waypoint_cells,
)
from nav2_reader import load_graph, navsat_xy
from pyproj import Transformer
from rosbags.typesys import Stores, get_typestore

from hrt_cli.artifacts.plan import PlanDocument
from hrt_cli.errors import ArgumentError
from hrt_cli.missions import nav2
from hrt_cli.missions.mission import Mission, MissionOptions, mission_of

PLACES = {
    "south": (UTM_SOUTH, (138.6012345, -34.9287654)),
    "north": ("EPSG:32633", (14.2, 52.1)),
    "Bergen": ("EPSG:32632", (5.3, 60.4)),
    "Svalbard": ("EPSG:32633", (15.6, 78.2)),
    "mercator": ("EPSG:3857", (-122.3, 47.6)),
    "feet": ("EPSG:2225", (-122.5, 41.0)),
    "meridian 180": ("EPSG:32760", (179.9999, -16.8)),
}
FRAMES = ("utm", "enu")


def mission(plan: PlanDocument, **options: Any) -> Mission:
    return mission_of(plan, MissionOptions(**options))


def folder(plan: PlanDocument, **options: Any) -> dict[str, bytes]:
    return nav2.to_files(mission(plan, **options), None)


def placed(name: str) -> PlanDocument:
    crs, lonlat = PLACES[name]
    return sample_plan(DIAGONAL, crs=crs, lonlat=lonlat, cell=3.0)


def positions(path: bytes) -> list[tuple[float, float]]:
    return [(p["pose"]["position"]["x"], p["pose"]["position"]["y"]) for p in yaml.safe_load(path)["poses"]]


@pytest.mark.parametrize("name", PLACES)
def test_gps_waypoints_are_the_tutorials(name: str) -> None:
    """YamlWaypointParser: a list `waypoints` of latitude, longitude, yaw."""
    plan = placed(name)
    text = nav2.to_text(mission(plan))
    found = yaml.safe_load(text)
    assert list(found) == ["waypoints"]
    assert all(list(place) == ["latitude", "longitude", "yaw"] for place in found["waypoints"])
    assert all(isinstance(value, float) for place in found["waypoints"] for value in place.values())
    places = [(place["longitude"], place["latitude"]) for place in found["waypoints"]]
    assert_at_cells(plan, places, waypoint_cells(plan))
    assert all(re.fullmatch(r"-?\d+\.\d{9}", value) for value in re.findall(r"itude: (\S+)", text))
    yaws = [place["yaw"] for place in found["waypoints"]]
    for yaw, before, after in zip(yaws, places, places[1:], strict=False):
        bearing = math.radians(WGS84.inv(*before, *after)[0])
        assert math.remainder(math.pi / 2 - bearing - yaw, math.tau) == pytest.approx(0, abs=1e-4)
    assert yaws[-1] == yaws[-2]


def test_a_single_file_is_the_folders_gps_waypoints() -> None:
    assert folder(sample_plan())["gps_waypoints.yaml"].decode() == nav2.to_text(mission(sample_plan()))


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("name", PLACES)
def test_the_path_is_where_the_datum_says(name: str, frame: str) -> None:
    plan = placed(name)
    files = folder(plan, frame=frame)
    datum = yaml.safe_load(files["datum.yaml"])
    back = Transformer.from_crs(datum["crs"], "EPSG:4326", always_xy=True)
    points = positions(files["path.yaml"])
    places = [back.transform(x + datum["easting"], y + datum["northing"]) for x, y in points]
    assert_at_cells(plan, places, waypoint_cells(plan))
    here = back.transform(datum["easting"], datum["northing"])
    assert distance_m(here, (datum["longitude"], datum["latitude"])) < 0.001
    assert datum["frame"] == frame
    assert max(abs(value) for point in points for value in point) < 70_000


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("name", PLACES)
def test_robot_localization_finds_every_cell_where_the_path_is(name: str, frame: str) -> None:
    plan = placed(name)
    lon, lat = plan.lonlat[0]
    files = folder(plan, frame=frame, datum=(lon - 0.005, lat + 0.003) if name != "meridian 180" else (179.999, lat))
    parameters = yaml.safe_load(files["navsat_transform.yaml"])
    for (x, y), cell in zip(positions(files["path.yaml"]), waypoint_cells(plan), strict=True):
        assert math.dist(navsat_xy(parameters, *true_lonlat(plan, cell)), (x, y)) < 0.02


def test_a_heading_of_the_wrong_sign_would_be_noticed() -> None:
    plan = placed("Bergen")
    files = folder(plan, datum=(5.29, 60.39))
    parameters = yaml.safe_load(files["navsat_transform.yaml"])
    datum = parameters["navsat_transform"]["ros__parameters"]["datum"]
    datum[2] = -datum[2]
    (x, y), cell = positions(files["path.yaml"])[0], waypoint_cells(plan)[0]
    assert math.dist(navsat_xy(parameters, *true_lonlat(plan, cell)), (x, y)) > 10


@pytest.mark.parametrize("frame", FRAMES)
def test_the_path_is_a_message(frame: str) -> None:
    """Built by rosbags' types from the YAML, which takes neither less nor more than the fields, and serialised."""
    plan = sample_plan(LAWNMOWER)
    document = yaml.safe_load(folder(plan, frame=frame, vehicle="submarine", altitude_m=-2.5)["path.yaml"])
    store = get_typestore(Stores.ROS2_HUMBLE)

    def build(kind: str, **fields: Any) -> Any:
        return store.types[kind](**fields)

    def header(fields: dict[str, Any]) -> Any:
        stamp = build("builtin_interfaces/msg/Time", **fields.pop("stamp"))
        return build("std_msgs/msg/Header", stamp=stamp, **fields)

    poses = []
    for stamped in document.pop("poses"):
        pose = stamped.pop("pose")
        point = build("geometry_msgs/msg/Point", **pose.pop("position"))
        turn = build("geometry_msgs/msg/Quaternion", **pose.pop("orientation"))
        pose = build("geometry_msgs/msg/Pose", position=point, orientation=turn, **pose)
        poses.append(build("geometry_msgs/msg/PoseStamped", header=header(stamped.pop("header")), pose=pose, **stamped))
    message = build("nav_msgs/msg/Path", header=header(document.pop("header")), poses=poses, **document)
    read = store.deserialize_cdr(store.serialize_cdr(message, "nav_msgs/msg/Path"), "nav_msgs/msg/Path")
    assert read.header.frame_id == "map"
    assert len(read.poses) == len(plan.waypoints)
    assert {pose.pose.position.z for pose in read.poses} == {-2.5}
    for before, after in zip(read.poses, read.poses[1:], strict=False):
        turn, start, end = before.pose.orientation, before.pose.position, after.pose.position
        assert math.hypot(turn.z, turn.w) == pytest.approx(1)
        yaw = math.atan2(2 * turn.w * turn.z, 1 - 2 * turn.z**2)
        assert math.remainder(yaw - math.atan2(end.y - start.y, end.x - start.x), math.tau) == pytest.approx(
            0, abs=1e-3
        )


def test_the_graph_has_every_place_once_and_every_leg_both_ways() -> None:
    moves = SQUARE + SQUARE[:4]
    plan = sample_plan(moves)
    nodes, edges = load_graph(folder(plan)["route.geojson"])
    assert len(nodes) == 4
    assert sorted((a, b) for a, b, _ in edges) == sorted(
        pair for k in range(4) for pair in ((k, (k + 1) % 4), ((k + 1) % 4, k))
    )
    points = positions(folder(plan)["path.yaml"])
    assert [nodes[k] for k in range(4)] == [pytest.approx(point, abs=0.001) for point in points[:4]]
    assert [cost for _, _, cost in edges] == pytest.approx([2.0] * 8, abs=0.01)


def test_ways_there_and_back_meet_in_the_same_nodes() -> None:
    plan = sample_plan([(1, 1)] * 7 + [(-1, -1)] * 7)
    nodes, edges = load_graph(folder(plan, spacing_m=0.6)["route.geojson"])
    assert len(nodes) == 10
    assert len(edges) == 2 * 9


@pytest.mark.parametrize("shift", range(8))
def test_a_place_come_to_again_is_one_node_wherever_it_lies(shift: int) -> None:
    """On the way back its coordinates may differ in the last digits, on both sides of any border of rounding."""
    members = sample_plan(SQUARE).model_dump()
    lon, lat = members["lonlat"][0]
    members["lonlat"][-1] = (lon + 5e-8, lat - 5e-8)
    members["waypoints"][-1] |= {"lon": lon + 5e-8, "lat": lat - 5e-8}
    datum = (lon - 0.001 + shift * 1.3e-8, lat - 0.001)
    nodes, edges = load_graph(folder(PlanDocument.model_validate(members), datum=datum)["route.geojson"])
    assert (len(nodes), len(edges)) == (4, 8)


def test_a_graph_survives_floats_of_32_bits() -> None:
    plan = sample_plan([(0, 1)] * 30, start=(4000, 4000))
    nodes, _ = load_graph(folder(plan)["route.geojson"])
    points = positions(folder(plan)["path.yaml"])
    assert max(math.dist(nodes[k], point) for k, point in enumerate(points)) < 0.002


def test_of_one_waypoint_there_is_no_graph() -> None:
    files = folder(sample_plan([]))
    assert "route.geojson" not in files
    assert len(positions(files["path.yaml"])) == 1


def test_a_loop_that_tolerance_closes_is_no_edge() -> None:
    plan = sample_plan(SQUARE)
    shape = plan.grid.rows, plan.grid.cols
    loop = mission_of(plan, MissionOptions(tolerance_m=10.0), np.ones(shape, bool))
    assert len(loop.stops) == 2
    assert "route.geojson" not in nav2.to_files(loop, None)


@pytest.mark.parametrize(
    ("sound", "broken"),
    [(b'"startid": 0', b'"startid": 99'), (b'"id": 1,', b'"id": 0,'), (b'"step": 0', b'"step": null')],
)
def test_the_reader_refuses_a_broken_graph(sound: bytes, broken: bytes) -> None:
    content = folder(sample_plan())["route.geojson"]
    load_graph(content)
    assert sound in content
    with pytest.raises(ValueError, match=r"."):
        load_graph(content.replace(sound, broken, 1))


def test_a_height_above_the_bottom_is_refused() -> None:
    with pytest.raises(ArgumentError, match="above the bottom"):
        folder(sample_plan(), vehicle="submarine", above_bottom_m=2.0)


def test_a_wait_is_told_in_the_parameters_own_name() -> None:
    assert "waypoint_pause_duration: 4000" in nav2.to_text(mission(sample_plan(), hold_s=4))
    assert "pause" not in nav2.to_text(mission(sample_plan()))


def test_files_are_ascii_end_in_a_line_end_and_are_the_same_each_time() -> None:
    files = folder(sample_plan(), name="Nord-Süd\n: {x")
    assert files == folder(sample_plan(), name="Nord-Süd\n: {x")
    for content in files.values():
        assert content.isascii()
        assert content.endswith(b"\n")
