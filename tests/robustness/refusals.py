"""Runs `hrt` and looks at how it refuses: one line, the right exit code, nothing changed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from hrt_cli.main import main

OLD = b"what was there before"


@dataclass
class Outcome:
    code: int
    stdout: str
    stderr: str


def here(args: list[str], capfd: pytest.CaptureFixture[str]) -> Outcome:
    """Run the program in this process (a command's imports are paid once); what GDAL prints is seen too."""
    capfd.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(args)
    code = stop.value.code
    assert isinstance(code, int)
    return Outcome(code, *capfd.readouterr())


def process(args: list[str]) -> Outcome:
    """Run the program as a process of its own."""
    # HRT_DEBUG would let tracebacks through.
    env = {name: value for name, value in os.environ.items() if name != "HRT_DEBUG"}
    command = [sys.executable, "-m", "hrt_cli.main", *args]
    done = subprocess.run(command, capture_output=True, text=True, env=env, timeout=60, check=False)
    return Outcome(done.returncode, done.stdout, done.stderr)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def check_refused(outcome: Outcome, code: int, named: str, problem: str = "") -> None:
    errors = [line for line in outcome.stderr.splitlines() if line.startswith("Error:")]
    assert outcome.code == code, outcome.stderr
    assert len(errors) == 1, outcome.stderr
    assert named in errors[0], errors
    assert problem in errors[0], errors
    assert "internal error" not in errors[0], errors
    assert "Traceback" not in outcome.stderr
    assert "Warning" not in outcome.stderr
    assert outcome.stdout == ""
    if code == 1:
        assert outcome.stderr.count("\n") == 1, outcome.stderr


def refused(
    run: Callable[[list[str]], Outcome],
    args: list[str],
    output: Path,
    code: int,
    named: str,
    problem: str = "",
    option: str = "-o",
) -> None:
    """Run twice, without an old output and with one that may be overwritten; either way nothing is changed."""
    before = contents(output.parent)
    check_refused(run([*args, option, str(output)]), code, named, problem)
    assert contents(output.parent) == before
    output.write_bytes(OLD)
    check_refused(run([*args, option, str(output), "--overwrite"]), code, named, problem)
    assert contents(output.parent) == before | {output.name: OLD}
