"""The picture of a mission shows the waypoints that are exported, the fence, and the cells that are passed by."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from raster_files import UTM33
from rasterio.warp import transform as warp
from world_files import map_xy, put_plan

from hrt_cli.artifacts.plan import Grid, PlanDocument, read_plan
from hrt_cli.artifacts.stage import REFUSE, Existing
from hrt_cli.report.figures.mission import draw_missions

PLACES = [(1.0, 1.0), (7.0, 1.0), (7.0, 5.0), (1.5, 5.0)]


@dataclass(frozen=True)
class Fence:
    keep_in: tuple = ()
    keep_out: tuple = ()


@dataclass(frozen=True)
class Mission:
    plan: PlanDocument
    waypoints_lonlat: list
    missed: tuple = ()
    fence: Fence = field(default_factory=Fence)
    length_m: float = 15.5
    time_s: float = 31.0
    speed_m_s: float = 0.5


def lonlat(places) -> list[tuple[float, float]]:
    return list(zip(*warp(UTM33, "EPSG:4326", *zip(*(map_xy(*each) for each in places), strict=True)), strict=True))


@pytest.fixture
def mission(tmp_path: Path) -> Mission:
    plan = read_plan(put_plan(tmp_path / "p.json", [map_xy(*each) for each in PLACES]))
    (x, y), side = map_xy(0, 0), 0.9996
    grid = Grid(rows=8, cols=10, transform=(side, 0, x, 0, -side, y), crs=UTM33, cell_size_m=1.0, georeference="real")
    return Mission(plan.model_copy(update={"grid": grid}), lonlat(PLACES))


def draw(folder: Path, missions: list[Mission], existing: Existing = REFUSE) -> bool:
    return draw_missions(folder / "p.json", missions, folder / "f.png", vehicle="rover", existing=existing)


def test_waypoints_lie_where_they_are_and_are_numbered(mission: Mission, tmp_path: Path, drawn: list[Figure]) -> None:
    assert not draw(tmp_path, [mission])
    assert draw(tmp_path, [mission])
    axes = drawn[0].axes[0]
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_allclose(lines["mission"], PLACES, atol=2e-3)
    np.testing.assert_allclose(lines["home and first waypoint"], PLACES[:1], atol=2e-3)
    np.testing.assert_allclose(lines["last waypoint"], PLACES[-1:], atol=2e-3)
    numbers = {text.get_text(): tuple(text.xy) for text in axes.texts if text.get_text().isdigit()}
    assert sorted(numbers) == ["1", "2", "3", "4"]
    for number, place in numbers.items():
        assert place == pytest.approx(PLACES[int(number) - 1], abs=2e-3)
    assert axes.get_title(loc="left") == "rover, 4 waypoints, 16 m, 31 s at 0.5 m/s"


def test_numbers_do_not_stand_on_one_another(mission: Mission, tmp_path: Path, drawn: list[Figure]) -> None:
    crowded = [(1 + 0.05 * k, 4.0) for k in range(100)]
    draw(tmp_path, [replace(mission, waypoints_lonlat=lonlat(crowded))])
    texts = [text for text in drawn[0].axes[0].texts if text.get_text().isdigit()]
    assert "100" in [text.get_text() for text in texts]
    right = sorted(text.xy[0] for text in texts)
    assert 5 < len(right) < 40
    assert np.diff(right).min() >= 10 / 32 - 0.01


def test_fences_and_missed_cells_are_shown(mission: Mission, tmp_path: Path, drawn: list[Figure]) -> None:
    area, hole = [(0.5, 0.5), (9.0, 0.5), (9.0, 7.0)], [(3.0, 2.0), (4.0, 2.0), (4.0, 3.0)]
    fence = Fence((tuple(lonlat(area)),), (tuple(lonlat(hole)),))
    draw(tmp_path, [replace(mission, missed=((2, 3), (4, 5)), fence=fence)])
    axes = drawn[0].axes[0]
    patches = {patch.get_label(): patch.get_xy()[:3] for patch in axes.patches}
    np.testing.assert_allclose(patches["stay within"], area, atol=2e-3)
    np.testing.assert_allclose(patches["keep out"], hole, atol=2e-3)
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_allclose(lines["cell passed by"], [(3.5, 2.5), (5.5, 4.5)], atol=2e-3)
    assert "2 cells passed by" in axes.get_title(loc="left")


def test_a_team_has_one_picture_and_each_robot_its_line(mission: Mission, tmp_path: Path, drawn: list[Figure]) -> None:
    draw(tmp_path, [mission] * 9)
    axes = drawn[0].axes[0]
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == [*(f"robot {k}" for k in range(1, 10)), "home and first waypoint", "last waypoint"]
    looks = {(line.get_color(), line.get_linestyle()) for line in axes.lines if line.get_label().startswith("robot")}
    assert len(looks) == 9
    assert axes.get_title(loc="left").startswith("9 rovers, 36 waypoints, 140 m")


@pytest.mark.usefixtures("drawn")
def test_another_mission_is_another_picture(mission: Mission, tmp_path: Path) -> None:
    draw(tmp_path, [mission])
    other = replace(mission, waypoints_lonlat=mission.waypoints_lonlat[:-1])
    assert not draw(tmp_path, [other], Existing(overwrite=True))
    assert draw(tmp_path, [other])
