"""Pixels and numbers as text that a page carries within it."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.errors import HrtError

_LEVELS = 65534


def webp(rgba: NDArray[np.uint8], quality: int) -> str:
    """Return an image, uint8 [rows, cols, 3 or 4], as the address of a WebP in the page itself."""
    return _address("webp", rgba, [cv2.IMWRITE_WEBP_QUALITY, quality])


def jpeg(rgb: NDArray[np.uint8], quality: int) -> str:
    """Return an image, uint8 [rows, cols, 3], as the address of a JPEG in the page itself."""
    return _address("jpeg", rgb, [cv2.IMWRITE_JPEG_QUALITY, quality])


def _address(kind: str, image: NDArray[np.uint8], parameters: list[int]) -> str:
    code = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    done, encoded = cv2.imencode(f".{kind}", cv2.cvtColor(image, code), parameters)
    if not done:
        raise HrtError(f"a picture of {image.shape[1]} x {image.shape[0]} pixels cannot be encoded as {kind}")
    return f"data:image/{kind};base64,{base64.b64encode(encoded.tobytes()).decode()}"


def packed(array: NDArray[Any]) -> str:
    """Return an array's bytes, little-endian, deflated (RFC 1950) and in base64."""
    plain = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<"), copy=False)
    return base64.b64encode(zlib.compress(plain.tobytes(), 9)).decode()


def levels(values: NDArray[np.floating[Any]], low: float, high: float) -> NDArray[np.uint16]:
    """Return values as whole numbers: 0 for NaN, 1 for `low` to 65535 for `high`."""
    span = high - low
    known = np.isfinite(values)
    share = np.clip((np.where(known, values, low).astype(np.float64) - low) / (span if span > 0 else 1.0), 0.0, 1.0)
    return np.where(known, 1 + np.rint(share * _LEVELS), 0).astype(np.uint16)
