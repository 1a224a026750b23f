"""New classes for what a model has never seen, beside the old ones, which keep their ids."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.texture.cluster import Sample, class_radius, distances, kmeans, project
from hrt_cli.texture.model import MAX_CLASSES, TextureModel

MIN_SHARE = 0.01
"""A texture must hold this share of a survey to be a class; ten times what lies outside the radii by chance."""
MAX_NEW = 8
"""New classes that one survey may bring."""
_SLACK = 1.2
"""A class of few patches may reach so much further than the widest old one by chance."""

F64 = NDArray[np.float64]


def novel(model: TextureModel, sample: Sample) -> NDArray[np.bool_]:
    """Return which patches lie outside the radius of every class, and on plain ground: bool [patches].

    What lies on a border is a mixture, which no class was to hold.
    """
    away = distances(project(model, sample.values), model.centroids)
    return np.asarray((away > model.radius[:, None]).all(axis=0) & sample.plain)


def grow(model: TextureModel, sample: Sample, seed: int) -> TextureModel:
    """Give the novel patches of a survey classes of their own, after the old ones.

    Centroids, scaling and radii of the old classes stay as they are, so a patch that lies near an old class keeps its
    id, and the scores that a robot has learnt for that class stay true. The new ones are found by K-means among the
    novel patches alone, with the fewest classes of which none is much wider than the widest old class.

    Parameters
    ----------
    model : TextureModel
    sample : Sample
        Patches of the new survey, measured as the model's were.
    seed : int

    Returns
    -------
    TextureModel
        `model` itself where less than `MIN_SHARE` of the sample is novel, or no new class would hold that much.

    Raises
    ------
    ArgumentError
        There would be more classes than a class raster can hold.
    """
    outside = novel(model, sample)
    if outside.mean() < MIN_SHARE:
        return model
    points = project(model, sample.values)[outside]
    centroids, labels = _fewest(points, float(model.radius.max()), seed)
    large = np.flatnonzero(np.bincount(labels, minlength=len(centroids)) >= MIN_SHARE * len(outside))
    if len(large) == 0:
        return model
    if model.classes + len(large) > MAX_CLASSES:
        raise ArgumentError(f"{model.classes + len(large)} classes, {MAX_CLASSES} are possible")
    members = [labels == k for k in large]
    rgb = np.array([sample.rgb[outside][one].mean(axis=0) for one in members])
    roughness = np.array([sample.roughness[outside][one].mean() for one in members])
    order = np.lexsort((roughness, rgb @ np.array([0.299, 0.587, 0.114])))
    grown = replace(
        model,
        centroids=np.concatenate([model.centroids, centroids[large][order]]),
        mean_rgb=np.concatenate([model.mean_rgb, rgb[order]]),
        roughness=np.concatenate([model.roughness, roughness[order]]),
        radius=np.concatenate([model.radius, class_radius(points, centroids, labels)[large][order]]),
    )
    nearest = distances(project(model, sample.values), grown.centroids).argmin(axis=0)
    return replace(grown, share=np.bincount(nearest, minlength=grown.classes) / len(nearest))


def _fewest(points: F64, widest: float, seed: int) -> tuple[F64, NDArray[np.int64]]:
    """Find the fewest classes that are all no wider than `widest`, `MAX_NEW` at most."""
    distinct = len(np.unique(points.round(3), axis=0))
    for count in range(1, min(MAX_NEW, distinct) + 1):
        centroids, labels = kmeans(points, count, seed)
        if class_radius(points, centroids, labels).max() <= _SLACK * widest:
            break
    return centroids, labels
