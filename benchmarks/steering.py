"""The steering network: how fast it learns and answers, how good it is beside Donkeycar's, and whether it resumes.

    python benchmarks/steering.py speed                          training, beside plain float32 PyTorch
    python benchmarks/steering.py latency [--data TUB]           one picture: PyTorch, ONNX, int8
    python benchmarks/steering.py accuracy [--data TUB] [--seeds 0 1 2] [--size 80x60] [--sigma 0.12]
    python benchmarks/steering.py resume [--kills 30]            a training killed at random moments

TUB is a Donkeycar tub v2, a folder or a .tar.gz of one. With --json FILE, accuracy writes each figure as soon as it
has it and does not compute again what the file holds, so that a long run can be cut into parts. docs/benchmarks.md
says how to read the figures.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import steering_accuracy
import steering_resume
import steering_speed
from steering_data import TUB
from tables import Skipped, Table, machine

PACKAGES = ("torch", "numpy", "opencv-python-headless", "onnx", "onnxruntime")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sections = parser.add_subparsers(dest="section", required=True, metavar="SECTION")
    for name, text in (
        ("speed", "images a second of training"),
        ("latency", "milliseconds an answer"),
        ("accuracy", "errors on held-out frames"),
        ("resume", "whether a killed training comes to the same"),
    ):
        section = sections.add_parser(name, help=text)
        section.add_argument("--quick", action="store_true", help="a glance: the figures say little")
        section.add_argument("--threads", type=int, default=2)
        section.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
        if name in ("latency", "accuracy"):
            section.add_argument("--data", type=Path, default=TUB, metavar="TUB")
            section.add_argument("--gap", type=int, default=20, help="frames dropped beside a block held out")
        if name in ("latency", "resume"):
            section.add_argument("--seed", type=int, default=0)
        if name == "accuracy":
            study = steering_accuracy.Study()
            section.add_argument("--seeds", type=int, nargs="+", default=list(study.seeds))
            section.add_argument("--size", type=parse_size, default=study.size, help="what hrt's network sees: 160x120")
            section.add_argument("--sigma", type=float, default=study.sigma, help="of hrt's Gaussian labels")
            section.add_argument("--epochs", type=int, default=study.epochs, help="of hrt's network, at most")
            section.add_argument("--peer-epochs", type=int, default=study.peer_epochs, help="of Donkeycar's, at most")
            section.add_argument("--patience", type=int, default=study.patience, help="of Donkeycar's early stopping")
        if name == "resume":
            section.add_argument("--kills", type=int, default=30)
    return parser.parse_args(arguments)


def parse_size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    return int(width), int(height)


def run(given: argparse.Namespace, facts: dict[str, Any]) -> list[Table]:
    size = steering_speed.QUICK if given.quick else steering_speed.NORMAL
    work: dict[str, Callable[[], list[Table]]] = {
        "speed": lambda: steering_speed.speed(size, given.threads),
        "latency": lambda: steering_speed.latency(size, given.threads, given.data, given.gap, given.seed),
        "accuracy": lambda: steering_accuracy.accuracy(study(given), given.data, given.json, facts),
        "resume": lambda: steering_resume.resume(
            steering_resume.QUICK if given.quick else steering_resume.NORMAL, given.kills, given.threads, given.seed
        ),
    }
    return work[given.section]()


def study(given: argparse.Namespace) -> steering_accuracy.Study:
    if given.quick:
        size, epochs, peer_epochs, patience = (64, 48), 1, 1, 1
    else:
        size, epochs, peer_epochs, patience = given.size, given.epochs, given.peer_epochs, given.patience
    return steering_accuracy.Study(
        size=size, seeds=tuple(given.seeds), gap=given.gap, sigma=given.sigma, epochs=epochs, peer_epochs=peer_epochs,
        patience=patience, threads=given.threads,
    )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    given = parse(arguments)
    facts = machine(PACKAGES)
    packages = ", ".join(f"{name} {found}" for name, found in dict(facts["packages"]).items() if found)
    print(
        f"{facts['processor']}, {facts['cores']} cores, {given.threads} threads, Python {facts['python']}, {packages};"
    )
    print(f"{steering_speed.arithmetic_told()}\n", flush=True)
    try:
        tables = run(given, facts)
    except Skipped as reason:
        print(f"{given.section}: skipped, {reason}")
        return 0
    for table in tables:
        print(f"{table.text()}\n", flush=True)
    if given.json and given.section != "accuracy":
        shown = [{"title": one.title, "rows": list(one.rows), "notes": list(one.notes)} for one in tables]
        given.json.write_text(json.dumps({"machine": facts, "tables": shown}, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
