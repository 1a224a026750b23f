"""Which frames to learn from and which to measure by, so that no frame to measure by has a near twin to learn from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.progress import Note, unheard
from hrt_cli.steering.recordings.samples import Samples

By = Literal["auto", "session", "block", "random"]
BLOCKS, GAP = 10, 10
_ENOUGH_SESSIONS = 4
"""From how many on whole sessions are held out by default."""

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Split:
    """Frames to learn from and frames to measure by, as ascending indices, and in words how they were parted."""

    train: Index
    validation: Index
    how: str


def split(
    samples: Samples,
    *,
    by: By = "auto",
    share: float = 0.2,
    blocks: int = BLOCKS,
    gap: int = GAP,
    seed: int = 0,
    note: Note = unheard,
) -> Split:
    """Part frames into those to learn from and those to measure by. Cameras of one moment stay together.

    Parameters
    ----------
    samples : Samples
    by : str
        'session' holds whole sessions out. 'block' cuts the sessions into blocks of neighbouring moments and holds some
        out. 'random' holds single moments out, which have near twins among the others. 'auto' is 'session' from 4
        sessions on, else 'block'.
    share : float
        Of the frames to hold out, in (0, 1): as nearly as sessions or blocks allow.
    blocks : int
        Into about how many all frames are cut; a session is one at least.
    gap : int
        Moments next to a block that is held out, on each side, that are not learnt from either.
    seed : int
        Of the choice.
    note : Note
        Told what speaks against the split.

    Raises
    ------
    ArgumentError
        A value is out of range, or a part would be empty.
    """
    if not 0.0 < share < 1.0:
        raise ArgumentError(f"the share to hold out is {share:g}; it must lie between 0 and 1")
    if blocks < 2 or gap < 0:
        raise ArgumentError(f"{blocks} blocks with a gap of {gap}: there must be 2 blocks, and the gap not be negative")
    rng = np.random.default_rng([seed, 0x5911])
    sessions = np.unique(samples.session)
    if by == "auto":
        by = "session" if len(sessions) >= _ENOUGH_SESSIONS else "block"
    moment = _moments(samples)
    if by == "session":
        if len(sessions) < 2:
            raise ArgumentError("there is only one session, so none can be held out; split by block")
        held = _hold_out(samples.session, share, rng)
        train = ~held
    elif by == "block":
        held = _hold_out(_blocks(samples.session, moment, blocks), share, rng)
        train = ~held & ~_near(samples.session, moment, held, gap)
    else:
        note("Warning: random frame splits halve the apparent error: held-out frames have near twins in training")
        held = _scattered(samples.session, moment, share, rng)
        train = ~held
    if not train.any() or not held.any():
        what = "learn from" if not train.any() else "measure by"
        raise ArgumentError(
            f"a split by {by} of {held.size} frames leaves none to {what}; record more, or take fewer blocks, "
            "a smaller gap or another share"
        )
    parts = f"{held.mean():.0%} of the frames"
    dropped = int((~train & ~held).sum())
    how = {
        "session": f"by session: {len(np.unique(samples.session[held]))} of {len(sessions)} held out, {parts}",
        "block": f"by block: {parts} held out, {dropped} frames beside them dropped (gap {gap})",
        "random": f"by random frame: {parts} held out, with near twins among the others",
    }[by]
    return Split(np.flatnonzero(train), np.flatnonzero(held), how)


def _moments(samples: Samples) -> Index:
    """Return the number of each frame's moment within its session, int64 [n]."""
    if samples.moment is not None:
        return samples.moment.astype(np.int64)
    moment = np.zeros(len(samples.paths), np.int64)
    for session in np.unique(samples.session):
        mine = samples.session == session
        moment[mine] = np.arange(mine.sum())
    return moment


def _blocks(session: NDArray[np.int32], moment: Index, blocks: int) -> Index:
    """Return the number of each frame's block, int64 [n]: neighbouring moments of one session."""
    out = np.zeros(len(session), np.int64)
    moments = {int(each): np.unique(moment[session == each]) for each in np.unique(session)}
    total = sum(each.size for each in moments.values())
    first = 0
    for each, mine in moments.items():
        count = min(mine.size, max(1, round(blocks * mine.size / total)))
        block = np.arange(mine.size) * count // mine.size
        chosen = session == each
        out[chosen] = first + block[np.searchsorted(mine, moment[chosen])]
        first += count
    return out


def _near(session: NDArray[np.int32], moment: Index, held: NDArray[np.bool_], gap: int) -> NDArray[np.bool_]:
    """Say which frames are at most `gap` moments from one that is held out, in the same session."""
    near = np.zeros(held.size, np.bool_)
    for each in np.unique(session[held]):
        mine = session == each
        away = np.sort(moment[mine & held])
        right = np.searchsorted(away, moment[mine]).clip(max=away.size - 1)
        left = (right - 1).clip(min=0)
        distance = np.minimum(np.abs(away[right] - moment[mine]), np.abs(away[left] - moment[mine]))
        near[mine] = distance <= gap
    return near


def _scattered(session: NDArray[np.int32], moment: Index, share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Hold single moments out, with all cameras of each."""
    _, which = np.unique(np.stack([session, moment]), axis=1, return_inverse=True)
    moments = int(which.max()) + 1
    chosen = rng.permutation(moments) < round(share * moments)
    held: NDArray[np.bool_] = chosen[which.reshape(-1)]
    return held


def _hold_out(group: NDArray[np.integer], share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Hold whole groups out so that the frames in them come as near to the share as groups can, not all and not none.

    The sums that groups can make are found exactly (subset sum); among equals the generator chooses.
    """
    names, which, size = np.unique(group, return_inverse=True, return_counts=True)
    total = int(size.sum())
    order = rng.permutation(names.size)
    if (size == size[0]).all():
        count = min(max(1, round(share * names.size)), names.size - 1)
        chosen = order[:count]
    else:
        chosen = order[_nearest_sum(size[order], share * total)]
    held: NDArray[np.bool_] = np.isin(which, chosen)
    return held


def _nearest_sum(size: Index, target: float) -> Index:
    """Return which of the sizes sum to the nearest of the target, neither none of them nor all."""
    total = int(size.sum())
    by = np.full(total, -1, np.int64)
    """The item with which each sum was first reached; it holds only earlier ones beside it."""
    for item, each in enumerate(size.tolist()):
        new = np.zeros(total, np.bool_)
        new[each:] = by[: total - each] >= 0
        if each < total:
            new[each] = True
        by[new & (by < 0)] = item
    sums = np.flatnonzero(by >= 0)
    left = int(sums[np.argmin(np.abs(sums - target))])
    chosen = []
    while left > 0:
        chosen.append(int(by[left]))
        left -= int(size[by[left]])
    return np.array(chosen, np.int64)
