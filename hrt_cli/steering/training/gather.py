"""From folders of steering data to the frames to train on and those held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.progress import Note, Progress, silent, unheard
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.recordings.load import load_pictures
from hrt_cli.steering.recordings.samples import Samples, check_lens, check_varied, read_samples
from hrt_cli.steering.recordings.split import split
from hrt_cli.steering.training.batches import Frames
from hrt_cli.steering.training.train import SteerSpec


@dataclass(frozen=True)
class Gathered:
    """What a training learns from.

    Attributes
    ----------
    training, validation : Frames
    config : SteeringConfig
        With the outputs and the goal that the data have.
    inputs : dict of str to Path
        The label files by role, for provenance.
    digests : dict of str to str
        By role, a hash over all pictures and labels used.
    skipped, sessions : int
    how : str
        How the validation frames were chosen.
    """

    training: Frames
    validation: Frames
    config: SteeringConfig
    inputs: dict[str, Path]
    digests: dict[str, str]
    skipped: int
    sessions: int
    how: str


def gather(
    folders: Sequence[Path],
    held_out: Sequence[Path],
    spec: SteerSpec,
    config: SteeringConfig,
    *,
    correction: float = 0.2,
    skip_bad: bool = False,
    progress: Progress = silent,
    note: Note = unheard,
) -> Gathered:
    """Read steering data; hold out the folders `held_out`, or where there are none a part of the others.

    Raises
    ------
    InputError
        See `samples.read_samples`, `load.load_pictures` and `samples.check_varied`; or what is held out has other
        outputs or lacks the goals, or is trained on, too.
    ArgumentError
        See `split.split`; or too few frames are left.
    """
    found = read_samples(folders, skip_bad=skip_bad, correction=correction, note=note)
    apart = read_samples(held_out, skip_bad=skip_bad, correction=correction, note=note) if held_out else None
    goal = spec.goal and found.goal is not None
    if apart is not None:
        _check_alike(found, apart, goal)
    told = {"outputs": found.outputs, "goal": goal, "hfov_deg": found.hfov_deg, "mirrored": spec.augment.flip > 0.0}
    config = SteeringConfig(**{**dict(config), **told, "temperature": {}})
    found, pictures, digest = load_pictures(found, config, skip_bad=skip_bad, progress=progress, note=note)
    check_varied(found, config.half_classes)
    others = spec.cost_scale_s > 0.0
    if apart is None:
        parts = split(found, by=spec.split, share=spec.share, gap=spec.gap, seed=spec.seed, note=note)
        training = _frames(found, pictures, parts.train, goal, others=others)
        validation = _frames(found, pictures, parts.validation, goal)
        how, samples, digests = parts.how, [found], {"pictures": digest}
    else:
        apart, theirs, other = load_pictures(apart, config, skip_bad=skip_bad, progress=progress, note=note)
        training = _frames(found, pictures, np.arange(len(found.paths)), goal, others=others)
        validation = _frames(apart, theirs, np.arange(len(apart.paths)), goal)
        how, samples = "folders of their own", [found, apart]
        digests = {"pictures": digest, "validation_pictures": other}
    if len(training) < 2 or len(validation) < 1:
        raise ArgumentError(f"{len(training)} training and {len(validation)} validation frames are too few")
    roles = ("labels", "validation")
    return Gathered(
        training,
        validation,
        config,
        {f"{role}/{i}": path for role, each in zip(roles, samples, strict=False) for i, path in enumerate(each.files)},
        digests,
        sum(each.skipped for each in samples),
        sum(len(each.sessions) for each in samples),
        how,
    )


def _check_alike(found: Samples, apart: Samples, goal: bool) -> None:
    where = apart.files[0]
    if apart.outputs != found.outputs:
        raise InputError(where, f"has {', '.join(apart.outputs)}; the training data have {', '.join(found.outputs)}")
    check_lens(where, apart.hfov_deg, found.hfov_deg)
    if goal and apart.goal is None:
        raise InputError(where, "does not say where to go, and the training data do", "use --no-goal")
    turns = [0 if each.turn_costs_s is None else each.turn_costs_s.shape[1] for each in (apart, found)]
    if goal and turns[0] != turns[1]:
        raise InputError(where, f"has {turns[0]} turn_costs_s a row, and the training data {turns[1]}")
    both = {path.resolve() for path in apart.files} & {path.resolve() for path in found.files}
    if both:
        raise InputError(sorted(both)[0], "is both trained on and held out")


def _frames(
    samples: Samples, pictures: NDArray[np.uint8], rows: NDArray[np.int64], goal: bool, *, others: bool = False
) -> Frames:
    """Return frames, perhaps with their other goals: those have costs alone, and are measured by nothing else."""
    if not goal or samples.goal is None:
        return Frames(pictures, rows, samples.steering[rows], None, None)
    told = samples.goal[rows][:, None]
    costs = None if samples.turn_costs_s is None else samples.turn_costs_s[rows][:, None]
    if others and costs is not None and samples.other_goals is not None and samples.other_costs_s is not None:
        told = np.concatenate([told, samples.other_goals[rows]], axis=1)
        costs = np.concatenate([costs, samples.other_costs_s[rows]], axis=1)
    return Frames(pictures, rows, samples.steering[rows], told, costs)
