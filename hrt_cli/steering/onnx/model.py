"""A steering model exported to ONNX, run by onnxruntime."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from hrt_cli.artifacts.jsonio import Document, describe
from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.steering.network.net import SteeringConfig
from hrt_cli.steering.network.predictor import Distributions
from hrt_cli.steering.onnx.file import read_onnx

FORMAT, VERSION = "hrt-steering-onnx", 1
IMAGE, GOAL = "image", "goal"
_FATAL_ONLY = 4
"""What onnxruntime may print by itself: errors come as exceptions, and are told in one line."""


class OnnxHeader(Document):
    """What an exported model says of itself.

    Attributes
    ----------
    precision : {"float32", "int8"}
    preprocessing : str
        In plain English: how to make the inputs, and what the outputs mean.
    """

    format: Literal["hrt-steering-onnx"]
    version: int
    config: SteeringConfig
    precision: Literal["float32", "int8"]
    preprocessing: str


class OnnxPredictor:
    """An exported network; see `predictor.Predictor`.

    Parameters
    ----------
    path : Path
        What `hrt export-steer` wrote.
    threads : int
        0 for all cores.

    Raises
    ------
    ArgumentError
        onnxruntime is not installed.
    InputError
        The file is absent, not ours, of a later version, damaged, or its graph is not what its configuration says.
    """

    def __init__(self, path: Path, *, threads: int = 0) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise ArgumentError(f"{path}: needs onnxruntime: pip install 'hrt[onnx]'") from error
        model, document, _ = read_onnx(path)
        self._header = _header(path, document)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = _FATAL_ONLY
        try:
            # From memory: the bytes that were checked, and a graph that names other files cannot have them read.
            self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's exceptions have no base of their own
            problem = f"cannot be run by onnxruntime {onnxruntime.__version__}: {str(error).splitlines()[0]}"
            raise InputError(path, problem) from error
        self._check_shapes(path)

    @property
    def config(self) -> SteeringConfig:
        """See `predictor.Predictor`."""
        return self._header.config

    @property
    def precision(self) -> str:
        """`float32` or `int8`."""
        return self._header.precision

    def probabilities(self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None = None) -> Distributions:
        """See `predictor.Predictor`."""
        inputs: dict[str, NDArray[Any]] = {IMAGE: np.ascontiguousarray(pictures)}
        if self.config.goal:
            if goal is None:
                raise ValueError("this network must be told where to go")
            inputs[GOAL] = goal.astype(np.float32)
        found = self._session.run(list(self.config.outputs), inputs)
        return {name: np.asarray(each, np.float64) for name, each in zip(self.config.outputs, found, strict=True)}

    def _check_shapes(self, path: Path) -> None:
        config = self.config
        wanted: dict[str, tuple[str, list[int]]] = {IMAGE: ("tensor(uint8)", [config.height, config.width, 3])}
        if config.goal:
            wanted[GOAL] = ("tensor(float)", [])
        inputs = {each.name: (each.type, each.shape[1:]) for each in self._session.get_inputs()}
        outputs = {each.name: (each.type, each.shape[1:]) for each in self._session.get_outputs()}
        if inputs != wanted or outputs != {name: ("tensor(float)", [config.classes]) for name in config.outputs}:
            raise InputError(path, "its graph has other inputs or outputs than its configuration says")


def _header(path: Path, document: dict[str, Any]) -> OnnxHeader:
    if document.get("format") != FORMAT:
        raise InputError(path, "is not a steering model of hrt")
    version = document.get("version")
    if isinstance(version, int) and version > VERSION:
        raise InputError(path, f"is of version {version}; this hrt reads versions up to {VERSION}", "update hrt")
    try:
        return OnnxHeader.model_validate_json(json.dumps(document))
    except ValidationError as error:
        raise InputError(path, describe(error)) from error
