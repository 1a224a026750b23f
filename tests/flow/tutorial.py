"""The commands of the tutorials and what they print: `python tests/flow/tutorial.py --write` prints it anew.

A block begins with ```console; a line that begins with `$ ` is a command, which goes on in lines that begin with `> `;
the lines after it are what it prints, on stdout and stderr, until the next command. A picture `images/reef-plan.jpg` is
the `plan.png` that a command made.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2

ROOT = Path(__file__).parents[2]
TUTORIALS = {"wildfire": ROOT / "docs" / "tutorial.md", "reef": ROOT / "docs" / "tutorial-reef.md"}
IMAGES = ROOT / "docs" / "images"
ENV = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", "NO_COLOR": "1"}
ENV |= {"COLUMNS": "120"}

_BLOCK = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?")
_TIMES = re.compile(r"(?<=classes in )[\d.]+(?= s)|(?<=\()[\d.]+(?= s\))")
_FIRST_USE = "Note: compiling for this machine"
NEARLY = 0.02
WIDTH = 760


class Step(NamedTuple):
    """A command as it stands in the tutorial, and the lines after it."""

    command: str
    printed: str


def steps_of(text: str) -> list[Step]:
    """Return the commands of a tutorial in their order."""
    found: list[Step] = []
    for block in _BLOCK.findall(text):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append(Step(line[2:], ""))
            elif line.startswith("> "):
                found[-1] = Step(f"{found[-1].command}\n{line[2:]}", "")
            else:
                found[-1] = Step(found[-1].command, found[-1].printed + line + "\n")
    return found


def run(steps: list[Step], folder: Path) -> Iterator[tuple[Step, str]]:
    """Run commands one after another in a folder; yield each with what it printed."""
    for step in steps:
        done = subprocess.run(
            ["sh", "-c", step.command],
            cwd=folder,
            env=ENV,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        printed = "".join(f"{line.rstrip()}\n" for line in done.stdout.splitlines() if not line.startswith(_FIRST_USE))
        if done.returncode:
            raise RuntimeError(f"{step.command}: exit {done.returncode}\n{printed}")
        yield step, printed


def agree(told: str, printed: str) -> bool:
    """Say whether both are the same text, with `...` for anything on a line, and numbers within 2 % of one another."""
    told_lines, lines = told.splitlines(), printed.splitlines()
    return len(told_lines) == len(lines) and all(map(_line_agrees, told_lines, lines))


def _line_agrees(told: str, line: str) -> bool:
    pattern = ".*?".join(
        "(-?[0-9.]+(?:e[-+][0-9]+)?)".join(re.escape(text) for text in _NUMBER.split(part))
        for part in told.split("...")
    )
    found = re.fullmatch(pattern, line)
    if found is None:
        return False
    numbers = _NUMBER.findall(told.replace("...", " ... "))
    return all(abs(float(a) - float(b)) <= NEARLY * abs(float(a)) for a, b in zip(numbers, found.groups(), strict=True))


def written(text: str, printed: list[str]) -> str:
    """Return the tutorial with what its commands printed; times, which differ from run to run, as `...`."""
    outputs = iter(printed)

    def block(found: re.Match[str]) -> str:
        commands: list[str] = []
        for line in found[1].splitlines():
            if line.startswith("$ "):
                commands.append(f"{line}\n")
            elif line.startswith("> "):
                commands[-1] += f"{line}\n"
        return "```console\n" + "".join(each + _TIMES.sub("...", next(outputs)) for each in commands) + "```"

    return _BLOCK.sub(block, text)


def pictures(name: str, text: str) -> dict[str, str]:
    """Return the pictures of a tutorial: the file in docs/images, and the PNG that it was made of."""
    return {f"{name}-{stem}.jpg": f"{stem}.png" for stem in re.findall(rf"\(images/{name}-([a-z0-9]+)\.jpg\)", text)}


def draw(made: Path, picture: Path) -> None:
    """Write a picture for a page: a JPEG, smaller than the PNG that a command made."""
    pixels = cv2.imread(str(made))
    height, width = pixels.shape[:2]
    size = (WIDTH, round(height * WIDTH / width))
    shrunk = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(picture), shrunk, [cv2.IMWRITE_JPEG_QUALITY, 85, cv2.IMWRITE_JPEG_OPTIMIZE, 1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", required=True, help="write what is printed into the tutorial")
    parser.add_argument("names", nargs="*", help="which (wildfire, reef); by default all")
    for name in parser.parse_args().names or TUTORIALS:
        text = TUTORIALS[name].read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            printed = []
            for step, lines in run(steps_of(text), Path(folder)):
                print(f"$ {step.command}\n{lines}", end="", flush=True)
                printed.append(lines)
            for picture, made in pictures(name, text).items():
                draw(Path(folder, made), IMAGES / picture)
        TUTORIALS[name].write_text(written(text, printed), encoding="utf-8")


if __name__ == "__main__":
    main()
