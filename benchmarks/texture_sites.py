"""How good the classes are on sites: real ones with polygons drawn by hand, and synthetic ones with their truth."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans
from tables import DATA, ROOT, Effort, Skipped, Table
from texture_classes import Picture, agree, segment

from hrt_cli.raster.classes import NODATA
from hrt_cli.world.scenes import SCENES
from hrt_cli.world.synth import Site as SyntheticSite
from hrt_cli.world.synth import SiteSpec, make_site

sys.path.append(str(ROOT / "tests" / "texture"))
from sites import FOLDERS, SITES, Site, baseline, cell_colours, read_site, recalls, smoothed, spread

SITE_CLASSES = (5, 6, 8)
PROGRAMS = ("hrt segment", "Lab + contrast")
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
    names = [name for name in SITES if (DATA / name).exists()][: effort.sites]
    if not names:
        raise Skipped("the real sites are absent (../shared/data)")
    rows = []
    for name in names:
        rows.extend(_site_rows(name.rsplit(".", 1)[0], read_site(DATA, name), DATA / name))
    for classes in SITE_CLASSES:
        ours, plain = (float(np.mean([row[key] for row in rows if row["K"] == classes])) for key in PROGRAMS)
        rows.append(_site_row("mean", classes, ours, plain))
    if len(names) == len(SITES):
        for folder in FOLDERS:
            together = read_site(DATA, folder)
            picture = Picture(together.rgb, together.valid)
            rows.extend(_site_rows(f"{folder}, its tiles as one", together, picture))
    notes = [
        "Mean recall of the labels drawn. Lab + contrast: mean colour and contrast in a window, standardised, K-means.",
        "Tiles as one: pictures of different places, each with light of its own, side by side.",
    ]
    return [Table("Real sites, polygons drawn by hand", rows, notes)]


def _site_rows(shown: str, site: Site, picture: Picture | Path) -> list[dict[str, object]]:
    rows = []
    for classes in SITE_CLASSES:
        found = segment(picture, classes), baseline(site.rgb, site.valid, classes)
        rows.append(_site_row(shown, classes, *(float(recalls(one, site.truth)[0].mean()) for one in found)))
    return rows


def _site_row(shown: str, classes: int, ours: float, plain: float) -> dict[str, object]:
    better = PROGRAMS[0] if ours > plain else PROGRAMS[1] if plain > ours else "equal"
    return {"site": shown, "K": classes, PROGRAMS[0]: ours, PROGRAMS[1]: plain, "better": better}


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


def _accuracies(site: SyntheticSite) -> dict[str, float]:
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
