"""Policy-gradient training on many maps: GPOMDP and REINFORCE with unbiased baselines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.planning.families import FAMILIES, make_map
from hrt_cli.planning.features import LAYOUTS, TIED, Blocks, build_blocks, feature_count, weight_count
from hrt_cli.planning.jit import kernel
from hrt_cli.planning.policy import SEED_STRIDE, Policy, roll, shape_net
from hrt_cli.planning.problem import NEIGHBOURS_8, Budget, Problem
from hrt_cli.planning.walk import Field, build_field, capacity
from hrt_cli.progress import Progress, silent

ESTIMATORS = ("gpomdp", "reinforce")

ADAM_DECAY = (0.9, 0.99)
ADAM_EPSILON = 1e-8
"""Constants of Adam (Kingma and Ba 2015); the second decay is short, as a training has few hundred steps."""

FIRST_SPREAD = 0.1
"""Standard deviation of the weights of the hinges before training."""

THREADS = 2
"""Maps rolled out at the same time; the answer does not depend on it."""


@dataclass(frozen=True)
class TrainSpec:
    """Hyper-parameters of a training.

    Parameters
    ----------
    estimator : {'gpomdp', 'reinforce'}
        Rewards to go against a baseline per time step, or whole returns against one baseline.
    layout : str
        Feature layout, one of `features.LAYOUTS`.
    iterations : int
        Steps of the optimiser.
    maps_per_iteration, rollouts : int
        Maps (each with its own start) per step, and rollouts on each; at least 2 rollouts.
    map_side : int
        Rows and columns of the largest generated maps; the smallest have a third as many.
    moves : int
        Budget of a rollout.
    trace_decay : float
        Discount of the eligibility trace (Baxter and Bartlett 2001), in (0, 1]; 1 is unbiased.
    learning_rate : float
        Adam's step at the start; it falls to a tenth by a cosine.
    eight : float
        Share of the maps on which diagonal moves are allowed.
    families : tuple of str
        Map families drawn from, see `families.FAMILIES`.
    seed : int
        Random seed, >= 0.
    """

    estimator: str = "gpomdp"
    layout: str = "network"
    iterations: int = 300
    maps_per_iteration: int = 8
    rollouts: int = 16
    map_side: int = 64
    moves: int = 250
    trace_decay: float = 0.98
    learning_rate: float = 0.1
    eight: float = 0.25
    families: tuple[str, ...] = FAMILIES
    seed: int = 0

    def __post_init__(self) -> None:
        if self.estimator not in ESTIMATORS:
            raise ArgumentError(f"unknown estimator {self.estimator!r} (one of: {', '.join(ESTIMATORS)})")
        if self.layout not in LAYOUTS:
            raise ArgumentError(f"unknown feature layout {self.layout!r} (one of: {', '.join(LAYOUTS)})")
        unknown = sorted(set(self.families) - set(FAMILIES))
        if unknown or not self.families:
            raise ArgumentError(
                f"unknown map families: {', '.join(unknown) or 'none given'} (known: {', '.join(FAMILIES)})"
            )
        for name, least in (("iterations", 1), ("maps_per_iteration", 1), ("rollouts", 2), ("map_side", 4),
                            ("moves", 1), ("seed", 0)):  # fmt: skip
            if getattr(self, name) < least:
                raise ArgumentError(f"{name} must be at least {least}, not {getattr(self, name)}")
        if not 0.0 < self.trace_decay <= 1.0:
            raise ArgumentError(f"trace_decay must be above 0 and at most 1, not {self.trace_decay}")
        if not 0.0 < self.learning_rate < np.inf:
            raise ArgumentError(f"learning_rate must be a positive number, not {self.learning_rate}")
        if not 0.0 <= self.eight <= 1.0:
            raise ArgumentError(f"eight must be between 0 and 1, not {self.eight}")


@dataclass(frozen=True)
class TrainState:
    """Where a training stands between two steps of the optimiser: all that the next ones depend on.

    Attributes
    ----------
    done : int
        Steps made.
    weights : ndarray, float64 [weights]
        The policy's.
    mean, square : ndarray, float64 [weights]
        Adam's running means of the gradient and of its square, which start from zero.
    curve : ndarray, float64 [iterations]
        The learning curve; what comes from `done` on means nothing yet. Later states share it.
    """

    done: int
    weights: NDArray[np.float64]
    mean: NDArray[np.float64]
    square: NDArray[np.float64]
    curve: NDArray[np.float64]

    @classmethod
    def fresh(cls, spec: TrainSpec) -> TrainState:
        """Return the state before the first step."""
        weights = first_weights(spec.layout, spec.seed)
        return cls(0, weights, np.zeros_like(weights), np.zeros_like(weights), np.zeros(spec.iterations))

    def to_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the state as named arrays without objects, ready for an NPZ file."""
        return {"weights": self.weights, "mean": self.mean, "square": self.square, "curve": self.curve[: self.done]}

    @classmethod
    def from_arrays(cls, spec: TrainSpec, arrays: Mapping[str, NDArray[np.generic]]) -> TrainState:
        """Return the state that `to_arrays` wrote.

        Raises
        ------
        ValueError
            When the arrays are not those of a training as `spec` wants it.
        """
        state = cls.fresh(spec)
        expected = state.to_arrays()
        if set(arrays) != set(expected):
            raise ValueError("is not the state of a training")
        for name, like in expected.items():
            shape = (min(arrays[name].size, spec.iterations),) if name == "curve" else like.shape
            if arrays[name].dtype != like.dtype or arrays[name].shape != shape:
                raise ValueError(f"{name} is {arrays[name].dtype} {arrays[name].shape}, not {like.dtype} {shape}")
            if not np.isfinite(arrays[name].astype(np.float64)).all():
                raise ValueError(f"{name} is not finite")
        weights, mean, square, curve = (
            arrays[name].astype(np.float64) for name in ("weights", "mean", "square", "curve")
        )
        state.curve[: curve.size] = curve
        return cls(curve.size, weights, mean, square, state.curve)


