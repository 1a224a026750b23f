"""The stochastic policy: a softmax over moves, from the tied multi-resolution features.

The preference of a move is linear in its features, in layout 'network' plus hinge functions of them:
w·phi + sum_h s_h max(0, u_h·phi), s_h = 1 for the first half of the hinges and -1 for the second.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from hrt_cli.planning.features import (
    LAYOUTS,
    RING,
    TIED,
    Blocks,
    padded_index,
    put_back,
    read_more,
    read_rings,
    take_out,
    tie_rings,
    weight_count,
)
from hrt_cli.planning.jit import kernel, lean_kernel, lean_sums
from hrt_cli.planning.walk import Field, capacity, may_step, next_uniform

DEFAULT_POLICY_FILES = ("default_policy_network.npz", "default_policy_manjanna24.npz")
"""The policies that ship with the package: one sees more of what is near, the other to the edges of the map."""

RecipeValue = str | int | float
LANES = 32
"""Features are padded to whole multiples of this many, which the processor adds up at once."""

SEED_STRIDE = np.uint64(0xD1342543DE82EF95)
"""Odd constant that spreads consecutive rollout numbers over the generator's states."""


@dataclass(frozen=True)
class Policy:
    """Weights of the move preferences, and how they came about.

    Attributes
    ----------
    weights : ndarray, float64 [(1 + hinges) * features]
        One weight per tied feature of the layout for the linear part, then for each hinge.
    layout : str
        One of `features.LAYOUTS`.
    recipe : dict
        Numbers and strings of the training that made it.
    """

    weights: NDArray[np.float64]
    layout: str = "network"
    recipe: dict[str, RecipeValue] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.layout not in LAYOUTS:
            raise ValueError(f"unknown feature layout {self.layout!r} (known: {', '.join(LAYOUTS)})")
        expected = (weight_count(self.layout),)
        if self.weights.shape != expected or self.weights.dtype != np.float64:
            raise ValueError(
                f"the weights of layout {self.layout!r} must be float64 {expected}, "
                f"not {self.weights.dtype} {self.weights.shape}"
            )
        if not np.isfinite(self.weights).all():
            raise ValueError("the weights are not finite")

    def to_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the policy as named arrays without objects, ready for an NPZ file."""
        names = sorted(self.recipe)
        return {
            "weights": self.weights,
            "layout": np.array(self.layout),
            "recipe_names": np.array(names, dtype=np.str_),
            "recipe_values": np.array([_spell(self.recipe[name]) for name in names], dtype=np.str_),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> Policy:
        """Return the policy that `to_arrays` wrote; other arrays may stand beside its own.

        Raises
        ------
        ValueError
            When an array is missing or is not what `to_arrays` writes.
        """
        missing = {"weights", "layout", "recipe_names", "recipe_values"} - set(arrays)
        if missing:
            raise ValueError(f"not a policy: {', '.join(sorted(missing))} missing")
        names, values, layout = arrays["recipe_names"], arrays["recipe_values"], arrays["layout"]
        for name, array, ndim in (("recipe_names", names, 1), ("recipe_values", values, 1), ("layout", layout, 0)):
            if array.ndim != ndim or (array.dtype.kind != "U" and array.size > 0):
                raise ValueError(f"not a policy: {name} is not {'a list of ' if ndim else ''}text")
        if names.shape != values.shape:
            raise ValueError("not a policy: recipe names and values differ in number")
        weights = np.array(arrays["weights"])
        recipe = {str(name): _parse(str(value)) for name, value in zip(names, values, strict=True)}
        return cls(weights, str(layout), recipe)


def _spell(value: RecipeValue) -> str:
    return f"{type(value).__name__}:{value!r}" if not isinstance(value, str) else f"str:{value}"


def _parse(text: str) -> RecipeValue:
    kind, _, value = text.partition(":")
    if kind == "int":
        return int(value)
    if kind == "float":
        return float(value)
    if kind == "str":
        return value
    raise ValueError(f"not a policy: recipe value {text!r} has no known type")


def default_policies() -> tuple[Policy, ...]:
    """Return the policies that ship with the package, trained by `train` with its default recipe but for the layout."""
    return tuple(_read_shipped(name) for name in DEFAULT_POLICY_FILES)


def default_policies_sha256() -> str:
    """Return the hash of the shipped policies' files, by which a plan records what made it."""
    return hashlib.sha256(b"".join(map(_shipped_bytes, DEFAULT_POLICY_FILES))).hexdigest()


