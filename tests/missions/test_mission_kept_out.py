"""From areas as they are drawn to missions in every format: none leads into a keep-out or out of its area."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import shapely
import shapely.affinity
from area_files import FORMS, GRIDS, HALF_M, LOCAL, classes_on, crs_of, drawn, moved, polygons
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_readers import read_positions

from hrt_cli.drivability.limits import Limits
from hrt_cli.drivability.stage import make_scoremap
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.missions.formats import FORMATS
from hrt_cli.missions.mission import MissionOptions
from hrt_cli.missions.stage import export_missions
from hrt_cli.planning.request import PlanRequest, Spending, Start
from hrt_cli.planning.stage import plan_file
from hrt_cli.raster.scoremap import read_scoremap

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")


def turned(shape: Any, turn_deg: int) -> Any:
    return shapely.affinity.rotate(shape, turn_deg, origin=(0, 0))


def wall_at(turn_deg: int) -> Any:
    """A wall of 4 m through the middle."""
    return turned(shapely.box(-2, -0.1, 2, 0.1), turn_deg)


def sides_of(turn_deg: int) -> list[Any]:
    return [turned(shapely.Point(0, y), turn_deg) for y in (1.5, -1.5)]


@settings(max_examples=25)
@given(
    grid=st.sampled_from(sorted(GRIDS)),
    aoi=st.none() | polygons(4 * HALF_M),
    others=polygons(HALF_M / 3),
    forms=st.tuples(FORMS, FORMS),
    tolerance_m=st.sampled_from([2.0, 1.5, 3.0, 0.0]),
    spacing_m=st.sampled_from([None, 1.7]),
    turn_deg=st.integers(0, 359),
)
def test_no_mission_enters_a_keep_out_or_leaves_the_area(
    grid: str, aoi: Any, others: Any, forms: tuple[str, str], tolerance_m: float, spacing_m: float | None,
    turn_deg: int,
) -> None:  # fmt: skip
    keep_out = shapely.union_all([others, wall_at(turn_deg)])
    with TemporaryDirectory() as name:
        folder = Path(name)
        within = drawn(folder, "aoi", aoi, forms[0]) if aoi else None
        without = drawn(folder, "keep", keep_out, forms[1])
        scoremap = folder / "s.tif"
        try:
            make_scoremap(classes_on(folder, grid), scoremap, limits=Limits(within, (without,)))
        except InputError as error:
            if not re.search("leaves nowhere to go|lies outside", str(error)):
                raise
            return
        # From one side of the wall to the other, about its end: straight is within the tolerance.
        found = read_scoremap(scoremap)
        go = np.argwhere(np.isfinite(found.score))
        x, y = found.grid.xy(go[:, 0] + 0.5, go[:, 1] + 0.5)
        places = moved(shapely.points(x, y), crs_of(found.grid), LOCAL)
        start, end = (
            Start("cell", *map(int, go[shapely.distance(places, side).argmin()])) for side in sides_of(turn_deg)
        )
        plan = folder / "plan.json"
        request = PlanRequest((start,), Spending(40, "steps"), ends=(end,), effort=0.01, samples=4)
        try:
            plan_file(scoremap, plan, request)
        except ArgumentError as error:
            if not re.search("walled in|cannot be reached", str(error)):
                raise
            return
        options = MissionOptions(tolerance_m=tolerance_m, spacing_m=spacing_m)
        for name, entry in FORMATS.items():
            path = folder / f"mission{entry.suffixes[0]}"
            export_missions(plan, path, options, scoremap_path=scoremap, aoi_path=within, keep_out_paths=[without])
            lonlat = read_positions(name, path.read_text(), folder)
            line = moved(shapely.LineString(np.array(lonlat).repeat(2, axis=0)), "EPSG:4326", LOCAL)
            assert not line.intersects(keep_out), name
            assert aoi is None or line.within(aoi), name
