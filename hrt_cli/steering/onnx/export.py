"""The export-steer stage: a steering model becomes an ONNX file that robots run without PyTorch."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hrt_cli.artifacts.stage import REFUSE, Existing, begin
from hrt_cli.errors import ArgumentError, InputError, OutputError
from hrt_cli.progress import Note, Progress, silent, unheard
from hrt_cli.steering.network.metrics import expected_angles
from hrt_cli.steering.network.model import read_model
from hrt_cli.steering.network.net import SteeringConfig, SteeringNet
from hrt_cli.steering.network.predictor import Predictor, TorchPredictor
from hrt_cli.steering.onnx.file import onnx_provenance, publish_onnx
from hrt_cli.steering.onnx.frames import Frames, made_up_frames, read_frames
from hrt_cli.steering.onnx.model import FORMAT, VERSION, OnnxPredictor

STAGE, STAGE_VERSION = "export-steer", 1
FEWEST_FRAMES = 32
"""To calibrate on: of fewer the extremes say little."""
MOST_DIFFERENCE = 1e-4
"""Of a probability in float32 from PyTorch's: rounding comes to a hundredth of it."""
MOST_ANGLE_DIFFERENCE = 0.05
"""Mean, in int8, of the expected angle from PyTorch's: on real frames it was a fifth of that at most."""
_BATCH = 16


@dataclass(frozen=True)
class Comparison:
    """How far an exported network is from the original.

    Attributes
    ----------
    frames : int
        On which they were compared.
    max_difference : float
        The largest, of a probability.
    angle_difference : float
        Mean absolute difference of the expected angle.
    mae_before, mae_after : float or None
        Mean absolute errors of the two against the labels; None where there are none.
    """

    frames: int
    max_difference: float
    angle_difference: float
    mae_before: float | None
    mae_after: float | None


@dataclass(frozen=True)
class SteerExport:
    """What the export-steer stage did.

    Attributes
    ----------
    up_to_date : bool
        Nothing had to be done; then nothing was compared.
    size_bytes : int
        Of the file.
    comparison : Comparison or None
    """

    up_to_date: bool
    size_bytes: int
    comparison: Comparison | None


def export_onnx(
    model: Path,
    output: Path,
    *,
    int8: bool = False,
    calibration: Sequence[Path] = (),
    skip_bad: bool = False,
    correction: float = 0.2,
    existing: Existing = REFUSE,
    progress: Progress = silent,
    note: Note = unheard,
) -> SteerExport:
    """Write a steering model as ONNX (`graph.float_graph` says what goes in and comes out).

    Before it is published, the file is opened by onnxruntime and compared with PyTorch: on the frames of `calibration`
    where there are any, else on made-up pictures.

    Parameters
    ----------
    model : Path
        What `hrt train-steer` wrote.
    output : Path
        A name that ends in `.onnx`.
    int8 : bool
        Quantise it (`quantise`); needs `calibration`.
    calibration : sequence of Path
        Folders of steering data, or picture files; at most 256 frames of them are used, evenly spaced.
    skip_bad, correction
        As in `read_samples`.
    existing : Existing
    progress : Progress
        Called with (frames calibrated on, frames).
    note : Note
        Told what was left out of the calibration.

    Raises
    ------
    ArgumentError
        onnx or onnxruntime is not installed, or there is nothing to calibrate on.
    InputError
        The model or the frames cannot be used, or the network does not bear being quantised.
    OutputError
        The exported network does something else than the original; see also `hrt_cli.artifacts.stage.begin`.
    """
    if output.suffix.lower() != ".onnx":
        raise OutputError(f"{output}: an exported model is a .onnx")
    if int8 and not calibration:
        raise ArgumentError(f"{output}: int8 needs pictures to calibrate on (--calibrate)")
    _require_packages(output)
    net = read_model(model)
    frames = made_up_frames(net.config)
    if calibration:
        frames = read_frames(calibration, net.config, skip_bad=skip_bad, correction=correction, note=note)
        if int8 and len(frames.pictures) < FEWEST_FRAMES:
            problem = f"has {len(frames.pictures)} frames to calibrate on; give {FEWEST_FRAMES} at least"
            raise InputError(calibration[0], problem)
    job = begin(
        STAGE,
        STAGE_VERSION,
        inputs={"model": model} | {f"calibration/{index}": path for index, path in enumerate(frames.files)},
        parameters={"precision": "int8" if int8 else "float32", "frames": frames.digest},
        outputs={output: onnx_provenance},
        existing=existing,
    )
    if job.up_to_date:
        return SteerExport(True, output.stat().st_size, None)
    description = describe_use(net.config)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "config": json.loads(net.config.model_dump_json()),
        "precision": "int8" if int8 else "float32",
        "preprocessing": description,
    }
    found: list[Comparison] = []

    def check(draft: Path) -> None:
        found.append(compare(TorchPredictor(net), OnnxPredictor(draft), frames))
        _require_alike(model, output, found[0], int8)

    publish_onnx(output, _graph_bytes(net, frames, description, int8, progress), document, job.provenance, check)
    return SteerExport(False, output.stat().st_size, found[0])