def _read_shipped(name: str) -> Policy:
    with np.load(io.BytesIO(_shipped_bytes(name)), allow_pickle=False) as arrays:
        return Policy.from_arrays({name: arrays[name] for name in arrays.files})


def _shipped_bytes(name: str) -> bytes:
    return resources.files("hrt_cli.planning").joinpath(name).read_bytes()


@lean_sums
def weigh(phi: NDArray[np.float32], net: NDArray[np.float32], parts: NDArray[np.float32]) -> None:
    """Fill `parts` [moves, 1 + hinges] with `phi` [moves, lanes] times `net` [1 + hinges, lanes].

    Moves come in fours: four sums at once keep the processor busy.
    """
    for a in range(0, phi.shape[0], 4):
        for h in range(net.shape[0]):
            first, second, third, fourth = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for i in range(phi.shape[1]):
                weight = net[h, i]
                first += phi[a, i] * weight
                second += phi[a + 1, i] * weight
                third += phi[a + 2, i] * weight
                fourth += phi[a + 3, i] * weight
            parts[a, h], parts[a + 1, h], parts[a + 2, h], parts[a + 3, h] = first, second, third, fourth


@lean_kernel
def add_hinges(parts: NDArray[np.float32], logits: NDArray[np.float64]) -> None:
    """Fill `logits` [moves] with the linear part plus the positive parts of the hinges, half of them negated.

    Leaves in `parts` how each logit changes with each part: 1, 0 or -1.
    """
    half = parts.shape[1] // 2
    for a in range(parts.shape[0]):
        logit = parts[a, 0]
        parts[a, 0] = 1.0
        for h in range(1, parts.shape[1]):
            sign = np.float32(1.0 if h <= half else -1.0)
            slope = sign if parts[a, h] > 0.0 else np.float32(0.0)
            logit += slope * parts[a, h]
            parts[a, h] = slope
        logits[a] = logit


@lean_kernel
def choose(
    logits: NDArray[np.float64],
    allowed: NDArray[np.bool_],
    sample: bool,
    state: NDArray[np.uint64],
    share: NDArray[np.float64],
) -> int:
    """Return the move taken, -1 when none is allowed.

    Fills `share` with the softmax over the allowed moves; takes the likeliest unless `sample`.
    """
    best, best_logit = -1, -np.inf
    for a in range(logits.size):
        if allowed[a] and logits[a] > best_logit:
            best, best_logit = a, logits[a]
    if best < 0:
        return -1
    total = 0.0
    for a in range(logits.size):
        share[a] = np.exp(logits[a] - best_logit) if allowed[a] else 0.0
        total += share[a]
    for a in range(logits.size):
        share[a] /= total
    if not sample:
        return best
    threshold = next_uniform(state)
    for a in range(logits.size):
        threshold -= share[a]
        if allowed[a] and threshold < 0.0:
            return a
    return best


@lean_kernel
def log_gradient(
    phi: NDArray[np.float32],
    slopes: NDArray[np.float32],
    share: NDArray[np.float64],
    taken: int,
    scores: NDArray[np.float32],
    row: int,
) -> None:
    """Write into `scores[row]` [1 + hinges, features] the gradient of log pi by the weights.

    It is that of the logit of the move taken less the mean over the moves; `slopes` is what `add_hinges` left.
    """
    for h in range(slopes.shape[1]):
        for i in range(scores.shape[2]):
            scores[row, h, i] = 0.0
        for a in range(phi.shape[0]):
            pull = slopes[a, h] * np.float32((1.0 if a == taken else 0.0) - share[a])
            if pull != 0.0:
                for i in range(scores.shape[2]):
                    scores[row, h, i] += pull * phi[a, i]


