"""The frames that an exported network is calibrated on and compared with the original."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError
from hrt_cli.progress import Note
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.network.pictures import fitted
from hrt_cli.steering.recordings.decode import read_picture
from hrt_cli.steering.recordings.load import load_pictures
from hrt_cli.steering.recordings.samples import read_samples

MOST = 256
"""Frames that are used; of more, so many evenly spaced."""
_PROBES = 8


@dataclass(frozen=True)
class Frames:
    """Pictures as a network sees them.

    Attributes
    ----------
    pictures : uint8 [n, height, width, 3]
    goal : float32 [n] or None
        Radians; None where the network needs none.
    steering : float32 [n, outputs] or None
        Labels; None unless all have them.
    files : tuple of Path
        The label files read.
    digest : str
        Hash of the frames.
    """

    pictures: NDArray[np.uint8]
    goal: NDArray[np.float32] | None
    steering: NDArray[np.float32] | None
    files: tuple[Path, ...]
    digest: str


def read_frames(
    paths: Sequence[Path], config: SteeringConfig, *, skip_bad: bool, correction: float, note: Note
) -> Frames:
    """Read frames from folders of steering data and from picture files.

    Raises
    ------
    InputError
        One cannot be used, or does not say where to go although the network must be told.
    """
    folders = [path for path in paths if path.is_dir()]
    files = [path for path in paths if not path.is_dir()]
    if config.goal and files:
        raise InputError(files[0], "does not say where to go, and the model must be told; give folders of data")
    if not folders:
        chosen = [files[index] for index in _even(len(files))]
        pictures = np.stack([fitted(read_picture(path), config) for path in chosen])
        return Frames(pictures, None, None, (), hashlib.sha256(pictures.tobytes()).hexdigest())
    if files:
        raise InputError(files[0], "is a file beside folders; give either folders of data or pictures")
    samples = read_samples(folders, skip_bad=skip_bad, correction=correction, note=note)
    if config.goal and samples.goal is None:
        raise InputError(folders[0], "does not say where to go, and the model must be told (the column goal_deg)")
    samples = samples.take(_even(len(samples.paths)))
    samples, pictures, digest = load_pictures(samples, config, skip_bad=skip_bad, note=note)
    labelled = set(config.outputs) <= set(samples.outputs)
    columns = [samples.outputs.index(name) for name in config.outputs] if labelled else []
    return Frames(
        pictures=pictures,
        goal=samples.goal if config.goal else None,
        steering=samples.steering[:, columns] if labelled else None,
        files=samples.files,
        digest=digest,
    )


def made_up_frames(config: SteeringConfig) -> Frames:
    """Return pictures to compare on where none is given: noise of several grains, and two that are all one colour."""
    rng = np.random.default_rng(0)
    pictures = []
    for number in range(_PROBES):
        grain = 2**number
        coarse = rng.integers(0, 256, (-(-config.height // grain), -(-config.width // grain), 3), np.uint8)
        pictures.append(coarse.repeat(grain, 0).repeat(grain, 1)[: config.height, : config.width])
    pictures += [np.full_like(pictures[0], value) for value in (0, 255)]
    goal = np.linspace(-np.pi, np.pi, len(pictures), dtype=np.float32) if config.goal else None
    return Frames(np.stack(pictures), goal, None, (), "")


def _even(count: int) -> NDArray[np.int64]:
    """Return indices of at most `MOST` of so many, evenly spaced."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, MOST)).round().astype(np.int64))
