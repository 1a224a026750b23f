"""`hrt report` from artifacts to a page that a browser shows with the network off."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import browser
import pytest

from hrt_cli.artifacts.html import html_provenance

MEADOW = Path(__file__).parents[3] / "fixtures" / "meadow"
ENV = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}

pytestmark = pytest.mark.slow


def hrt(*args: str | Path, cwd: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hrt_cli.main", *map(str, args)]
    done = subprocess.run(command, cwd=cwd, env=ENV, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A meadow from orthomosaic to a drive that taught scores, with what the camera saw."""
    folder = tmp_path_factory.mktemp("trial")
    shutil.copytree(MEADOW, folder / "site")
    hrt("segment", "site/ortho.tif", "-o", "classes.tif", "--classes", "5", cwd=folder)
    hrt("scoremap", "classes.tif", "-o", "scoremap.tif", cwd=folder)
    hrt("plan", "scoremap.tif", "-o", "plan.json", "--start", "auto", "--budget", "60", "--speed", "1", cwd=folder)
    drive = ("drive", "plan.json", "--world", "site", "-o", "drive.jsonl", "--record", "frames")
    hrt(*drive, "--local", "expert", cwd=folder)
    hrt("feedback", "drive.jsonl", "--classes", "classes.tif", "-o", "scores.json", cwd=folder)
    team = ("--robots", "2", "--start", "auto", "--budget", "30")
    hrt("plan", "scoremap.tif", "-o", "team.json", *team, cwd=folder)
    hrt("train-plan", "scoremap.tif", "-o", "policy.npz", "--iterations", "3", cwd=folder)
    bins = [{"count": 8, "confidence": 0.3, "accuracy": 0.25}, {"count": 0, "confidence": None, "accuracy": None}]
    steer = {"mae": 0.2, "nll": 1.5, "ece": 0.05, "reliability": {"yaw": bins}, "constant_baseline_mae": 0.3}
    (folder / "steer.json").write_text(json.dumps(steer))
    (folder / "torn.json").write_text('{"format": ')
    return folder


@pytest.fixture(scope="module")
def report(trial: Path) -> Path:
    done = hrt("report", ".", "-o", "report.html", "--title", "A & <b>meadow</b>", "--json", cwd=trial)
    told = json.loads(done.stdout)
    assert told["sites"] == 1
    assert told["plans"] == 2
    assert told["drives"] == 1
    assert any("torn.json" in problem for problem in told["problems"])
    assert "Note: torn.json" in done.stderr
    return trial / "report.html"


def test_the_page_is_up_to_date_and_verified_and_the_same_from_anywhere(
    trial: Path, report: Path, tmp_path: Path
) -> None:
    again = hrt("report", ".", "-o", "report.html", "--title", "A & <b>meadow</b>", cwd=trial)
    assert "up to date" in again.stdout
    hrt("verify", "report.html", cwd=trial)
    hrt("report", trial, "-o", tmp_path / "other.html", "--title", "A & <b>meadow</b>", cwd=tmp_path)
    assert (tmp_path / "other.html").read_bytes() == report.read_bytes()
    found = html_provenance(report)
    assert found is not None
    assert "file/plan.json" in {each.role for each in found.inputs}


def test_another_page_is_not_replaced_unasked(trial: Path, report: Path) -> None:
    before = report.read_bytes()
    refused = hrt("report", ".", "-o", "report.html", "--frames", "0", cwd=trial, code=1)
    assert "--overwrite" in refused.stderr
    assert report.read_bytes() == before


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("nothing", "-o", "x.html"), "no such file or folder"),
        (("empty", "-o", "x.html"), "nothing that can be shown"),
        (("plan.json", "-o", "x.pdf"), ".html"),
        (("plan.json", "-o", "x.html", "--world", "frames"), "holds no ortho.tif"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(trial: Path, args: tuple[str, ...], word: str) -> None:
    (trial / "empty").mkdir(exist_ok=True)
    done = hrt("report", *args, cwd=trial, code=1)
    assert word in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (trial / args[2]).exists()


@pytest.mark.skipif(not browser.is_wanted(), reason="there is no Chromium")
def test_a_browser_shows_it_all_without_a_network(trial: Path, report: Path) -> None:
    browser.check_report(report)
    with browser.opened(report) as shown:
        page = shown.page
        assert page.title() == "A & <b>meadow</b>"
        plan = json.loads((trial / "plan.json").read_text())
        site = shown.data()["sites"][0]
        names = [line["name"] for line in site["plans"]]
        assert names == ["plan.json", "team.json, robot 1", "team.json, robot 2"]
        for point, wanted in zip(site["plans"][0]["waypoints"], plan["waypoints"], strict=True):
            assert (point["x"], point["y"], point["lon"], point["lat"]) == (
                wanted["x"], wanted["y"], wanted["lon"], wanted["lat"],
            )  # fmt: skip
        charts = page.locator(".chart figcaption").all_inner_texts()
        for word in ("cumulative reward", "before and after", "learning curve", "reliability", "nearest obstacle"):
            assert any(word in chart for chart in charts), charts
        assert len(charts) == len(shown.data()["charts"])
        assert "as the camera saw it" in page.locator(".camera figcaption").inner_text()
        page.locator("#waypoints summary").first.click()
        row = page.locator("#waypoints tbody tr").nth(1)
        row.hover()
        assert "waypoint 2" in shown.tip()
        assert row.locator("td").nth(1).inner_text() == f"{plan['waypoints'][1]['lat']:.7f}"
        first = page.locator(".chart").first
        first.locator("summary").click()
        assert first.locator("tbody tr").count() > 10
        files = page.locator(".files").inner_text()
        assert "torn.json" in files
        assert "drive.jsonl drive log, made by hrt drive" in files


@pytest.mark.skipif(not browser.is_wanted(), reason="there is no Chromium")
def test_the_page_tells_what_a_place_is(trial: Path, report: Path) -> None:
    from hrt_cli.raster.classes import open_classes
    from hrt_cli.raster.scoremap import read_scoremap
    from hrt_cli.raster.windows import Window

    scoremap = read_scoremap(trial / "scoremap.tif")
    with browser.opened(report) as shown:
        for title in ("classes.tif", "scoremap.tif"):
            shown.page.locator(".entry", has_text=title).filter(has=shown.page.locator(".swatch.layer")).locator(
                "input[type=checkbox]"
            ).last.check()
        shown.settle()
        box = shown.page.locator(".frame").bounding_box()
        compared = 0
        for across, down in ((0.35, 0.3), (0.5, 0.5), (0.6, 0.42), (0.42, 0.66)):
            shown.page.mouse.move(box["x"] + across * box["width"], box["y"] + down * box["height"])
            said = shown.page.locator(".place").text_content().split("  ·  ")
            lat, lon = map(float, said[0].split(", "))
            x, y = scoremap.grid.xy_of_lonlat(lon, lat)
            row, col = (int(each) for each in scoremap.grid.rowcol(x, y))
            with open_classes(trial / "classes.tif") as raster:
                r, c = (int(each) for each in raster.grid.rowcol(x, y))
                k = int(raster.read(Window(r, c, 1, 1))[0, 0])
            if k == 255:
                continue
            compared += 1
            assert f"class {k}" in said
            score = next(float(part.split()[-1]) for part in said if part.startswith("score "))
            assert score == pytest.approx(float(scoremap.score[row, col]), abs=1e-3)
        assert compared >= 2
