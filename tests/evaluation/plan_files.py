"""Scoremaps to value plans on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from affine import Affine
from rasterio.crs import CRS

from hrt_cli.artifacts.provenance import record
from hrt_cli.raster.grid import Grid
from hrt_cli.raster.scoremap import Scoremap, publish_scoremap

UTM33 = CRS.from_epsg(32633)
PLACE = Affine(1, 0, 400_000, 0, -1, 5_000_000)


def scores() -> np.ndarray:
    score = np.random.default_rng(4).random((20, 24)).astype(np.float32)
    score[5:9, 12] = np.nan
    return score


def put(path: Path, score: np.ndarray, transform: Affine = PLACE, crs: CRS = UTM33) -> Path:
    grid = Grid(*score.shape, transform, crs)
    sd = np.where(np.isnan(score), np.nan, 0).astype(np.float32)
    publish_scoremap(path, Scoremap(score, sd, grid, 1.0), record("test", 1, {}, {}), tags={}, creation={})
    return path
