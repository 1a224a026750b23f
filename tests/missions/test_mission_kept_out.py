"""From areas as they are drawn to missions in every format: none leads into a keep-out or out of its area."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import shapely
from area_files import FORMS, GRIDS, HALF_M, LOCAL, classes_on, drawn, moved, polygons
from hypothesis import given, settings
from hypothesis import strategies as st
from mission_readers import read_positions

from hrt_cli.drivability.limits import Limits
from hrt_cli.drivability.stage import make_scoremap
from hrt_cli.errors import InputError
from hrt_cli.missions.formats import FORMATS
from hrt_cli.missions.mission import MissionOptions
from hrt_cli.missions.stage import export_missions
from hrt_cli.planning.request import PlanRequest, Spending, Start
from hrt_cli.planning.stage import plan_file
from hrt_cli.raster.scoremap import read_scoremap

pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")


@pytest.mark.parametrize("grid", GRIDS)
@settings(max_examples=8)
@given(
    aoi=st.none() | polygons(2 * HALF_M),
    keep_out=polygons(HALF_M / 2),
    forms=st.tuples(FORMS, FORMS),
    tolerance_m=st.sampled_from([0.0, 1.0, 3.0]),
    spacing_m=st.sampled_from([None, 1.7]),
    where=st.floats(0, 1, exclude_max=True),
)
def test_no_mission_enters_a_keep_out_or_leaves_the_area(
    grid: str, aoi: Any, keep_out: Any, forms: tuple[str, str], tolerance_m: float, spacing_m: float | None,
    where: float,
) -> None:  # fmt: skip
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
        go = np.argwhere(np.isfinite(read_scoremap(scoremap).score))
        start = Start("cell", *map(int, go[int(where * len(go))]))
        plan = folder / "plan.json"
        plan_file(scoremap, plan, PlanRequest((start,), Spending(30, "steps"), effort=0.01, samples=4, or_stay=True))
        options = MissionOptions(tolerance_m=tolerance_m, spacing_m=spacing_m)
        for name, entry in FORMATS.items():
            path = folder / f"mission{entry.suffixes[0]}"
            export_missions(plan, path, options, scoremap_path=scoremap, aoi_path=within, keep_out_paths=[without])
            lonlat = read_positions(name, path.read_text(), folder)
            line = moved(shapely.LineString(np.array(lonlat).repeat(2, axis=0)), "EPSG:4326", LOCAL)
            assert not line.intersects(keep_out), name
            assert aoi is None or line.within(aoi), name
