"""Run a program and print what it cost as JSON: CPU seconds, wall seconds, peak memory in MB.

    python benchmarks/process_cost.py PROGRAM [ARGUMENT ...]

It is a process of its own because the peak memory the system reports of a child starts at what its parent held.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """Of one process; None where that was not measured."""

    cpu_s: float
    wall_s: float | None = None
    peak_mb: float | None = None


def process_cost(command: Sequence[str], **environment: str) -> Cost:
    """Run a command and return its cost; it is a RuntimeError if the command fails."""
    done = subprocess.run(
        [sys.executable, __file__, *command], stdout=subprocess.PIPE, env={**os.environ, **environment}, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: failed with status {done.returncode}")
    return Cost(**json.loads(done.stdout))


def main() -> int:
    began = time.monotonic()
    process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    cost = {
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "wall_s": time.monotonic() - began,
        "peak_mb": usage.ru_maxrss / (1024 * 1024 if sys.platform == "darwin" else 1024),
    }
    print(json.dumps(cost))
    return 1 if process.returncode else 0


if __name__ == "__main__":
    sys.exit(main())
