"""The steering network as an ONNX graph, from the picture as a camera gives it to probabilities.

The graph is written node by node rather than traced by `torch.onnx.export`: it takes a tenth of a second instead of
six, the bytes depend on no version of PyTorch, nothing of this machine gets into them (the exporter records where the
Python sources lie), and batch norms, normalisation and temperatures go into weights before anything is quantised.
What keeps it true to the network is that `export` compares the two on every export.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from hrt_cli.steering.network.net import LOUDNESS, SHARPNESS, SteeringConfig, SteeringNet, directions
from hrt_cli.steering.network.resnet import BasicBlock

OPSET, IR_VERSION = 17, 8
"""Of 2022: what robots have installed reads them, and quantisation per channel needs no later ones."""
IMAGE, GOAL = "image", "goal"
_STRIDE = 32
"""Pixels of the picture to a row or column of the trunk's features."""


def float_graph(net: SteeringNet, description: str) -> onnx.ModelProto:
    """Return a network in evaluation as an ONNX model.

    Inputs: `image`, uint8 [n, height, width, 3], red, green and blue of fitted pictures (`pictures.fitted`); where the
    network is told where to go also `goal`, float32 [n], radians. For each output a float32 [n, 2M + 1] of its name:
    probabilities, temperature applied.

    Parameters
    ----------
    net : SteeringNet
    description : str
        What to write as the model's documentation.
    """
    config = net.config
    graph = _Graph()
    features = _trunk(graph, net, _normalised(graph, config))
    # Quicker in onnxruntime than ReduceMean, as BatchNormalization below is than a product and a sum.
    pooled = graph.op("AveragePool", [features], "rows", kernel_shape=[-(-config.height // _STRIDE), 1])
    pooled = graph.op("MatMul", [pooled, graph.constant("columns.share", _column_shares(config))], "columns")
    seen = graph.op("Flatten", [pooled], "features", axis=1)
    if net.merge is not None:
        seen = _merged(graph, net.merge, seen)
    for name in config.outputs:
        logits = graph.linear(f"{name}.logits", seen, net.heads[name], config.temperature.get(name, 1.0))
        graph.op("Softmax", [logits], name, axis=-1)
    inputs = [helper.make_tensor_value_info(IMAGE, TensorProto.UINT8, ["n", config.height, config.width, 3])]
    if config.goal:
        inputs.append(helper.make_tensor_value_info(GOAL, TensorProto.FLOAT, ["n"]))
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", config.classes]) for name in config.outputs]
    made = helper.make_graph(graph.nodes, "steering", inputs, outputs, graph.weights, doc_string=description)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    model.producer_name, model.doc_string = "hrt", description
    onnx.checker.check_model(model, full_check=True)
    return model


class _Graph:
    """Nodes and weights, each node named after what it makes."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.weights: list[onnx.TensorProto] = []

    def constant(self, name: str, value: NDArray[np.float64] | NDArray[np.float32] | torch.Tensor) -> str:
        array = value.detach().numpy() if isinstance(value, torch.Tensor) else value
        self.weights.append(numpy_helper.from_array(np.ascontiguousarray(array, np.float32), name))
        return name

    def op(self, kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def linear(self, name: str, seen: str, layer: nn.Module, divisor: float = 1.0) -> str:
        """Add a linear layer whose result is divided by a number."""
        if not isinstance(layer, nn.Linear):
            raise TypeError(f"{name} is no linear layer")
        weight, bias = layer.weight.double() / divisor, layer.bias.double() / divisor
        parts = [seen, self.constant(f"{name}.weight", weight), self.constant(f"{name}.bias", bias)]
        return self.op("Gemm", parts, name, transB=1)

    def convolution(self, name: str, seen: str, layer: nn.Conv2d, norm: nn.BatchNorm2d) -> str:
        """Add a convolution with the batch norm that follows it in its weights."""
        mean, variance = norm.running_mean, norm.running_var
        if mean is None or variance is None:
            raise ValueError(f"{name} has no statistics")
        gain = norm.weight.double() / torch.sqrt(variance.double() + norm.eps)
        weight = layer.weight.double() * gain[:, None, None, None]
        bias = norm.bias.double() - mean.double() * gain
        side, pad = layer.kernel_size[0], int(layer.padding[0])
        parts = [seen, self.constant(f"{name}.weight", weight), self.constant(f"{name}.bias", bias)]
        return self.op(
            "Conv", parts, name, kernel_shape=[side, side], strides=list(layer.stride), pads=[pad, pad, pad, pad]
        )


def _normalised(graph: _Graph, config: SteeringConfig) -> str:
    """Add what `pictures.prepare` does."""
    mean, std = np.array(config.mean, np.float32), np.array(config.std, np.float32)
    planes = graph.op("Transpose", [IMAGE], "planes", perm=[0, 3, 1, 2])
    pixels = graph.op("Cast", [planes], "pixels", to=TensorProto.FLOAT)
    values = {"gain": 1.0 / (255.0 * std), "offset": -mean / std, "mean": np.zeros(3), "variance": np.ones(3)}
    parts = [graph.constant(f"normalise.{name}", np.asarray(value, np.float32)) for name, value in values.items()]
    return graph.op("BatchNormalization", [pixels, *parts], "seen", epsilon=0.0)


def _trunk(graph: _Graph, net: SteeringNet, seen: str) -> str:
    trunk = net.trunk
    seen = graph.op("Relu", [graph.convolution("conv1", seen, trunk.conv1, trunk.bn1)], "relu1")
    seen = graph.op("MaxPool", [seen], "pool1", kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1])
    for number in range(1, 5):
        for index, block in enumerate(trunk.get_submodule(f"layer{number}").children()):
            seen = _block(graph, f"layer{number}.{index}", block, seen)
    return seen


def _block(graph: _Graph, name: str, block: nn.Module, seen: str) -> str:
    if not isinstance(block, BasicBlock):
        raise TypeError(f"{name} is no block of a ResNet-18")
    shortcut = seen
    if block.downsample is not None:
        layer, norm = block.downsample
        if not (isinstance(layer, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d)):
            raise TypeError(f"{name} has another shortcut than a ResNet-18")
        shortcut = graph.convolution(f"{name}.shortcut", seen, layer, norm)
    inner = graph.op("Relu", [graph.convolution(f"{name}.conv1", seen, block.conv1, block.bn1)], f"{name}.relu1")
    inner = graph.convolution(f"{name}.conv2", inner, block.conv2, block.bn2)
    return graph.op("Relu", [graph.op("Add", [inner, shortcut], f"{name}.sum")], f"{name}.relu2")


def _merged(graph: _Graph, merge: nn.Module, seen: str) -> str:
    """Add the layer in which what is seen and where to go meet."""
    # A column [n, 1]; by Reshape, whose shape is no float.
    graph.weights.append(numpy_helper.from_array(np.array([-1, 1], np.int64), "goal.shape"))
    column = graph.op("Reshape", [GOAL, "goal.shape"], "goal.column")
    away = graph.op("Sub", [column, graph.constant("goal.directions", directions()[None])], "goal.away")
    # k (cos - 1), in the order in which the network computes it.
    short = graph.op("Sub", [graph.op("Cos", [away], "goal.cos"), graph.constant("one", np.ones(1))], "goal.short")
    sharp = graph.op("Mul", [short, graph.constant("goal.sharpness", np.full(1, SHARPNESS))], "goal.log")
    loud = graph.constant("goal.loudness", np.full(1, LOUDNESS))
    bearing = graph.op("Mul", [graph.op("Exp", [sharp], "goal.near"), loud], "goal.bearing")
    both = graph.op("Concat", [seen, bearing], "merge.inputs", axis=1)
    merged = graph.op("Relu", [graph.linear("merge.linear", both, merge.get_submodule("0"))], "merged")
    return graph.op("Concat", [merged, bearing], "head.inputs", axis=1)


def _column_shares(config: SteeringConfig) -> NDArray[np.float32]:
    """Return how much each column of features counts in each average, float32 [ceil(width / 32), columns].

    This is adaptive average pooling as a matrix, which ONNX has not.
    """
    eye = torch.eye(-(-config.width // _STRIDE))
    return np.asarray(nn.functional.adaptive_avg_pool1d(eye[None], config.columns)[0].numpy(), np.float32)
