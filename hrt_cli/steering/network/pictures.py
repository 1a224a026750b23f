"""Pictures as the network sees them: cropped, scaled, and with red, green and blue about zero.

`docs/method.md` says the same in words, for who runs an exported network elsewhere.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hrt_cli.steering.network.net import SteeringConfig


def fitted(rgb: NDArray[np.uint8], config: SteeringConfig) -> NDArray[np.uint8]:
    """Return a picture cropped and scaled to what a network sees, uint8 [height, width, 3].

    Parameters
    ----------
    rgb : uint8 [rows, cols, 3]
    """
    below = rgb[round(config.crop_top * rgb.shape[0]) :]
    if below.shape[:2] == (config.height, config.width):
        return np.ascontiguousarray(below)
    shrinks = config.height < below.shape[0] or config.width < below.shape[1]
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(below, (config.width, config.height), interpolation=how), np.uint8)


def prepare(pictures: NDArray[np.uint8], config: SteeringConfig) -> NDArray[np.float32]:
    """Return fitted pictures as the network takes them, float32 [n, 3, height, width].

    Parameters
    ----------
    pictures : uint8 [n, height, width, 3]
    """
    mean, std = np.array(config.mean, np.float32), np.array(config.std, np.float32)
    scaled = pictures * (1.0 / (255.0 * std)) - mean / std
    return np.asarray(scaled.transpose(0, 3, 1, 2), np.float32)
