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


NEEDS_MAKE = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
NEEDS_SNAKEMAKE = pytest.mark.skipif(
    shutil.which("snakemake", path=ENV["PATH"]) is None, reason="snakemake is not installed"
)


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which nothing was made yet; not to be changed."""
    folder = tmp_path_factory.mktemp("fresh") / "project"
    subprocess.run(["hrt", "init", str(folder)], env=ENV, check=True, capture_output=True)
    shutil.copy(ROOT / "fixtures" / "meadow" / "ortho.tif", folder / "ortho.tif")
    config = (folder / "config.yaml").read_text()
    (folder / "config.yaml").write_text(
        config.replace("budget: 300 ", "budget: 40 ").replace("classes: 5 ", "classes: 4 ")
    )
    return folder


@pytest.fixture(scope="module")
def made(fresh: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same after make; not to be changed."""
    folder = tmp_path_factory.mktemp("made") / "project"
    shutil.copytree(fresh, folder)
    make(folder)
    return folder


@pytest.fixture
def project(fresh: Path, tmp_path: Path) -> Path:
    shutil.copytree(fresh, tmp_path / "project")
    return tmp_path / "project"


@pytest.fixture
def finished(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "project")  # copies times as well
    return tmp_path / "project"


def make(folder: Path, *args: str) -> str:
    done = subprocess.run(["make", "-C", str(folder), *args], env=ENV, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def make_fails(folder: Path, *args: str) -> str:
    done = subprocess.run(["make", "-C", str(folder), *args], env=ENV, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    return done.stderr


def snakemake(folder: Path, *args: str, fails: bool = False) -> str:
    command = ["snakemake", "--cores", "2", *args]
    done = subprocess.run(command, cwd=folder, env=ENV, capture_output=True, text=True, check=False)
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done.stdout + done.stderr


def artifacts(folder: Path) -> dict[str, bytes]:
    """Return what hrt made: not what make and snakemake note down beside it."""
    out = folder / "out"
    notes = (".args", "logs", "benchmarks")
    paths = [path.relative_to(out) for path in out.rglob("*") if path.is_file()]
    return {
        str(path): (out / path).read_bytes()
        for path in paths
        if path.parts[0] not in notes and path.name != ".snakemake_timestamp"
    }


@NEEDS_MAKE
def test_make(finished: Path) -> None:
    out = finished / "out"
    names = ("classes.tif", "scoremap.tif", "plan.json", "mission.plan", "mission.gpx", "mission.kml", "nav2/path.yaml")
    for name in (*names, "plan.png", "model.npz"):
        assert (out / name).stat().st_size > 0
    assert "Nothing to be done" in make(finished)
    # A touched input with the same bytes: every stage finds itself up to date, and then make is at rest.
    (finished / "ortho.tif").touch()
    ends = ("out/mission.plan", "out/plan.png", "out/nav2/path.yaml")
    assert "up to date" in make(finished, *ends)
    assert all(f"'{name}' is up to date" in make(finished, *ends) for name in ends)
    # Another budget touches neither classes nor scoremap.
    kept = {name: (out / name).stat().st_mtime_ns for name in ("classes.tif", "scoremap.tif")}
    again = make(finished, "budget=30", "out/mission.plan")
    assert "hrt plan" in again
    assert "hrt segment" not in again
    assert kept == {name: (out / name).stat().st_mtime_ns for name in kept}
    make(finished, "clean")
    assert not out.exists()


@NEEDS_MAKE
@NEEDS_SNAKEMAKE
def test_snakemake_makes_the_same_bytes_as_make(project: Path, made: Path) -> None:
    snakemake(project)
    assert artifacts(project) == artifacts(made)
    assert "scoremap.qml" in artifacts(made)
    for rule in ("segment", "scoremap", "plan", "export.csv", "export.nav2"):
        assert (project / "out" / "logs" / f"{rule}.log").read_text().startswith(("out/", "Note: "))
        assert (project / "out" / "benchmarks" / f"{rule}.tsv").read_text().startswith("s\th:m:s\tmax_rss")
    assert "Nothing to be done" in snakemake(project)


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


@NEEDS_MAKE
def test_make_keeps_the_robot_within_its_limits(finished: Path) -> None:
    given = [f"{key}={value}" for key, value in put_limits(finished).items()]
    told = make(finished, *given, "out/scoremap.tif")
    assert "--aoi area.geojson --keep-out pond.kml --keep-out shed.kml" in told
    assert "outside the area of interest" in told
    assert "up to date" in make(finished, *given, "out/scoremap.tif")
    (finished / "shed.kml").write_text((finished / "shed.kml").read_text().replace("<kml>", "<kml >"))
    again = make(finished, *given, "out/scoremap.tif")
    assert "hrt scoremap" in again
    assert "hrt segment" not in again
    assert "--margin" not in make(finished, "-n", "no_go_below=", "margin_m=0.5", "out/scoremap.tif")
    make(finished, *given, "tolerance_m=1", "out/mission.plan")
    fence = json.loads((finished / "out" / "mission.plan").read_text())["geoFence"]["polygons"]
    assert [each["inclusion"] for each in fence] == [True, False, False]


@NEEDS_MAKE
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


@NEEDS_SNAKEMAKE
@pytest.mark.parametrize("file", ["Snakefile", "rounds.smk"])
def test_snakemake_keeps_it_there_by_the_same_options(project: Path, file: str) -> None:
    config = [f"{key}={value}" for key, value in {**put_limits(project), "robot": "real"}.items()]
    told = snakemake(project, "-n", "-s", file, "--config", *config)
    options = r"--aoi area\.geojson --keep-out pond\.kml --keep-out shed\.kml +--margin 0\.5 "
    assert re.search(rf"hrt scoremap .*{options}", told)
    assert re.search(r"input: .*shed\.kml", told)


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
@NEEDS_MAKE
def test_make_learns_to_steer(project: Path) -> None:
    world = ROOT / "fixtures" / "meadow"
    given = ["-f", "steer.mk", f"world={world}", *(f"{key}={value}" for key, value in TINY.items())]
    told = make(project, *given, "learning")
    steer = project / "out" / "steer"
    assert told.count("hrt train-steer") == 2
    assert "--rescue" in told
    # What has learnt so little stands still until it counts as stuck, which takes half a minute to compute: a drive on
    # which it was helped stands in for that of the test.
    would = " ".join(make(project, "-n", *given).replace("\\\n", " ").split())
    model = "--local steer --model out/steer/round-2/steer.safetensors --seed $(( 0 * 100000 + 99000 + 1 ))"
    assert f"-o out/steer/test/drive-1.jsonl {model}" in would
    (steer / "test").mkdir()
    shutil.copyfile(steer / "round-2" / "drive-1.jsonl", steer / "test" / "drive-1.jsonl")
    assert make(project, *given).count("hrt ") == 1
    assert json.loads((steer / "test" / "report.json").read_text())["drives"]
    assert "Nothing to be done" in make(project, *given)
    # A round more learns from all so far, and nothing before it is made again.
    more = make(project, "-n", *given, "steer_rounds=3", "steer_rate=0.001 0.0005 0.0005", "steer_epochs=1 1 1")
    assert "round-3/drive-1" in more
    told = make_fails(project, *given, "steer_epochs=1")
    assert "steer_epochs needs a number for each of the 2 rounds" in told
    make(project, *given, "clean-steering")
    assert not steer.exists()


@NEEDS_SNAKEMAKE
@pytest.mark.parametrize(
    ("more", "count"), [({}, 7), ({"steer_worlds": str(ROOT / "fixtures" / "wildfire"), "steer_drives": "3"}, 12)]
)
def test_snakemake_would_learn_to_steer_by_the_same_commands(project: Path, more: dict[str, str], count: int) -> None:
    world = ROOT / "fixtures" / "meadow"
    given = [f"{key}={value}" for key, value in ({"world": str(world)} | TINY | more).items()]
    told = snakemake(project, "-n", "-s", "steer.smk", "--config", *given)
    made = make(project, "-n", "-f", "steer.mk", *given)

    def commands(text: str) -> list[list[str]]:
        whole = re.sub(r"\$\(\((.*?)\)\)", lambda found: str(eval(found[1])), text.replace("\\\n", " "))
        # Snakemake keeps what the commands say.
        whole = re.sub(r" (?:2>&1 \| tee|2>) out/steer/logs/\S+\.log$", "", whole, flags=re.MULTILINE)
        found = re.findall(r"^(?:Shell command: *|\s*@?)hrt (.*)", whole, re.MULTILINE)
        return sorted(sorted(each.split()) for each in found)

    assert len(commands(made)) == count
    assert commands(told) == commands(made)


@NEEDS_SNAKEMAKE
def test_learning_to_steer_needs_a_world_and_has_but_one_site(project: Path) -> None:
    assert "a robot needs a world" in snakemake(project, "-n", "-s", "steer.smk", fails=True)
    given = ("--config", "world=x", "seeds=1 2")
    assert "seeds must be empty here" in snakemake(project, "-n", "-s", "steer.smk", *given, fails=True)
