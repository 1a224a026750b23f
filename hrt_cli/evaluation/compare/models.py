"""Two models of one kind: how far apart their weights are, and in what they are set otherwise."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.npz import read_npz
from hrt_cli.errors import InputError
from hrt_cli.evaluation.compare.result import Found, apart
from hrt_cli.planning.policy import Policy
from hrt_cli.texture.model import TextureModel

_TEXTURE = ("mean", "transform", "centroids", "mean_rgb", "roughness", "radius")
_SETTINGS = ("pixel_m", "version")


@dataclass(frozen=True)
class Weights:
    """A model, or anything else of named arrays.

    Attributes
    ----------
    tensors : mapping of str to array
    settings : dict
        What it is and how it was made, as JSON values.
    """

    tensors: Mapping[str, NDArray[Any]]
    settings: dict[str, Any] = field(default_factory=dict)


def compare_models(a: Weights, b: Weights) -> Found:
    """Compare two models.

    `max` is the largest absolute difference of a weight, `relative` the Euclidean norm of all differences by that of
    all weights of A; `tensors` counts those that only one has, or that differ in shape, `settings` the settings that
    differ.
    """
    both = [k for k in a.tensors if k in b.tensors and a.tensors[k].shape == b.tensors[k].shape]
    odd = [k for k in dict.fromkeys([*a.tensors, *b.tensors]) if k not in both]
    settings = [k for k in dict.fromkeys([*a.settings, *b.settings]) if a.settings.get(k) != b.settings.get(k)]
    per_tensor: dict[str, dict[str, Any]] = {}
    squares, size = 0.0, 0.0
    for name in both:
        of_a, of_b = (np.asarray(each.tensors[name], np.float64) for each in (a, b))
        gap = of_a - of_b
        moved, norm = float((gap * gap).sum()), float((of_a * of_a).sum())
        squares, size = squares + moved, size + norm
        relative = _ratio(moved, norm)
        per_tensor[name] = {"shape": list(of_a.shape), "max": float(np.abs(gap).max(initial=0.0)), "relative": relative}
    figures = [
        apart("max", max((each["max"] for each in per_tensor.values()), default=0.0), family="weights"),
        apart("relative", _ratio(squares, size), family="weights"),
        apart("tensors", float(len(odd))),
        apart("settings", float(len(settings))),
    ]
    moved_most = sorted((k for k in per_tensor if per_tensor[k]["max"]), key=lambda k: -per_tensor[k]["max"])
    lines = [f"{name}: {_shape(a, name)} in A, {_shape(b, name)} in B" for name in odd]
    lines += [f"{name}: {_short(a.settings.get(name))} in A, {_short(b.settings.get(name))} in B" for name in settings]
    lines += [f"{name}: max {per_tensor[name]['max']:.6g}" for name in moved_most]
    detail = {
        "per_tensor": per_tensor,
        "settings": {name: {"a": a.settings.get(name), "b": b.settings.get(name)} for name in settings},
        "tensors": odd,
    }
    return Found(figures, lines, detail)


def read_weights(kind: str, path: Path) -> Weights:
    """Read a model of a kind ("policy", "texture model", "steering model").

    Raises
    ------
    InputError
    """
    return {"policy": _read_policy, "texture model": _read_texture_model, "steering model": _read_steering_model}[kind](
        path
    )


def _read_policy(path: Path) -> Weights:
    # The learning curve counts as a setting: no plan depends on it.
    arrays = _arrays(path)
    try:
        policy = Policy.from_arrays(arrays)
    except ValueError as error:
        raise InputError(path, str(error)) from error
    settings: dict[str, Any] = {"layout": policy.layout, **policy.recipe}
    if "learning_curve" in arrays:
        settings["learning_curve"] = np.asarray(arrays["learning_curve"]).tolist()
    return Weights({"weights": policy.weights}, settings)


def _read_texture_model(path: Path) -> Weights:
    try:
        model = TextureModel.from_arrays(_arrays(path))
    except ValueError as error:
        raise InputError(path, str(error)) from error
    settings = asdict(model.settings) | {name: getattr(model, name) for name in _SETTINGS}
    return Weights({name: getattr(model, name) for name in _TEXTURE}, json.loads(json.dumps(settings)))


def _read_steering_model(path: Path) -> Weights:
    from hrt_cli.steering.network.model import read_model  # PyTorch takes a second to import

    net = read_model(path, as_it_stands=True)
    tensors = {name: tensor.numpy() for name, tensor in net.state_dict().items()}
    return Weights(tensors, json.loads(net.config.model_dump_json()))


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    arrays = read_npz(path)
    arrays.pop("provenance", None)
    return arrays


def _ratio(squares: float, size: float) -> float | None:
    if not squares:
        return 0.0
    return math.sqrt(squares / size) if size else None


def _shape(model: Weights, name: str) -> str:
    return f"shape {list(model.tensors[name].shape)}" if name in model.tensors else "none"


def _short(value: Any, most: int = 60) -> str:
    told = str(value)
    return told if len(told) <= most else f"{told[:most]}…"
