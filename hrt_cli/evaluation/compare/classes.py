"""Two class rasters, pixel by pixel, by the ids as they are: scores belong to ids."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.evaluation.compare.grids import common_windows, compare_grids
from hrt_cli.evaluation.compare.result import Figure, Found, alike, apart, text
from hrt_cli.evaluation.segment import agreement
from hrt_cli.progress import Progress
from hrt_cli.raster.classes import NODATA, ClassRaster, open_classes
from hrt_cli.raster.gate import is_plain
from hrt_cli.raster.windows import Window, blocks

BLOCK_PX = 2048


def compare_classes(path_a: Path, path_b: Path, progress: Progress, block_px: int = BLOCK_PX) -> Found:
    """Compare two class rasters; what is in memory does not grow with them.

    `changed` is the share of the pixels with a class in either whose id differs, a class that only one has among
    them; `iou` the least intersection over union of an id; `ari` the adjusted Rand index of the areas, whatever their
    ids; `names` the number of ids whose name differs.

    Raises
    ------
    InputError
        A raster cannot be used.
    """
    with ExitStack() as stack:
        a, b = (stack.enter_context(open_classes(path, unreferenced=is_plain(path))) for path in (path_a, path_b))
        figures = compare_grids(path_a, a.grid, path_b, b.grid)
        common = common_windows(a.grid, b.grid)
        table = _table(a, b, *common, block_px, progress) if common else None
        names = [(k, _name(a, k), _name(b, k)) for k in range(NODATA)]
        colours = [_palette(each, NODATA) for each in (a, b)]
    renamed = [(k, old, new) for k, old, new in names if old != new]
    figures += [
        apart("names", float(len(renamed))),
        text("palette", None, None, same=colours[0] == colours[1], counts=False),
    ]
    lines = [f"class {k} is called {old!r} in A and {new!r} in B" for k, old, new in renamed]
    detail: dict[str, Any] = {"renamed": [{"id": k, "a": old, "b": new} for k, old, new in renamed]}
    if table is None:
        return Found(figures, [*lines, "pixels are not compared: they do not lie on one another"], detail)
    shown = {k: old or new for k, old, new in names}
    areas = _compare_areas(table, shown)
    return Found([*areas.figures, *figures], [*areas.lines, *lines], {**areas.detail, **detail})


def _name(classes: ClassRaster, number: int) -> str:
    return classes.names[number] if number < len(classes.names) else ""


def _palette(classes: ClassRaster, count: int) -> list[list[int]] | None:
    palette = classes.raster.palette
    return None if palette is None else palette[:count].tolist()


def _table(
    a: ClassRaster, b: ClassRaster, in_a: Window, in_b: Window, block_px: int, progress: Progress
) -> NDArray[np.int64]:
    """Return how many pixels are of each id in A (row) and B (column), int64 [256, 256]; 255 is no class."""
    table = np.zeros((NODATA + 1, NODATA + 1), np.int64)
    parts = list(blocks((in_a.height, in_a.width), block_px))
    for done, part in enumerate(parts):
        progress(done, len(parts))
        ids_a, ids_b = (
            each.read(Window(there.row + part.row, there.col + part.col, part.height, part.width))
            for each, there in ((a, in_a), (b, in_b))
        )
        pair = ids_a.astype(np.int64) * (NODATA + 1) + ids_b
        table += np.bincount(pair.ravel(), minlength=table.size).reshape(table.shape)
    progress(len(parts), len(parts))
    return table


def _compare_areas(table: NDArray[np.int64], names: dict[int, str]) -> Found:
    of_a, of_b, common = table.sum(axis=1)[:NODATA], table.sum(axis=0)[:NODATA], np.diag(table)[:NODATA]
    pixels = int(table.sum() - table[NODATA, NODATA])
    changed = (pixels - int(common.sum())) / pixels if pixels else 0.0
    ids = np.flatnonzero(of_a + of_b)
    share = common[ids] / (of_a + of_b - common)[ids]
    both = table[:NODATA, :NODATA]
    areas = agreement(both) if both.any() else None
    renumbered = areas is not None and changed > 0 and _one_to_one(areas.confusion) and int(both.sum()) == pixels
    # Sums of large squares, added up in another order, need not agree to the last bit.
    ari = 1.0 if areas is None and not pixels else 0.0 if areas is None else areas.ari
    if areas is not None and _one_to_one(areas.confusion):
        ari = 1.0
    per_class: list[dict[str, Any]] = [
        {
            "id": k,
            "name": names[k],
            "pixels_a": int(of_a[k]),
            "pixels_b": int(of_b[k]),
            "common": int(common[k]),
            "iou": float(part),
        }
        for k, part in zip(ids.tolist(), share, strict=True)
    ]
    figures: list[Figure] = [
        apart("changed", changed, family="pixels"),
        alike("iou", float(share.min(initial=1.0)), family="pixels"),
        alike("ari", ari, family="pixels", speaks=False),
    ]
    matching = {} if areas is None else areas.matching
    lines = [
        f"{_called(each['id'], each['name'])}: {each['pixels_a']} pixels in A, {each['pixels_b']} in B, "
        f"{each['common']} in both, IoU {each['iou']:.6g}"
        for each in per_class
        if each["iou"] < 1
    ]
    if renumbered:
        told = ", ".join(f"{old} -> {new}" for old, new in sorted(matching.items()) if old != new)
        lines.append(f"renumbered: the same areas bear other ids: {told}")
    elif areas is not None and changed > 0:
        lines.append(f"under the best one-to-one matching of ids {areas.accuracy:.6g} of the pixels agree")
    detail = {
        "pixels": pixels,
        "per_class": per_class,
        "renumbered": renumbered,
        "matching": {str(old): new for old, new in sorted(matching.items())},
        "matched_accuracy": None if areas is None else areas.accuracy,
    }
    return Found(figures, lines, detail)


def _called(number: int, name: str) -> str:
    plain = f"class {number}"
    return plain if name in ("", plain) else f"{plain} ({name})"


def _one_to_one(confusion: NDArray[np.int64]) -> bool:
    some = confusion > 0
    return bool((some.sum(axis=0) == 1).all() and (some.sum(axis=1) == 1).all())
