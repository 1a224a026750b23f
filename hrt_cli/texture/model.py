"""The texture model: what was measured, how it was scaled, and the classes that were found."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hrt_cli.texture.settings import FEATURE_SETS, ROTATIONS, FeatureSettings

MODEL_VERSION = 2
MAX_CLASSES = 255
"""Classes are 0 … 254 in a uint8 raster; 255 is nodata."""
NOVEL_QUANTILE = 0.999
_SAME_PIXEL = 1e-3
MAX_WAVELENGTHS = 16
MAX_ORIENTATIONS = 32
_SCALARS = ("texture_sigma_m", "fit_sigma_m", "colour_sigma_m", "contrast_sigma_m", "step_m")

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class TextureModel:
    """A segmentation that can be applied to another image.

    A patch with features x has coordinates z = transform · (x − mean), and belongs to the nearest centroid.

    Attributes
    ----------
    settings : FeatureSettings
        What is measured, in metres.
    pixel_m : (float, float)
        Ground metres per pixel at the fit, along rows and columns.
    mean : ndarray [channels] float64
    transform : ndarray [coordinates, channels] float64
        Scaling, block weights and whitening in one.
    centroids : ndarray [classes, coordinates] float64
        In canonical order: dark to bright.
    share : ndarray [classes] float64
        Share of the sample that each class holds; sums to 1.
    mean_rgb : ndarray [classes, 3] float64 in [0, 255]
    roughness : ndarray [classes] float64
        Mean log Gabor amplitude (log of relative contrast).
    radius : ndarray [classes] float64
        Distance from the centroid that `NOVEL_QUANTILE` of the class's own patches stay within, in coordinates. What
        lies further from every class is unlike all that the model was fitted on.
    version : int
    """

    settings: FeatureSettings
    pixel_m: tuple[float, float]
    mean: F64
    transform: F64
    centroids: F64
    share: F64
    mean_rgb: F64
    roughness: F64
    radius: F64
    version: int = MODEL_VERSION

    @property
    def classes(self) -> int:
        """Number of classes."""
        return len(self.centroids)

    def pixels_of(self, pixel_m: tuple[float, float]) -> tuple[float, float]:
        """Return what to take the pixels of another image for: those of the fit, where they are nearly those.

        A crop of a raster lies elsewhere in its projection, and the ground metres of its pixels differ in the ninth
        digit; it is to be measured by the very filters of the whole.
        """
        near = all(abs(one / other - 1) <= _SAME_PIXEL for one, other in zip(pixel_m, self.pixel_m, strict=True))
        return self.pixel_m if near else pixel_m

    def linear_scores(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Return `(mean, gain, offset)`: the class of x is argmin of gain · (x − mean) + offset.

        The squared distance to each centroid less |z|², which all classes share; what is left is linear in x, so
        interpolating scores between patches is interpolating features.

        Returns
        -------
        mean : ndarray [channels] float32
        gain : ndarray [classes, channels] float32
        offset : ndarray [classes] float32
        """
        gain = -2 * _product(self.centroids, self.transform)
        offset = np.array([math.fsum(one * one) for one in self.centroids])
        return self.mean.astype(np.float32), gain.astype(np.float32), offset.astype(np.float32)

    def to_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the model as named numeric and unicode arrays, the inverse of `from_arrays`."""
        settings = self.settings
        arrays: dict[str, NDArray[np.generic]] = {
            "version": np.array(self.version, np.int64),
            "features": np.array(settings.features),
            "rotation": np.array(settings.rotation),
            "orientations": np.array(settings.orientations, np.int64),
            "scale_invariant": np.array(int(settings.scale_invariant), np.int64),
            "wavelengths_m": np.array(settings.wavelengths_m, np.float64),
            "pixel_m": np.array(self.pixel_m, np.float64),
        }
        arrays.update({name: np.array(getattr(settings, name), np.float64) for name in _SCALARS})
        for name in ("mean", "transform", "centroids", "share", "mean_rgb", "roughness", "radius"):
            arrays[name] = np.array(getattr(self, name), np.float64)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[np.generic]]) -> TextureModel:
        """Build the model from what `to_arrays` gave, trusting none of it.

        Raises
        ------
        ValueError
            A member is missing, has the wrong type or shape, is not finite or out of range, or the model is of a
            later version.
        """
        version = _integer(arrays, "version", 1, None)
        if version != MODEL_VERSION:
            remedy = "update hrt to use it" if version > MODEL_VERSION else "fit it again"
            raise ValueError(f"it is of version {version}, this hrt reads version {MODEL_VERSION}: {remedy}")
        settings = _settings(arrays)
        pixel_m = _floats(arrays, "pixel_m", (2,), low=0.0, exclusive=True)
        channels = sum(settings.block_sizes)
        centroids = _floats(arrays, "centroids", (None, None))
        classes, coordinates = centroids.shape
        if not 2 <= classes <= MAX_CLASSES:
            raise ValueError(f"'centroids' has {classes} classes, 2 to {MAX_CLASSES} are possible")
        share = _floats(arrays, "share", (classes,), low=0.0, high=1.0)
        if abs(share.sum() - 1) > 1e-6:
            raise ValueError(f"'share' sums to {share.sum():g}, not to 1")
        return cls(
            settings=settings,
            pixel_m=(float(pixel_m[0]), float(pixel_m[1])),
            mean=_floats(arrays, "mean", (channels,)),
            transform=_floats(arrays, "transform", (coordinates, channels)),
            centroids=centroids,
            share=share,
            mean_rgb=_floats(arrays, "mean_rgb", (classes, 3), low=0.0, high=255.0),
            roughness=_floats(arrays, "roughness", (classes,)),
            radius=_floats(arrays, "radius", (classes,), low=0.0),
            version=version,
        )


def describe(model: TextureModel) -> list[dict[str, object]]:
    """Return the class table, one row per class: `id`, `share`, `mean_rgb` (three integers), `roughness`."""
    return [
        {
            "id": index,
            "share": float(model.share[index]),
            "mean_rgb": [round(float(value)) for value in model.mean_rgb[index]],
            "roughness": float(model.roughness[index]),
        }
        for index in range(model.classes)
    ]


def _product(left: F64, right: F64) -> F64:
    """Matrix product with exactly rounded sums: the same bits on every machine and BLAS."""
    return np.array([[math.fsum(row * column) for column in right.T] for row in left])


def _settings(arrays: dict[str, NDArray[np.generic]]) -> FeatureSettings:
    wavelengths = _floats(arrays, "wavelengths_m", (None,), low=0.0, exclusive=True)
    if not 1 <= len(wavelengths) <= MAX_WAVELENGTHS:
        raise ValueError(f"'wavelengths_m' has {len(wavelengths)} entries, 1 to {MAX_WAVELENGTHS} are possible")
    scalars = {name: float(_floats(arrays, name, (), low=0.0, exclusive=True)) for name in _SCALARS}
    return FeatureSettings(
        features=_choice(arrays, "features", FEATURE_SETS),
        rotation=_choice(arrays, "rotation", ROTATIONS),
        wavelengths_m=tuple(float(value) for value in wavelengths),
        orientations=_integer(arrays, "orientations", 2, MAX_ORIENTATIONS),
        scale_invariant=bool(_integer(arrays, "scale_invariant", 0, 1)),
        **scalars,
    )


def _member(arrays: dict[str, NDArray[np.generic]], name: str) -> NDArray[np.generic]:
    if name not in arrays:
        raise ValueError(f"'{name}' is missing: this is not a texture model")
    return np.asarray(arrays[name])


def _choice(arrays: dict[str, NDArray[np.generic]], name: str, choices: tuple[str, ...]) -> str:
    value = _member(arrays, name)
    if value.shape != () or value.dtype.kind != "U":
        raise ValueError(f"'{name}' is not a single string")
    if str(value) not in choices:
        raise ValueError(f"'{name}' is {str(value)!r}, not one of {', '.join(choices)}")
    return str(value)


def _integer(arrays: dict[str, NDArray[np.generic]], name: str, low: int, high: int | None) -> int:
    value = _member(arrays, name)
    if value.shape != () or value.dtype.kind not in "iu":
        raise ValueError(f"'{name}' is not a single integer")
    number = int(value)
    if number < low or (high is not None and number > high):
        raise ValueError(f"'{name}' is {number}, outside {low} to {'any' if high is None else high}")
    return number


def _floats(
    arrays: dict[str, NDArray[np.generic]],
    name: str,
    shape: tuple[int | None, ...],
    *,
    low: float = -math.inf,
    high: float = math.inf,
    exclusive: bool = False,
) -> F64:
    value = _member(arrays, name)
    if value.dtype.kind not in "fiu":
        raise ValueError(f"'{name}' is not numeric (dtype {value.dtype})")
    if value.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, value.shape, strict=True)):
        wanted = "×".join("any" if n is None else str(n) for n in shape) or "a single number"
        raise ValueError(f"'{name}' has shape {value.shape}, not {wanted}")
    result = value.astype(np.float64)
    if not np.isfinite(result).all():
        raise ValueError(f"'{name}' holds a value that is not finite")
    if result.size and (result.min() < low or result.max() > high or (exclusive and result.min() <= low)):
        raise ValueError(f"'{name}' is outside {'above ' if exclusive else ''}{low:g} to {high:g}")
    return result
