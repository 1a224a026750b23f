"""From a plan's file to the mission's, as a user calls it: teams, folders, what is up to date and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from affine import Affine
from click.testing import CliRunner, Result
from mission_samples import ADELAIDE, UTM_SOUTH, transform_at
from nav2_reader import keepout_cost, load_graph, load_map
from rasterio.crs import CRS

from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.provenance import InputRecord, Provenance, file_sha256
from hrt_cli.main import cli
from hrt_cli.missions.formats import FORMATS
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap, read_scoremap

MADE = Provenance(
    tool="hrt", version="0", stage="scoremap", stage_version=1, parameters={}, inputs=[], fingerprint="0" * 64
)
NAV2_FILES = {
    "gps_waypoints.yaml", "path.yaml", "datum.yaml", "navsat_transform.yaml", "route.geojson",
    "scoremap.yaml", "scoremap.pgm", "keepout_mask.yaml", "keepout_mask.pgm", "speed_mask.yaml", "speed_mask.pgm",
    "filter_info.yaml",
}  # fmt: skip


def hrt(*words: object) -> Result:
    return CliRunner().invoke(cli, list(map(str, words)))


def run(*words: object) -> dict[str, Any]:
    result = hrt(*words, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def refusal(*words: object) -> str:
    """The message of the refusal."""
    result = hrt(*words)
    assert result.exit_code != 0
    return str(result.exception) + result.output


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scoremap, a plan on it, and the plan of a team."""
    folder = tmp_path_factory.mktemp("site")
    score = np.random.default_rng(4).random((14, 18)).astype(np.float32)
    score[5:8, 6:9] = np.nan
    grid = Grid(14, 18, Affine(*transform_at(UTM_SOUTH, ADELAIDE, 2.0, 20.0)), CRS.from_user_input(UTM_SOUTH))
    made = Scoremap(score, np.zeros_like(score), grid, 2.0)
    publish_scoremap(folder / "map.tif", made, MADE, tags={}, creation={})
    plan = ["plan", folder / "map.tif", "--budget", 40, "--effort", 0.1, "--start"]
    run(*plan, "cell:0,0", "-o", folder / "plan.json")
    run(*plan, "cell:0,0", "--start", "cell:13,17", "--robots", 2, "-o", folder / "team.json")
    return folder


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_is_written_and_then_up_to_date(name: str, site: Path, tmp_path: Path) -> None:
    output = tmp_path / f"mission{FORMATS[name].suffixes[0]}"
    said = run("export", site / "plan.json", "-o", output)
    assert (said["format"], said["up_to_date"], said["output"]) == (name, False, str(output))
    content = output.read_bytes()
    assert run("export", site / "plan.json", "-o", output)["up_to_date"]
    assert output.read_bytes() == content


@pytest.mark.parametrize(("plan", "suffix"), [("plan.json", ".gpx"), ("team.json", ".plan")])
def test_the_mission_is_drawn_alike_for_every_format(plan: str, suffix: str, site: Path, tmp_path: Path) -> None:
    words = ["export", site / plan, "--figure", tmp_path / "f.png", "--tolerance", 3, "--scoremap", site / "map.tif"]
    run(*words, "-o", tmp_path / f"m{suffix}")
    before = (tmp_path / "f.png").read_bytes()
    run(*words, "-o", tmp_path / "m.kml")  # the figure is up to date, or this would be refused
    assert (tmp_path / "f.png").read_bytes() == before
    found = png_provenance(tmp_path / "f.png")
    assert found is not None
    assert [each.role for each in found.inputs] == ["plan", "scoremap"]


def test_a_nav2_folder_holds_all_its_files_and_is_then_up_to_date(site: Path, tmp_path: Path) -> None:
    words = ["export", site / "plan.json", "-o", tmp_path / "site", "--format", "nav2", "--scoremap", site / "map.tif"]
    assert not run(*words)["up_to_date"]
    assert {path.name for path in (tmp_path / "site").iterdir()} == NAV2_FILES
    assert run(*words)["up_to_date"]
    (tmp_path / "site" / "datum.yaml").write_text("latitude: 0.0\n")
    assert "--overwrite" in refusal(*words)
    assert not run(*words, "--overwrite")["up_to_date"]
    assert yaml.safe_load((tmp_path / "site" / "datum.yaml").read_text())["latitude"] < -30