def describe_use(config: SteeringConfig) -> str:
    """Say in plain English how to feed an exported network, and what it answers, for who writes a robot's code."""
    crop = ""
    if config.crop_top:
        crop = f"cut off the first round({config.crop_top:g} * rows) rows, then "
    steps = [
        f"image: uint8 [n, {config.height}, {config.width}, 3], red, green, blue, row 0 at the top. Of a picture: "
        f"{crop}scale it to {config.width} x {config.height} pixels, by averaging areas (OpenCV's INTER_AREA) where "
        "it is larger, bilinearly where it is smaller; its values stay 0 to 255, normalisation is in the graph."
    ]
    if config.goal:
        steps.append(
            "goal: float32 [n], the bearing in radians, right positive, of a point ahead on the path in the robot's "
            "frame."
        )
    signs = {"yaw": "1 is full right", "pitch": "1 is full up"}
    for name in config.outputs:
        steps.append(
            f"{name}: float32 [n, {config.classes}], probabilities of the angles "
            f"-1, {1 - config.half_classes}/{config.half_classes}, ..., 1 ({signs[name]}). Steer by their mean; where "
            "two angles far apart are likely the mean may lie between two ways round an obstacle."
        )
    return "\n".join(steps)


def compare(before: Predictor, after: Predictor, frames: Frames) -> Comparison:
    """Compare two predictors on frames."""
    differences, angles, errors = [], [], []
    for first in range(0, len(frames.pictures), _BATCH):
        these = slice(first, first + _BATCH)
        goal = None if frames.goal is None else frames.goal[these]
        ours, theirs = (each.probabilities(frames.pictures[these], goal) for each in (before, after))
        for column, name in enumerate(ours):
            differences.append(float(np.abs(ours[name] - theirs[name]).max()))
            pair = np.stack([expected_angles(ours[name]), expected_angles(theirs[name])])
            angles.append(np.abs(pair[1] - pair[0]))
            if frames.steering is not None:
                errors.append(np.abs(pair - frames.steering[these, column]))
    mae = np.concatenate(errors, axis=1).mean(axis=1).tolist() if errors else [None, None]
    # NumPy's maximum, unlike Python's, is NaN where one of them is.
    return Comparison(len(frames.pictures), float(np.max(differences)), float(np.concatenate(angles).mean()), *mae)


def _graph_bytes(net: SteeringNet, frames: Frames, description: str, int8: bool, progress: Progress) -> bytes:
    from hrt_cli.steering.onnx.graph import float_graph

    graph = float_graph(net, description)
    if int8:
        from hrt_cli.steering.onnx.quantise import quantised

        graph = quantised(graph, frames.pictures, frames.goal, progress)
    return bytes(graph.SerializeToString(deterministic=True))


def _require_alike(model: Path, output: Path, found: Comparison, int8: bool) -> None:
    if int8 and not found.angle_difference <= MOST_ANGLE_DIFFERENCE:
        problem = f"in int8 it steers by {found.angle_difference:.3f} otherwise on average; nothing was written"
        raise InputError(model, problem, "calibrate on more pictures, or export it without --int8")
    if not int8 and not found.max_difference <= MOST_DIFFERENCE:
        raise OutputError(
            f"{output}: a probability would be {found.max_difference:.2g} away from that of {model}, more than "
            f"{MOST_DIFFERENCE:g}; nothing was written"
        )


def _require_packages(output: Path) -> None:
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        raise ArgumentError(f"{output}: exporting needs onnx and onnxruntime: pip install 'hrt[onnx]'") from error
    del onnx, onnxruntime
