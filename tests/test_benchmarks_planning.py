"""The planner's benchmark still runs, and judges walks by the rules."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from hrt_cli.planning.features import build_blocks
from hrt_cli.planning.policy import padded_index
from hrt_cli.planning.problem import Budget, Problem
from hrt_cli.planning.walk import build_field

ROOT = Path(__file__).parents[1]
SCORE = np.array([[1.0, 2.0, np.nan], [0.5, 4.0, 8.0]])


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    module = importlib.import_module("planning")
    one = {"shores": module.HELD_OUT["shores"]}
    monkeypatch.setattr(module, "HELD_OUT", one)
    monkeypatch.setattr(module, "MOVES", 40)
    monkeypatch.setattr(module, "NORMAL", module.Size(maps=2, peer_maps=1))
    return module


def test_each_cell_pays_once(bench: ModuleType) -> None:
    task = bench.Task("hand", 0, SCORE, (0, 0), 3)
    assert bench.walk_score(task, [(0, 0), (0, 1), (0, 0), (0, 1)]) == 3.0
    assert bench.walk_score(task, [(0, 0), (0, 1), (1, 1)], 0.5) == 1.0 + 0.5 * 2.0 + 0.25 * 4.0


@pytest.mark.parametrize(
    "walk",
    [
        [(0, 1), (0, 0)],
        [(0, 0), (1, 1)],
        [(0, 0), (0, 1), (0, 2)],
        [(0, 0), (-1, 0)],
        [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)],
    ],
    ids=["elsewhere", "diagonal", "no-go", "off the map", "too long"],
)
def test_a_walk_that_breaks_a_rule_stops_the_run(bench: ModuleType, walk: list[tuple[int, int]]) -> None:
    with pytest.raises(RuntimeError):
        bench.walk_score(bench.Task("hand", 0, SCORE, (0, 0), 3), walk)


def test_a_tour_takes_the_richest_shortest_paths(bench: ModuleType) -> None:
    walks = importlib.import_module("planning_walks")
    task = bench.Task("hand", 0, SCORE, (0, 0), 4)
    walk = walks.expand_tour(task, [4, 1, 5])
    assert walk.tolist()[:4] == [[0, 0], [0, 1], [1, 1], [1, 2]]
    assert len(walk) == 5
    assert bench.walk_score(task, walk) == 15.0


def test_the_learner_sees_what_policies_see(bench: ModuleType) -> None:
    score, start = bench.held_out("shores", 0)
    task = bench.Task("shores", 0, score, start, 250)
    game = bench.peers.CollectingGame([task])
    seen = game.reset(0)
    field = build_field(Problem(score, start, Budget(250.0)))
    blocks = build_blocks(field, "rings")
    at = padded_index(blocks, field.width, field.start)
    share = np.repeat(1.0 / np.array([1.0, 9.0, 81.0]), 8)
    sums = np.concatenate([blocks.sums[level, at + blocks.rings[level]] for level in range(3)])
    assert seen[:24] == pytest.approx(sums * share, rel=0.05, abs=1e-4)
    before = game.sums.copy()
    game.step(next(a for a, (dr, dc) in enumerate(bench.peers.MOVES) if game.open[game.row + dr, game.col + dc]))
    assert game.worth[game.row, game.col] == 0.0
    rebuilt = bench.peers._block_sums(game.worth, 27)
    assert game.sums[3] == pytest.approx(rebuilt, abs=1e-9)
    assert (game.sums <= before + 1e-9).all()


def test_quality_and_its_intervals(bench: ModuleType, tmp_path: Path) -> None:
    bench.main(["quality", "--start", "centre", "--json", str(tmp_path / "out.json")])
    tables = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["sections"]["quality"]["tables"]
    by_method = {row["method"]: row["of the bound"] for row in tables[0]["rows"]}
    assert set(by_method) == set(bench.METHODS)
    assert by_method["refined"] == max(by_method.values())
    low, high = bench.interval(np.array([[0.5, 1.0], [0.5, 1.0]]))
    assert 0.5 <= low < 0.75 < high <= 1.0


def test_absent_peers_are_skipped_with_a_word(
    bench: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def absent(name: str) -> ModuleType:
        raise bench.Skipped(f"{name} is not installed")

    monkeypatch.setattr(bench.peers, "need", absent)
    bench.main(["peers"])
    assert "peers: skipped, ortools is not installed; pyvrp is not installed" in capsys.readouterr().out
