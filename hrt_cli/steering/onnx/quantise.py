"""An ONNX graph of the steering network in 8-bit integers, calibrated on pictures.

Static quantisation (Jacob et al. 2018, arXiv:1712.05877) of the convolutions, the sums and the pooling between them,
one scale per output channel of the weights. What comes after the last convolution stays float32: it takes 2 % of the
time and decides the angle.

Activations are unsigned and weights have 7 bits. On x86 without VNNI the instruction that multiplies (vpmaddubsw) adds
two products in 16 bits and saturates, silently: 2 x 255 x 127 does not fit, 2 x 255 x 64 does. With 7 bits no
processor can saturate, so a model does on the robot what it did where it was tried. Measured on real frames on such a
processor: as fast as 8 bits, and the angles are less than half as far from those in float32.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

from hrt_cli.progress import Progress
from hrt_cli.steering.onnx.graph import GOAL, IMAGE

_QUANTISED = ["Conv", "Relu", "Add", "MaxPool"]
_BATCH = 8


def quantised(
    model: onnx.ModelProto, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None, progress: Progress
) -> onnx.ModelProto:
    """Return a float graph (`graph.float_graph`) quantised, ranges being the extremes seen on pictures.

    Parameters
    ----------
    pictures : uint8 [n, height, width, 3]
    goal : float32 [n], optional
    progress : Progress
        Called with (pictures seen, pictures).
    """
    with tempfile.TemporaryDirectory() as folder, _quiet():
        whole, made = Path(folder, "float.onnx"), Path(folder, "int8.onnx")
        onnx.save(model, whole)
        quantize_static(
            whole,
            made,
            _Reader(pictures, goal, progress),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=_QUANTISED,
            # After the goal has come in, all is float.
            nodes_to_exclude=["merged"],
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
        found = onnx.load(made)
    found.producer_name, found.producer_version, found.doc_string = "hrt", "", model.doc_string
    onnx.checker.check_model(found)
    return found


class _Reader(CalibrationDataReader):  # type: ignore[misc]  # onnxruntime is untyped
    def __init__(self, pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None, progress: Progress) -> None:
        self._batches = self._read(pictures, goal, progress)

    def get_next(self) -> dict[str, NDArray[np.generic]] | None:
        return next(self._batches, None)

    @staticmethod
    def _read(
        pictures: NDArray[np.uint8], goal: NDArray[np.float32] | None, progress: Progress
    ) -> Iterator[dict[str, NDArray[np.generic]]]:
        for first in range(0, len(pictures), _BATCH):
            these = slice(first, first + _BATCH)
            yield {IMAGE: pictures[these]} | ({} if goal is None else {GOAL: goal[these]})
            progress(min(first + _BATCH, len(pictures)), len(pictures))


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep onnxruntime from giving advice through the root logger."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
