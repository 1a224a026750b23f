"""What predicts by a model file: the model itself in PyTorch, or the same exported to ONNX."""

from __future__ import annotations

from pathlib import Path

from hrt_cli.steering.network.model import read_model
from hrt_cli.steering.network.predictor import Predictor, TorchPredictor


def load_predictor(path: Path, *, threads: int = 0) -> Predictor:
    """Return what predicts by a model file: one that was exported (`.onnx`), or a model itself (`model.read_model`).

    It computes on so many threads of the CPU; 0 for as many as its library takes.
    """
    if path.suffix.lower() == ".onnx":
        from hrt_cli.steering.onnx.model import OnnxPredictor

        return OnnxPredictor(path, threads=threads)
    return TorchPredictor(read_model(path), threads=threads)