@kernel
def shape_net(weights: NDArray[np.float64], blocks: Blocks) -> NDArray[np.float32]:
    """Return the weights of a policy as float32 [1 + hinges, lanes]: zeros fill the rows up to whole `LANES`."""
    features = blocks.levels * TIED + blocks.constants
    net = np.zeros((weights.size // features, (features + LANES - 1) // LANES * LANES), np.float32)
    for h in range(net.shape[0]):
        for i in range(features):
            net[h, i] = weights[h * features + i]
    return net


@kernel
def roll(
    field: Field,
    blocks: Blocks,
    sums: NDArray[np.float32],
    net: NDArray[np.float32],
    sample: bool,
    state: NDArray[np.uint64],
    path: NDArray[np.int64],
    fresh: NDArray[np.float64],
    scores: NDArray[np.float32],
) -> int:
    """Walk once under the policy until the budget is spent; return the number of cells.

    Unless `sample`, the likeliest move is taken, but drawn at a cell that was left before since the last score:
    there nothing has changed, and the likeliest moves would run in circles for good.

    Fills `path` and `fresh` (scaled score collected at each cell). Where `scores` [moves, 1 + hinges, features] is not
    empty it receives the gradient of log pi at each move. `sums` is restored before returning.
    """
    moves = field.offsets.size
    features = blocks.levels * TIED + blocks.constants
    rings = np.zeros((blocks.levels + 1, RING))
    phi = np.zeros((moves, net.shape[1]), np.float32)
    parts = np.zeros((moves, net.shape[0]), np.float32)
    logits = np.zeros(moves)
    share = np.zeros(moves)
    allowed = np.zeros(moves, np.bool_)
    last = np.full(field.free.size, -1)
    # Where cells paid, and what: only regions that reach to the edges of the map ask.
    asked = blocks.far.size > 0
    paid = np.zeros((2, path.size if asked else 0), np.int32)
    scaled = np.zeros(path.size if asked else 0)
    cell, left, n, count, lately, came = field.start, field.limit, 1, 0, 0, -1
    path[0] = cell
    fresh[0] = field.value[cell] / blocks.scale
    take_out(blocks, sums, padded_index(blocks, field.width, cell), fresh[0])
    while n < path.size:
        at = padded_index(blocks, field.width, cell)
        if asked and fresh[n - 1] > 0.0:
            paid[0, count], paid[1, count] = at // blocks.width - blocks.pad, at % blocks.width - blocks.pad
            scaled[count] = fresh[n - 1]
            count += 1
        read_rings(blocks, sums, at, paid, scaled, count, rings)
        circling = last[cell] >= lately
        last[cell] = n
        if blocks.constants > 0:
            read_more(field, blocks, sums, at, cell, last, came, rings)
        for a in range(moves):
            allowed[a] = may_step(field, cell, a, left)
            tie_rings(rings, a, a * (RING // moves), phi)
            if blocks.constants > 0:
                phi[a, features - 2] = left / field.limit
                phi[a, features - 1] = 1.0
        weigh(phi, net, parts)
        add_hinges(parts, logits)
        a = choose(logits, allowed, sample or circling, state, share)
        if a < 0:
            break
        if scores.size > 0:
            log_gradient(phi, parts, share, a, scores, n - 1)
        cell += field.offsets[a]
        left -= field.costs[a]
        came = a * (RING // moves)
        path[n] = cell
        fresh[n] = 0.0
        if last[cell] < 0:
            fresh[n] = field.value[cell] / blocks.scale
            if fresh[n] > 0.0:
                lately = n + 1
                take_out(blocks, sums, padded_index(blocks, field.width, cell), fresh[n])
        n += 1
    for t in range(n):
        put_back(blocks, sums, padded_index(blocks, field.width, path[t]))
    return n


@kernel
def _roll_each(
    field: Field, blocks: Blocks, weights: NDArray[np.float64], states: NDArray[np.uint64], sample: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return a walk for each state of the generator, int64 [states, capacity], and their numbers of cells."""
    cells = capacity(field)
    paths = np.zeros((states.size, cells), np.int64)
    lengths = np.zeros(states.size, np.int64)
    fresh = np.zeros(cells)
    nothing = np.zeros((0, 0, 0), np.float32)
    net = shape_net(weights, blocks)
    sums = blocks.sums.copy()
    state = np.zeros(1, np.uint64)
    for i in range(states.size):
        state[0] = states[i]
        lengths[i] = roll(field, blocks, sums, net, sample, state, paths[i], fresh, nothing)
    return paths, lengths


def roll_many(
    field: Field, blocks: Blocks, weights: NDArray[np.float64], count: int, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return `count` sampled walks, int64 [count, capacity], and their numbers of cells, int64 [count]."""
    states = np.uint64(seed) + np.arange(1, count + 1, dtype=np.uint64) * SEED_STRIDE
    paths, lengths = _roll_each(field, blocks, weights, states, True)
    return paths, lengths


def roll_best(field: Field, blocks: Blocks, weights: NDArray[np.float64], seed: int) -> NDArray[np.int64]:
    """Return the walk that takes the likeliest moves, int64 [cells]."""
    paths, lengths = _roll_each(field, blocks, weights, np.full(1, seed, np.uint64), False)
    return np.asarray(paths[0, : lengths[0]])
