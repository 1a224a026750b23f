"""Benchmarks of the planner: what its plans collect, beside bounds, baselines and other programs, and its speed.

    python benchmarks/planning.py [--quick | --full] [--start random|centre|both] [--json FILE] [SECTION ...]

docs/benchmarks.md says what each section measures.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import planning_peers as peers
from planning_maps import HELD_OUT, held_out
from planning_walks import Task, walk_score
from scipy import ndimage
from tables import DATA, Skipped, Table, machine, measure

from hrt_cli.planning.features import build_blocks
from hrt_cli.planning.planner import METHODS, plan
from hrt_cli.planning.policy import Policy, default_policies, roll_many
from hrt_cli.planning.problem import Budget, Plan, Problem
from hrt_cli.planning.train import TrainSpec, train
from hrt_cli.planning.walk import build_field

PACKAGES = ("numpy", "numba", "scipy", "ortools", "pyvrp", "stable-baselines3", "gymnasium", "torch")
SIDE, MOVES = 64, 250
RESAMPLES = 2000
GAMMA = 0.99
AUTHORS = {"policy": 0.976, "greedy": 0.430, "lawnmower": 0.208}
"""Share of their map's total that the authors' stored run gives (policy, greedy, boustrophedon)."""

WELL = 0.84
"""Share of the sum of the best cells that a plan is asked for, where a path can collect so much."""

TOLERANCE = 1e-9
"""Two values closer than this, relatively, are the same; sums in another order differ by less."""


@dataclass(frozen=True)
class Size:
    """How much is measured.

    Parameters
    ----------
    maps, peer_maps, seed_maps : int
        Maps of each family, for the peers, and for the training seeds.
    peer_seconds : float
        Search time of OR-Tools and PyVRP on each map.
    rollouts, iterations : int
        Rollouts sampled on each map, and training steps, whose speed is taken.
    ppo_moves : int
        Moves that PPO learns from.
    large_side, large_moves : int
        The large map and its budget.
    seeds, seed_iterations : int
        Trainings that are compared, and their length.
    starts : tuple of str
        'random', 'centre' or both.
    """

    maps: int = 20
    peer_maps: int = 4
    seed_maps: int = 20
    peer_seconds: float = 10.0
    rollouts: int = 400
    iterations: int = 40
    ppo_moves: int = 16_384
    large_side: int = 1000
    large_moves: int = 5000
    seeds: int = 3
    seed_iterations: int = TrainSpec().iterations
    starts: tuple[str, ...] = ("random",)


NORMAL = Size()
QUICK = Size(
    maps=4, peer_maps=1, seed_maps=2, peer_seconds=2.0, rollouts=50, iterations=5, ppo_moves=4096, large_side=300,
    large_moves=1500, seed_iterations=20,
)  # fmt: skip
FULL = Size(peer_maps=20)


def make_tasks(count: int, start: str = "random") -> list[Task]:
    """Return the first `count` maps of every held-out family."""
    tasks = []
    for family in HELD_OUT:
        for index in range(count):
            score, at = held_out(family, index, SIDE)
            task = Task(family, index, score, at, MOVES)
            if start == "centre":
                cells = np.argwhere(own_region(task))
                nearest = int(np.argmin(np.abs(cells - np.array(score.shape) // 2).sum(axis=1)))
                task = replace(task, start=(int(cells[nearest, 0]), int(cells[nearest, 1])))
            tasks.append(task)
    return tasks


def own_region(task: Task) -> np.ndarray:
    """Return the cells, bool [rows, cols], that can be reached from the start."""
    regions, _ = ndimage.label(~np.isnan(task.score))
    return np.asarray(regions == regions[task.start])


def best_cells(task: Task) -> float:
    """Return the sum of the best cells of the start's region, as many as a walk can visit."""
    return float(np.sort(task.score[own_region(task)])[::-1][: task.moves + 1].sum())


def checked_plan(task: Task, method: str, objective: str = "total", policies: Sequence[Policy] | None = None) -> Plan:
    """Plan, and value the walk again; a RuntimeError if the two differ or the walk breaks a rule."""
    made = plan(Problem(task.score, task.start, Budget(float(task.moves)), objective=objective, gamma=GAMMA), method,
                policies)  # fmt: skip
    for name, gamma, claimed in (("score", 1.0, made.score), ("discounted score", GAMMA, made.discounted_score)):
        found = walk_score(task, made.cells, gamma)
        if abs(found - claimed) > TOLERANCE * max(1.0, abs(found)):
            raise RuntimeError(f"{task.family} {task.index}, {method}: the {name} is {found!r}, not {claimed!r}")
    if made.score > made.upper_bound * (1.0 + TOLERANCE):
        raise RuntimeError(f"{task.family} {task.index}, {method}: {made.score!r} is above its bound")
    return made


