"""What an epoch shows the network, in which order, and that nothing of it depends on what came before."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
import torch

from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.training import batches
from hrt_cli.steering.training.augment import Augment
from hrt_cli.steering.training.batches import Batch, Frames, batch_count, dropout_seed, epoch_batches

CONFIG = SteeringConfig(width=32, height=32, mean=(0.0, 0.0, 0.0), std=(1.0, 1.0, 1.0))


def numbered(n: int = 11, goal: bool = False) -> Frames:
    """Frames whose grey level, steering and goal are their number; they are every second picture, backwards."""
    pictures = np.zeros((2 * n, 32, 32, 3), np.uint8)
    rows = np.arange(2 * n - 2, -1, -2)
    pictures[rows] = np.arange(n, dtype=np.uint8)[:, None, None, None]
    told = np.arange(n, dtype=np.float32) / 100
    return Frames(pictures, rows, told[:, None], -told[:, None] if goal else None)


def shown(frames: Frames, *, strengths: Augment | None = None, first: int = 0, epoch: int = 0, seed: int = 0,
          batch: int = 4, balance: float = 0.0) -> list[Batch]:  # fmt: skip
    return list(
        epoch_batches(
            frames,
            CONFIG,
            batch=batch,
            balance_strength=balance,
            strengths=strengths or Augment.none(),
            seed=seed,
            epoch=epoch,
            first=first,
        )
    )


def numbers(found: list[Batch]) -> list[int]:
    return [round(float(value) * 100) for each in found for value in each.steering[:, 0]]


def test_an_epoch_shows_every_frame_once_with_its_own_label_and_goal() -> None:
    found = shown(numbered(goal=True))
    assert [len(each.steering) for each in found] == [6, 5]
    assert sorted(numbers(found)) == list(range(11))
    for each in found:
        assert each.goal is not None
        torch.testing.assert_close(each.goal, -each.steering)
        torch.testing.assert_close(each.pictures[:, 0, 3, 5] * 255 / 100, each.steering[:, 0])
        assert each.pictures.shape[1:] == (3, 32, 32)
        assert each.pictures.is_contiguous(memory_format=torch.channels_last)


def test_epochs_and_seeds_have_orders_of_their_own() -> None:
    frames = numbered()
    orders = [numbers(shown(frames, epoch=e, seed=s)) for e, s in ((0, 0), (1, 0), (0, 1))]
    assert len({tuple(order) for order in orders}) == 3
    assert numbers(shown(frames, epoch=1)) == orders[1]


@pytest.mark.parametrize("first", [0, 1, 2, 3])
def test_the_rest_of_an_epoch_is_the_rest_of_the_whole(first: int) -> None:
    frames = numbered(13)
    whole, rest = shown(frames, strengths=Augment()), shown(frames, strengths=Augment(), first=first)
    assert len(whole) == 3
    assert len(rest) == len(whole) - first
    for a, b in zip(whole[first:], rest, strict=True):
        torch.testing.assert_close(a.pictures, b.pictures, rtol=0, atol=0)
        torch.testing.assert_close(a.steering, b.steering, rtol=0, atol=0)


def test_batches_of_an_epoch_are_varied_differently() -> None:
    grey = Frames(np.full((8, 32, 32, 3), 90, np.uint8), np.arange(8), np.zeros((8, 1), np.float32), None)
    first, second = shown(grey, strengths=Augment())
    assert not torch.equal(first.pictures, second.pictures)
    (again, _) = shown(grey, strengths=Augment(), epoch=1)
    assert not torch.equal(first.pictures, again.pictures)


@pytest.mark.parametrize(
    ("frames", "batch", "count"), [(1, 4, 1), (4, 4, 1), (7, 4, 1), (8, 4, 2), (9, 4, 2), (3, 2, 1)]
)
def test_no_batch_is_smaller_than_asked_for(frames: int, batch: int, count: int) -> None:
    assert batch_count(frames, batch) == count


def test_a_balance_shows_the_rare_more_often() -> None:
    steering = np.zeros((400, 1), np.float32)
    steering[:8] = 1.0
    frames = Frames(np.zeros((400, 32, 32, 3), np.uint8), np.arange(400), steering, None)
    plain, even = shown(frames, batch=400), shown(frames, batch=400, balance=1.0)
    assert float(plain[0].steering.sum()) == 8
    assert float(even[0].steering.sum()) > 40
    assert len(even[0].steering) == 400


def test_the_next_batch_is_made_while_one_is_in_use(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []

    def count(*args: object) -> object:
        made.append(threading.get_ident())
        return args[:4]

    monkeypatch.setattr(batches, "augment", count)
    running = epoch_batches(
        numbered(12), CONFIG, batch=4, balance_strength=0.0, strengths=Augment.none(), seed=0, epoch=0
    )
    next(running)
    deadline = time.monotonic() + 20
    while len(made) < 2 and time.monotonic() < deadline:
        time.sleep(0.001)
    running.close()
    assert len(made) == 2
    assert threading.get_ident() not in made


def test_what_goes_wrong_in_the_making_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object) -> object:
        raise MemoryError

    monkeypatch.setattr(batches, "augment", fail)
    with pytest.raises(MemoryError):
        shown(numbered())


def test_every_batch_has_dropout_of_its_own() -> None:
    seeds = {dropout_seed(s, e, k) for s in range(3) for e in range(4) for k in range(5)}
    assert len(seeds) == 60
    assert all(0 <= seed < 2**63 for seed in seeds)
