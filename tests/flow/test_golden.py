"""The flow on the sample sites makes what it made before: `hrt compare` finds no more than a processor may change."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
import golden  # noqa: E402 - the folder is put on the path first

# How far another processor's floating point may move a figure. Of plans of one worth it may find another.
TOLERANCES = {
    "classes.tif": ("changed=0.01",),
    "scoremap.tif": ("rmse=0.02", "sd_rmse=0.02", "no_go=12", "go=12"),
    "plan.json": (
        *("score=2", "discounted_score=3", "upper_bound=2", "gap=0.02", "length_m=0.1", "time_s=0.1"),
        *("overlap=0.5", "end_m=25", "waypoints=60"),
    ),
    "figures.json": (
        "ari=0.02",
        "accuracy=0.01",
        "go_cells=12",
        "mean_score=0.01",
        "score=2",
        "gap=0.02",
        "length_m=0.1",
    ),
}


def hrt(*args: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hrt_cli.main", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("site", golden.SITES)
def test_the_flow_makes_what_it_made_before(site: str, tmp_path: Path) -> None:
    golden.run_flow(site, tmp_path)
    for name in golden.ARTIFACTS:
        tolerances = [word for each in TOLERANCES[name] for word in ("--tolerance", each)]
        done = hrt("compare", golden.GOLDEN / site / name, tmp_path / name, *tolerances)
        assert done.returncode == 0, done.stdout + done.stderr


def test_the_tolerances_would_notice_another_site() -> None:
    meadow, reef = (golden.GOLDEN / site for site in ("meadow", "reef"))
    for name in golden.ARTIFACTS:
        tolerances = [word for each in TOLERANCES[name] for word in ("--tolerance", each)]
        assert hrt("compare", meadow / name, reef / name, *tolerances).returncode == 3, name


def test_fixtures_are_small_and_signed() -> None:
    files = [p for p in golden.FIXTURES.rglob("*") if p.is_file()]
    assert sum(p.stat().st_size for p in files) < 2_000_000
    assert sum(p.stat().st_size for p in golden.GOLDEN.rglob("*")) < 300_000
    signed = [p for p in files if p.suffix == ".tif" or p.name == "plan.json"]
    done = hrt("verify", *signed)
    assert done.returncode == 0, done.stderr
