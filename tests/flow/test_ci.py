"""What docs/inputs.md shows of a job in CI runs as it stands, and fails where it should."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ENV = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}

pytestmark = pytest.mark.slow


def test_the_job_in_the_docs(tmp_path: Path) -> None:
    section = (ROOT / "docs" / "inputs.md").read_text(encoding="utf-8").split("## In CI")[1]
    lines = [line.strip() for line in section.splitlines() if line.startswith("    ")]
    assert any("hrt compare" in line for line in lines)
    assert any("--require" in line for line in lines)

    def run(*commands: str) -> int:
        script = "\n".join(["set -e", *commands])
        return subprocess.run(["sh", "-c", script], env=ENV, cwd=tmp_path, capture_output=True, check=False).returncode

    assert run(*lines) == 0
    assert run("hrt segment site/ortho.tif -o site/classes.tif --classes 5 --overwrite") == 0
    assert run(*(line for line in lines if line.startswith("hrt compare golden/classes.tif"))) == 1  # the old figure
    assert run("hrt compare golden/classes.tif site/classes.tif --tolerance changed=0.01") == 3
    assert run("hrt evaluate segment site/classes.tif site/truth.tif --require 'ari>=0.99'") == 3
