"""The flow on the sample sites reaches its golden figures."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
import golden  # noqa: E402 - the folder is put on the path first

# Figures that another processor's floating point may move a little, and how far.
TOLERANCE = {"ari": 0.02, "accuracy": 0.01, "mean_score": 0.01, "gap": 0.02, "score": 0.02, "length_m": 0.001}


@pytest.mark.parametrize("site", golden.SITES)
def test_flow_reaches_golden_figures(site: str, tmp_path: Path) -> None:
    wanted = json.loads(golden.GOLDEN.read_text())[site]
    found = golden.run_flow(site, tmp_path)
    assert set(found) == set(wanted)
    for key, value in wanted.items():
        scale = abs(value) if key in ("score", "length_m") else 1.0
        assert abs(found[key] - value) <= TOLERANCE.get(key, 0.02 * abs(value)) * max(scale, 1e-9), (key, found, wanted)


def test_fixtures_are_small_and_signed() -> None:
    files = [p for p in golden.FIXTURES.rglob("*") if p.is_file()]
    assert sum(p.stat().st_size for p in files) < 2_000_000
    rasters = [str(p) for p in files if p.suffix == ".tif"]
    done = subprocess.run([sys.executable, "-m", "hrt_cli.main", "verify", *rasters], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
