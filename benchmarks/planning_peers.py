"""Peers of the planner on its own task: OR-Tools' routing, PyVRP, and PPO of Stable-Baselines3.

None of this uses hrt. The two routing solvers are given an orienteering problem: the promising cells are optional
nodes with their scores as prizes, the arcs between them are shortest paths, one vehicle has the moves as its length
and ends where it likes. docs/benchmarks.md says which formulations were tried.
"""

from __future__ import annotations

import importlib
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from planning_walks import Task, expand_tour
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from tables import Skipped

PRIZE_SCALE = 1000
"""Prize of a score of 1 in the solvers' integers."""

ORTOOLS_CELLS = 300
PYVRP_CELLS = 300
"""Cells offered to the solvers: the best of the map that can be reached."""

PATIENCE = 50
"""Seconds on the clock that a second of CPU may take at most."""

PYVRP_NEIGHBOURS = 100
"""Cells that PyVRP tries beside each."""

PYVRP_MOVE_COST = 20
"""Cost of a move for PyVRP, a fiftieth of a score of 1: without it its search is led by prizes alone, and worse."""

RING_SIZES = (1, 3, 9, 27)
"""Sides of the blocks the learner sees in a ring around itself, as the policies of hrt do."""

ROLLOUT = 2048
"""Moves between two updates of PPO, its default, over all environments."""

RING = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))
MOVES = RING[::2]


