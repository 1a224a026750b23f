"""Splits: nothing to measure by has a near twin to learn from."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrt_cli.errors import ArgumentError
from hrt_cli.steering.recordings.samples import Samples
from hrt_cli.steering.recordings.split import By, Split, split


def frames(sizes: list[int], *, cameras: int = 1, moments: bool = True) -> Samples:
    """Sessions of so many moments, interleaved, as they need not stand one after the other."""
    session = np.repeat(np.arange(len(sizes)), np.array(sizes) * cameras).astype(np.int32)
    moment = np.concatenate([np.repeat(np.arange(size), cameras) for size in sizes]).astype(np.int32)
    order = np.argsort(moment, kind="stable") if moments else np.arange(session.size)
    return Samples(
        paths=(Path("x"),) * session.size,
        steering=np.zeros((session.size, 1), np.float32),
        outputs=("yaw",),
        session=session[order],
        sessions=tuple(str(each) for each in range(len(sizes))),
        goal=None,
        skipped=0,
        files=(),
        moment=moment[order] if moments else None,
    )


def check(samples: Samples, parts: Split) -> None:
    assert parts.train.size > 0
    assert parts.validation.size > 0
    assert not set(parts.train.tolist()) & set(parts.validation.tolist())
    for index in (parts.train, parts.validation):
        assert (np.diff(index) > 0).all()
        assert 0 <= index[0] <= index[-1] < len(samples.paths)


SIZES = st.lists(st.integers(1, 60), min_size=1, max_size=5)


@settings(max_examples=80)
@given(SIZES, st.sampled_from([1, 3]), st.floats(0.05, 0.95), st.integers(2, 12), st.integers(0, 12), st.integers(0, 9))
def test_blocks_have_a_gap(sizes: list[int], cameras: int, share: float, blocks: int, gap: int, seed: int) -> None:
    samples = frames(sizes, cameras=cameras)
    try:
        parts = split(samples, by="block", share=share, blocks=blocks, gap=gap, seed=seed)
    except ArgumentError as refused:
        assert "leaves none" in str(refused)  # noqa: PT017
        return
    check(samples, parts)
    assert samples.moment is not None
    used = set(parts.train.tolist()) | set(parts.validation.tolist())
    near = np.zeros(len(samples.paths), bool)
    for held in parts.validation:
        same = samples.session == samples.session[held]
        near |= same & (np.abs(samples.moment - samples.moment[held]) <= gap)
    assert not near[parts.train].any()
    # And no more than those is dropped.
    dropped = np.setdiff1d(np.arange(len(samples.paths)), list(used))
    assert near[dropped].all()


def test_a_split_by_blocks_by_hand() -> None:
    samples = frames([100])
    parts = split(samples, by="block", share=0.1, blocks=10, gap=3)
    first, last = int(parts.validation[0]), int(parts.validation[-1])
    assert (first % 10, last) == (0, first + 9)
    near = [n for n in range(100) if first - 3 <= n <= last + 3]
    assert parts.train.tolist() == [n for n in range(100) if n not in near]
    assert parts.how == f"by block: 10% of the frames held out, {len(near) - 10} frames beside them dropped (gap 3)"


def test_blocks_are_whole_with_all_cameras() -> None:
    samples = frames([30], cameras=3)
    parts = split(samples, by="block", share=0.3, blocks=3, gap=0)
    first = int(parts.validation[0])
    assert first % 30 == 0
    assert parts.validation.tolist() == list(range(first, first + 30))
    assert parts.train.size == 60


def test_blocks_of_the_default_size() -> None:
    samples = frames([500, 500])
    parts = split(samples)
    held = [set((parts.validation[samples.session[parts.validation] == each]).tolist()) for each in (0, 1)]
    assert parts.validation.size == 200
    assert sum(map(len, held)) == 200
    assert parts.how.startswith("by block")


def test_a_frame_that_was_left_out_counts_in_the_gap() -> None:
    samples = frames([40])
    kept = samples.take(np.delete(np.arange(40), np.arange(18, 22)))
    parts = split(kept, by="block", share=0.4, blocks=2, gap=5)
    assert kept.moment is not None
    moments = [kept.moment[index] for index in (parts.train, parts.validation)]
    assert min(abs(a - b) for a in moments[0] for b in moments[1]) == 6


def test_without_moments_each_frame_is_the_next() -> None:
    with_them, without = frames([30, 30]), frames([30, 30], moments=False)
    a, b = (split(each, by="block", gap=2) for each in (with_them, without))
    place = np.lexsort((with_them.moment, with_them.session))
    np.testing.assert_array_equal(np.sort(np.argsort(place)[a.train]), b.train)


@settings(max_examples=60)
@given(st.lists(st.integers(1, 30), min_size=2, max_size=7), st.floats(0.05, 0.95), st.integers(0, 5))
def test_sessions_as_near_to_the_share_as_any(sizes: list[int], share: float, seed: int) -> None:
    samples = frames(sizes)
    parts = split(samples, by="session", share=share, seed=seed)
    check(samples, parts)
    assert not set(samples.session[parts.train]) & set(samples.session[parts.validation])
    assert parts.train.size + parts.validation.size == sum(sizes)
    subsets = itertools.chain.from_iterable(itertools.combinations(sizes, n) for n in range(1, len(sizes)))
    best = min(abs(sum(each) - share * sum(sizes)) for each in subsets)
    assert abs(parts.validation.size - share * sum(sizes)) == pytest.approx(best)


def test_the_seed_chooses_the_sessions() -> None:
    samples = frames([10] * 8 + [11])
    chosen = {tuple(split(samples, by="session", seed=seed).validation.tolist()) for seed in range(12)}
    assert len(chosen) > 3


@pytest.mark.parametrize("by", get_args(By))
def test_the_same_seed_gives_the_same_split(by: By) -> None:
    samples = frames([40, 50, 60, 45], cameras=3)
    first, again, other = (split(samples, by=by, gap=2, seed=seed) for seed in (7, 7, 8))
    check(samples, first)
    np.testing.assert_array_equal(first.train, again.train)
    np.testing.assert_array_equal(first.validation, again.validation)
    assert first.how == again.how
    if by in ("block", "random"):
        assert first.validation.tolist() != other.validation.tolist()


@pytest.mark.parametrize("by", get_args(By))
@pytest.mark.parametrize("seed", range(3))
def test_cameras_of_one_moment_stay_together(by: By, seed: int) -> None:
    samples = frames([23, 31, 17, 29], cameras=3)
    parts = split(samples, by=by, gap=0, seed=seed)
    assert samples.moment is not None
    sides = [
        set(zip(samples.session[i].tolist(), samples.moment[i].tolist(), strict=True))
        for i in (parts.train, parts.validation)
    ]
    assert not sides[0] & sides[1]


def test_auto_holds_sessions_out_from_four_on() -> None:
    assert split(frames([30] * 4)).how.startswith("by session: 1 of 4 held out, 25%")
    assert split(frames([60] * 3)).how.startswith("by block")


def test_random_frames_are_warned_of() -> None:
    notes: list[str] = []
    parts = split(frames([100]), by="random", note=notes.append)
    assert "halve the apparent error" in notes[0]
    assert "near twins" in parts.how
    assert parts.validation.size == 20
    assert parts.train.size == 80
    assert split(frames([100]), by="block", gap=1, note=notes.append)
    assert len(notes) == 1


@pytest.mark.parametrize(
    ("sizes", "options", "problem"),
    [
        ([20], {"by": "session"}, "only one session"),
        ([15], {"by": "block"}, "leaves none to learn from"),
        ([1], {"by": "block"}, "leaves none to measure by"),
        ([2], {"by": "random"}, "leaves none to measure by"),
        ([9], {"share": 0.0}, "must lie between 0 and 1"),
        ([9], {"share": 1.0}, "must lie between 0 and 1"),
        ([9], {"share": float("nan")}, "must lie between 0 and 1"),
        ([9], {"blocks": 1}, "there must be 2 blocks"),
        ([9], {"gap": -1}, "not be negative"),
    ],
)
def test_refused(sizes: list[int], options: dict[str, object], problem: str) -> None:
    with pytest.raises(ArgumentError, match=problem):
        split(frames(sizes), **options)  # type: ignore[arg-type]
