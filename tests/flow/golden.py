"""The flow on the sample sites of fixtures/, and the artifacts and figures it is held to (`--write` records them)."""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "fixtures"
GOLDEN = FIXTURES / "golden"
ARTIFACTS = ("classes.tif", "scoremap.tif", "plan.json", "figures.json")
SITES = ("meadow", "wildfire", "reef")
BUDGET = 120


def hrt(*args: str | Path) -> dict[str, Any]:
    """Run the real program with `--json` and return what it printed."""
    command = [sys.executable, "-m", "hrt_cli.main", *map(str, args), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stderr}"
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def run_flow(site: str, out: Path) -> dict[str, Any]:
    """Run segment, evaluate, scoremap, plan and export on a sample site; write and return the figures."""
    folder = FIXTURES / site
    truth_classes = len(json.loads((folder / "world.json").read_text())["classes"])
    classes, scoremap, plan = out / "classes.tif", out / "scoremap.tif", out / "plan.json"
    segmented = hrt("segment", folder / "ortho.tif", "-o", classes, "--classes", str(truth_classes))
    agreement = hrt("evaluate", "segment", classes, folder / "truth.tif")
    scores = out / "scores.json"
    scores.write_text(json.dumps({"scores": operator_scores(folder, agreement["matching"])}))
    mapped = hrt("scoremap", classes, "-o", scoremap, "--scores", scores, "--no-go-below", "0.15")
    planned = hrt("plan", scoremap, "-o", plan, "--start", "auto", "--budget", str(BUDGET))
    waypoints = {}
    for suffix in ("plan", "waypoints", "gpx", "geojson"):
        waypoints[suffix] = hrt("export", plan, "-o", out / f"mission.{suffix}")["waypoints"]
    assert set(waypoints.values()) == {planned["waypoints"]}
    figures = {
        "classes": segmented["classes"],
        "ari": agreement["ari"],
        "accuracy": agreement["accuracy"],
        "go_cells": mapped["go_cells"],
        "mean_score": mapped["mean_score"],
        "score": planned["score"],
        "gap": planned["gap"],
        "steps": planned["steps"],
        "length_m": planned["length_m"],
    }
    (out / "figures.json").write_text(json.dumps(figures, indent=2) + "\n")
    return figures


def operator_scores(folder: Path, matching: dict[str, int]) -> dict[str, float]:
    """Score each class as an operator would who recognises it in the picture."""
    truth = json.loads((folder / "world.json").read_text())["classes"]
    return {k: min(0.98, max(0.02, truth[str(v)]["drivability"])) for k, v in matching.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="record artifacts and figures")
    write = parser.parse_args().write
    figures = {}
    for site in SITES:
        with tempfile.TemporaryDirectory() as out:
            figures[site] = run_flow(site, Path(out))
            if write:
                (GOLDEN / site).mkdir(parents=True, exist_ok=True)
                for name in ARTIFACTS:
                    shutil.copyfile(Path(out) / name, GOLDEN / site / name)
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
