"""How good the classes are on mosaics of textures: of Outex, and of photographs turned."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from skimage import data as photographs
from tables import DATA, Effort, Skipped, Table
from texture_classes import Mask, Picture, agree, segment
from texture_plain import fast_amplitudes, plain_classes

from hrt_cli.raster.classes import NODATA

BORDER_PX = 20
PLAIN_FIT_EVERY_PX = 4
TURNS_DEG = (0.0, 30.0, 60.0, 90.0)
PATCH_PX = 160
COMPOSITE_ROWS, COMPOSITE_COLS = 4, 3
GREY_MEAN, GREY_SD = 128.0, 35.0
PUBLISHED = (("K-means clustering", 0.646, 0.775), ("FSEG + merge", 0.820, 0.892), ("PCA-MS", 0.818, 0.892))
"""Adjusted Rand index and accuracy, means over all 100 mosaics, as published."""

U8 = NDArray[np.uint8]
Method = Callable[[Picture, int], U8]


def _hrt(features: str, rotation: str) -> Method:
    return lambda picture, classes: segment(picture, classes, features=features, rotation=rotation)


def _plain(picture: Picture, classes: int) -> U8:
    grey = picture.rgb[..., 0].astype(np.float32) / 255
    return plain_classes(fast_amplitudes(grey), classes, PLAIN_FIT_EVERY_PX)


TEXTURE: dict[str, Method] = {f"hrt texture, {one}": _hrt("texture", one) for one in ("aware", "invariant", "sorted")}
ON_MOSAICS: dict[str, Method] = {
    **TEXTURE,
    "hrt paper": _hrt("paper", "invariant"),
    "scikit-image + scikit-learn": _plain,
}


def _read(path: Path) -> U8:
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


def mosaics(count: int) -> list[tuple[U8, U8]]:
    """Return grey mosaics with their truth, classes 0 … 4."""
    folder = DATA / "outex"
    if not (folder / "gt.png").exists():
        raise Skipped("the Outex mosaics are absent (outex/ in ../shared/data)")
    _, truth = np.unique(_read(folder / "gt.png"), return_inverse=True)
    pictures = [_read(path) for path in sorted(folder.glob("[0-9]*.png"))[:count]]
    return [(one, truth.reshape(one.shape).astype(np.uint8)) for one in pictures]


def near_border(truth: U8) -> Mask:
    """Pixels less than `BORDER_PX` from another class."""
    same = np.ones(truth.shape, np.bool_)
    same[:-1] &= truth[:-1] == truth[1:]
    same[:, :-1] &= truth[:, :-1] == truth[:, 1:]
    near: Mask = distance_transform_edt(same) < BORDER_PX
    return near


def _score(
    methods: dict[str, Method], pictures: Iterable[tuple[Picture, U8]], borders: bool
) -> list[dict[str, object]]:
    """One row per method: means and the worst over the pictures."""
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in methods}
    for picture, truth in pictures:
        border = near_border(truth)
        for name, method in methods.items():
            classes = method(picture, len(np.unique(truth[truth != NODATA])))
            whole = agree(classes, truth)
            found[name].append((whole.ari, whole.accuracy, agree(classes, truth, border).ari if borders else 0.0))
    rows = []
    for name, figures in found.items():
        mean, worst = np.mean(figures, axis=0), np.min(figures, axis=0)
        row = {"method": name, "ARI": float(mean[0]), "worst ARI": float(worst[0]), "accuracy": float(mean[1]),
               "worst accuracy": float(worst[1])}  # fmt: skip
        rows.append({**row, "border ARI": float(mean[2])} if borders else row)
    return rows


def quality_outex(effort: Effort) -> list[Table]:
    """Outex mosaics of five textures, one setting for all of them, beside published figures."""
    pictures = mosaics(effort.mosaics)
    rows = _score(ON_MOSAICS, ((Picture.grey(grey), truth) for grey, truth in pictures), borders=True)
    for name, ari, accuracy in PUBLISHED:
        rows.append({**dict.fromkeys(rows[0]), "method": f"{name} (published)", "ARI": ari, "accuracy": accuracy})
    notes = [
        f"{len(pictures)} mosaics, K = 5, all else at its default; border: within {BORDER_PX} px of another texture.",
        "Published figures are means over all 100 mosaics of the set.",
    ]
    return [Table("Outex mosaics", rows, notes)]


def turned_mosaic(grey: U8, truth: U8) -> tuple[Picture, U8]:
    """One mosaic four times, turned by `TURNS_DEG`, as one picture; what a turn brings in from outside is no data."""
    parts: list[tuple[U8, U8, Mask]] = []
    for turn in TURNS_DEG:
        matrix = cv2.getRotationMatrix2D(((grey.shape[1] - 1) / 2, (grey.shape[0] - 1) / 2), turn, 1.0)
        size = grey.shape[::-1]
        inside = cv2.warpAffine(np.full(grey.shape, 255, np.uint8), matrix, size, flags=cv2.INTER_NEAREST) > 0
        labels = cv2.warpAffine(truth, matrix, size, flags=cv2.INTER_NEAREST)
        parts.append((cv2.warpAffine(grey, matrix, size, flags=cv2.INTER_CUBIC), labels, inside))
    whole, labels, inside = (
        np.concatenate([np.concatenate([parts[0][k], parts[1][k]], 1), np.concatenate([parts[2][k], parts[3][k]], 1)])
        for k in range(3)
    )
    return Picture.grey(whole, inside), np.where(inside, labels, np.uint8(NODATA))


def _levelled(photograph: U8) -> NDArray[np.float32]:
    """The photograph at the same mean and contrast as the others: what is left to tell them apart is texture."""
    values = photograph.astype(np.float32)
    return (values - values.mean()) / values.std() * GREY_SD + GREY_MEAN


def composite(seed: int) -> tuple[Picture, U8]:
    """Patches of brick, grass and gravel at random places, each class at a turn of its own in every row."""
    rng = np.random.default_rng(seed)
    sources = [_levelled(one()) for one in (photographs.brick, photographs.grass, photographs.gravel)]
    grey = np.empty((COMPOSITE_ROWS * PATCH_PX, COMPOSITE_COLS * PATCH_PX), np.uint8)
    truth = np.empty(grey.shape, np.uint8)
    # The patch's half diagonal, so that a turned patch stays inside the photograph.
    reach = PATCH_PX / np.sqrt(2) + 1
    turns = np.array([rng.permutation(COMPOSITE_ROWS) * 180 / COMPOSITE_ROWS for _ in sources])
    for row in range(COMPOSITE_ROWS):
        for col, source in enumerate(rng.permutation(len(sources))):
            picture = sources[source]
            x, y = rng.uniform(reach, len(picture) - 1 - reach, 2)
            matrix = cv2.getRotationMatrix2D((x, y), turns[source, row] + rng.uniform(0, 45), 1.0)
            matrix[:, 2] += (PATCH_PX - 1) / 2 - np.array([x, y])
            patch = cv2.warpAffine(picture, matrix, (PATCH_PX, PATCH_PX), flags=cv2.INTER_CUBIC)
            place = (slice(row * PATCH_PX, (row + 1) * PATCH_PX), slice(col * PATCH_PX, (col + 1) * PATCH_PX))
            grey[place], truth[place] = np.clip(np.rint(patch), 0, 255).astype(np.uint8), source
    return Picture.grey(grey), truth


def quality_rotated(effort: Effort) -> list[Table]:
    """Each class at several turns: only features that turns leave alone find it whole."""
    notes = [
        f"{effort.composites} composites of {COMPOSITE_ROWS * COMPOSITE_COLS} patches of {PATCH_PX} px, each class at "
        f"{COMPOSITE_ROWS} turns; contrast made equal.",
    ]
    rows = _score(TEXTURE, (composite(seed) for seed in range(effort.composites)), borders=False)
    tables = [Table("Photographs turned (scikit-image's brick, grass, gravel)", rows, notes)]
    try:
        pictures = mosaics(effort.mosaics)
    except Skipped as reason:
        return [Table(tables[0].title, rows, [*notes, f"Outex mosaics turned left out: {reason}."])]
    turned = _score(TEXTURE, (turned_mosaic(*one) for one in pictures), borders=False)
    angles = ", ".join(f"{one:g}" for one in TURNS_DEG)
    notes = [f"{len(pictures)} mosaics, each in one picture with itself turned by {angles} degrees, K = 5."]
    return [*tables, Table("Outex mosaics turned", turned, notes)]
