"""What a survey of a site adds to it: the covered area, the area of interest, a place to start."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from hrt_cli.world.layout import Frame, Mask
from hrt_cli.world.noise import FloatArray, derive_seed, fbm, worley

Polygon = tuple[tuple[float, float], ...]
"""Convex polygon of (row, col) corners, not closed; (0, 0) is the upper left corner of the upper left pixel."""

_COVER_POWER = 14.0
"""Exponent of the superellipse that rounds the covered area's corners."""

_AOI_POWER, _AOI_CORNERS = 5.0, 16
_START_CLEARANCE_M = 1.0


def _superellipse(frame: Frame, power: float) -> FloatArray:
    """Give each pixel's superelliptic radius: 1 at the middle of every side of the picture."""
    v = np.abs(2.0 * (np.arange(frame.rows) + 0.5) / frame.rows - 1.0) ** power
    u = np.abs(2.0 * (np.arange(frame.cols) + 0.5) / frame.cols - 1.0) ** power
    return np.asarray((v[:, None] + u[None, :]) ** (1.0 / power))


def valid_area(frame: Frame, seed: int) -> Mask:
    """Draw the covered area: the rectangle less its corners, with the stepped rim of overlapping photographs.

    Returns
    -------
    bool array, [rows, cols]
        About 97 % true.
    """
    photo = 4.0 * frame.scale
    steps = worley(frame.y_m, frame.x_m, photo, derive_seed(seed, "photos")).key - 0.5
    fray = fbm(frame.y_m, frame.x_m, 0.4 * photo, derive_seed(seed, "rim"), octaves=3)
    covered = _superellipse(frame, _COVER_POWER) < 1.0 + 0.045 * steps + 0.004 * fray
    pieces, _ = ndimage.label(covered)
    return np.asarray(ndimage.binary_fill_holes(pieces == pieces[frame.rows // 2, frame.cols // 2]))


def inside(frame: Frame, polygon: Polygon) -> Mask:
    """Mark the pixels whose centre lies in a convex polygon given clockwise in the picture."""
    rows = (np.arange(frame.rows) + 0.5)[:, None]
    cols = (np.arange(frame.cols) + 0.5)[None, :]
    mask = np.ones((frame.rows, frame.cols), bool)
    for (r0, c0), (r1, c1) in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        mask &= (c1 - c0) * (rows - r0) - (r1 - r0) * (cols - c0) >= 0.0
    return mask


def outline(frame: Frame, valid: Mask) -> Polygon:
    """Draw the area of interest: the largest rounded rectangle of a fixed family that lies in the valid area."""
    turns = 2.0 * np.pi * (np.arange(_AOI_CORNERS) + 0.5) / _AOI_CORNERS
    radius = (np.abs(np.sin(turns)) ** _AOI_POWER + np.abs(np.cos(turns)) ** _AOI_POWER) ** (-1.0 / _AOI_POWER)
    for size in np.arange(0.97, 0.5, -0.01):
        rows = 0.5 * frame.rows * (1.0 + size * radius * np.sin(turns))
        cols = 0.5 * frame.cols * (1.0 + size * radius * np.cos(turns))
        polygon = tuple((round(float(r), 2), round(float(c), 2)) for r, c in zip(rows, cols, strict=True))
        if valid[inside(frame, polygon)].all():
            break
    return polygon


def start_cell(frame: Frame, start_class: Mask, passable: Mask, aoi: Polygon) -> tuple[int, int]:
    """Choose where the robot is put down: near the rim of the area of interest, as a crew on foot would.

    The cell lies on the start class, a metre (as far as the site's size allows) from its edge, and in the largest
    connected piece of passable ground, so that the robot can get somewhere from there.
    """
    pieces, _ = ndimage.label(passable)
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    region = start_class & inside(frame, aoi)
    main = region & (pieces == int(np.argmax(sizes)))
    if main.any():
        region = main
    clearance = ndimage.distance_transform_edt(np.pad(region, 1))[1:-1, 1:-1] * frame.pixel_m
    wanted = min(_START_CLEARANCE_M, 0.8 * float(clearance.max()))
    outwards = np.where(clearance >= wanted, _superellipse(frame, _AOI_POWER), -1.0)
    row, col = np.unravel_index(int(np.argmax(outwards)), outwards.shape)
    return int(row), int(col)
