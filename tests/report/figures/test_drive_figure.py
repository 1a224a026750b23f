"""The picture of a drive: the track lies where the log says, in the colours of its speed, with what happened."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from raster_files import UTM33
from world_files import map_xy, put_drive_log, put_plan, put_world

from hrt_cli.artifacts.stage import REFUSE
from hrt_cli.report.figures.drive import draw_drive

EAST = np.array([1.0, 3.0, 5.0, 5.0, 5.0])
SOUTH = np.array([2.0, 2.0, 2.0, 3.0, 6.0])
SPEED = [0.0, 1.0, 1.0, 0.5, 0.25]


def put(path: Path, *, crs: str | None = UTM33, **more) -> Path:
    records = []
    for k, (east, south, speed) in enumerate(zip(EAST, SOUTH, SPEED, strict=True)):
        x, y = map_xy(east, south) if crs else (east, -south)
        records.append({"t": float(k), "x": x, "y": y, "speed_m_s": speed} | ({"event": "collision"} if k == 2 else {}))
    return put_drive_log(path, records, crs, **more)


def track(figure: Figure) -> tuple[np.ndarray, np.ndarray]:
    """Segments and values of the coloured line."""
    (line,) = [
        each for each in figure.axes[0].collections if isinstance(each, LineCollection) and each.get_array() is not None
    ]
    return np.array(line.get_segments()), np.ma.filled(line.get_array(), np.nan)


def test_the_track_lies_on_the_orthomosaic_in_ground_metres(tmp_path: Path, drawn: list[Figure]) -> None:
    world = put_world(tmp_path / "site", np.zeros((80, 100)))
    log = put(tmp_path / "d.jsonl")
    plan = put_plan(tmp_path / "p.json", [map_xy(1, 2), map_xy(5, 2), map_xy(5, 6)])
    options = {"plan": plan, "backdrop": world / "ortho.tif", "caption": "a drive", "existing": REFUSE}
    assert not draw_drive(log, tmp_path / "f.png", **options)
    segments, speed = track(drawn[0])
    np.testing.assert_allclose(segments[:, 0], np.column_stack([EAST, SOUTH])[:-1], atol=2e-3)
    np.testing.assert_allclose(segments[:, 1], np.column_stack([EAST, SOUTH])[1:], atol=2e-3)
    np.testing.assert_allclose(speed, [0.5, 1.0, 0.75, 0.375])
    axes = drawn[0].axes[0]
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_allclose(lines["plan"], [(1, 2), (5, 2), (5, 6)], atol=2e-3)
    np.testing.assert_allclose(lines["1 collision"], [(5, 2)], atol=2e-3)
    np.testing.assert_allclose([lines["start"][0], lines["end"][0]], [(1, 2), (5, 6)], atol=2e-3)
    assert axes.get_title(loc="left") == "a drive"
    assert drawn[0].axes[1].get_ylabel() == "speed, m/s"
    assert draw_drive(log, tmp_path / "f.png", **options)


def test_a_log_without_a_crs_is_drawn_in_its_own_metres(tmp_path: Path, drawn: list[Figure]) -> None:
    draw_drive(put(tmp_path / "d.jsonl", crs=None), tmp_path / "f.png", caption="", existing=REFUSE)
    segments, _ = track(drawn[0])
    np.testing.assert_allclose(
        segments[:, 1] - segments[:, 0], np.diff(np.column_stack([EAST, SOUTH]), axis=0), atol=1e-9
    )
    assert not any(text.get_text() == "N" for text in drawn[0].axes[0].texts)
    assert any(text.get_text().endswith(" m") for text in drawn[0].axes[0].texts)


def test_a_log_in_degrees_is_drawn_in_ground_metres_also_across_180(tmp_path: Path, drawn: list[Figure]) -> None:
    lons = [179.9999, 180.0, -179.9999]
    log = put_drive_log(tmp_path / "d.jsonl", [{"t": k, "lon": lon, "lat": 0.0} for k, lon in enumerate(lons)], None)
    draw_drive(log, tmp_path / "f.png", caption="", existing=REFUSE)
    segments, time = track(drawn[0])
    np.testing.assert_allclose(np.diff(segments[..., 0]).ravel(), np.radians(1e-4) * 6_378_137, rtol=1e-3)
    np.testing.assert_allclose(time, [0.5, 1.5])
    assert drawn[0].axes[1].get_ylabel() == "time, s"


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize("records", [1, 2])
def test_a_robot_that_stays_has_a_picture_too(tmp_path: Path, records: int) -> None:
    log = put_drive_log(tmp_path / "d.jsonl", [{"t": 0.0, "lon": 15.0, "lat": 45.0}] * records, None)
    assert not draw_drive(log, tmp_path / "f.png", caption="", existing=REFUSE)