@dataclass(frozen=True)
class Made:
    """Plans of one method, and what each of them took."""

    plans: list[Plan]
    cpu_s: list[float]

    def values(self, name: str, maps: int) -> np.ndarray:
        """Return an attribute of the plans, float64 [families, maps]."""
        return np.array([getattr(one, name) for one in self.plans], float).reshape(-1, maps)

    def times(self) -> dict[str, object]:
        """Return the columns of a table that say what a plan took."""
        return {"seconds": timing([one.seconds for one in self.plans]), "CPU seconds": timing(self.cpu_s)}


def make_plans(
    tasks: Sequence[Task], method: str, objective: str = "total", policies: Sequence[Policy] | None = None
) -> Made:
    """Plan on every map, with the CPU time of all threads."""
    plans, cpu_s = [], []
    for task in tasks:
        began = time.process_time()
        plans.append(checked_plan(task, method, objective, policies))
        cpu_s.append(time.process_time() - began)
    return Made(plans, cpu_s)


def interval(values: np.ndarray, below: np.ndarray | None = None) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean over all of values [families, maps], or of a ratio of means.

    Maps are drawn anew within each family, for the families are what they are; of one map each nothing can be told.
    """
    if values.shape[1] == 1:
        return float("nan"), float("nan")
    rng = np.random.default_rng(0)
    draws = rng.integers(0, values.shape[1], (RESAMPLES, *values.shape))
    means = np.take_along_axis(values[None], draws, axis=2).mean(axis=(1, 2))
    if below is not None:
        means = means / np.take_along_axis(below[None], draws, axis=2).mean(axis=(1, 2))
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


def spread(values: np.ndarray, name: str) -> dict[str, object]:
    """Return the mean, the worst and the interval of shares [families, maps] as columns of a table."""
    worst = round(float(values.min()), 4)
    return {name: float(values.mean()), "worst": worst, "95 %": _shown(*interval(values))}


def _shown(low: float, high: float) -> str | None:
    return None if np.isnan(low) else f"{low:.3f}-{high:.3f}"


def compare(
    what: str,
    tasks: Sequence[Task],
    got: Mapping[str, np.ndarray],
    bounds: np.ndarray,
    times: Mapping[str, Mapping[str, object]],
) -> list[Table]:
    """Return the tables of what methods collected: over all maps, then family by family.

    Parameters
    ----------
    got : mapping of str to ndarray [families, maps]
        What each method collected; 'refined' among them.
    bounds : ndarray [families, maps]
        The proven bounds.
    times : mapping of str to columns
        What a plan of each method took.
    """
    best = np.array([best_cells(task) for task in tasks]).reshape(bounds.shape)
    others = np.max([values for name, values in got.items() if name != "refined"], axis=0)
    wins = got["refined"] > others * (1.0 + TOLERANCE)
    ties = ~wins & (got["refined"] >= others * (1.0 - TOLERANCE))
    rows = []
    for name, values in got.items():
        beside = {f"{key} ": value for key, value in spread(values / best, "of the best cells").items()}
        rows.append({"method": name, **spread(values / bounds, "of the bound"), **beside, **times[name]})
    families = []
    for k, family in enumerate(HELD_OUT):
        means: dict[str, object] = {name: float((values[k] / bounds[k]).mean()) for name, values in got.items()}
        one = spread(got["refined"][k : k + 1] / bounds[k : k + 1], "")
        share = float((got["refined"][k] / best[k]).mean())
        families.append({"family": family, **means, "worst": one["worst"], "95 %": one["95 %"], "of best": share,
                         "wins": int(wins[k].sum()),
                         f"{WELL} of best": int((got["refined"][k] >= WELL * best[k]).sum()),
                         "bound below": int((bounds[k] < WELL * best[k]).sum())})  # fmt: skip
    note = (
        f"{bounds.size} maps of {SIDE} x {SIDE} cells, {bounds.shape[1]} of each family, {MOVES} moves; "
        f"refined collects more than every other on {int(wins.sum())} and as much as the best on {int(ties.sum())}"
    )
    of_best = (
        f"of the best cells: of the sum of the {MOVES + 1} best cells that are connected to the start; "
        "seconds, CPU seconds: median and most of a plan, its bound included"
    )
    reach = f"{WELL} of best: maps on which refined collects so much of the best cells; bound below: where no plan can"
    return [
        Table(what, rows, [note, of_best]),
        Table(
            f"{what}, by family: mean share of the bound; worst, 95 %, of best and wins are refined's",
            families,
            [reach],
        ),
    ]


def ratios(what: str, pairs: Sequence[tuple[str, str]], got: Mapping[str, np.ndarray]) -> Table:
    """Return the table of ratios of what methods collected: of the means over all maps, and family by family."""
    rows: list[dict[str, object]] = []
    for over, under in pairs:
        paid = got[under] > 0.0
        least = float((got[over][paid] / got[under][paid]).min()) if paid.any() else None
        row: dict[str, object] = {"ratio": f"{over} / {under}", "all": float(got[over].mean() / got[under].mean())}
        row |= {
            "95 %": _shown(*interval(got[over], got[under])),
            "least of a map": least,
        }
        row |= {family: float(got[over][k].mean() / got[under][k].mean()) for k, family in enumerate(HELD_OUT)}
        rows.append(row)
    return Table(what, rows)


def timing(seconds: Sequence[float]) -> str:
    """Return the median and the most of some times."""
    return f"{np.median(seconds):.3f}, {np.max(seconds):.3f}"


def warm_up(methods: Sequence[str] = METHODS, objective: str = "total") -> None:
    """Compile, so that no plan is charged for it."""
    score, start = held_out("shores", 10_000, SIDE)
    for method in methods:
        checked_plan(Task("warm-up", 0, score, start, MOVES), method, objective)


def quality(size: Size) -> list[Table]:
    warm_up()
    tables = []
    for start in size.starts:
        tasks = make_tasks(size.maps, start)
        plans = {method: make_plans(tasks, method) for method in METHODS[::-1]}
        got = {method: made.values("score", size.maps) for method, made in plans.items()}
        bounds = plans["refined"].values("upper_bound", size.maps)
        times = {method: made.times() for method, made in plans.items()}
        tables += compare(f"quality, {start} starts", tasks, got, bounds, times)
        pairs = [("policy", "lawnmower"), ("policy", "greedy"), ("refined", "rectangle")]
        tables.append(ratios(f"quality, {start} starts: ratios of what is collected", pairs, got))
    return tables


def beside_peers(size: Size) -> list[Table]:
    warm_up(("refined", "rectangle"))
    solvers: dict[str, Callable[[Task], np.ndarray]] = {}
    absent = []
    for package, name in (("ortools", "OR-Tools"), ("pyvrp", "PyVRP")):
        try:
            peers.need(package)
        except Skipped as reason:
            absent.append(str(reason))
            continue
        if package == "pyvrp":
            solvers[name] = lambda task: peers.pyvrp_walk(task, size.peer_seconds)
        else:
            solvers[name] = lambda task: peers.ortools_walk(task, size.peer_seconds)
            solvers[f"{name} from rectangle"] = lambda task: peers.ortools_walk(
                task, size.peer_seconds, checked_plan(task, "rectangle").cells
            )
    if not solvers:
        raise Skipped("; ".join(absent))
    tasks = make_tasks(size.peer_maps)
    refined = make_plans(tasks, "refined")
    got = {"refined": refined.values("score", size.peer_maps)}
    times = {"refined": refined.times()}
    for name, solve in solvers.items():
        scores, wall_s, cpu_s = [], [], []
        for task in tasks:
            began, began_cpu = time.perf_counter(), time.process_time()
            walk = solve(task)
            wall_s.append(time.perf_counter() - began)
            cpu_s.append(time.process_time() - began_cpu)
            scores.append(walk_score(task, walk))
        got[name] = np.array(scores).reshape(-1, size.peer_maps)
        times[name] = {"seconds": timing(wall_s), "CPU seconds": timing(cpu_s)}
    bounds = refined.values("upper_bound", size.peer_maps)
    if any((values > bounds * (1.0 + TOLERANCE)).any() for values in got.values()):
        raise RuntimeError("a peer's walk is above the proven bound")
    what = f"peers, given {size.peer_seconds:g} CPU seconds of search a map"
    tables = compare(what, tasks, got, bounds, times)
    pairs = [("refined", name) for name in solvers]
    closing = ratios(f"{what}: ratios of what is collected", pairs, got)
    notes = [*absent, "seconds of the peers hold their set-up and the expansion of the tour besides the search"]
    return [*tables, replace(closing, notes=notes)]


def rollout_speed(tasks: Sequence[Task], rollouts: int, threads: int) -> tuple[float, float]:
    """Return the moves per second and per CPU second of sampled rollouts, shared out among the default policies."""
    policies = default_policies()
    fields = [build_field(Problem(task.score, task.start, Budget(float(task.moves)))) for task in tasks]
    jobs = [(field, build_blocks(field, policy.layout), policy.weights, rollouts // len(policies), k)
            for k, field in enumerate(fields) for policy in policies]  # fmt: skip
    roll_many(*jobs[0])

    def one(k: int) -> int:
        return int((roll_many(*jobs[k])[1] - 1).sum())

    clock = peers.Clock()
    with ThreadPoolExecutor(threads) as pool:
        return clock.rates(sum(pool.map(one, range(len(jobs)))))


def speed(size: Size) -> list[Table]:
    tasks = make_tasks(2)
    train(TrainSpec(iterations=1))
    specs = [TrainSpec(iterations=size.iterations, layout=policy.layout) for policy in default_policies()]
    default = TrainSpec()
    each = default.maps_per_iteration * default.rollouts
    clock = peers.Clock()
    for spec in specs:
        train(spec)
    learning = clock.rates(len(specs) * size.iterations * each * default.moves)
    measured = {
        "hrt, sampled rollouts, 1 thread": rollout_speed(tasks, size.rollouts, 1),
        "hrt, sampled rollouts, 2 threads": rollout_speed(tasks, size.rollouts, 2),
        "hrt, training, 2 threads": learning,
    }
    seconds = len(specs) * default.iterations * each * default.moves / learning[0]
    notes = [f"training of the default policies: {seconds:.1f} s for {default.iterations} iterations each, of "
             f"{default.maps_per_iteration} maps and {each} rollouts of {default.moves} moves"]  # fmt: skip
    try:
        learners = [peers.ppo_speed(tasks, envs, size.ppo_moves) for envs in (1, 8)]
        for one in learners:
            measured[f"Stable-Baselines3 PPO, learning, {one.envs} at once"] = one.learning
            measured[f"its environment alone, {one.envs} at once"] = one.stepping
        faster = [learning[k] / max(one.learning[k] for one in learners) for k in (0, 1)]
        notes.append(f"hrt learns from {faster[0]:.0f} x the moves of PPO per second, {faster[1]:.0f} x per CPU second")
    except Skipped as reason:
        notes.append(f"Stable-Baselines3: skipped, {reason}")
    rows = [{"what": what, "moves per second": round(rates[0]), "per CPU second": round(rates[1])}
            for what, rates in measured.items()]  # fmt: skip
    return [Table("speed, moves", rows, notes), _plan_times(size)]


def _plan_times(size: Size) -> Table:
    warm_up(("refined",))
    made = make_plans(make_tasks(min(size.maps, 5)), "refined")
    rows: list[dict[str, object]] = [
        {"map": f"{SIDE} x {SIDE}", "moves": MOVES, "maps": len(made.plans), **made.times(), "peak MB": None}
    ]
    command = [sys.executable, __file__, "--one-map", str(size.large_side), str(size.large_moves)]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)
    row = {"map": f"{size.large_side} x {size.large_side}", "moves": size.large_moves, "maps": 1}
    rows.append({**row, **json.loads(done.stdout)})
    return Table(
        "speed, refined plans", rows, ["median and most; peak memory is that of a process of its own, numba and all"]
    )


def one_map(side: int, moves: int) -> None:
    """Plan on one large map and print the time and the peak memory of this process as JSON."""
    warm_up(("refined",))
    score, start = held_out("lognormal", 0, side)
    made = make_plans([Task("lognormal", 0, score, start, moves)], "refined")
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = next(int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM"))
    print(json.dumps({**made.times(), "peak MB": round(peak)}))


def discounted(size: Size) -> list[Table]:
    methods = ("greedy", "rectangle", "policy", "refined")
    warm_up(methods, "discounted")
    tasks = make_tasks(size.maps)
    plans = {method: make_plans(tasks, method, "discounted") for method in methods}
    bounds = plans["refined"].values("discounted_upper_bound", size.maps)
    rows, families = [], [{"family": family} for family in HELD_OUT]
    for method, made in plans.items():
        shares = made.values("discounted_score", size.maps) / bounds
        rows.append({"method": method, **spread(shares, "of the bound"), **made.times()})
        for k, row in enumerate(families):
            row[method] = float(shares[k].mean())  # type: ignore[assignment]
    note = f"{len(tasks)} maps, gamma {GAMMA}: discounted score over the discounted bound of the refined plan"
    return [Table("discounted", rows, [note]), Table("discounted, by family: mean share of the bound", families)]


def authors(size: Size) -> list[Table]:
    file = DATA / "planning" / "gaussian_mixture_test1.npz"
    if not file.exists():
        raise Skipped(f"{file.name} is not in ../shared/data/planning")
    warm_up()
    with np.load(file, allow_pickle=False) as arrays:
        score = arrays["score"]
    cells = np.random.default_rng(0).choice(score.size, 21, replace=False)
    tasks = [Task("authors", k, score, (int(cell) // score.shape[1], int(cell) % score.shape[1]), 200)
             for k, cell in enumerate(cells)]  # fmt: skip
    rows: list[dict[str, object]] = []
    runs: list[tuple[str, str, list[Policy] | None]] = [
        (method, method, None) for method in ("lawnmower", "greedy", "policy", "policy-sample", "refined")
    ]
    runs += [(f"policy, {policy.layout} alone", "policy", [policy]) for policy in default_policies()]
    for name, method, policies in runs:
        made = make_plans(tasks, method, policies=policies)
        shares = made.values("score", len(tasks)) / float(score.sum())
        bound = float(made.values("upper_bound", len(tasks)).mean() / score.sum())
        rows.append({"method": name, **spread(shares, "of the total"), "bound": bound,
                     "authors": AUTHORS.get(name)})  # fmt: skip
    notes = ["their test map 1, 30 x 30 cells, 200 moves, 21 starts drawn at random (theirs are not known)",
             "authors: the policy they trained on one map, their greedy and their boustrophedon"]  # fmt: skip
    return [Table("authors", rows, notes)]


def seeds(size: Size) -> list[Table]:
    tasks = make_tasks(size.seed_maps)
    bounds = make_plans(tasks, "refined").values("upper_bound", size.seed_maps)
    rows, means = [], []
    for seed in range(size.seeds):
        trained = [train(TrainSpec(seed=seed, iterations=size.seed_iterations, layout=policy.layout))
                   for policy in default_policies()]  # fmt: skip
        both = [policy for policy, _ in trained]
        shares, *alone = (make_plans(tasks, "policy", policies=policies).values("score", size.seed_maps) / bounds
                          for policies in (both, *([policy] for policy in both)))  # fmt: skip
        means.append(float(shares.mean()))
        families = {family: float(shares[k].mean()) for k, family in enumerate(HELD_OUT)}
        last = [round(float(curve[-20:].mean()), 3) for _, curve in trained]
        rows.append({"seed": seed, **spread(shares, "of the bound"), "last of the curve": last,
                     **{f"{policy.layout} alone": float(share.mean())
                        for policy, share in zip(both, alone, strict=True)}, **families})  # fmt: skip
    notes = [f"{len(tasks)} maps; the likeliest moves of policies trained for {size.seed_iterations} iterations",
             f"mean of the seeds {np.mean(means):.4f}, standard deviation {np.std(means, ddof=1):.4f}"]  # fmt: skip
    return [Table("seeds", rows, notes)]


SECTIONS: dict[str, Callable[[Size], list[Table]]] = {
    "quality": quality,
    "peers": beside_peers,
    "speed": speed,
    "discounted": discounted,
    "authors": authors,
    "seeds": seeds,
}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"{', '.join(SECTIONS)}; all by default")
    effort = parser.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_const", dest="size", const=QUICK, help="few maps, little time")
    effort.add_argument("--full", action="store_const", dest="size", const=FULL, help="all maps for the peers too")
    parser.add_argument("--start", choices=("random", "centre", "both"), default="random", help="starts of 'quality'")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    parser.add_argument("--one-map", type=int, nargs=2, metavar=("SIDE", "MOVES"), help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.one_map:
        one_map(*given.one_map)
        return
    unknown = [name for name in given.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"no section {', '.join(unknown)}: choose from {', '.join(SECTIONS)}")
    starts = ("random", "centre") if given.start == "both" else (given.start,)
    results = measure(SECTIONS, given.sections or list(SECTIONS), replace(given.size or NORMAL, starts=starts))
    if given.json:
        figures = {"machine": machine(PACKAGES), "sections": results}
        given.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
