from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from affine import Affine
from mission_samples import ADELAIDE, UTM_SOUTH, transform_at
from nav2_reader import (
    LETHAL_COST,
    NO_LIMIT,
    UNKNOWN,
    OccupancyGrid,
    interpreted,
    keepout_cost,
    load_map,
    speed_percent,
)
from PIL import Image
from pyproj import Transformer
from rasterio.crs import CRS

from hrt_cli.artifacts.carriers import publish_npz
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.missions.local import FrameKind, LocalFrame
from hrt_cli.missions.nav2_maps import graded, map_files
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap, read_scoremap

CELL_M = 2.0
DATUM = (138.6000001, -34.9300002)
NAMES = ("scoremap", "keepout_mask", "speed_mask")
GRIDS: dict[str, tuple[str, float]] = {
    "as the frame": (UTM_SOUTH, 0.0),
    "rotated": (UTM_SOUTH, 30.0),
    "turned about": (UTM_SOUTH, -117.0),
    "of another zone": ("EPSG:32753", 0.0),
    "web mercator": ("EPSG:3857", 0.0),
}


def scores(rows: int = 23, cols: int = 31, most: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(5)
    score = (rng.random((rows, cols)) * most).astype(np.float32)
    score[rng.random((rows, cols)) < 0.3] = np.nan
    score[0, 0] = most
    return score


def scoremap_of(kind: str, score: np.ndarray, **changes: Any) -> Scoremap:
    crs, turn_deg = GRIDS[kind]
    transform = Affine(*transform_at(crs, ADELAIDE, CELL_M, turn_deg))
    grid = Grid(*score.shape, transform, CRS.from_user_input(crs))
    return Scoremap(score, np.zeros_like(score), grid, float(np.mean(grid.pixel_m)), **changes)


def centres(grid: OccupancyGrid) -> tuple[np.ndarray, np.ndarray]:
    rows, cols = np.indices(grid.data.shape)
    return grid.x + (cols + 0.5) * grid.resolution, grid.y + (rows + 0.5) * grid.resolution


def score_there(scoremap: Scoremap, frame: LocalFrame, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The score of the cell that holds each place of the frame (by pyproj), NaN off the map, -1 on cells' edges."""
    back = Transformer.from_crs(
        frame.crs.to_wkt(), CRS.to_wkt(scoremap.grid.crs), always_xy=True
    )  # a datum both have: WGS 84
    east, north = back.transform(x + frame.origin[0], y + frame.origin[1])
    col, row = ~scoremap.grid.transform @ (east, north)
    found = np.full(x.shape, np.nan)
    rows, cols = scoremap.score.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    found[inside] = scoremap.score[row[inside].astype(int), col[inside].astype(int)]
    edge = np.minimum(np.abs(row - np.rint(row)), np.abs(col - np.rint(col))) < 1e-3
    found[edge] = -1
    return found


@pytest.mark.parametrize("kind", GRIDS)
@pytest.mark.parametrize("frame_kind", ["utm", "enu"])
def test_every_map_says_of_every_place_what_the_scoremap_says(kind: str, frame_kind: FrameKind) -> None:
    scoremap, frame = scoremap_of(kind, scores()), LocalFrame(frame_kind, *DATUM)
    files = map_files(scoremap, frame)
    for name in NAMES:
        grid = load_map(files, f"{name}.yaml")
        x, y = centres(grid)
        want = score_there(scoremap, frame, x, y)
        plain = want != -1
        assert plain.mean() > 0.95
        want, data = want[plain], grid.data[plain]
        go = ~np.isnan(want)
        assert go.sum() > 0.5 * scoremap.score.size
        if name == "scoremap":
            assert np.abs(data[go] / 100 - want[go]).max() <= 0.0051
            assert set(data[~go]) == {UNKNOWN}
        elif name == "keepout_mask":
            assert np.abs(1 - data[go] / 100 - want[go]).max() <= 0.0151
            assert data[go].max() < 100
            assert set(data[~go]) == {100}
        else:
            assert np.abs(1 - data[go] / 100 - np.maximum(want[go], 0.1)).max() <= 0.0051
            assert set(data[~go]) == {90}


@pytest.mark.parametrize("kind", GRIDS)
@pytest.mark.parametrize("frame_kind", ["utm", "enu"])
def test_at_the_middle_of_every_cell_the_map_has_that_cell(kind: str, frame_kind: FrameKind) -> None:
    """So that no waypoint is kept out, or stands off the map, for how the map's grid lies to the scoremap's."""
    scoremap, frame = scoremap_of(kind, scores()), LocalFrame(frame_kind, *DATUM)
    grid = load_map(map_files(scoremap, frame), "scoremap.yaml")
    rows, cols = (a.ravel() for a in np.indices(scoremap.score.shape))
    forth = Transformer.from_crs(CRS.to_wkt(scoremap.grid.crs), frame.crs.to_wkt(), always_xy=True)
    east, north = forth.transform(*(scoremap.grid.transform @ (cols + 0.5, rows + 0.5)))
    found = [grid.at(x, y) for x, y in zip(east - frame.origin[0], north - frame.origin[1], strict=True)]
    score = scoremap.score.ravel()
    assert np.array_equal(found, np.where(np.isnan(score), UNKNOWN, np.rint(100 * np.nan_to_num(score))))


def test_a_scoremap_on_the_frames_axes_is_written_as_it_is() -> None:
    score = scores()
    files = map_files(scoremap_of("as the frame", score), LocalFrame("utm", *DATUM))
    image = np.asarray(Image.open(io.BytesIO(files["scoremap.pgm"])))
    assert image.shape == score.shape
    assert np.array_equal(image == 255, np.isnan(score))
    assert float(yaml.safe_load(files["scoremap.yaml"])["resolution"]) == CELL_M


def test_a_slight_turn_counts_by_what_it_makes_at_the_far_end() -> None:
    """Half a thousandth is nothing to a cell, and a whole cell after two thousand of them."""
    score = scores(4, 2000)
    transform = Affine(*transform_at(UTM_SOUTH, ADELAIDE, CELL_M, math.degrees(5e-4)))
    scoremap = Scoremap(score, np.zeros_like(score), Grid(4, 2000, transform, CRS.from_user_input(UTM_SOUTH)), CELL_M)
    frame = LocalFrame("utm", *DATUM)
    grid = load_map(map_files(scoremap, frame), "scoremap.yaml")
    want = score_there(scoremap, frame, *centres(grid))
    go = (want != -1) & ~np.isnan(want)
    assert np.abs(grid.data[go] / 100 - want[go]).max() <= 0.0051


def test_the_keepout_filter_keeps_the_robot_on_what_is_open() -> None:
    scoremap, frame = scoremap_of("rotated", scores()), LocalFrame("utm", *DATUM)
    mask = load_map(map_files(scoremap, frame), "keepout_mask.yaml")
    x, y = centres(mask)
    want = score_there(scoremap, frame, x, y)
    for px, py, score in zip(x.flat, y.flat, want.flat, strict=True):
        cost = keepout_cost(mask, px, py, 0)
        assert (cost == LETHAL_COST) == bool(np.isnan(score)) or score == -1
        assert cost <= 251 or cost == LETHAL_COST  # never taken for the inside of an obstacle's radius


def test_nobody_leaves_the_map_between_the_cells_of_its_rim() -> None:
    scoremap, frame = scoremap_of("as the frame", np.ones((4, 6), np.float32)), LocalFrame("utm", *DATUM)
    mask = load_map(map_files(scoremap, frame), "keepout_mask.yaml")
    assert mask.data.shape == (6, 8)
    assert (mask.data[1:-1, 1:-1] == 0).all()
    rim = np.concatenate([mask.data[0], mask.data[-1], mask.data[:, 0], mask.data[:, -1]])
    assert (rim == 100).all()
    assert keepout_cost(mask, mask.x - 1, mask.y, 17) == 17  # beyond it the filter does nothing


def test_the_speed_filter_slows_by_the_score_and_most_where_none_may_go() -> None:
    score = scores()
    score[3, 4:8] = [0.0, 0.004, 0.5, 1.0]
    scoremap, frame = scoremap_of("as the frame", score), LocalFrame("utm", *DATUM)
    files = map_files(scoremap, frame)
    info = yaml.safe_load(files["filter_info.yaml"])["speed_costmap_filter_info_server"]["ros__parameters"]
    assert info["type"] == 1
    mask = load_map(files, "speed_mask.yaml")
    x, y = centres(mask)
    places = zip(x.flat, y.flat, strict=True)
    found = [speed_percent(mask, info["base"], info["multiplier"], *place) for place in places]
    limits = np.array(found).reshape(score.shape)[::-1]
    assert (info["base"], info["multiplier"]) == (100.0, -1.0)  # of Nav2's tutorial, which many robots have set up
    free = limits == NO_LIMIT
    assert (score[free] >= 0.995).all()
    assert limits[3, 4:8].tolist() == [10, 10, 50, NO_LIMIT]
    assert (limits[np.isnan(score)] == limits[~free].min()).all()


def test_cells_that_earlier_drives_blocked_are_kept_out() -> None:
    scoremap, frame = scoremap_of("as the frame", np.ones((5, 5), np.float32)), LocalFrame("utm", *DATUM)
    files = map_files(scoremap, frame, [(1, 2)])
    kept_out = load_map(files, "keepout_mask.yaml").data[::-1][1:-1, 1:-1] == 100
    assert np.argwhere(kept_out).tolist() == [[1, 2]]
    assert load_map(files, "scoremap.yaml").data[::-1][1, 2] == UNKNOWN
    assert not np.isnan(scoremap.score).any()


def test_scores_beyond_1_are_percent_of_the_highest() -> None:
    scoremap = scoremap_of("as the frame", scores(most=8.0))
    files = map_files(scoremap, LocalFrame("utm", *DATUM))
    data = load_map(files, "scoremap.yaml").data[::-1]
    go = np.isfinite(scoremap.score)
    assert np.abs(data[go] / 100 - scoremap.score[go] / 8).max() <= 0.0051
    assert b"100 is a score of 8," in files["scoremap.yaml"]


def test_what_is_of_interest_does_not_make_ground_passable() -> None:
    scoremap = scoremap_of("as the frame", scores(), drivability=False)
    files = map_files(scoremap, LocalFrame("utm", *DATUM))
    assert not graded(scoremap)
    assert not [name for name in files if "speed" in name]
    assert "speed" not in files["filter_info.yaml"].decode()
    inside = load_map(files, "keepout_mask.yaml").data[::-1][1:-1, 1:-1]
    assert np.array_equal(inside, np.where(np.isnan(scoremap.score), 100, 0))
    assert b"not drivability alone" in files["keepout_mask.yaml"]


def test_the_servers_are_told_of_files_that_are_there() -> None:
    files = map_files(scoremap_of("as the frame", scores()), LocalFrame("utm", *DATUM))
    servers = yaml.safe_load(files["filter_info.yaml"])
    found = {name: server["ros__parameters"] for name, server in servers.items()}
    for name in ("keepout", "speed"):
        mask, info = found[f"{name}_filter_mask_server"], found[f"{name}_costmap_filter_info_server"]
        assert mask["yaml_filename"] in files
        assert mask["topic_name"] == info["mask_topic"]
    keepout = found["keepout_costmap_filter_info_server"]
    assert (keepout["type"], keepout["base"], keepout["multiplier"]) == (0, 0.0, 1.0)


def test_the_same_scoremap_gives_the_same_bytes() -> None:
    scoremap, frame = scoremap_of("rotated", scores()), LocalFrame("enu", *DATUM)
    assert map_files(scoremap, frame) == map_files(scoremap, frame)


def provenance(**parameters: Any) -> Provenance:
    return Provenance(
        tool="hrt",
        version="0",
        stage="scoremap",
        stage_version=1,
        parameters=parameters,
        inputs=[],
        fingerprint="0" * 64,
    )


@pytest.mark.parametrize(
    ("parameters", "alone"),
    [
        ({"cell_m": 1.0, "explore": 0.0}, True),
        ({"explore": 0.5}, False),
        ({"explore": 0.0, "interest": {"weight": 1.0}}, False),
    ],
)
@pytest.mark.parametrize("suffix", [".tif", ".npz"])
def test_a_scoremap_tells_by_its_provenance_what_it_scores(
    parameters: dict[str, Any], alone: bool, suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"map{suffix}"
    made = scoremap_of("as the frame", scores())
    if suffix == ".tif":
        publish_scoremap(path, made, provenance(**parameters), tags={}, creation={})
    else:
        publish_npz(path, {"score": made.score, "sd": made.sd}, provenance(**parameters))
    assert graded(read_scoremap(path)) is alone


def test_a_scoremap_of_unknown_make_is_taken_for_drivability(tmp_path: Path) -> None:
    np.savez(tmp_path / "map.npz", score=scores())
    assert graded(read_scoremap(tmp_path / "map.npz"))


@pytest.mark.parametrize(
    ("mode", "free", "occupied", "grey", "want"),
    [
        ("raw", 0.196, 0.65, [0, 100, 101, 255], [0, 100, -1, -1]),
        ("trinary", 0.196, 0.65, [254, 0, 205], [0, 100, -1]),
        ("trinary", 0.25, 0.65, [205], [0]),
        ("scale", 0.0, 1.0, [255, 191, 128, 0], [0, 25, 50, 100]),
    ],
)
def test_the_reader_reads_as_map_server_is_documented(
    mode: str, free: float, occupied: float, grey: list[int], want: list[int]
) -> None:
    document = {"mode": mode, "free_thresh": free, "occupied_thresh": occupied, "negate": 0}
    assert interpreted(np.array([grey]), document).tolist() == [want]


@pytest.mark.parametrize("damage", ["no image", "two numbers", "cut short"])
def test_the_reader_refuses_a_broken_map(damage: str) -> None:
    files = map_files(scoremap_of("as the frame", scores()), LocalFrame("utm", *DATUM))
    if damage == "cut short":
        files["scoremap.pgm"] = files["scoremap.pgm"][:-1]
    else:
        document = yaml.safe_load(files["scoremap.yaml"])
        document["origin"] = [0.0, 0.0] if damage == "two numbers" else document["origin"]
        if damage == "no image":
            del document["image"]
        files["scoremap.yaml"] = yaml.safe_dump(document).encode()
    with pytest.raises(ValueError, match=r"."):
        load_map(files, "scoremap.yaml")