def test_a_folder_with_files_of_others_is_left_alone(site: Path, tmp_path: Path) -> None:
    words = ["export", site / "plan.json", "-o", tmp_path / "site", "--format", "nav2"]
    run(*words)
    mine = tmp_path / "site" / "mine.txt"
    mine.write_text("mine")
    assert "--overwrite" in refusal(*words)
    assert mine.read_text() == "mine"


def test_no_waypoint_of_a_nav2_folder_is_kept_out_by_its_own_masks(site: Path, tmp_path: Path) -> None:
    folder = tmp_path / "site"
    run("export", site / "plan.json", "-o", folder, "--format", "nav2", "--scoremap", site / "map.tif")
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    mask = load_map(files, "keepout_mask.yaml")
    poses = yaml.safe_load(files["path.yaml"])["poses"]
    places = [(pose["pose"]["position"]["x"], pose["pose"]["position"]["y"]) for pose in poses]
    assert len(places) > 5
    assert max(keepout_cost(mask, x, y, 0) for x, y in places) < 253
    nodes, _ = load_graph(files["route.geojson"])
    assert len(nodes) == len(set(places))


@pytest.mark.parametrize("output", ["mission.plan", "mission.yaml", "nav2"])
def test_a_team_gets_a_mission_each(output: str, site: Path, tmp_path: Path) -> None:
    target = tmp_path / output
    said = run("export", site / "team.json", "-o", target, *(["--format", "nav2"] if "plan" not in output else []))
    paths = [target.with_name(f"{target.stem}-{robot}{target.suffix}") for robot in (1, 2)]
    assert [mission["output"] for mission in said["missions"]] == list(map(str, paths))
    assert sorted(tmp_path.iterdir()) == paths
    alone = tmp_path / "alone" / output
    alone.parent.mkdir()
    run("export", site / "team-2.json", "-o", alone, *(["--format", "nav2"] if "plan" not in output else []))
    assert contents(alone) == contents(paths[1])


def contents(path: Path) -> Any:
    """A file's bytes, or those of a folder's files; without the comments that tell the name."""
    if path.is_dir():
        return {each.name: contents(each) for each in sorted(path.iterdir())}
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


