"""The predictions artifact (`steering.json`): for each frame where the network would steer, and how sure it is.

`yaw` (and `pitch`) is the mean of the distribution. Where the network sees two ways, left or right round an obstacle,
the mean leads into the obstacle: `yaw_modes` counts the ways (`uncertainty.count_modes`), and `yaw_mode` is the angle
of the likeliest class.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.jsonio import Document, read_model
from hrt_cli.artifacts.provenance import Provenance
from hrt_cli.steering.network.net import Output
from hrt_cli.steering.prediction.uncertainty import Uncertainty, count_modes, moments

FORMAT, VERSION = "hrt-steering-predictions", 1
DIGITS = 6
"""Of what is written: below them, the arithmetic of another processor may differ."""

Angle = Annotated[float, Field(ge=-1, le=1)]
Share = Annotated[float, Field(ge=0, le=1)]
Some = Annotated[float, Field(ge=0)]


class ModelRecord(Document):
    """Which network predicted: its file's bare name and bytes, its outputs, and the angles of its 2M + 1 classes."""

    name: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    outputs: tuple[Output, ...]
    half_classes: int = Field(ge=1)
    angles: tuple[Angle, ...]


class Sureness(Document):
    """How sure a prediction is, by `passes` networks drawn by dropout; see `uncertainty.Uncertainty`."""

    spread: Some
    aleatoric: Some
    epistemic: Some
    entropy_nats: Some
    mutual_information_nats: Some


class Prediction(Document):
    """One frame.

    Attributes
    ----------
    input : int
        Which of the document's `inputs` it is from.
    image : str
        The picture's name within that input, or the video's.
    index, time_s : int, float
        Of a video's frame: its number and its time from the start.
    goal_deg : float
        Bearing that the network was told, right positive.
    yaw, pitch : float
        Expected angle; right and up are positive.
    yaw_spread, pitch_spread : float
        Standard deviation of the angle under the distribution.
    yaw_mode, pitch_mode : float
        Angle of the likeliest class.
    yaw_modes, pitch_modes : int
        Ways that the network sees.
    distribution : dict
        By output, the probabilities of the classes.
    uncertainty : dict
        By output; absent where nothing was drawn.
    label : dict
        By output, what was steered, where the input says so.
    """

    input: int = Field(ge=0)
    image: str
    index: int | None = Field(default=None, ge=0)
    time_s: float | None = Field(default=None, ge=0)
    goal_deg: float | None = Field(default=None, ge=-180, le=180)
    yaw: Angle
    yaw_spread: Some
    yaw_mode: Angle
    yaw_modes: int = Field(ge=1)
    pitch: Angle | None = None
    pitch_spread: Some | None = None
    pitch_mode: Angle | None = None
    pitch_modes: int | None = Field(default=None, ge=1)
    distribution: dict[Output, tuple[Share, ...]]
    uncertainty: dict[Output, Sureness] | None = None
    label: dict[Output, Angle] | None = None


class PredictionsDocument(Document):
    """The whole file; `passes` is how many networks were drawn for `uncertainty`, `skipped` counts unread frames."""

    format: Literal["hrt-steering-predictions"]
    version: Literal[1] = 1
    model: ModelRecord
    inputs: tuple[str, ...]
    passes: int = Field(ge=0)
    frames: tuple[Prediction, ...]
    skipped: int = Field(ge=0)
    provenance: Provenance | None = None

    @model_validator(mode="after")
    def _whole(self) -> PredictionsDocument:
        classes = 2 * self.model.half_classes + 1
        if len(self.model.angles) != classes:
            raise ValueError(f"model.angles must be {classes} angles")
        for number, frame in enumerate(self.frames):
            if frame.input >= len(self.inputs):
                raise ValueError(f"frames.{number} is from an input that is not named")
            if tuple(frame.distribution) != self.model.outputs or (frame.pitch is None) == (
                "pitch" in self.model.outputs
            ):
                raise ValueError(f"frames.{number} has other outputs than the model")
            for name, shares in frame.distribution.items():
                if len(shares) != classes or abs(math.fsum(shares) - 1.0) > 1e-3:
                    raise ValueError(f"frames.{number}: the distribution of {name} is none over {classes} classes")
        return self


def read_predictions(path: Path) -> PredictionsDocument:
    """Read predictions, checked against their provenance where they have one.

    Raises
    ------
    InputError
        The file is absent, no such document, or not what its provenance recorded.
    """
    found = read_model(path, PredictionsDocument)
    json_provenance(path)
    return found


def prediction(
    distribution: Mapping[Output, NDArray[np.float64]],
    sure: Mapping[Output, Uncertainty] | None,
    at: int,
    label: Mapping[Output, float] | None,
) -> dict[str, Any]:
    """Return what a frame's prediction says, without where the frame is from, as JSON values.

    Parameters
    ----------
    distribution : dict of float64 [n, 2M + 1]
    sure : dict of Uncertainty, optional
        Of the same n pictures.
    at : int
        Which of them.
    label : dict of float, optional
        What was steered.
    """
    said: dict[str, Any] = {}
    for name, probability in distribution.items():
        row = probability[at]
        mean, variance = moments(row)
        half = len(row) // 2
        said[name] = _rounded(mean)
        said[f"{name}_spread"] = _rounded(np.sqrt(variance))
        said[f"{name}_mode"] = _rounded((int(row.argmax()) - half) / half)
        said[f"{name}_modes"] = count_modes(row)
    said["distribution"] = {name: [_rounded(share) for share in each[at]] for name, each in distribution.items()}
    if sure is not None:
        said["uncertainty"] = {
            name: {field: _rounded(getattr(each, field)[at]) for field in Sureness.model_fields}
            for name, each in sure.items()
        }
    if label is not None:
        said["label"] = {name: _rounded(value) for name, value in label.items()}
    return said


def _rounded(value: Any) -> float:
    return round(float(value), DIGITS) + 0.0  # no minus zero
