"""The classes `hrt segment` finds, as a user gets them, and how well they agree with the truth."""

from __future__ import annotations

import contextlib
import io
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning

from hrt_cli.evaluation.segment import Agreement, agreement
from hrt_cli.main import cli
from hrt_cli.raster.classes import NODATA

Mask = NDArray[np.bool_]
U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class Picture:
    """An RGB picture [rows, cols, 3] with its valid pixels."""

    rgb: U8
    valid: Mask

    @classmethod
    def grey(cls, values: U8, valid: Mask | None = None) -> Picture:
        rgb = np.repeat(values[..., None], 3, axis=2)
        return cls(rgb, np.ones(values.shape, np.bool_) if valid is None else valid)

    def write(self, path: Path) -> None:
        """Write it as PNG, what is not valid transparent."""
        alpha = self.valid.astype(np.uint8) * np.uint8(255)
        pixels = self.rgb[..., ::-1] if self.valid.all() else np.dstack([self.rgb[..., ::-1], alpha])
        if not cv2.imwrite(str(path), pixels):
            raise OSError(f"{path}: cannot be written")


def segment(image: Picture | Path, classes: int, **options: str) -> U8:
    """Run `hrt segment` in this process; `options` are its own (`features="texture"`)."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name) / "classes.tif"
        flags = [f"--{option}={value}" for option, value in options.items()]
        if isinstance(image, Picture):
            path = Path(name) / "picture.png"
            image.write(path)
            flags.append("--unreferenced")
        else:
            path = image
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            cli.main(["segment", str(path), "-o", str(out), "-K", str(classes), *flags, "-q"], standalone_mode=False)
            with rasterio.open(out) as raster:
                found: U8 = raster.read(1)
    return found


def agree(classes: U8, truth: U8, where: Mask | None = None) -> Agreement:
    """Compare two labellings where both have one, and where `where` says."""
    some = (classes != NODATA) & (truth != NODATA)
    if where is not None:
        some &= where
    pairs = classes[some].astype(np.int64) * NODATA + truth[some]
    return agreement(np.bincount(pairs, minlength=NODATA * NODATA).reshape(NODATA, NODATA))
