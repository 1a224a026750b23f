"""The example that ends each command's help runs as it stands, and prints the keys that the reference promises."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import click
import pytest

from hrt_cli.main import COMMANDS, cli

ENV = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
KINDS = ("segment", "plan", "runs", "drive", "steer")
NAMES = ["", *COMMANDS, *(f"evaluate {kind}" for kind in KINDS)]

pytestmark = pytest.mark.slow


def keys_of(name: str) -> tuple[str, ...]:
    """The keys that `--json` promises for a command."""
    command: click.Command | None = cli
    for part in name.split():
        assert isinstance(command, click.Group)
        command = command.get_command(click.Context(command), part)
    return tuple(getattr(command, "keys", ()))


@pytest.mark.parametrize("name", NAMES)
def test_the_example_runs(name: str, tmp_path: Path) -> None:
    shown = subprocess.run(["hrt", *name.split(), "--help"], env=ENV, capture_output=True, text=True, check=True).stdout
    lines = [line.strip() for line in shown.split("Example:")[1].splitlines()]
    commands = [line for line in lines if line.startswith("hrt ")]
    assert any(line.startswith(f"hrt {name}") for line in commands)
    keys = keys_of(name)
    commands[-1] += " --json" if keys else ""
    script = "\n".join(["set -e", *commands])
    done = subprocess.run(["sh", "-c", script], env=ENV, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    if keys:
        assert set(keys) <= set(json.loads(done.stdout.splitlines()[-1]))
