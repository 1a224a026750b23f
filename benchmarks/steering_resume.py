"""Trainings killed at random moments, and whether what they come to in the end is what an unbroken one does."""

from __future__ import annotations

import hashlib
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from steering_data import made_up, write_recording
from tables import Table

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
_PROGRAM = (
    "from hrt_cli.steering.training import checkpoint; checkpoint.EVERY_S, checkpoint._SHARE = 0.02, 0.5;"
    "from hrt_cli.main import main; main()"
)
"""`hrt`, with checkpoints as often as half the time allows: else a training so short would have none to go on from."""
_RESUMED = re.compile(r"going on after step (\d+) of")
_AT_MOST_S = 600.0


@dataclass(frozen=True)
class Size:
    """Of the training: frames, side of the pictures, epochs, frames of a batch."""

    frames: int = 96
    side_px: int = 32
    epochs: int = 6
    batch: int = 16


NORMAL, QUICK = Size(), Size(48, 32, 2, 16)


@dataclass
class Tally:
    """What became of the trainings: the codes they left with by signal, steps resumed at, sums of finished ones."""

    codes: Counter[str] = field(default_factory=Counter)
    resumed: list[int] = field(default_factory=list)
    sums: list[str] = field(default_factory=list)


def resume(size: Size, kills: int, threads: int, seed: int) -> list[Table]:
    """Kill a training so many times, each time running it again, and compare what it finishes with."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pictures, steering = made_up(size.frames, size.side_px, size.side_px)
        data = write_recording(folder / "data", pictures, steering)
        unbroken, broken = folder / "unbroken", folder / "broken"
        unbroken.mkdir()
        broken.mkdir()
        began = time.monotonic()
        finish(start(data, unbroken, size, threads))
        whole_s = time.monotonic() - began
        wanted = sum_of(unbroken)
        tally = Tally()
        done = 0
        while done < kills or not tally.sums or any(broken.iterdir()):
            process = start(data, broken, size, threads)
            delay_s = float(rng.uniform(0.0, whole_s)) if done < kills else _AT_MOST_S
            done += killed(process, delay_s, SIGNALS[done % len(SIGNALS)], tally)
            if process.returncode == 0:
                tally.sums.append(sum_of(broken))
                for path in broken.iterdir():
                    path.unlink()
    same = sum(each == wanted for each in tally.sums)
    rows = [{"signal": key.split(":")[0], "exit code": key.split(":")[1], "times": count}
            for key, count in sorted(tally.codes.items())]  # fmt: skip
    notes = [
        f"{size.frames} frames of {size.side_px} x {size.side_px}, {size.epochs} epochs: {whole_s:.1f} s unbroken",
        f"{done} kills; {len(tally.resumed)} runs went on after step {', '.join(map(str, tally.resumed)) or '-'}",
        f"{same} of {len(tally.sums)} trainings that were finished are the unbroken one, byte for byte ({wanted[:12]})",
    ]
    if same != len(tally.sums):
        notes.append("NOT THE SAME: a resumed training came to another model")
    return [Table("resume", rows, notes)]


def start(data: Path, folder: Path, size: Size, threads: int) -> subprocess.Popen[str]:
    command = [
        sys.executable, "-c", _PROGRAM, "train-steer", str(data), "-o", str(folder / "model.safetensors"),
        "--size", f"{size.side_px}x{size.side_px}", "--epochs", str(size.epochs), "--batch", str(size.batch),
        "--gap", "0", "--threads", str(threads),
    ]  # fmt: skip
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def killed(process: subprocess.Popen[str], delay_s: float, number: signal.Signals, tally: Tally) -> int:
    """Kill a process after a while, unless it ends before; return how many kills that was."""
    try:
        _, said = process.communicate(timeout=delay_s)
        kills = 0
    except subprocess.TimeoutExpired:
        process.send_signal(number)
        _, said = process.communicate(timeout=_AT_MOST_S)
        tally.codes[f"{number.name}:{process.returncode}"] += 1
        kills = 1
    tally.resumed += [int(step) for step in _RESUMED.findall(said)]
    if not kills and process.returncode:
        raise RuntimeError(f"a training failed by itself with status {process.returncode}: {said.strip()}")
    return kills


def finish(process: subprocess.Popen[str]) -> None:
    killed(process, _AT_MOST_S, signal.SIGKILL, Tally())
    if process.returncode:
        raise RuntimeError(f"the unbroken training took more than {_AT_MOST_S:g} s")


def sum_of(folder: Path) -> str:
    """Return the SHA-256 of the model in a folder; a RuntimeError if anything else is left there."""
    names = sorted(path.name for path in folder.iterdir())
    if names != ["model.safetensors"]:
        raise RuntimeError(f"a finished training left {', '.join(names)}")
    return hashlib.sha256((folder / names[0]).read_bytes()).hexdigest()
