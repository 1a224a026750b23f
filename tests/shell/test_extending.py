"""The code in docs/extending.md runs: a plugin in a package of its own, a mission format, a stage."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import rasterio

from hrt_cli.artifacts.plan import read_plan
from hrt_cli.artifacts.stage import Existing
from hrt_cli.errors import OutputError
from hrt_cli.evaluation.verify import verify_file
from hrt_cli.main import COMMANDS
from hrt_cli.missions.formats import FORMATS, Format
from hrt_cli.missions.mission import MissionOptions
from hrt_cli.missions.stage import export_missions
from hrt_cli.planning.request import PlanRequest, parse_budget, parse_start
from hrt_cli.planning.stage import plan_file

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
HELLO = ROOT / "tests" / "plugin" / "hrt_hello"


def block(name: str) -> str:
    """The code that follows the name of a file."""
    found = re.search(rf"^`{re.escape(name)}`\n\n```[a-z]+\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    assert found, name
    return found[1]


def module_of(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A module made of the code that follows the name of its file, where that file would be."""
    called = name.removesuffix(".py").replace("/", ".")
    module = ModuleType(called)
    monkeypatch.setitem(sys.modules, called, module)
    exec(compile(block(name), name, "exec"), module.__dict__)
    return module


@pytest.fixture(scope="module")
def scoremap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("extending") / "scoremap.tif"
    score = np.random.default_rng(0).uniform(0.1, 1, (8, 8)).astype(np.float32)
    score[2, 3] = np.nan
    place = {"crs": "EPSG:32633", "transform": rasterio.Affine(1, 0, 400000, 0, -1, 5000000)}
    with rasterio.open(
        path, "w", driver="GTiff", height=8, width=8, count=2, dtype="float32", nodata=np.nan, **place
    ) as f:
        f.write(score, 1)
        f.write(np.where(np.isnan(score), np.nan, 0).astype(np.float32), 2)
    return path


@pytest.fixture(scope="module")
def plan(scoremap: Path) -> Path:
    path = scoremap.with_name("plan.json")
    start = parse_start("cell:0,0")
    plan_file(scoremap, path, PlanRequest(starts=(start,), budget=parse_budget("20"), method="greedy"))
    return path


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the plugin is installed, by pip, from the two files that the page shows."""
    pytest.importorskip("setuptools")
    folder = tmp_path_factory.mktemp("plugin")
    source = folder / "source"
    shutil.copytree(HELLO, source, ignore=shutil.ignore_patterns("__pycache__", "build", "*.egg-info"))
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*pip, "--target", folder / "lib", source], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {"PYTHONPATH": f"{folder / 'lib'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}


def hrt(*args: object, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hrt_cli.main", *map(str, args)]
    return subprocess.run(command, env=os.environ | env, cwd=ROOT, capture_output=True, text=True, check=False)


def test_the_page_shows_the_plugin_as_it_is() -> None:
    for name in ("pyproject.toml", "hrt_hello.py"):
        assert block(name) == (HELLO / name).read_text(encoding="utf-8")


def test_the_plugin_is_listed_runs_and_helps(installed: dict[str, str], plan: Path) -> None:
    listed = " ".join(hrt("--help", env=installed).stdout.split())
    assert "Plugins: hello Say hello at every waypoint of a plan. (plugin hrt-hello 1.0)" in listed
    done = hrt("hello", plan, env=installed)
    assert (done.returncode, done.stderr) == (0, "")
    waypoints = read_plan(plan).waypoints
    assert done.stdout == "".join(f"step {each.step}: hello, cell {each.cell}\n" for each in waypoints)
    assert hrt("hello", "--help", env=installed).stdout.endswith("Example:\n  hrt hello plan.json\n")


def test_what_the_plugin_refuses_is_told_as_everywhere(installed: dict[str, str], tmp_path: Path) -> None:
    done = hrt("hello", tmp_path / "absent.json", env=installed)
    assert done.returncode == 1
    assert done.stderr == f"Error: {tmp_path / 'absent.json'}: no such file\n"


def test_the_readers_that_plugins_are_promised_are_there() -> None:
    promised = re.findall(r"`((?:artifacts|raster|logs)\.[a-z_.]+)\.([a-z_]+)`", TEXT)
    assert len(promised) == 5
    for module, name in promised:
        assert callable(getattr(import_module(f"hrt_cli.{module}"), name))


def test_the_mission_format_of_the_page(plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = module_of("hrt_cli/missions/lines.py", monkeypatch)
    entry = re.search(r"^Format\(.*\)$", TEXT, re.MULTILINE)
    assert entry
    made: Any = eval(entry[0], {"Format": Format, "to_text": lines.to_text})
    monkeypatch.setitem(FORMATS, made.name, made)
    output = tmp_path / "mission.lines"
    done = export_missions(plan, output, MissionOptions())
    assert done.format == "lines"
    places = [tuple(map(float, line.split())) for line in output.read_text().splitlines()]
    expected = [(each.lat, each.lon) for each in read_plan(plan).waypoints]
    assert np.allclose(places, expected, rtol=0, atol=1e-7)


def test_the_stage_of_the_page(scoremap: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count = module_of("hrt_cli/drivability/count.py", monkeypatch)
    output = tmp_path / "count.json"
    assert count.count_cells(scoremap, output) == count.Counted(63, False)
    assert count.count_cells(scoremap, output) == count.Counted(63, True)
    with rasterio.open(scoremap) as file:
        high = int((file.read(1) >= 0.5).sum())
    with pytest.raises(OutputError, match="--overwrite"):
        count.count_cells(scoremap, output, least=0.5)
    assert count.count_cells(scoremap, output, least=0.5, existing=Existing(overwrite=True)).open_cells == high
    assert verify_file(output, [scoremap.parent]).verdict == "ok"


def test_what_the_page_says_to_edit_is_there() -> None:
    assert "COMMANDS" in TEXT
    assert COMMANDS
    for path in re.findall(r"`((?:hrt_cli|commands|docs|tests)/[a-z_/]+\.(?:py|md))`", TEXT):
        assert (ROOT / path).exists() or path in (
            "hrt_cli/missions/lines.py",
            "hrt_cli/drivability/count.py",
            "commands/count.py",
        ), path