def need(name: str) -> ModuleType:
    """Return the module of a peer, or skip what needs it."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise Skipped(f'{name.partition(".")[0]} is not installed (pip install -e ".[bench]")') from None


def spent(seconds: float, every: int = 1) -> Callable[[], bool]:
    """Return what tells whether this process has used `seconds` of CPU from now on; one call in `every` looks.

    Both solvers search on one thread, so that on an idle machine these are seconds on the clock; on a busy one they
    lose nothing.
    """
    until = time.process_time() + seconds
    asked = itertools.count(1)
    return lambda: next(asked) % every == 0 and time.process_time() >= until


def steps_from(score: np.ndarray, cells: np.ndarray, far: int) -> np.ndarray:
    """Return the fewest moves, int64 [len(cells), rows * cols], from cells to all others; `far` where none."""
    rows, cols = score.shape
    row, col = np.divmod(np.arange(rows * cols), cols)
    if not np.isnan(score).any():
        return np.abs(row[cells][:, None] - row) + np.abs(col[cells][:, None] - col)
    free, index = ~np.isnan(score), np.arange(rows * cols).reshape(rows, cols)
    across, down = free[:, :-1] & free[:, 1:], free[:-1] & free[1:]
    one = np.concatenate([index[:, :-1][across], index[:-1][down]])
    other = np.concatenate([index[:, 1:][across], index[1:][down]])
    ends = (np.concatenate([one, other]), np.concatenate([other, one]))
    graph = csr_array((np.ones(2 * one.size), ends), shape=(rows * cols, rows * cols))
    steps = dijkstra(graph, indices=cells, unweighted=True)
    return np.where(np.isfinite(steps), steps, far).astype(np.int64)


@dataclass(frozen=True)
class Nodes:
    """What a solver sees: cells int64 [k], the start first; their prizes int64 [k]; the moves between them.

    `steps`, int64 [k + 1, k + 1], has one node more than there are cells: the free end, no move away from all.
    """

    cells: np.ndarray
    prizes: np.ndarray
    steps: np.ndarray


def offer(task: Task, count: int, also: Sequence[int] = ()) -> Nodes:
    """Return the `count` best cells within reach, and those of `also`, as nodes."""
    far = 2 * task.moves + 2
    start = task.start[0] * task.score.shape[1] + task.start[1]
    worth = np.nan_to_num(task.score.ravel(), nan=0.0)
    reached = steps_from(task.score, np.array([start]), far)[0] <= task.moves
    ranked = np.argsort(-np.where(reached, worth, 0.0), kind="stable")[:count]
    chosen = np.union1d(ranked[worth[ranked] > 0.0], np.array(also, np.int64))
    cells = np.concatenate([[start], chosen[chosen != start]])
    steps = np.zeros((cells.size + 1, cells.size + 1), np.int64)
    steps[:-1, :-1] = steps_from(task.score, cells, far)[:, cells]
    return Nodes(cells, np.round(PRIZE_SCALE * worth[cells]).astype(np.int64), steps)


def ortools_walk(task: Task, seconds: float, initial: np.ndarray | None = None) -> np.ndarray:
    """Return the walk, int [n, 2], that OR-Tools' routing finds in `seconds` of CPU.

    `initial`, int [n, 2], is a walk that the search starts from.
    """
    routing = need("ortools.constraint_solver.pywrapcp")
    enums = need("ortools.constraint_solver.routing_enums_pb2")
    first = [] if initial is None else list(dict.fromkeys(int(r) * task.score.shape[1] + int(c) for r, c in initial))
    nodes = offer(task, ORTOOLS_CELLS, first)
    end = nodes.cells.size
    manager = routing.RoutingIndexManager(end + 1, 1, [0], [end])
    model = routing.RoutingModel(manager)
    steps = model.RegisterTransitMatrix(nodes.steps.tolist())
    model.SetArcCostEvaluatorOfAllVehicles(steps)
    model.AddDimension(steps, 0, task.moves, True, "length")
    for node in range(1, end):
        model.AddDisjunction([manager.NodeToIndex(node)], int(nodes.prizes[node]))
    search = routing.DefaultRoutingSearchParameters()
    search.first_solution_strategy = enums.FirstSolutionStrategy.PARALLEL_CHEAPEST_INSERTION
    search.local_search_metaheuristic = enums.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    search.time_limit.FromSeconds(round(PATIENCE * seconds))
    limit = spent(seconds, 64)
    model.AddSearchMonitor(model.solver().CustomLimit(limit))
    if initial is None:
        found = model.SolveWithParameters(search)
    else:
        number = {int(cell): node for node, cell in enumerate(nodes.cells)}
        model.CloseModelWithParameters(search)
        given = model.ReadAssignmentFromRoutes([[number[cell] for cell in first[1:]]], True)
        found = model.SolveFromAssignmentWithParameters(given, search)
    tour: list[int] = []
    if found is not None:
        at = found.Value(model.NextVar(model.Start(0)))
        while not model.IsEnd(at):
            tour.append(int(nodes.cells[manager.IndexToNode(at)]))
            at = found.Value(model.NextVar(at))
    return expand_tour(task, tour)


def pyvrp_walk(task: Task, seconds: float, seed: int = 1) -> np.ndarray:
    """Return the walk, int [n, 2], that PyVRP finds in `seconds` of CPU."""
    vrp, search = need("pyvrp"), need("pyvrp.search")
    nodes = offer(task, PYVRP_CELLS)
    end = nodes.cells.size
    clients = [vrp.Client(node, prize=int(nodes.prizes[node]), required=False) for node in range(1, end)]
    vehicle = vrp.VehicleType(
        1, start_depot=0, end_depot=1, max_distance=task.moves, unit_distance_cost=PYVRP_MOVE_COST
    )
    places = [vrp.Location(int(cell % task.score.shape[1]), int(cell // task.score.shape[1])) for cell in nodes.cells]
    data = vrp.ProblemData(
        [*places, places[0]], clients, [vrp.Depot(0), vrp.Depot(end)], [vehicle],
        [nodes.steps], [np.zeros_like(nodes.steps)],
    )  # fmt: skip
    params = vrp.SolveParams(neighbourhood=search.NeighbourhoodParams(num_neighbours=PYVRP_NEIGHBOURS))
    limit = spent(seconds)
    found = vrp.solve(data, lambda _: limit(), seed=seed, collect_stats=False, display=False, params=params)
    routes = found.best.routes() if found.is_feasible() else []
    tour = [int(nodes.cells[1 + visit.idx]) for route in routes for visit in route if visit.is_client()]
    return expand_tour(task, tour)


class CollectingGame:
    """The task as a game: what the learner sees, and what a move pays.

    It sees the blocks of hrt's policies: rings of eight blocks of 1, 3, 9 and 27 cells a side, the mean of the score
    left in each and the share of it that cannot be entered. Block sums are kept up to date by subtraction, so that a
    move costs a few array operations.
    """

    def __init__(self, tasks: Sequence[Task]) -> None:
        self.tasks = tasks
        self.pad = RING_SIZES[-1] + RING_SIZES[-1] // 2 + 1
        self.shape = (tasks[0].score.shape[0] + 2 * self.pad, tasks[0].score.shape[1] + 2 * self.pad)
        around = np.array([row * self.shape[1] + col for row, col in RING])
        plane = self.shape[0] * self.shape[1]
        self.places = np.concatenate([level * plane + size * around for level, size in enumerate(RING_SIZES)])
        self.shares = np.repeat([1.0 / size**2 for size in RING_SIZES], len(RING))
        self.maps = [self._prepare(task) for task in tasks]

    def _prepare(self, task: Task) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        worth = np.pad(np.nan_to_num(task.score, nan=0.0), self.pad)
        best = np.sort(worth.ravel())[::-1][: task.moves + 1].mean()
        worth = worth / best if best > 0 else worth
        free = np.pad(~np.isnan(task.score), self.pad)
        sums = np.stack([_block_sums(worth, size) for size in RING_SIZES])
        blocked = np.stack([1.0 - _block_sums(free.astype(float), size) / size**2 for size in RING_SIZES])
        return worth, sums, blocked

    def reset(self, which: int) -> np.ndarray:
        worth, sums, self.blocked = self.maps[which]
        task = self.tasks[which]
        self.worth, self.sums = worth.copy(), sums.copy()
        self.open = self.blocked[0] < 0.5
        self.row, self.col = task.start[0] + self.pad, task.start[1] + self.pad
        self.left = task.moves
        self._collect()
        return self._look()

    def step(self, move: int) -> tuple[np.ndarray, float, bool]:
        """Move, or stay where that is forbidden; return what is seen, what the move paid and whether it is over."""
        row, col = self.row + MOVES[move][0], self.col + MOVES[move][1]
        reward = 0.0
        if self.open[row, col]:
            self.row, self.col = row, col
            reward = self._collect()
        self.left -= 1
        return self._look(), reward, self.left == 0

    def _collect(self) -> float:
        paid = float(self.worth[self.row, self.col])
        if paid > 0.0:
            self.worth[self.row, self.col] = 0.0
            for level, size in enumerate(RING_SIZES):
                half = size // 2
                self.sums[level, self.row - half : self.row + half + 1, self.col - half : self.col + half + 1] -= paid
        return paid

    def _look(self) -> np.ndarray:
        at = self.places + (self.row * self.shape[1] + self.col)
        seen = [self.sums.ravel()[at] * self.shares, self.blocked.ravel()[at]]
        return np.concatenate(seen).astype(np.float32)


def _block_sums(values: np.ndarray, size: int) -> np.ndarray:
    """Return the sum over the block of `size` a side centred at each cell, of zeros beyond the edge."""
    half = size // 2
    table = np.zeros((values.shape[0] + 2 * half + 1, values.shape[1] + 2 * half + 1))
    table[1:, 1:] = np.pad(values, half).cumsum(axis=0).cumsum(axis=1)
    return table[size:, size:] - table[:-size, size:] - table[size:, :-size] + table[:-size, :-size]


class Clock:
    """Counts moves per second on the clock and per second of CPU from its making on."""

    def __init__(self) -> None:
        self.began = time.perf_counter(), time.process_time()

    def rates(self, moves: int) -> tuple[float, float]:
        return moves / (time.perf_counter() - self.began[0]), moves / (time.process_time() - self.began[1])


@dataclass(frozen=True)
class LearningSpeed:
    """Moves per second and per CPU second of PPO while it learns, and of its environments alone."""

    envs: int
    learning: tuple[float, float]
    stepping: tuple[float, float]


def ppo_speed(tasks: Sequence[Task], envs: int, moves: int) -> LearningSpeed:
    """Let Stable-Baselines3's PPO learn the task for at least `moves` moves, on one thread of torch.

    More threads are slower: its network is small.
    """
    need("torch").set_num_threads(1)
    gym, sb3, vec = need("gymnasium"), need("stable_baselines3"), need("stable_baselines3.common.vec_env")

    class Env(gym.Env):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            self.game = CollectingGame(tasks)
            self.observation_space = gym.spaces.Box(-np.inf, np.inf, (2 * self.game.places.size,), np.float32)
            self.action_space = gym.spaces.Discrete(len(MOVES))

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
            super().reset(seed=seed)
            return self.game.reset(int(self.np_random.integers(len(tasks)))), {}

        def step(self, action: Any) -> Any:
            seen, reward, over = self.game.step(int(action))
            return seen, reward, False, over, {}

    venv = vec.DummyVecEnv([Env] * envs)
    venv.reset()
    actions = [np.random.default_rng(0).integers(0, len(MOVES), envs) for _ in range(2000 // envs)]
    clock = Clock()
    for action in actions:
        venv.step(action)
    stepping = clock.rates(envs * len(actions))
    model = sb3.PPO("MlpPolicy", venv, n_steps=ROLLOUT // envs, seed=0, device="cpu")
    model.learn(ROLLOUT)
    clock = Clock()
    model.learn(moves, reset_num_timesteps=False)
    return LearningSpeed(envs, clock.rates(model.num_timesteps - ROLLOUT), stepping)
