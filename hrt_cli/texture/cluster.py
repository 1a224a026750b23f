"""From a sample of patches to a texture model: scaling, whitening, K-means, canonical order."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import ArgumentError
from hrt_cli.texture.discriminate import Tile, discriminant, noise_whitening, pure
from hrt_cli.texture.model import NOVEL_QUANTILE, TextureModel
from hrt_cli.texture.settings import FeatureSettings
from hrt_cli.texture.weigh import site_factors, unit_spread

MAX_ROUNDS = 100
MOST_CONSIDERED = 12
_CONSIDERED_PATCHES = 8000
RESTARTS = 20
"""K-means starts; one start leaves the answer to luck (ARI sd .08), twenty do not (.001)."""
_DISTINCT_DECIMALS = 3
MAX_POINTS = 20_000
"""Patches that K-means sees."""

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Sample:
    """Patches drawn from an image.

    Attributes
    ----------
    values : ndarray [patches, channels] float64
    rgb : ndarray [patches, 3] float64
    roughness : ndarray [patches] float64
    plain : ndarray [patches] bool
        See `Patches`.
    tiles : list of Tile
        Where settings ask for a wide window: the tiles whose usable cells, in order, the patches are.
    apart_cells : (int, int)
        Cells along rows and columns that lie between wide windows which share nothing.
    """

    values: F64
    rgb: F64
    roughness: F64
    plain: NDArray[np.bool_]
    tiles: list[Tile] = field(default_factory=list)
    apart_cells: tuple[int, int] = (1, 1)

    @classmethod
    def joined(cls, parts: list[Sample]) -> Sample:
        """Return all patches of `parts`, in order."""
        return cls(
            np.concatenate([one.values for one in parts]),
            np.concatenate([one.rgb for one in parts]),
            np.concatenate([one.roughness for one in parts]),
            np.concatenate([one.plain for one in parts]),
            [tile for one in parts for tile in one.tiles],
            parts[0].apart_cells,
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
    points = _points(sample, settings)
    _refuse_too_few(points, classes)
    centroids, labels = kmeans(_thinned(points, MAX_POINTS, seed), classes, seed)
    if len(labels) < len(points):
        labels = distances(points, centroids).argmin(axis=0)
    counts = np.bincount(labels, minlength=classes)
    if counts.min() == 0:
        raise ArgumentError(f"only {np.count_nonzero(counts)} distinct textures, K={classes} asked")
    if settings.discriminates:
        transform, means = discriminant(sample.values, labels, pure(sample.tiles, labels), classes)
        centroids = _product(means - mean, transform)
        coordinates = _product(sample.values - mean, transform)
    else:
        transform, coordinates = _whitening(sample.values - mean), points
    mean_rgb = _class_means(sample.rgb, labels, classes)
    roughness = _class_means(sample.roughness[:, None], labels, classes)[:, 0]
    order = np.lexsort((roughness, mean_rgb @ np.array([0.299, 0.587, 0.114])))
    return TextureModel(
        settings=settings,
        pixel_m=pixel_m,
        mean=mean,
        transform=transform,
        centroids=centroids[order],
        share=counts[order] / len(labels),
        mean_rgb=np.clip(mean_rgb[order], 0, 255),
        roughness=roughness[order],
        radius=_radius_on_plain_ground(coordinates, centroids, sample.plain)[order],
    )


def _radius_on_plain_ground(coordinates: F64, centroids: F64, plain: NDArray[np.bool_]) -> F64:
    """Return the radius of each class among the plain patches that are nearest to it."""
    chosen = coordinates[plain] if plain.any() else coordinates
    return class_radius(chosen, centroids, distances(chosen, centroids).argmin(axis=0))


def consider(sample: Sample, settings: FeatureSettings, seed: int) -> dict[int, float]:
    """Judge numbers of classes by the variance ratio criterion (Calinski and Harabasz 1974).

    It is the variance between classes over that within them, each by its degrees of freedom: it rises as long as a
    further class tells textures apart, and falls when one is cut in two.

    Returns
    -------
    dict of int to float
        For 2 to `MOST_CONSIDERED` classes, or as many as there are distinct textures.

    Raises
    ------
    ArgumentError
        The sample holds one texture only.
    """
    from sklearn.metrics import calinski_harabasz_score

    points = _thinned(_points(sample, settings), _CONSIDERED_PATCHES, seed)
    most = min(MOST_CONSIDERED, _distinct(points) - 1)
    if most < 2:
        raise ArgumentError("the image has too few textures to choose a number of classes from")
    found = {}
    for classes in range(2, most + 1):
        labels = kmeans(points, classes, seed)[1]
        found[classes] = float(calinski_harabasz_score(points, labels))
    return found


def best(considered: dict[int, float]) -> int:
    """Return the number of classes of the highest criterion, the fewest of equal ones."""
    return max(considered, key=lambda classes: (considered[classes], -classes))


def project(model: TextureModel, values: F64) -> F64:
    """Return the coordinates [patches, coordinates] of features [patches, channels] in a model."""
    return _product(values - model.mean, model.transform)


def class_radius(points: F64, centroids: F64, labels: NDArray[np.int64]) -> F64:
    """Return the distance from each centroid within which `NOVEL_QUANTILE` of its points lie."""
    own = distances(points, centroids)[labels, np.arange(len(labels))]
    held = [own[labels == k] for k in range(len(centroids))]
    return np.array([np.quantile(one, NOVEL_QUANTILE) if len(one) else 0.0 for one in held])


def kmeans(points: F64, classes: int, seed: int) -> tuple[F64, NDArray[np.int64]]:
    """Partition points into classes of least squared distance (Lloyd 1982, seeded as Arthur and Vassilvitskii 2007).

    The best of `RESTARTS` starts, carried on in double precision until no point changes its class: then the result is
    a property of the points, and does not hang on the order of a processor's additions.

    Parameters
    ----------
    points : ndarray [points, coordinates] float64
    classes : int
    seed : int

    Returns
    -------
    centroids : ndarray [classes, coordinates] float64
    labels : ndarray [points] int64
    """
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        cv2.setRNGSeed(seed % 2**31)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, MAX_ROUNDS, 1e-4)
        data = points.astype(np.float32)
        _, _, found = cv2.kmeans(data, classes, None, stop, RESTARTS, cv2.KMEANS_PP_CENTERS)  # type: ignore[call-overload]
    finally:
        cv2.setNumThreads(threads)
    centroids = found.astype(np.float64)
    labels = distances(points, centroids).argmin(axis=0)
    for _ in range(MAX_ROUNDS):
        counts = np.bincount(labels, minlength=classes)
        held = counts > 0
        for axis in range(points.shape[1]):
            sums = np.bincount(labels, points[:, axis], classes)
            centroids[held, axis] = sums[held] / counts[held]
        before, labels = labels, distances(points, centroids).argmin(axis=0)
        if np.array_equal(before, labels):
            break
    return centroids, labels


def distances(points: F64, centroids: F64) -> F64:
    """Return the distance of every point from every centroid [centroids, points]."""
    squares = np.zeros((len(centroids), len(points)))
    for k, centroid in enumerate(centroids):
        for axis, place in enumerate(centroid):
            squares[k] += (points[:, axis] - place) ** 2
    return np.asarray(np.sqrt(squares))


def _product(left: F64, right: F64) -> F64:
    """Return left · rightᵀ, summed in a fixed order: the same bits whatever BLAS there is and however many threads."""
    return np.asarray(np.einsum("ik,jk->ij", left, right))


def _points(sample: Sample, settings: FeatureSettings) -> F64:
    """Return the coordinates in which K-means finds the classes [patches, coordinates]."""
    values = sample.values
    if settings.discriminates:
        values = np.concatenate([one.patches for one in sample.tiles])
    centred = values - values.mean(axis=0)
    if settings.features == "site":
        return np.asarray(centred * site_factors(sample.tiles, centred, settings, sample.apart_cells))
    if settings.features == "texture":
        unit_spread(centred)
        return _product(centred, noise_whitening(sample.tiles))
    return _product(centred, _whitening(centred))


def _thinned(points: F64, most: int, seed: int) -> F64:
    if len(points) <= most:
        return points
    return points[np.sort(np.random.default_rng(seed).choice(len(points), most, replace=False))]


def _whitening(centred: F64) -> F64:
    """Return PCA whitening of channels, standardised first, without directions that hardly vary."""
    scale = unit_spread(centred)
    scaled = centred * scale
    values, vectors = np.linalg.eigh(_product(scaled.T, scaled.T) / len(scaled))
    kept = values > 1e-3 * values.max()
    # An eigenvector's sign is arbitrary; the largest component is made positive.
    chosen = vectors[:, kept]
    signs = np.sign(chosen[np.abs(chosen).argmax(axis=0), np.arange(chosen.shape[1])])
    whitening: F64 = (chosen * signs / np.sqrt(values[kept])).T * scale
    return whitening


def _refuse_too_few(coordinates: F64, classes: int) -> None:
    # Few are enough to see that there are enough; sorting all of them takes time.
    if _distinct(coordinates[:: max(1, len(coordinates) // _CONSIDERED_PATCHES)]) >= classes:
        return
    distinct = _distinct(coordinates)
    if distinct < classes:
        raise ArgumentError(f"only {distinct} distinct textures, K={classes} asked: ask for fewer classes")


def _distinct(coordinates: F64) -> int:
    return len(np.unique(coordinates.round(_DISTINCT_DECIMALS), axis=0))


def _class_means(values: F64, labels: NDArray[np.int64], classes: int) -> F64:
    return np.stack([values[labels == k].mean(axis=0) for k in range(classes)])
