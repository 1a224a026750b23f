"""How good the classes are on sites: real ones with polygons drawn by hand, and synthetic ones with their truth."""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from tables import DATA, ROOT, Effort, Skipped, Table
from texture_classes import Picture, agree, segment

from hrt_cli.raster.classes import NODATA
from hrt_cli.world.scenes import SCENES
from hrt_cli.world.synth import Site, SiteSpec, make_site

sys.path.append(str(ROOT / "tests" / "texture"))
from sites import POLYGONS, baseline, cell_colours, read_site, recalls, smoothed, spread

SITE_CLASSES = (5, 6, 8)
PIXEL_M = 0.05
HUE_CELL_PX = 8
HUE_SIGMA_CELLS = 1.0
HUE_BINS = 12
GREY_CHROMA = 4.0
"""Chroma (Lab) below which a window counts as grey rather than as of a hue."""
STARTS = 10

U8 = NDArray[np.uint8]


def quality_sites(effort: Effort) -> list[Table]:
    """Mean recall of the labels of the polygons, each class voting for one label."""
    names = [name for name in POLYGONS if (DATA / name).exists()][: effort.sites]
    if not names:
        raise Skipped("the real sites are absent (../shared/data)")
    found: dict[tuple[str, int], tuple[float, float]] = {}
    for name in names:
        site = read_site(DATA, name)
        picture = Picture(site.rgb, site.valid) if (DATA / name).is_dir() else DATA / name
        for classes in SITE_CLASSES:
            ours = segment(picture, classes)
            plain = baseline(site.rgb, site.valid, classes)
            found[name, classes] = tuple(float(recalls(one, site.truth)[0].mean()) for one in (ours, plain))
    for classes in SITE_CLASSES:
        mean = np.mean([found[name, classes] for name in names], axis=0)
        found["mean", classes] = (float(mean[0]), float(mean[1]))
    rows = [
        {"site": name.rsplit(".", 1)[0], "K": classes, "hrt segment": ours, "Lab + contrast": plain,
         "better": "hrt" if ours > plain else "Lab + contrast" if plain > ours else "equal"}
        for (name, classes), (ours, plain) in found.items()
    ]  # fmt: skip
    notes = [
        "Mean recall of the labels drawn. Lab + contrast: mean colour and contrast in a window, standardised, K-means.",
    ]
    return [Table("Real sites, polygons drawn by hand", rows, notes)]


def hue_classes(picture: Picture, classes: int) -> U8:
    """Chroma-weighted hue histograms of cells, square-rooted, and K-means: colour alone, as the paper has it."""
    (_, a, b), share = cell_colours(picture.rgb, picture.valid, HUE_CELL_PX)
    bins = np.floor((np.arctan2(b, a) / (2 * np.pi) + 0.5) * HUE_BINS).astype(int) % HUE_BINS
    votes = smoothed([np.hypot(a, b) * (bins == one) for one in range(HUE_BINS)], share, HUE_SIGMA_CELLS)
    values = np.sqrt(votes / (votes.sum(axis=0) + GREY_CHROMA))
    usable = share >= 0.5
    cells = np.full(usable.shape, NODATA, np.uint8)
    cells[usable] = KMeans(classes, n_init=STARTS, random_state=0).fit_predict(values[:, usable].T)
    return spread(cells, picture.valid.shape, HUE_CELL_PX)


def _accuracies(site: Site) -> dict[str, float]:
    picture = Picture(site.rgb, site.valid)
    classes = len(np.unique(site.truth[site.valid]))
    found = {
        "site": segment(picture, classes),
        "texture alone": segment(picture, classes, features="texture"),
        "hue alone": hue_classes(picture, classes),
        "paper": segment(picture, classes, features="paper"),
    }
    return {name: agree(one, site.truth).accuracy for name, one in found.items()}


def quality_synth(effort: Effort) -> list[Table]:
    """Matched accuracy on synthetic sites, pixel by pixel."""
    metres = effort.site_px * PIXEL_M
    rows = []
    for scene in SCENES:
        specs = [SiteSpec(scene, (metres, metres), PIXEL_M, seed) for seed in range(effort.seeds)]
        figures = [_accuracies(make_site(spec)) for spec in specs]
        for name in figures[0]:
            values = [one[name] for one in figures]
            rows.append({"scene": scene, "features": name, "accuracy": float(np.mean(values)), "worst": min(values)})
    notes = [
        f"Matched accuracy, {effort.seeds} seeds, {metres:g} m at {PIXEL_M:g} m, K = the number of true classes.",
        "Hue alone: chroma-weighted hue histograms and K-means. Paper: Gabor order statistics and hue.",
    ]
    return [Table("Synthetic sites", rows, notes)]