@kernel
def explore(
    field: Field, blocks: Blocks, weights: NDArray[np.float64], count: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Return rewards [count, moves] and gradients of log pi [count, moves, weights] of sampled rollouts.

    Rewards are in units of `blocks.scale`; what the start pays is left out, no move earns it.
    """
    moves = capacity(field) - 1
    rewards = np.zeros((count, moves))
    net = shape_net(weights, blocks)
    features = blocks.levels * TIED + blocks.constants
    scores = np.zeros((count, moves, net.shape[0], features), np.float32)
    path = np.zeros(moves + 1, np.int64)
    fresh = np.zeros(moves + 1)
    sums = blocks.sums.copy()
    state = np.zeros(1, np.uint64)
    for i in range(count):
        state[0] = np.uint64(seed) + np.uint64(i + 1) * SEED_STRIDE
        # Told at run time, so that one compiled `roll` serves all its callers.
        n = roll(field, blocks, sums, net, count > 0, state, path, fresh, scores[i])
        rewards[i, : n - 1] = fresh[1:n]
    return rewards, scores.reshape((count, moves, weights.size))


@kernel
def add_scores(factors: NDArray[np.float64], scores: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the sum of `scores` [rollouts, moves, weights], each times its factor [rollouts, moves]."""
    total = np.zeros(scores.shape[2])
    for i in range(scores.shape[0]):
        for t in range(scores.shape[1]):
            for k in range(scores.shape[2]):
                total[k] += factors[i, t] * scores[i, t, k]
    return total


def gpomdp_gradient(
    rewards: NDArray[np.float64], scores: NDArray[np.float32], trace_decay: float = 1.0
) -> NDArray[np.float64]:
    """Return the GPOMDP estimate of the gradient of the expected reward.

    grad = 1/m sum_i sum_t score_it sum_{j >= t} decay^(j - t) (r_ij - b_ij) (Baxter and Bartlett 2001), with
    b_ij the mean reward at time j over the *other* rollouts from the same start: independent of rollout i, so
    the estimate stays unbiased at decay 1.

    Parameters
    ----------
    rewards : ndarray, float64 [rollouts, moves]
        Rewards of rollouts from one start.
    scores : ndarray, float32 [rollouts, moves, weights]
        Gradients of log pi.
    trace_decay : float
        In (0, 1]; below 1 trades bias for variance.

    Returns
    -------
    ndarray, float64 [weights]
    """
    count = rewards.shape[0]
    advantage = rewards - (rewards.sum(axis=0) - rewards) / (count - 1)
    to_go = np.zeros_like(advantage)
    carried = np.zeros(count)
    for t in range(rewards.shape[1] - 1, -1, -1):
        carried = advantage[:, t] + trace_decay * carried
        to_go[:, t] = carried
    return np.asarray(add_scores(to_go, scores) / count)


def reinforce_gradient(rewards: NDArray[np.float64], scores: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the REINFORCE estimate of the gradient of the expected reward (Williams 1992).

    grad = 1/m sum_i (R_i - b_i) sum_t score_it, with b_i the mean return of the other rollouts. Arguments as
    for `gpomdp_gradient`.
    """
    returns = rewards.sum(axis=1)
    count = returns.size
    advantage = returns - (returns.sum() - returns) / (count - 1)
    return np.asarray(add_scores(np.repeat(advantage[:, None], scores.shape[1], axis=1), scores) / count)


def first_weights(layout: str, seed: int) -> NDArray[np.float64]:
    """Return the weights a training starts from: zeros for the linear part, small random ones for the hinges."""
    weights = np.zeros(weight_count(layout))
    hinges = weights[feature_count(layout) :]
    hinges[:] = np.random.default_rng(seed).normal(0.0, FIRST_SPREAD, hinges.size)
    return weights


def forget(state: TrainState) -> None:
    """Keep nothing: what `train` does with its states unless told otherwise."""


def train(
    spec: TrainSpec,
    maps: Sequence[NDArray[np.floating]] | None = None,
    progress: Progress = silent,
    *,
    state: TrainState | None = None,
    keep: Callable[[TrainState], object] = forget,
) -> tuple[Policy, NDArray[np.float64]]:
    """Train a policy; return it and its learning curve.

    Parameters
    ----------
    spec : TrainSpec
        Hyper-parameters; they become the policy's recipe.
    maps : sequence of ndarray [rows, cols], optional
        Score maps to draw from (NaN = no-go); without it new maps of `spec.families` are made all along.
    progress : Progress
        Called with (iterations done, iterations).
    state : TrainState, optional
        Where an earlier training by the same `spec` and `maps` was; the outcome is that of one that never stopped.
    keep : callable
        Called with the state after each step.

    Returns
    -------
    policy : Policy
    curve : ndarray, float64 [iterations]
        Mean share of the best T cells of the map (of all, where there are fewer) that a rollout collected, per
        iteration.

    Raises
    ------
    ArgumentError
        When a map has no cell to start from.
    """
    state = state or TrainState.fresh(spec)
    with ThreadPoolExecutor(THREADS) as pool:
        while state.done < spec.iterations:
            state = _step(spec, maps, state, pool)
            keep(state)
            progress(state.done, spec.iterations)
    recipe: dict[str, str | int | float] = {
        name: ",".join(value) if isinstance(value, tuple) else value for name, value in asdict(spec).items()
    }
    recipe["maps"] = "generated" if maps is None else len(maps)
    return Policy(state.weights, spec.layout, recipe), state.curve


def _step(
    spec: TrainSpec, maps: Sequence[NDArray[np.floating]] | None, state: TrainState, pool: ThreadPoolExecutor
) -> TrainState:
    """Roll out on the maps of one step and follow their mean gradient by Adam."""
    step = state.done
    outcomes = list(pool.map(partial(_try_map, spec, maps, state.weights), _map_seeds(spec, step)))
    gradient = np.mean([outcome[0] for outcome in outcomes], axis=0)
    state.curve[step] = float(np.mean([outcome[1] for outcome in outcomes]))
    mean = ADAM_DECAY[0] * state.mean + (1 - ADAM_DECAY[0]) * gradient
    square = ADAM_DECAY[1] * state.square + (1 - ADAM_DECAY[1]) * gradient**2
    unbiased = mean / (1 - ADAM_DECAY[0] ** (step + 1))
    spread = np.sqrt(square / (1 - ADAM_DECAY[1] ** (step + 1)))
    fade = 0.55 + 0.45 * np.cos(np.pi * step / spec.iterations)
    weights = state.weights + spec.learning_rate * fade * unbiased / (spread + ADAM_EPSILON)
    return TrainState(step + 1, weights, mean, square, state.curve)


def _map_seeds(spec: TrainSpec, step: int) -> list[int]:
    """Return the seeds of a step's maps: they depend on nothing else, so that a training can go on at any step."""
    source = np.random.PCG64(spec.seed)
    # One stream for all steps. A seed takes one word of it, for a power of two is drawn without rejections.
    source.advance(step * spec.maps_per_iteration)
    return [int(seed) for seed in np.random.Generator(source).integers(0, 2**62, spec.maps_per_iteration)]


def _try_map(
    spec: TrainSpec, maps: Sequence[NDArray[np.floating]] | None, weights: NDArray[np.float64], seed: int
) -> tuple[NDArray[np.float64], float]:
    """Roll out on one map; return the gradient and the mean share of the best T cells collected."""
    rng = np.random.default_rng(seed)
    if maps is None:
        family = spec.families[int(rng.integers(len(spec.families)))]
        side = int(rng.integers(max(4, spec.map_side // 3), spec.map_side + 1))
        score = make_map(family, (side, side), rng)
    else:
        score = np.asarray(maps[int(rng.integers(len(maps)))], np.float64)
    eight = bool(rng.random() < spec.eight)
    field = build_field(_problem_on(score, spec.moves, 8 if eight else 4, rng))
    blocks = build_blocks(field, spec.layout)
    rewards, scores = explore(field, blocks, weights, spec.rollouts, int(rng.integers(2**62)))
    rewards = rewards / spec.moves
    if spec.estimator == "gpomdp":
        gradient = gpomdp_gradient(rewards, scores, spec.trace_decay)
    else:
        gradient = reinforce_gradient(rewards, scores)
    # On a map of fewer cells than moves, all that there is counts as 1.
    most = min(1.0, np.count_nonzero(field.free) / spec.moves)
    return gradient, float(rewards.sum(axis=1).mean()) / most


def start_cells(score: NDArray[np.floating], connectivity: int) -> NDArray[np.bool_]:
    """Return which cells of a score map [rows, cols] (NaN = no-go) a robot can start from: those not walled in."""
    rows, cols = score.shape
    framed = np.pad(~np.isnan(score), 1)
    beside = np.zeros((rows, cols), np.bool_)
    for dr, dc in NEIGHBOURS_8 if connectivity == 8 else NEIGHBOURS_8[::2]:
        beside |= framed[1 + dr : 1 + dr + rows, 1 + dc : 1 + dc + cols]
    return np.asarray(beside & framed[1:-1, 1:-1])


def _problem_on(score: NDArray[np.floating], moves: int, connectivity: int, rng: np.random.Generator) -> Problem:
    """Return a problem with a random start that is not walled in."""
    order = rng.permutation(np.flatnonzero(~np.isnan(score)))
    starts = order[start_cells(score, connectivity).ravel()[order]]
    if not starts.size:
        raise ArgumentError("a training map has no cell a robot could start from")
    start = divmod(int(starts[0]), score.shape[1])
    return Problem(score, start, Budget(float(moves)), connectivity)
