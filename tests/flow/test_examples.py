"""The example that ends each command's help runs as it stands."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hrt_cli.main import COMMANDS

ENV = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
KINDS = ("segment", "plan", "runs", "drive", "steer")
NAMES = [name for name in COMMANDS if name != "evaluate"] + [f"evaluate {kind}" for kind in KINDS]

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", NAMES)
def test_the_example_runs(name: str, tmp_path: Path) -> None:
    shown = subprocess.run(["hrt", *name.split(), "--help"], env=ENV, capture_output=True, text=True, check=True).stdout
    lines = [line.strip() for line in shown.split("Example:")[1].splitlines()]
    commands = [line for line in lines if line.startswith("hrt ")]
    assert any(line.startswith(f"hrt {name}") for line in commands)
    script = "\n".join(["set -e", *commands])
    done = subprocess.run(["sh", "-c", script], env=ENV, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
