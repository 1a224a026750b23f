"""Round after round of one robot: several logs, ground that became no-go, and a robot with nothing left to do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bag_files import odometry, write
from click.testing import CliRunner, Result

from hrt_cli.artifacts.plan import read_plan
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.main import cli
from hrt_cli.planning.resume import driven_cells, read_drives
from hrt_cli.raster.scoremap import Scoremap, read_scoremap

SCORE = (0.1 + np.random.default_rng(4).random((14, 18))).astype(np.float32)
CELL_M = 2.0


@pytest.fixture
def scoremap(tmp_path: Path) -> Path:
    return put_map(tmp_path / "map.npz")


def put_map(path: Path, no_go: list[tuple[int, int]] | None = None) -> Path:
    score = SCORE.copy()
    for cell in no_go or ():
        score[cell] = np.nan
    np.savez(path, score=score, cell_size_m=np.float64(CELL_M))
    return path


def log_of(path: Path, cells: list[tuple[int, int]], stuck: tuple[int, ...] = (), t0: float = 0.0) -> Path:
    lines = [json.dumps({"format": "hrt-drive-log", "version": 1})]
    for k, (row, col) in enumerate(cells):
        record = {"t": t0 + k, "x": (col + 0.5) * CELL_M, "y": -(row + 0.5) * CELL_M}
        lines.append(json.dumps(record | ({"event": "stuck"} if k in stuck else {})))
    path.write_text("\n".join(lines) + "\n")
    return path


def hrt(*words: object) -> Result:
    return CliRunner().invoke(cli, list(map(str, words)))


def plan(*words: object) -> Result:
    done = hrt("plan", *words, "--effort", 0.1, "--overwrite")
    assert done.exit_code == 0, f"{done.output} {done.exception}"
    return done


def loaded(path: Path) -> Scoremap:
    return read_scoremap(path)


def test_successive_drives_of_one_robot_are_one(scoremap: Path, tmp_path: Path) -> None:
    first = [(2, 2), (2, 3), (2, 4), (3, 4)]
    second = [(3, 4), (4, 4), (5, 4), (5, 5)]
    logs = [log_of(tmp_path / "1.jsonl", first, (2,)), log_of(tmp_path / "2.jsonl", second)]
    output = tmp_path / "p.json"
    plan(scoremap, "-o", output, "--budget", 30, "--visited", logs[0], "--visited", logs[1])
    document = read_plan(output)
    assert document.start == (5, 5)
    assert document.steps == 30 - 3 - 3
    assert set(document.collected) == {*first, *second}
    assert document.blocked == [(2, 4)]
    plan(scoremap, "-o", output, "--budget", "60m", "--visited", logs[0], "--visited", logs[1])
    assert read_plan(output).length_m <= 60 - 2 * 3 * CELL_M + 1e-6
    assert read_plan(output).budget.cells == pytest.approx(24)
    plan(scoremap, "-o", output, "--budget", "1min", "--visited", logs[0], "--visited", logs[1])
    assert read_plan(output).budget.cells == pytest.approx((60 - 3 - 3) / CELL_M)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_what_lies_between_two_drives_costs_nothing(scoremap: Path, tmp_path: Path, connectivity: int) -> None:
    """Between the drives the robot was carried back to its start."""
    logs = [
        log_of(tmp_path / "1.jsonl", [(0, 0), (0, 1), (0, 2), (0, 3)]),
        log_of(tmp_path / "2.jsonl", [(9, 9), (10, 9)]),
    ]
    found = read_drives(logs, loaded(scoremap))
    assert found.spent("steps", connectivity) == 4
    assert found.spent("m", connectivity) == pytest.approx(4 * CELL_M)
    assert found.spent("min", connectivity) == pytest.approx(4 / 60)
    assert (5, 5) not in {tuple(cell) for cell in found.cells.tolist()}


def test_one_drive_cut_in_two_is_the_same_to_the_plan(scoremap: Path, tmp_path: Path) -> None:
    cells = [(2, 2), (2, 3), (3, 3), (4, 3), (4, 4), (5, 4)]
    whole = read_drives([log_of(tmp_path / "w.jsonl", cells, (1,))], loaded(scoremap))
    parts = [
        log_of(tmp_path / "a.jsonl", cells[:4], (1,)),
        log_of(tmp_path / "b.jsonl", cells[3:], t0=3.0),
    ]
    cut = read_drives(parts, loaded(scoremap))
    assert cut.stands == whole.stands
    assert cut.blocked == whole.blocked
    assert {*map(tuple, cut.cells.tolist())} == {*map(tuple, whole.cells.tolist())}
    for unit in ("steps", "m", "min"):
        assert cut.spent(unit, 4) == pytest.approx(whole.spent(unit, 4))


def test_a_drive_over_the_edge_of_the_map_and_back(scoremap: Path, tmp_path: Path) -> None:
    log = log_of(tmp_path / "d.jsonl", [(1, 1), (0, 1), (-1, 1), (-1, 2), (0, 2)])
    found = read_drives([log], loaded(scoremap))
    assert found.cells.tolist() == [[1, 1], [0, 1], [0, 2]]
    assert found.spent("steps", 4) == 4
    off = log_of(tmp_path / "o.jsonl", [(1, 1), (0, 1), (-1, 1)])
    with pytest.raises(InputError, match="ends off the scoremap, at row -1, column 1"):
        read_drives([off], loaded(scoremap))
    assert driven_cells(off, loaded(scoremap)).tolist() == [[1, 1], [0, 1]]
    with pytest.raises(InputError, match="lies wholly off"):
        driven_cells(log_of(tmp_path / "x.jsonl", [(-5, 1), (-6, 1)]), loaded(scoremap))


def test_a_log_of_one_record(scoremap: Path, tmp_path: Path) -> None:
    found = read_drives([log_of(tmp_path / "d.jsonl", [(3, 4)], (0,))], loaded(scoremap))
    assert (found.stands, found.blocked, found.length_m) == ((3, 4), [], 0.0)
    assert found.spent("steps", 8) == 0


def test_nobody_drove_over_the_break_of_a_gpx_track(tmp_path: Path) -> None:
    from affine import Affine
    from rasterio.crs import CRS

    from hrt_cli.raster.grid import Grid

    def segment(minute: int, lon: float) -> str:
        points = [
            f'<trkpt lat="44.99995" lon="{lon + 1e-5 * k}"><time>2024-05-01T10:{minute:02}:{k:02}Z</time></trkpt>'
            for k in range(3)
        ]
        return f"<trkseg>{''.join(points)}</trkseg>"

    log = tmp_path / "d.gpx"
    log.write_text(
        '<gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1"><trk>'
        f"{segment(0, 15.000005)}{segment(5, 15.000105)}</trk></gpx>"
    )
    grid = Grid(10, 20, Affine(1e-5, 0, 15.0, 0, -1e-5, 45.0), CRS.from_epsg(4326))
    ones = np.ones(grid.shape, np.float32)
    found = read_drives([log], Scoremap(ones, ones, grid, 1.0))
    assert sorted({col for _, col in found.cells.tolist()}) == [0, 1, 2, 10, 11, 12]
    assert found.spent("steps", 4) == 4
    assert found.length_m == pytest.approx(4 * 0.788, rel=0.01)


def test_what_was_taken_for_granted_in_reading_a_log_is_told(tmp_path: Path) -> None:
    scoremap, log = put_map(tmp_path / "map.npz"), tmp_path / "d.csv"
    log.write_text("time,x,y,v\n0,5,-5,1\n2,7,-5,1\n")
    done = plan(scoremap, "-o", tmp_path / "p.json", "--budget", 20, "--visited", log, "--visited", log)
    assert done.stderr.count(f"Note: {log}: takes v to be in m/s") == 2
    wheels = write(tmp_path, [odometry(k, 5 + k, -5) for k in range(3)], "mcap folder")
    refused = hrt("plan", scoremap, "-o", tmp_path / "q.json", "--budget", 20, "--visited", wheels)
    assert "own frame odom, which is not on the map" in str(refused.exception)


def test_a_robot_on_ground_that_became_no_go_goes_back_on_its_own_track(tmp_path: Path) -> None:
    driven = [(2, 2), (2, 3), (3, 3), (3, 4), (3, 5)]
    scoremap = put_map(tmp_path / "map.npz", [(3, 4), (3, 5)])
    log, output = log_of(tmp_path / "d.jsonl", driven, (4,)), tmp_path / "p.json"
    done = plan(scoremap, "-o", output, "--budget", 20, "--visited", log)
    assert "ends in cell 3,5, which is no-go: the robot has to go back to 3,3" in done.stderr
    document = read_plan(output)
    assert document.start == document.cells[0] == (3, 3)
    assert document.start not in document.blocked
    assert not {(3, 4), (3, 5)} & set(document.cells)
    # Of two drives too: the second one never was on other ground.
    second = log_of(tmp_path / "2.jsonl", [(3, 4), (3, 5)])
    done = plan(scoremap, "-o", output, "--budget", 20, "--visited", log, "--visited", second)
    assert read_plan(output).start == (3, 3)
    alone = plan(scoremap, "-o", tmp_path / "q.json", "--budget", 20, "--visited", second)
    assert "the robot has been on no other ground, and the plan starts there" in alone.stderr
    assert read_plan(tmp_path / "q.json").start == (3, 5)


def test_the_cell_that_a_robot_goes_back_to_is_not_blocked(tmp_path: Path) -> None:
    scoremap = put_map(tmp_path / "map.npz", [(3, 4)])
    log = log_of(tmp_path / "d.jsonl", [(2, 2), (2, 3), (3, 3), (3, 4)], (2,))
    found = read_drives([log], loaded(scoremap))
    assert (found.stands, found.blocked) == ((3, 3), [])


def test_a_robot_with_nothing_left_stays_if_it_may(scoremap: Path, tmp_path: Path) -> None:
    log, output = log_of(tmp_path / "d.jsonl", [(2, k) for k in range(10)]), tmp_path / "p.json"
    words = ["plan", scoremap, "-o", output, "--budget", 9, "--visited", log]
    refused = hrt(*words)
    assert isinstance(refused.exception, ArgumentError)
    assert "took 9 steps of a budget of 9" in str(refused.exception)
    assert not output.exists()
    done = hrt(*words, "--or-stay", "--json")
    assert done.exit_code == 0, done.output
    assert "the robot stays where it is" in done.stderr
    said = json.loads(done.stdout)
    assert (said["method"], said["steps"], said["score"], said["length_m"]) == ("stay", 0, 0.0, 0.0)
    document = read_plan(output)
    assert document.cells == [document.start] == [(2, 9)]
    assert len(document.waypoints) == 1
    assert document.score == 0.0, "it has collected the cell on which it stands"
    again = hrt(*words, "--or-stay", "--json")
    assert json.loads(again.stdout)["up_to_date"]
    assert hrt("verify", output).exit_code == 0
    assert hrt(*words[:5], "9.5m", *words[6:], "--overwrite", "--or-stay").exit_code == 0
    for name in ("m.gpx", "m.plan", "m.waypoints", "m.geojson"):
        assert hrt("export", output, "-o", tmp_path / name).exit_code in (0, 1), "it crashes"


def test_a_walled_in_robot_stays_if_it_may(tmp_path: Path) -> None:
    walls = [(3, 4), (5, 4), (4, 3), (4, 5)]
    scoremap, output = put_map(tmp_path / "map.npz", walls), tmp_path / "p.json"
    words = ["plan", scoremap, "-o", output, "--start", "cell:4,4", "--budget", 20]
    assert "walled in" in str(hrt(*words).exception)
    assert hrt(*words, "--or-stay").exit_code == 0
    document = read_plan(output)
    assert document.method == "stay"
    assert document.score == document.upper_bound == pytest.approx(float(SCORE[4, 4]))
    # By the cells in which it got stuck as well.
    scoremap = put_map(tmp_path / "other.npz", walls[:3])
    log = log_of(tmp_path / "d.jsonl", [(4, 4), (4, 5), (4, 4)], (1,))
    assert (
        hrt("plan", scoremap, "-o", tmp_path / "q.json", "--budget", 20, "--visited", log, "--or-stay").exit_code == 0
    )
    document = read_plan(tmp_path / "q.json")
    assert (document.method, document.start, document.blocked) == ("stay", (4, 4), [(4, 5)])


def test_or_stay_covers_up_no_other_refusal(scoremap: Path, tmp_path: Path) -> None:
    blocked = put_map(tmp_path / "b.npz", [(0, 0)])
    for words in (
        [scoremap, "--start", "cell:99,0", "--budget", 9],
        [blocked, "--start", "cell:0,0", "--budget", 9],
        [scoremap, "--start", "cell:0,0", "--end", "cell:9,9", "--budget", 9],
        [scoremap, "--budget", 9],
    ):
        done = hrt("plan", *words, "-o", tmp_path / "p.json", "--or-stay")
        assert isinstance(done.exception, ArgumentError), words
        assert not (tmp_path / "p.json").exists()


def test_a_robot_that_has_to_end_elsewhere_does_not_stay(scoremap: Path, tmp_path: Path) -> None:
    log = log_of(tmp_path / "d.jsonl", [(2, k) for k in range(10)])
    words = ["plan", scoremap, "-o", tmp_path / "p.json", "--budget", 9, "--visited", log, "--or-stay"]
    assert hrt(*words, "--end", "cell:0,0").exit_code != 0
    assert not (tmp_path / "p.json").exists()
    assert hrt(*words, "--return-home").exit_code == 0
    assert hrt(*words, "--end", "cell:2,9", "--overwrite").exit_code == 0


def test_standstills_near_one_another_block_ever_wider(scoremap: Path, tmp_path: Path) -> None:
    """Three times before the same thing, and once far from it; what was driven through stays open."""
    ways = [[(7, 2), (7, 3), (7, 4), (7, 5)], [(6, 3), (6, 4), (6, 5)], [(8, 3), (8, 4), (8, 5)], [(1, 13), (1, 14)]]
    logs = [log_of(tmp_path / f"{k}.jsonl", way, (len(way) - 1,)) for k, way in enumerate(ways)]
    driven = {cell for way in ways for cell in way}
    # The robot stands in the last cell of each and was heading east: the cell ahead stopped it.
    hits = [(7, 6), (6, 6), (8, 6), (1, 15)]
    for count in range(1, 5):
        found = read_drives(logs[:count], loaded(scoremap))
        expected = {hits[0]}
        for number, (row, col) in enumerate(hits[:count]):
            reach = min(number, 2) if number < 3 else 0
            disc = {(r, c) for r in range(14) for c in range(18) if np.hypot(r - row, c - col) <= reach}
            expected |= (disc - driven) | {(row, col)}
        assert set(found.blocked) == expected


def test_a_heading_tells_what_stopped_a_robot_that_never_moved(scoremap: Path, tmp_path: Path) -> None:
    log = log_of(tmp_path / "1.jsonl", [(5, 5), (5, 5)], (1,))
    assert read_drives([log], loaded(scoremap)).blocked == []
    log.write_text(log.read_text().replace('"event"', '"heading_deg": 90.0, "event"'))
    assert read_drives([log], loaded(scoremap)).blocked == [(5, 6)]
