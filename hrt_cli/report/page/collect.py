"""What a folder holds: every file told by its content, with the provenance that it carries."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from hrt_cli.artifacts.jsonio import parse_strict, read_text
from hrt_cli.artifacts.plan import team_members
from hrt_cli.artifacts.png import png_provenance
from hrt_cli.artifacts.provenance import Provenance, file_sha256
from hrt_cli.errors import HrtError, InputError
from hrt_cli.evaluation.verify import carries_provenance, read_provenance
from hrt_cli.raster.gate import open_raster
from hrt_cli.raster.recognise import take_sample, what_it_is

Kind = Literal[
    "orthomosaic",
    "surface model",
    "terrain model",
    "thermal orthomosaic",
    "index map",
    "measured values",
    "class raster",
    "scoremap",
    "area",
    "plan",
    "team plan",
    "drive log",
    "recording",
    "score table",
    "world",
    "texture model",
    "policy",
    "steering model",
    "training history",
    "evaluation",
    "figure",
    "mission",
    "unknown",
]

MOST_FILES = 5000
_RASTERS = {".tif", ".tiff", ".vrt"}
_MISSIONS = {".plan", ".waypoints", ".bhv"}
_LOGS = {".csv", ".gpx", ".bin", ".bag", ".mcap"}
_BESIDE = {
    ".qml",
    ".xml",
    ".ovr",
    ".msk",
    ".tfw",
    ".prj",
    ".md",
    ".rst",
    ".txt",
    ".yaml",
    ".mk",
    ".smk",
    ".log",
    ".pgm",
}
_PAGES = {".html", ".htm"}
_FORMATS: dict[str, Kind] = {
    "hrt-plan": "plan",
    "hrt-team-plan": "team plan",
    "hrt-scores": "score table",
    "hrt-world": "world",
}
_EVALUATIONS = (
    {"plans", "baselines", "upper_bound"},
    {"mae", "nll", "reliability"},
    {"ari", "nmi", "confusion"},
    {"distance_m", "collisions", "duration_s"},
)
"""Keys of what the kinds of `hrt evaluate --json` print."""


@dataclass
class Item:
    """A file of a folder.

    Attributes
    ----------
    path : Path
    name : str
        Below the folder that was given, with `/`.
    kind : str
    provenance : Provenance or None
    problem : str
        Why it is not shown, or cannot be trusted; empty where there is nothing to say.
    """

    path: Path
    name: str
    kind: Kind = "unknown"
    provenance: Provenance | None = None
    problem: str = ""
    document: dict[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def size(self) -> int:
        """Bytes of it."""
        return self.path.stat().st_size

    @cached_property
    def sha256(self) -> str:
        """Hash of its bytes."""
        return file_sha256(self.path)


class Folder:
    """The items found, and who made what of which: what was made of others comes after them, else by name."""

    def __init__(self, items: Sequence[Item], notes: Sequence[str]) -> None:
        self.items, self.notes = list(items), list(notes)
        made_of = {item.sha256: item.provenance for item in items}
        depths: dict[str, int] = {}

        def depth(sha256: str) -> int:
            if sha256 not in depths:
                depths[sha256] = 0  # against a circle, which only forged records can have
                made = made_of.get(sha256)
                depths[sha256] = 1 + max((depth(r.sha256) for r in made.inputs), default=0) if made else 0
            return depths[sha256]

        self.items.sort(key=lambda item: (depth(item.sha256), natural(item.name)))

    def of(self, *kinds: Kind) -> list[Item]:
        """Return the usable items of some kinds, in that order."""
        return [item for item in self.items if item.kind in kinds and not item.problem]

    def plans(self) -> list[Item]:
        """Return the plans, of one robot or a team; those of a team's robots are in the team's."""
        robots = {path for item in self.of("team plan") for path in team_members(item.path)}
        return [item for item in self.of("plan", "team plan") if item.path not in robots]

    def input_of(self, item: Item, *roles: str) -> Item | None:
        """Return the item that another was made from in one of these roles: the same bytes, whatever its name is now.

        Only such a file: one of the same name that has changed since is another.
        """
        if item.provenance is None:
            return None
        wanted = {(r.sha256, r.size) for r in item.provenance.inputs if r.role in roles}
        sizes = {size for _, size in wanted}
        return next(
            (other for other in self.items if other.size in sizes and (other.sha256, other.size) in wanted), None
        )


def collect(paths: Sequence[Path]) -> Folder:
    """Look through files and folders, their hidden folders and links apart.

    Raises
    ------
    InputError
        A path does not exist, or there are more than `MOST_FILES` files.
    """
    named: dict[Path, str] = {}
    for path in paths:
        if not path.exists():
            raise InputError(path, "no such file or folder")
        found = [path] if path.is_file() else list(_walk(path))
        for each in found:
            prefix = "" if len(paths) == 1 or path.is_file() else f"{path.resolve().name}/"
            named.setdefault(each, prefix + (each.name if path.is_file() else each.relative_to(path).as_posix()))
        if len(named) > MOST_FILES:
            raise InputError(path, f"holds more than the {MOST_FILES} files that are looked at", "name a folder in it")
    distinct = _distinct(named)
    items = [_told(path, name) for path, name in sorted(distinct.items(), key=lambda pair: natural(pair[1]))]
    unknown = [item.name for item in items if item.kind == "unknown" and not item.problem]
    notes = [f"{len(unknown)} files of other kinds are not shown: {_some(unknown)}"] if unknown else []
    return Folder([item for item in items if item.name not in unknown], notes)


def _distinct(named: dict[Path, str]) -> dict[Path, str]:
    """Return names of which no two are the same: those that are get the folders before them, as many as it takes."""
    names, depth = dict(named), 1
    while twice := {name for name, count in Counter(names.values()).items() if count > 1}:
        depth += 1
        for path, name in names.items():
            if name in twice:
                above = path.resolve().parts[: -len(Path(named[path]).parts)]
                names[path] = Path(*above[1:][-(depth - 1) :], named[path]).as_posix()
    return names


def _walk(folder: Path) -> Iterator[Path]:
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError as error:
        raise InputError(folder, f"cannot be read: {error.strerror}") from error
    names = {entry.name for entry in entries}
    if {"labels.csv", "recording.json"} <= names:
        yield folder / "recording.json"
        return
    for entry in entries:
        if entry.name.startswith(".") or entry.is_symlink():
            continue
        if entry.is_dir():
            yield from _walk(Path(entry.path))
        elif entry.is_file() and _shown(entry.name):
            yield Path(entry.path)


def _shown(name: str) -> bool:
    suffix = os.path.splitext(name)[1].lower()
    return bool(suffix) and suffix not in _BESIDE | _PAGES


def natural(name: str) -> list[tuple[int, int, str]]:
    """Sort leg-10 after leg-9."""
    parts: list[tuple[int, int, str]] = []
    digits = ""
    for letter in [*name, ""]:
        if letter.isdigit():
            digits += letter
            continue
        if digits:
            parts.append((0, int(digits), digits))
            digits = ""
        parts.append((1, 0, letter))
    return parts


def _told(path: Path, name: str) -> Item:
    item = Item(path, name)
    try:
        item.kind = _kind(item)
        if item.kind == "figure":
            item.provenance = png_provenance(path)
        elif carries_provenance(path):
            item.provenance = read_provenance(path)
    except HrtError as error:
        item.problem = str(error).removeprefix(f"{path}: ")
    return item


def _kind(item: Item) -> Kind:
    suffix = item.path.suffix.lower()
    if suffix in _RASTERS:
        return _raster_kind(item.path)
    if suffix in (".json", ".geojson"):
        return _json_kind(item, suffix)
    if suffix == ".jsonl":
        return _lines_kind(item)
    if suffix == ".npz":
        return _npz_kind(item.path)
    if suffix in _LOGS:
        return _log_kind(item.path)
    kinds: dict[str, Kind] = {".safetensors": "steering model", ".kml": "area", ".kmz": "area", ".png": "figure"}
    kinds |= dict.fromkeys(_MISSIONS, "mission")
    kind = kinds.get(suffix, "unknown")
    if kind == "area":
        return kind if _is_area(item.path) else "mission"
    return kind


def _raster_kind(path: Path) -> Kind:
    with open_raster(path, unreferenced=True) as raster:
        found: Any = what_it_is(raster, take_sample(raster)).name
    kind: Kind = found
    return kind


def _json_kind(item: Item, suffix: str) -> Kind:
    document = parse_strict(item.path, read_text(item.path))
    if not isinstance(document, dict):
        return "unknown"
    if suffix == ".geojson" or document.get("type") == "FeatureCollection":
        return "area" if _is_area(item.path) else "mission"
    if document.get("format") == "hrt-recording":
        item.document = document
        return "recording"
    if kind := _FORMATS.get(str(document.get("format"))):
        return kind
    if isinstance(document.get("scores"), dict) and "format" not in document:
        return "score table"
    if any(keys <= set(document) for keys in _EVALUATIONS):
        item.document = document
        return "evaluation"
    return "unknown"


def _lines_kind(item: Item) -> Kind:
    lines = read_text(item.path, 2**28).splitlines()
    first = parse_strict(item.path, lines[0]) if lines else None
    if isinstance(first, dict) and {"epoch", "train_loss"} <= set(first):
        item.document = {"epochs": [parse_strict(item.path, line) for line in lines]}
        return "training history"
    return "drive log"


def _npz_kind(path: Path) -> Kind:
    from hrt_cli.artifacts.npz import read_npz

    names = set(read_npz(path))
    if "score" in names:
        return "scoremap"
    return "policy" if "learning_curve" in names else "texture model" if "centroids" in names else "unknown"


def _log_kind(path: Path) -> Kind:
    """Tell a robot's log from a mission of the same format, which has no times."""
    from hrt_cli.logs.read import read_drive_log

    try:
        read_drive_log(path)
    except HrtError:
        return "mission" if path.suffix.lower() in (".csv", ".gpx") else "unknown"
    return "drive log"


def _is_area(path: Path) -> bool:
    from hrt_cli.raster.aoi import read_aoi

    try:
        read_aoi(path)
    except HrtError:
        return False
    return True


def _some(names: list[str]) -> str:
    return ", ".join(names[:6]) + (" ..." if len(names) > 6 else "")
