"""What kind of artifact a file is, by what it holds; its name says little."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hrt_cli.artifacts.jsonio import parse_strict, read_text
from hrt_cli.artifacts.npz import read_npz
from hrt_cli.errors import InputError
from hrt_cli.logs.kinds import is_log

if TYPE_CHECKING:
    from hrt_cli.raster.gate import Raster

Kind = Literal[
    "classes",
    "scoremap",
    "scores",
    "plan",
    "team plan",
    "texture model",
    "policy",
    "steering model",
    "drive log",
    "figures",
]
TITLES: dict[Kind, str] = {
    "classes": "a class raster",
    "scoremap": "a scoremap",
    "scores": "a score table",
    "plan": "a plan",
    "team plan": "the plan of a team",
    "texture model": "a texture model",
    "policy": "a policy",
    "steering model": "a steering model",
    "drive log": "a drive log",
    "figures": "figures in JSON",
}

_HEAD = 4096
_ARCHIVES = (b"PK\x03\x04", b"PK\x05\x06")
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_MISSION = "compare the plans that missions are made from"
_WHAT = "class rasters, scoremaps, score tables, plans, models, drive logs and JSON are compared"


def kind_of(path: Path) -> Kind:
    """Tell what kind of artifact a file, or the folder of a ROS 2 bag, is.

    Raises
    ------
    InputError
        It is of no kind that is compared, or is damaged.
    """
    if path.is_dir() and not is_log(path):
        raise InputError(path, "is a folder; compare the files in it one by one")
    if path.is_dir():
        return "drive log"
    head = _head(path)
    if head.startswith(_ARCHIVES):
        return _of_arrays(path)
    text = head.decode("utf-8-sig", "replace").lstrip()
    if text.startswith("{") or text.startswith("["):
        return _of_json(path, text)
    if head[8:9] == b"{":
        return "steering model"
    if text.startswith("QGC WPL"):
        raise InputError(path, "is a mission", _MISSION)
    if "<kml" in text:
        raise InputError(path, "is KML: a mission or an area", _MISSION)
    if "<gpx" in text and "<rte" in text and "<trk" not in text:
        raise InputError(path, "is a route in GPX: a mission", _MISSION)
    if path.suffix.lower() == ".onnx":
        raise InputError(path, "is an exported model", "compare the .safetensors that it was exported from")
    if is_log(path):
        return "drive log"
    from hrt_cli.raster.gate import open_raster  # rasterio is for rasters only: it takes long to import

    try:
        with open_raster(path, unreferenced=True) as raster:
            return _of_raster(raster)
    except InputError as error:
        if head.startswith(_TIFF):
            raise
        raise InputError(path, "is nothing that can be compared", _WHAT) from error


def _head(path: Path) -> bytes:
    if not path.is_file():
        raise InputError(path, "no such file")
    try:
        with open(path, "rb") as file:
            return file.read(_HEAD)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error


def _of_raster(raster: Raster) -> Kind:
    from hrt_cli.raster.recognise import quantity

    real = raster.dtypes[0].startswith("float")
    if not real and raster.count == 1:
        return "classes"
    if real and raster.count <= 2:
        told = quantity(raster, 1)
        if told is None:
            return "scoremap"
        raise InputError(raster.path, f"looks like a {told[0]}: {told[1]}", _WHAT)
    raise InputError(raster.path, f"is a raster of {raster.count} bands", _WHAT)


def _of_arrays(path: Path) -> Kind:
    names = set(read_npz(path))
    if "score" in names:
        return "scoremap"
    if {"weights", "layout"} <= names:
        return "policy"
    if {"centroids", "transform"} <= names:
        return "texture model"
    raise InputError(path, "is no scoremap, policy or texture model", _WHAT)


def _of_json(path: Path, text: str) -> Kind:
    try:
        first = json.loads(text.splitlines()[0])
    except ValueError:
        first = None
    if isinstance(first, dict) and first.get("format") == "hrt-drive-log":
        return "drive log"
    document = parse_strict(path, read_text(path))
    if not isinstance(document, dict):
        raise InputError(path, "is a list in JSON", "objects are compared")
    return _of_object(path, document)


def _of_object(path: Path, document: dict[str, Any]) -> Kind:
    name = document.get("format")
    if name == "hrt-team-plan":
        return "team plan"
    if name == "hrt-plan" or {"cells", "waypoints", "grid"} <= document.keys():
        return "plan"
    if name == "hrt-scores" or (
        "scores" in document and document.keys() <= {"scores", "version", "logs", "provenance"}
    ):
        return "scores"
    if document.get("fileType") == "Plan":
        raise InputError(path, "is a mission", _MISSION)
    if document.get("type") in ("FeatureCollection", "Feature"):
        raise InputError(path, "is GeoJSON: a mission or an area", _MISSION)
    return "figures"
