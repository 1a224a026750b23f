"""Rounds of plan, drive, feedback and replan on synthetic sites, beside the robot without feedback and a lawnmower.

    python benchmarks/rounds.py                       10 sites x 3 seeds, about 12 minutes on 2 cores
    python benchmarks/rounds.py --sites 2 --seeds 1   a glance

Each robot starts from flat scores and is given `--minutes` a round. Blocked, it plans again with what time is left;
one with feedback also learns from the drives so far. What it collects is the true drivability of the distinct cells
that it drove through.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from hrt_cli.artifacts.scores import read_scores
from hrt_cli.artifacts.world import read_world
from hrt_cli.drivability.feedback import FeedbackSettings
from hrt_cli.drivability.feedback_stage import learn_scores
from hrt_cli.drivability.stage import make_scoremap
from hrt_cli.driving.stage import DriveRequest, drive_file
from hrt_cli.evaluation.drives import evaluate_drives
from hrt_cli.logs.read import read_drive_log
from hrt_cli.planning.request import PlanRequest, Spending, parse_start
from hrt_cli.planning.stage import plan_file
from hrt_cli.raster.classes import open_classes
from hrt_cli.raster.windows import Window
from hrt_cli.texture.segment import SegmentSpec
from hrt_cli.texture.stage import Wanted, segment_file
from hrt_cli.world.stage import synthesize
from hrt_cli.world.synth import SiteSpec

CELL_M = 1.0
SCENES = ("meadow", "wildfire")
MOST_LEGS = 25
NO_GO_BELOW = 0.2
NO_GO_SHARE = 0.3
MARGIN_M = 1.0
ENOUGH_M = 20.0
ROBOTS = ("feedback", "blind", "lawnmower")


@dataclass
class Round:
    """What a round came to: seconds stalled, seconds in all, drives."""

    stalled_s: float = 0.0
    spent_s: float = 0.0
    legs: int = 0


@dataclass
class Outcome:
    """What a robot came to on a site."""

    site: str
    seed: int
    robot: str
    score: float = 0.0
    rounds: list[Round] = field(default_factory=list)
    rank: float = math.nan
    ranked: int = 0
    means: dict[str, tuple[float, float, float]] = field(default_factory=dict)


def prepare(folder: Path, scene: str, seed: int, side_m: float, classes: int) -> None:
    """Make a site with its classes and its map of true scores."""
    synthesize(folder, SiteSpec(scene, (side_m, side_m), 0.1, seed))
    segment_file([folder / "ortho.tif"], folder / "classes.tif", Wanted(SegmentSpec(classes)))
    world = read_world(folder / "world.json")
    table = {key: each.drivability for key, each in world.classes.items()}
    (folder / "true-scores.json").write_text(json.dumps({"scores": table}))
    make_scoremap(folder / "truth.tif", folder / "true.tif", scores_path=folder / "true-scores.json", cell_m=CELL_M)


def run(site: Path, seed: int, robot: str, rounds: int, minutes: float, explore: float, local: str) -> Outcome:
    """Let one robot work on one site."""
    outcome = Outcome(site.name, seed, robot)
    x, y = read_world(site / "world.json").start.xy
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        logs: list[Path] = []
        scores: Path | None = None
        for number in range(1, rounds + 1):
            found = Round()
            for leg in range(1, MOST_LEGS + 1):
                at = work / f"{number}-{leg}"
                scoremap, plan, log = at.with_suffix(".tif"), at.with_suffix(".json"), at.with_suffix(".jsonl")
                make_scoremap(
                    site / "classes.tif", scoremap, scores_path=scores, cell_m=CELL_M, explore=explore,
                    no_go_below=NO_GO_BELOW, no_go_share=NO_GO_SHARE, margin_m=MARGIN_M,
                )  # fmt: skip
                request = PlanRequest(
                    starts=() if logs else (parse_start(f"xy:{x},{y}"),),
                    budget=Spending(number * minutes, "min"),
                    method="lawnmower" if robot == "lawnmower" else "refined",
                    effort=0.3,
                    seed=seed,
                    or_stay=True,
                )
                planned = plan_file(scoremap, plan, request, visited=tuple(logs)).robots[0]
                if planned.method == "stay" and planned.score == 0 and planned.budget.cells == 0 and logs:
                    break
                after = logs[-1] if logs else None
                drive_file(
                    plan, site, log, DriveRequest(local=local, seed=1000 * seed + 50 * number + leg), after=after
                )
                logs.append(log)
                measure = evaluate_drives([log]).total
                found.stalled_s += measure.stalled_s or 0.0
                found.spent_s += measure.duration_s
                found.legs += 1
                if robot == "feedback":
                    scores = at.with_name(f"{at.name}-scores.json")
                    learn_scores(logs, site / "classes.tif", scores, FeedbackSettings())
                if read_drive_log(log).end != "stuck":
                    break
            outcome.rounds.append(found)
        total = evaluate_drives(logs, scoremap=site / "true.tif").total
        outcome.score = total.score_collected or 0.0
        if scores is not None:
            outcome.rank, outcome.ranked, outcome.means = ranking(site, scores)
    return outcome


def ranking(site: Path, scores_path: Path) -> tuple[float, int, dict[str, tuple[float, float, float]]]:
    """Return Spearman's rho of learnt means and the hidden truth, over how many kinds of ground, and both by kind.

    A class of the segmentation is the kind of ground that most of its pixels are; classes of one kind are pooled, so
    that there is one learnt mean for each entry of the hidden table.
    """
    true_classes = read_world(site / "world.json").by_id()
    with open_classes(site / "classes.tif") as classes, open_classes(site / "truth.tif") as truth:
        window = Window(0, 0, *classes.grid.shape)
        found, true = classes.read(window), truth.read(window)
    pooled: dict[int, list[float]] = {}
    for number, belief in read_scores(scores_path).items():
        votes = np.bincount(true[(found == number) & (true != 255)], minlength=1)
        if votes.sum():
            sums = pooled.setdefault(int(votes.argmax()), [1.0, 1.0, 0.0])
            for k, value in enumerate((belief.alpha - 1.0, belief.beta - 1.0, belief.evidence_m)):
                sums[k] += value
    means = {
        true_classes[kind].name: (true_classes[kind].drivability, alpha / (alpha + beta), evidence)
        for kind, (alpha, beta, evidence) in pooled.items()
    }
    enough = [each for each in means.values() if each[2] >= ENOUGH_M]
    if len({each[0] for each in enough}) < 2:
        return math.nan, len(enough), means
    return float(spearmanr([e[0] for e in enough], [e[1] for e in enough]).statistic), len(enough), means


def table(outcomes: list[Outcome]) -> None:
    """Print what the robots came to."""
    by = {(o.site, o.seed, o.robot): o for o in outcomes}
    runs = sorted({(o.site, o.seed) for o in outcomes})
    print("rho: Spearman's, over so many kinds of ground; stalls in the first and last round; drives of each robot")
    names = ("rho", "of", "stall 1", "stall n", "feedback", "blind", "lawn", "score", "blind", "lawn")
    print(f"{'site':<13}{'seed':>5}" + "".join(f"{name:>9}" for name in names))
    stalls = {robot: [shares(by[site, seed, robot]) for site, seed in runs] for robot in ROBOTS}
    for number, (site, seed) in enumerate(runs):
        robots = [by[site, seed, robot] for robot in ROBOTS]
        first, last = stalls["feedback"][number]
        legs = "".join(f"{'/'.join(str(r.legs) for r in each.rounds):>9}" for each in robots)
        scores = "".join(f"{each.score:>9.1f}" for each in robots)
        print(f"{site:<13}{seed:>5}{robots[0].rank:>9.2f}{robots[0].ranked:>9}{first:>9.1%}{last:>9.1%}{legs}{scores}")
    ranks = np.array([by[site, seed, "feedback"].rank for site, seed in runs])
    known = ranks[~np.isnan(ranks)]
    print(f"Spearman's rho: mean {known.mean():.3f}; at least .95 in {(known >= 0.95).sum()} of {len(known)} runs")
    for robot in ROBOTS:
        first, last = np.mean(stalls[robot], axis=0)
        print(f"{robot}: stalled {first:.1%} of the time in round 1, {last:.1%} in the last ({last / first - 1:+.0%})")
    total = {robot: sum(o.score for o in outcomes if o.robot == robot) for robot in ROBOTS}
    for robot in ROBOTS[1:]:
        each = [by[site, seed, "feedback"].score / by[site, seed, robot].score for site, seed in runs]
        print(
            f"score: {total['feedback'] / total[robot]:.2f} x {robot} in all, {min(each):.2f} to {max(each):.2f} by run"
        )


def shares(outcome: Outcome) -> tuple[float, float]:
    """Return the shares of the first and of the last round's time that were lost to stalls."""
    first, last = (each.stalled_s / max(each.spent_s, 1e-9) for each in (outcome.rounds[0], outcome.rounds[-1]))
    return first, last


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--side", type=float, default=50.0, help="of a site, m")
    parser.add_argument("--classes", type=int, default=8)
    parser.add_argument("--explore", type=float, default=0.0)
    parser.add_argument("--local", default="pursuit")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--details", action="store_true", help="also the learnt and true mean of every class")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, ProcessPoolExecutor(given.workers) as pool:
        sites = [(SCENES[k % len(SCENES)], 10 + k) for k in range(given.sites)]
        folders = [Path(name) / f"{scene}-{seed}" for scene, seed in sites]
        list(
            pool.map(
                prepare, folders, *zip(*sites, strict=True), [given.side] * len(sites), [given.classes] * len(sites)
            )
        )
        jobs = [(folder, seed, robot) for folder in folders for seed in range(given.seeds) for robot in ROBOTS]
        settings = [[value] * len(jobs) for value in (given.rounds, given.minutes, given.explore, given.local)]
        outcomes = list(pool.map(run, *zip(*jobs, strict=True), *settings))
    table(outcomes)
    if given.details:
        for each in outcomes:
            if each.means:
                print(each.site, each.seed, {k: tuple(round(v, 2) for v in m) for k, m in each.means.items()})


if __name__ == "__main__":
    main()
