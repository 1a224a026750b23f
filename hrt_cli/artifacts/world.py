"""The world artifact (`world.json`): what only a simulator may know of a site, the true drivability of each class."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, field_validator

from hrt_cli.artifacts.jsonio import Document, read_model
from hrt_cli.artifacts.provenance import Provenance

MAX_CLASS = 254


class TrueClass(Document):
    """One class: how well a ground vehicle drives there, in [0, 1], and whether it collides with it."""

    name: str = Field(default="", max_length=200)
    drivability: float = Field(ge=0, le=1)
    obstacle: bool = False


class Start(Document):
    """Where a robot can be put down: in the site's CRS, and as WGS 84 degrees."""

    xy: tuple[float, float]
    lonlat: tuple[float, float]


class Hotspot(Document):
    """The place of a peak of temperature, and the width of the spot where half the excess is left."""

    xy: tuple[float, float]
    peak_c: float
    diameter_m: float


class WorldDocument(Document):
    """A world. `hrt synth` writes all of it; for a real site `classes` is enough, by the ids of the class raster."""

    format: str = Field(pattern="^hrt-world$")
    version: int = Field(default=1, ge=1, le=1)
    scene: str = ""
    seed: int | None = None
    crs: str | None = None
    pixel_m: float | None = Field(default=None, gt=0)
    start: Start | None = None
    target_class: str | None = None
    classes: dict[str, TrueClass] = Field(min_length=1)
    hotspots: list[Hotspot] = Field(default_factory=list)
    provenance: Provenance | None = None

    @field_validator("classes")
    @classmethod
    def _keys_are_ids(cls, value: dict[str, TrueClass]) -> dict[str, TrueClass]:
        for key in value:
            if not (key.isascii() and key.isdigit() and str(int(key)) == key and int(key) <= MAX_CLASS):
                raise ValueError(f"{key[:20]!r} is not a class id from 0 to {MAX_CLASS}")
        return value

    @property
    def under_water(self) -> bool:
        """Whether the site is the bottom of the sea, heights being negative depths."""
        return self.scene == "reef"

    def by_id(self) -> dict[int, TrueClass]:
        """Return the classes by number."""
        return {int(key): value for key, value in self.classes.items()}


def read_world(path: Path) -> WorldDocument:
    """Read a world.

    Raises
    ------
    InputError
        The file is no world, or holds a drivability outside [0, 1].
    """
    return read_model(path, WorldDocument)
