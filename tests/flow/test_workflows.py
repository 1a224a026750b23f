"""The Makefile and the Snakefile of a project: they run, a second run does nothing, a parameter reruns what it must."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ENV = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


@pytest.fixture
def project(tmp_path: Path) -> Path:
    folder = tmp_path / "project"
    subprocess.run(["hrt", "init", str(folder)], env=ENV, check=True, capture_output=True)
    shutil.copy(ROOT / "fixtures" / "meadow" / "ortho.tif", folder / "ortho.tif")
    config = (folder / "config.yaml").read_text()
    (folder / "config.yaml").write_text(
        config.replace("budget: 300 ", "budget: 40 ").replace("classes: 5 ", "classes: 4 ")
    )
    return folder


def make(folder: Path, *args: str) -> str:
    done = subprocess.run(["make", "-C", str(folder), *args], env=ENV, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make(project: Path) -> None:
    make(project)
    out = project / "out"
    names = ("classes.tif", "scoremap.tif", "plan.json", "mission.plan", "mission.gpx", "mission.kml", "nav2/path.yaml")
    for name in (*names, "plan.png", "model.npz"):
        assert (out / name).stat().st_size > 0
    assert "Nothing to be done" in make(project)
    # A touched input with the same bytes: every stage finds itself up to date, and then make is at rest.
    (project / "ortho.tif").touch()
    assert "up to date" in make(project)
    assert "Nothing to be done" in make(project)
    # Another budget touches neither classes nor scoremap.
    kept = {name: (out / name).stat().st_mtime_ns for name in ("classes.tif", "scoremap.tif")}
    again = make(project, "budget=30")
    assert "hrt plan" in again
    assert "hrt segment" not in again
    assert kept == {name: (out / name).stat().st_mtime_ns for name in kept}
    make(project, "clean")
    assert not out.exists()


@pytest.mark.skipif(shutil.which("snakemake", path=ENV["PATH"]) is None, reason="snakemake is not installed")
def test_snakemake(project: Path) -> None:
    command = ["snakemake", "--cores", "1", "--directory", str(project), "--snakefile", str(project / "Snakefile")]
    done = subprocess.run(command, env=ENV, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in ("mission.plan", "mission.csv", "nav2/keepout_mask.pgm"):
        assert (project / "out" / name).stat().st_size > 0
    again = subprocess.run(command, env=ENV, capture_output=True, text=True, check=True)
    assert "Nothing to be done" in again.stdout + again.stderr


def put_limits(folder: Path) -> dict[str, str]:
    """Put an area of interest and two keep-outs about the middle of the sample site into a project."""
    shutil.copy(ROOT / "fixtures" / "meadow" / "aoi.geojson", folder / "area.geojson")
    ring = json.loads((folder / "area.geojson").read_text())["features"][0]["geometry"]["coordinates"][0]
    lon, lat = (sum(axis) / len(ring) for axis in zip(*ring, strict=True))
    for name, east in (("pond", 0.0), ("shed", 4e-5)):
        corners = [(lon + east + x, lat + y) for x, y in ((0, 0), (2e-5, 0), (0, 2e-5), (0, 0))]
        points = " ".join(f"{x:.8f},{y:.8f}" for x, y in corners)
        (folder / f"{name}.kml").write_text(
            "<kml><Placemark><Polygon><outerBoundaryIs><LinearRing><coordinates>"
            f"{points}</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></kml>"
        )
    return {"aoi": "area.geojson", "keep_out": "pond.kml shed.kml", "no_go_below": "", "margin_m": "0.5"}


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_keeps_the_robot_within_its_limits(project: Path) -> None:
    given = [f"{key}={value}" for key, value in put_limits(project).items()]
    told = make(project, *given, "out/scoremap.tif")
    assert "--aoi area.geojson --keep-out pond.kml --keep-out shed.kml" in told
    assert "outside the area of interest" in told
    assert "up to date" in make(project, *given, "out/scoremap.tif")
    (project / "shed.kml").write_text((project / "shed.kml").read_text().replace("<kml>", "<kml >"))
    again = make(project, *given, "out/scoremap.tif")
    assert "hrt scoremap" in again
    assert "hrt segment" not in again
    assert "--margin" not in make(project, "-n", "no_go_below=", "margin_m=0.5", "out/scoremap.tif")
    make(project, *given, "tolerance_m=1", "out/mission.plan")
    fence = json.loads((project / "out" / "mission.plan").read_text())["geoFence"]["polygons"]
    assert [each["inclusion"] for each in fence] == [True, False, False]


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_lays_heights_and_heat_on_the_map(project: Path) -> None:
    site = ROOT / "fixtures" / "wildfire"
    for name in ("ortho", "dsm", "thermal"):
        shutil.copy(site / f"{name}.tif", project / f"{name}.tif")
    given = ["dsm=dsm.tif", "interest=thermal.tif", "interest_radius_m=2", "thermal_units=celsius"]
    told = make(project, *given, "out/scoremap.tif")
    assert "--dsm dsm.tif --interest thermal.tif --interest-radius 2 --thermal-units celsius" in " ".join(told.split())
    time.sleep(0.02)  # file systems count time in steps
    (project / "dsm.tif").touch()
    assert "hrt scoremap" in make(project, *given, "out/scoremap.tif")


@pytest.mark.skipif(shutil.which("snakemake", path=ENV["PATH"]) is None, reason="snakemake is not installed")
@pytest.mark.parametrize("file", ["Snakefile", "rounds.smk"])
def test_snakemake_keeps_it_there_by_the_same_options(project: Path, file: str) -> None:
    config = [f"{key}={value}" for key, value in {**put_limits(project), "robot": "real"}.items()]
    command = ["snakemake", "-n", "-p", "--cores", "1", "--directory", str(project), "--snakefile", str(project / file)]
    done = subprocess.run([*command, "--config", *config], env=ENV, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    options = r"--aoi area\.geojson --keep-out pond\.kml --keep-out shed\.kml +--margin 0\.5 "
    assert re.search(rf"hrt scoremap .*{options}", done.stdout + done.stderr)
    assert re.search(r"input: .*shed\.kml", done.stdout + done.stderr)


def test_init_leaves_edited_files_alone(project: Path) -> None:
    refused = subprocess.run(["hrt", "init", str(project)], env=ENV, capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "config.yaml" in refused.stderr
    assert "budget: 40" in (project / "config.yaml").read_text()


TINY = {
    "steer_glances": "24", "steer_rounds": "2", "steer_drives": "1", "steer_metres": "6", "steer_size": "32x32",
    "steer_columns": "1", "steer_batch": "8", "steer_rate": "0.001 0.0005", "steer_epochs": "1 1",
    "steer_test_drives": "1", "workers": "1",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_learns_to_steer(project: Path) -> None:
    world = ROOT / "fixtures" / "meadow"
    given = ["-f", "steer.mk", f"world={world}", *(f"{key}={value}" for key, value in TINY.items())]
    told = make(project, *given)
    steer = project / "out" / "steer"
    assert told.count("hrt train-steer") == 2
    assert "--rescue" in told
    assert json.loads((steer / "test" / "report.json").read_text())["drives"]
    assert "Nothing to be done" in make(project, *given)
    # A round more learns from all so far, and nothing before it is made again.
    more = make(project, "-n", *given, "steer_rounds=3", "steer_rate=0.001 0.0005 0.0005", "steer_epochs=1 1 1")
    assert "round-3/drive-1" in more
    failed = subprocess.run(
        ["make", "-C", str(project), *given, "steer_epochs=1"], env=ENV, capture_output=True, text=True
    )
    assert failed.returncode != 0
    assert "steer_epochs needs a number for each of the 2 rounds" in failed.stderr
    make(project, *given, "clean-steering")
    assert not steer.exists()


@pytest.mark.skipif(shutil.which("snakemake", path=ENV["PATH"]) is None, reason="snakemake is not installed")
@pytest.mark.parametrize(
    ("more", "count"), [({}, 7), ({"steer_worlds": str(ROOT / "fixtures" / "wildfire"), "steer_drives": "3"}, 12)]
)
def test_snakemake_would_learn_to_steer_by_the_same_commands(project: Path, more: dict[str, str], count: int) -> None:
    world = ROOT / "fixtures" / "meadow"
    file = project / "steer.smk"
    command = ["snakemake", "-n", "-p", "--cores", "1", "--directory", str(project), "--snakefile", str(file)]
    given = [f"{key}={value}" for key, value in (TINY | more).items()]
    done = subprocess.run([*command, "--config", f"world={world}", *given], env=ENV, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    made = make(project, "-n", "-f", "steer.mk", f"world={world}", *given)

    def commands(text: str) -> list[list[str]]:
        whole = re.sub(r"\$\(\((.*?)\)\)", lambda found: str(eval(found[1])), text.replace("\\\n", " "))
        found = re.findall(r"^(?:Shell command: *|\s*@?)hrt (.*)", whole, re.MULTILINE)
        return sorted(sorted(each.split()) for each in found)

    assert len(commands(made)) == count
    assert commands(done.stdout + done.stderr) == commands(made)
    refused = subprocess.run(command, env=ENV, capture_output=True, text=True)
    assert refused.returncode != 0
    assert "a robot needs a world" in refused.stdout + refused.stderr
