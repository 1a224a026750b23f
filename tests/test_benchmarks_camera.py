"""The camera's benchmark still runs, and its plain march sees what the camera sees."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_the_plain_march_agrees(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    bench = importlib.import_module("camera")
    monkeypatch.setattr(bench, "SCENES", ("meadow",))
    monkeypatch.setattr(bench, "NORMAL", bench.Size(2, 1, 12.0))
    out = tmp_path / "out.json"
    bench.main(["--json", str(out)])
    rows = json.loads(out.read_text(encoding="utf-8"))["sections"]["meadow"]["tables"][0]["rows"]
    assert [row["view"] for row in rows] == list(bench.KINDS)
    assert all(row["ms a frame"] > 0 and row["same distance"] > 0.9 for row in rows)
