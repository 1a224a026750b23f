"""Every picture of a training, decoded once, at the size that the network sees."""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import InputError, OutputError
from hrt_cli.progress import Note, Progress, silent, unheard
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.network.pictures import fitted
from hrt_cli.steering.recordings.decode import decode_picture, read_bytes
from hrt_cli.steering.recordings.samples import Samples

_IN_MEMORY_BYTES = 2**30
_ASPECT_TOLERANCE = 0.02
_NAMED = 3
"""Damaged pictures that are named one by one."""

T = TypeVar("T")


@dataclass(frozen=True)
class _Seen:
    """What is kept of a picture beside its pixels: width over height, and its file's SHA-256; or what is wrong."""

    aspect: float
    sha256: str
    problem: InputError | None = None


def load_pictures(
    samples: Samples,
    config: SteeringConfig,
    *,
    skip_bad: bool = False,
    progress: Progress = silent,
    note: Note = unheard,
) -> tuple[Samples, NDArray[np.uint8], str]:
    """Decode the picture of every frame and fit it to the network.

    Parameters
    ----------
    samples : Samples
    config : SteeringConfig
        Says the size and the crop.
    skip_bad : bool
        Leave out frames whose picture is absent or damaged, counted and noted, instead of refusing them.
    progress : Progress
        Called with (pictures done, pictures).
    note : Note
        Told what is left out.

    Returns
    -------
    samples : Samples
        The frames that are left; `skipped` counts the others, too.
    pictures : uint8 [n, height, width, 3]
        RGB. In a file without a name in the folder for temporary files where it is larger than 1 GiB, so that memory
        stays free; the file goes when the process does, however it ends.
    digest : str
        SHA-256 over name below its label file's folder, labels, goals, session, moment and costs of every frame and the
        bytes of its picture: the same wherever the folders lie.

    Raises
    ------
    InputError
        A picture cannot be used, none is left, or they differ in width over height by more than 2 %.
    OutputError
        There is no room for the temporary file.
    """
    shape = (len(samples.paths), config.height, config.width, 3)
    pictures = _room(shape)

    def load(index: int) -> _Seen:
        path = samples.paths[index]
        try:
            data = read_bytes(path)
            rgb = decode_picture(path, data)
        except InputError as error:
            return _Seen(math.nan, "", error)
        pictures[index] = fitted(rgb, config)
        return _Seen(rgb.shape[1] / rgb.shape[0], hashlib.sha256(data).hexdigest())

    seen = _in_threads(load, range(len(samples.paths)), progress)
    bad = [each.problem for each in seen if each.problem is not None]
    _refuse_or_note(bad, len(seen), skip_bad, note)
    kept = np.flatnonzero([each.problem is None for each in seen])
    left = replace(samples.take(kept), skipped=samples.skipped + len(bad))
    usable = [seen[index] for index in kept.tolist()]
    _check_aspect(left, usable)
    if bad:
        # In place: a copy might not fit in memory.
        for new, old in enumerate(kept.tolist()):
            pictures[new] = pictures[old]
    return left, pictures[: len(kept)], _digest(left, usable)


def _room(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    size = math.prod(shape)
    if size <= _IN_MEMORY_BYTES:
        return np.empty(shape, np.uint8)
    try:
        with tempfile.TemporaryFile() as file:
            # Reserved at once: a disk that fills up later would kill the process when it writes to the map.
            os.posix_fallocate(file.fileno(), 0, size)
            return np.memmap(file, np.uint8, "r+", shape=shape)
    except OSError as error:
        where = tempfile.gettempdir()
        problem = f"no room for {size / 2**30:.1f} GiB of pictures: {error.strerror}; set TMPDIR to a larger disk"
        raise OutputError(f"{where}: {problem}") from error


def _in_threads(work: Callable[[int], T], indices: Iterable[int], progress: Progress) -> list[T]:
    """Return the results in order; OpenCV and hashlib let other threads run while they work."""
    todo = list(indices)
    done: list[T] = []
    pool = ThreadPoolExecutor(min(8, os.cpu_count() or 1))
    try:
        for result in pool.map(work, todo):
            done.append(result)
            progress(len(done), len(todo))
    finally:
        pool.shutdown(cancel_futures=True)
    return done


def _refuse_or_note(bad: list[InputError], total: int, skip_bad: bool, note: Note) -> None:
    if bad and not skip_bad:
        more = f"; {len(bad)} of {total} pictures cannot be used" if len(bad) > 1 else ""
        raise InputError(bad[0].path, bad[0].problem + more, "put it right, or leave such out with --skip-bad")
    for each in bad[:_NAMED]:
        note(f"Warning: {each}; left out")
    if len(bad) > _NAMED:
        note(f"Warning: {len(bad) - _NAMED} more pictures cannot be used and are left out")
    if bad and len(bad) == total:
        raise InputError(bad[0].path, f"{bad[0].problem}; none of the {total} pictures can be used")


def _check_aspect(samples: Samples, seen: list[_Seen]) -> None:
    aspects = [each.aspect for each in seen]
    wide, tall = int(np.argmax(aspects)), int(np.argmin(aspects))
    if aspects[wide] > aspects[tall] * (1.0 + _ASPECT_TOLERANCE):
        problem = (
            f"is {aspects[wide]:.3f} times as wide as high, and {samples.paths[tall]} is {aspects[tall]:.3f}: "
            "pictures of one training must have one shape"
        )
        raise InputError(samples.paths[wide], problem)


def _digest(samples: Samples, seen: list[_Seen]) -> str:
    digest = hashlib.sha256(json.dumps(samples.outputs).encode())
    names = _names(samples)
    for index, each in enumerate(seen):
        row: list[object] = [
            names[index],
            samples.steering[index].tolist(),
            None if samples.goal is None else float(samples.goal[index]),
            int(samples.session[index]),
            None if samples.moment is None else int(samples.moment[index]),
            None if samples.turn_costs_s is None else samples.turn_costs_s[index].tolist(),
            each.sha256,
        ]
        if samples.other_goals is not None and samples.other_costs_s is not None:
            row += [samples.other_goals[index].tolist(), samples.other_costs_s[index].tolist()]
        digest.update(json.dumps(row).encode() + b"\n")
    return digest.hexdigest()


def _names(samples: Samples) -> list[str]:
    """Return each picture's name below the nearest folder that has a label file; else its name alone."""
    folders = {file.parent for file in samples.files}

    def name(path: Path) -> str:
        above = next((parent for parent in path.parents if parent in folders), path.parent)
        return path.relative_to(above).as_posix()

    return [name(path) for path in samples.paths]
