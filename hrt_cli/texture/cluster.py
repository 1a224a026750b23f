"""From a sample of patches to a texture model: scaling, whitening, K-means, canonical order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from hrt_cli.errors import ArgumentError
from hrt_cli.texture.features import FeatureSettings
from hrt_cli.texture.model import TextureModel

RESTARTS = 20
"""K-means starts; one start leaves the answer to luck (ARI sd .08), twenty do not (.001)."""
_SPREAD_FLOOR = 1e-3
"""A channel that varies less than this (Lab units, log units) carries no information and is left out."""
_DISTINCT_DECIMALS = 3
_LIGHTNESS_WEIGHT = 0.65
"""Weight of lightness beside a and b: at full weight a class is spent on the shadows of what is one ground."""

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Sample:
    """Patches drawn from an image.

    Attributes
    ----------
    values : ndarray [patches, channels] float64
    rgb : ndarray [patches, 3] float64
    roughness : ndarray [patches] float64
    """

    values: F64
    rgb: F64
    roughness: F64

    @classmethod
    def joined(cls, parts: list[Sample]) -> Sample:
        """Return all patches of `parts`, in order."""
        return cls(
            np.concatenate([one.values for one in parts]),
            np.concatenate([one.rgb for one in parts]),
            np.concatenate([one.roughness for one in parts]),
        )


def cluster(
    sample: Sample, settings: FeatureSettings, pixel_m: tuple[float, float], classes: int, seed: int
) -> TextureModel:
    """Scale a sample, find its classes by K-means and bring them into canonical order.

    Raises
    ------
    ArgumentError
        The sample holds one texture only, or fewer than `classes`.
    """
    mean = sample.values.mean(axis=0)
    with threadpool_limits(1):
        transform = _transform(sample.values - mean, settings)
        coordinates = (sample.values - mean) @ transform.T
        _refuse_too_few(coordinates, classes)
        kmeans = KMeans(classes, n_init=RESTARTS, random_state=seed, algorithm="lloyd").fit(coordinates)
    labels = kmeans.labels_
    counts = np.bincount(labels, minlength=classes)
    if counts.min() == 0:
        raise ArgumentError(f"only {np.count_nonzero(counts)} distinct textures, K={classes} asked")
    mean_rgb = _class_means(sample.rgb, labels, classes)
    roughness = _class_means(sample.roughness[:, None], labels, classes)[:, 0]
    order = np.lexsort((roughness, mean_rgb @ np.array([0.299, 0.587, 0.114])))
    return TextureModel(
        settings=settings,
        pixel_m=pixel_m,
        mean=mean,
        transform=transform,
        centroids=kmeans.cluster_centers_[order].astype(np.float64),
        share=counts[order] / len(labels),
        mean_rgb=np.clip(mean_rgb[order], 0, 255),
        roughness=roughness[order],
    )


def _transform(centred: F64, settings: FeatureSettings) -> F64:
    """Return the matrix from centred features to coordinates in which K-means' distance is fair."""
    spread = centred.std(axis=0)
    scale = np.where(spread > _SPREAD_FLOOR, 1 / np.maximum(spread, _SPREAD_FLOOR), 0.0)
    if not scale.any():
        raise ArgumentError("the image has one texture only: there is nothing to tell apart")
    colour, texture = settings.block_sizes
    if settings.features == "site":
        weights = np.concatenate([np.full(colour, 1 / np.sqrt(colour)), np.full(texture, 1 / np.sqrt(texture))])
        weights[0] *= _LIGHTNESS_WEIGHT
        return np.diag(scale * weights)
    return _whitening(centred * scale) * scale


def _whitening(scaled: F64) -> F64:
    """Return PCA whitening of standardised channels, without directions that hardly vary."""
    values, vectors = np.linalg.eigh(scaled.T @ scaled / len(scaled))
    kept = values > 1e-3 * values.max()
    # An eigenvector's sign is arbitrary; the largest component is made positive.
    chosen = vectors[:, kept]
    signs = np.sign(chosen[np.abs(chosen).argmax(axis=0), np.arange(chosen.shape[1])])
    whitening: F64 = (chosen * signs / np.sqrt(values[kept])).T
    return whitening


def _refuse_too_few(coordinates: F64, classes: int) -> None:
    distinct = len(np.unique(coordinates.round(_DISTINCT_DECIMALS), axis=0))
    if distinct < classes:
        raise ArgumentError(f"only {distinct} distinct textures, K={classes} asked: ask for fewer classes")


def _class_means(values: F64, labels: NDArray[np.int32], classes: int) -> F64:
    return np.stack([values[labels == k].mean(axis=0) for k in range(classes)])