def test_depth_and_a_negative_altitude_are_the_same(site: Path, tmp_path: Path) -> None:
    words = ["export", site / "plan.json", "--vehicle", "submarine", "-o"]
    run(*words, tmp_path / "a.waypoints", "--depth", 3.5)
    run(*words, tmp_path / "b.waypoints", "--altitude", -3.5)
    assert (tmp_path / "a.waypoints").read_bytes() == (tmp_path / "b.waypoints").read_bytes()
    run(*words, tmp_path / "c.bhv", "--depth", 3.5)
    assert "= 3.500" in (tmp_path / "c.bhv").read_text()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--depth", "3", "--altitude", "-3", "--vehicle", "submarine"], "give one"),
        (["--depth", "3", "--above-bottom", "3", "--vehicle", "submarine"], "give one"),
        (["--depth", "3"], "submarine"),
        (["--above-bottom", "3"], "submarine"),
        (["--above-bottom", "3", "--vehicle", "submarine", "--format", "moos"], "height above the bottom"),
        (["--above-bottom", "3", "--vehicle", "submarine", "--format", "nav2"], "height above the bottom"),
        (["--hold", "3", "--format", "moos"], "does not wait"),
        (["--datum", "0,86", "--format", "csv"], "UTM does not reach"),
        (["--format", "kmz"], "kmz"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_is_written(
    words: list[str], reason: str, site: Path, tmp_path: Path
) -> None:
    assert reason in refusal("export", site / "plan.json", "-o", tmp_path / "mission.plan", *words)
    assert not list(tmp_path.iterdir())


def test_a_scoremap_lets_tolerance_leave_out_more(site: Path, tmp_path: Path) -> None:
    words = ["export", site / "plan.json", "--tolerance", 3, "-o"]
    alone = run(*words, tmp_path / "a.csv")["waypoints"]
    with_map = run(*words, tmp_path / "b.csv", "--scoremap", site / "map.tif")["waypoints"]
    exact = run("export", site / "plan.json", "-o", tmp_path / "c.csv")["waypoints"]
    assert with_map < exact
    assert with_map <= alone <= exact


def test_a_scoremap_of_another_grid_is_refused(site: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", score=np.ones((4, 5), np.float32))
    said = refusal("export", site / "plan.json", "-o", tmp_path / "m.csv", "--scoremap", tmp_path / "other.npz")
    assert "other.npz" in said


def test_the_datum_moves_the_metres(site: Path, tmp_path: Path) -> None:
    words = ["export", site / "plan.json", "--local-frame", "enu", "-o"]
    run(*words, tmp_path / "a.csv")
    run(*words, tmp_path / "b.csv", "--datum", f"{ADELAIDE[0]},{ADELAIDE[1] - 0.001}")
    first, second = (np.genfromtxt(tmp_path / name, delimiter=",", names=True) for name in ("a.csv", "b.csv"))
    assert np.ptp(second["y_m"] - first["y_m"]) < 0.01
    assert second["y_m"][0] > first["y_m"][0]
    assert np.array_equal(first["lat"], second["lat"])


def test_legs_within_the_autopilot_s_radius_are_told(site: Path, tmp_path: Path) -> None:
    near = hrt("export", site / "plan.json", "-o", tmp_path / "m.plan", "--spacing", 1)
    assert "waypoints are as little as 1 m apart: set WP_RADIUS" in near.stderr
    assert "WP_RADIUS" not in hrt("export", site / "plan.json", "-o", tmp_path / "m.gpx", "--spacing", 1).stderr
    px4 = hrt("export", site / "plan.json", "-o", tmp_path / "p.plan", "--spacing", 1, "--firmware", "px4")
    assert "WP_RADIUS" not in px4.stderr


def test_cells_that_are_passed_beside_are_counted(site: Path, tmp_path: Path) -> None:
    exact = run("export", site / "plan.json", "-o", tmp_path / "a.plan")
    assert exact["passed_by"] == 0
    done = hrt(
        "export", site / "plan.json", "-o", tmp_path / "b.plan", "--tolerance", 4, "--scoremap", site / "map.tif"
    )
    assert re.search(r"Note: [1-9]\d* cells of the plan are passed within the tolerance, not entered", done.stderr)


def test_too_many_items_are_refused_with_a_tolerance_that_makes_room(site: Path, tmp_path: Path) -> None:
    words = ["export", site / "plan.json", "-o", tmp_path / "m.plan", "--scoremap", site / "map.tif"]
    count = run(*words)["waypoints"] + 2
    limit = count - 12
    said = refusal(*words, "--overwrite", "--max-items", limit)
    tolerance = re.search(r"--tolerance ([0-9.]+) makes (\d+) of them", said)
    assert tolerance is not None, said
    done = run(*words, "--overwrite", "--max-items", limit, "--tolerance", tolerance[1])
    assert done["waypoints"] + 2 == int(tolerance[2]) <= limit


def test_a_plan_that_enters_what_is_no_go_by_now_is_refused_unless_the_robot_stands_there(
    site: Path, tmp_path: Path
) -> None:
    found = read_scoremap(site / "map.tif")
    cells = json.loads((site / "plan.json").read_text())["cells"]
    for cell, refused in ((cells[0], False), (cells[5], True)):
        score = found.score.copy()
        score[tuple(cell)] = np.nan
        barred = tmp_path / f"barred-{refused}.tif"
        publish_scoremap(barred, Scoremap(score, found.sd, found.grid, 2.0), MADE, tags={}, creation={})
        words = ["export", site / "plan.json", "-o", tmp_path / f"{refused}.plan", "--scoremap", barred]
        if refused:
            assert f"enters cell {cell[0]},{cell[1]}, which is no-go" in refusal(*words)
        else:
            run(*words)


def test_areas_that_the_map_was_made_with_are_missed(site: Path, tmp_path: Path) -> None:
    lon, lat = ADELAIDE
    ring = [[lon - 1, lat - 1], [lon + 1, lat - 1], [lon + 1, lat + 1], [lon - 1, lat + 1], [lon - 1, lat - 1]]
    area = tmp_path / "area.geojson"
    area.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    known = InputRecord(role="aoi", name="area.geojson", sha256=file_sha256(area), size=area.stat().st_size)
    found = read_scoremap(site / "map.tif")
    publish_scoremap(tmp_path / "m.tif", found, MADE.model_copy(update={"inputs": [known]}), tags={}, creation={})
    words = ["export", site / "plan.json", "--scoremap", tmp_path / "m.tif", "-o"]
    assert "made with area.geojson, which is not given" in hrt(*words, tmp_path / "a.plan").stderr
    assert "not given" not in hrt(*words, tmp_path / "b.plan", "--aoi", area).stderr
    assert "not given" not in hrt(*words, tmp_path / "c.kml").stderr
