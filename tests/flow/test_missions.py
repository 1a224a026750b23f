"""The two sample missions run from survey to figures, and reach what the field trials of the paper did."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import browser
import pytest

ROOT = Path(__file__).parents[2]
ENV = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}

pytestmark = pytest.mark.slow


def figures_of(mission: str, folder: Path, scoremap: str = "scoremap.tif") -> dict:
    """Run a mission and measure its last drive."""
    env = ENV | {"MISSIONS": str(folder)}
    subprocess.run(["sh", str(ROOT / "pipelines" / "missions.sh"), mission], env=env, check=True, capture_output=True)
    out = folder / mission
    command = ["hrt", "evaluate", "drive", "drive.jsonl", "--world", "site", "--scoremap", scoremap, "--json"]
    done = subprocess.run(command, env=env, cwd=out, check=True, capture_output=True, text=True)
    assert (out / "mission.plan").exists()
    assert (out / "drive.png").exists()
    if browser.is_wanted():
        browser.check_report(out / "report.html")
    assert (out / "report.html").stat().st_size < 8_000_000
    return json.loads(done.stdout)


def test_reef(tmp_path: Path) -> None:
    found = figures_of("reef", tmp_path)
    assert found["collisions"] == 0
    assert found["distance_m"] > 1000
    # Manderson, Manjanna and Dudek 2019: the target on a third of the picture.
    assert found["target_in_view"] >= 0.33
    assert 0 < found["min_clearance_m"] < found["mean_clearance_m"]


def test_wildfire(tmp_path: Path) -> None:
    found = figures_of("wildfire", tmp_path)
    assert found["collisions"] == 0
    plan = json.loads((tmp_path / "wildfire" / "plan.json").read_text())
    assert found["score_collected"] > 0.7 * plan["score"]
    # Most of the hot spots of the site were driven over or passed within two metres.
    world = json.loads((tmp_path / "wildfire" / "site" / "world.json").read_text())
    lines = (tmp_path / "wildfire" / "drive.jsonl").read_text().splitlines()[1:]
    track = [(record["x"], record["y"]) for record in map(json.loads, lines)]
    passed = [min((x - h["xy"][0]) ** 2 + (y - h["xy"][1]) ** 2 for x, y in track) < 4.0 for h in world["hotspots"]]
    assert sum(passed) >= 0.6 * len(passed)
