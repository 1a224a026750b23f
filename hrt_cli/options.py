"""Options that several subcommands share, each defined once, so that they mean the same everywhere."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hrt_cli.manual import interval
from hrt_cli.progress import Console

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

F = TypeVar("F", bound=Callable[..., Any])

_DEMAND = re.compile(r"(.*[^<>=\s])\s*(>=|<=|==|>|<)\s*([^<>=\s]+)\s*")
_BANDS = re.compile(r"[1-9][0-9]{0,4}(,[1-9][0-9]{0,4})*")


class File(click.Path):
    """A path that help names and a shell completes: folders, and files that end as its name or one of `others` does.

    Parameters
    ----------
    shown : str
        What stands for it in the help: `CLASSES.tif`; without a suffix, any file will do, or only folders.
    others : str
        Other suffixes, with their dot.
    writes : bool
        The command writes it.
    """

    def __init__(self, shown: str, *others: str, writes: bool = False) -> None:
        super().__init__(path_type=Path)
        self.shown, self.writes = shown, writes
        self.suffixes = tuple(dict.fromkeys((Path(shown).suffix, *others))) if Path(shown).suffix else others
        self.folder = shown == "FOLDER"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str | None:  # noqa: D102
        return self.shown if isinstance(param, click.Option) else None

    def shell_complete(  # noqa: D102
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        from hrt_cli.completion import paths

        return paths(incomplete, self.suffixes, folders_only=self.folder)


PATH = File("PATH")
FOLDER = File("FOLDER")
RASTER = File("RASTER.tif", ".tiff", ".vrt", ".jp2", ".png", ".jpg", ".jpeg")
CLASSES = File("CLASSES.tif", ".tiff", ".vrt")
SCORES = File("SCORES.json")
SCOREMAP = File("SCOREMAP.tif", ".tiff", ".vrt", ".npz")
AREA = File("AREA.geojson", ".json", ".kml", ".kmz")
DSM = File("DSM.tif", ".tiff", ".vrt")
POLICY = File("POLICY.npz")
PLAN = File("PLAN.json")
LOG = File("LOG.jsonl", ".csv", ".tsv", ".gpx", ".bag", ".mcap", ".db3", ".bin")
STEERING = File("MODEL.safetensors")
ANY_STEERING = File("MODEL.safetensors", ".onnx")
RASTER_OR_LOG = File("FILE", *RASTER.suffixes, *LOG.suffixes)
"""The kinds of files and folders that commands take."""

_UNITS = {"_m_s": "M/S", "_m": "METRES", "_s": "SECONDS", "_deg": "DEGREES"}


class FiniteFloat(click.ParamType):  # type: ignore[type-arg]  # generic only from click 8.4
    """A real number in an interval; unlike `click.FLOAT` it takes no NaN and no infinity."""

    name = "number"

    def __init__(
        self, low: float = -math.inf, high: float = math.inf, *, low_open: bool = False, high_open: bool = False
    ) -> None:
        self.low, self.high = low, high
        self.low_open, self.high_open = low_open, high_open

    @property
    def allowed(self) -> str:
        """The interval in words."""
        return interval(self.low, self.high, low_open=self.low_open, high_open=self.high_open)

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Return the unit that the parameter's name tells."""
        return next((unit for end, unit in _UNITS.items() if (param.name or "").endswith(end)), "NUMBER")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:  # noqa: D102
        try:
            number = float(value)
        except ValueError:
            number = None
        # `float` also takes 1_000 and the digits of other scripts.
        if number is None or not str(value).isascii() or "_" in str(value):
            self.fail(f"{value!r} is not a number", param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        if number < self.low or (self.low_open and number == self.low):
            self.fail(
                f"{number:g} is too small; it must be {'more than' if self.low_open else 'at least'} {self.low:g}"
            )
        if number > self.high or (self.high_open and number == self.high):
            self.fail(
                f"{number:g} is too large; it must be {'less than' if self.high_open else 'at most'} {self.high:g}"
            )
        return number


class ClassCount(click.ParamType):  # type: ignore[type-arg]
    """A number of classes from 2 to 255, or `auto`."""

    name = "K|auto"
    allowed = "2 to 255, or auto"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Return the name as it is, not in capitals."""
        return self.name

    def convert(  # noqa: D102
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> int | str:
        if value == "auto":
            return "auto"
        text = str(value)
        if not (text.isascii() and text.isdigit() and 2 <= int(text) <= 255):
            self.fail(f"{value!r} is neither a number from 2 to 255 nor auto", param, ctx)
        return int(text)


class Range(click.ParamType):  # type: ignore[type-arg]
    """Two finite numbers written `LOW,HIGH`."""

    name = "LOW,HIGH"

    def convert(  # noqa: D102
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        if isinstance(value, tuple):
            return value
        parts = str(value).split(",")
        if len(parts) != 2:
            self.fail(f"{value!r} is not of the form {self.name}", param, ctx)
        low, high = (FiniteFloat().convert(part, param, ctx) for part in parts)
        return low, high


class LonLat(Range):
    """A place written `LON,LAT`, in degrees."""

    name = "LON,LAT"

    def convert(  # noqa: D102
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float]:
        lon, lat = super().convert(value, param, ctx)
        if not (-180 <= lon <= 180 and -90 <= lat <= 90):
            self.fail(f"{value!r} is no longitude and latitude", param, ctx)
        return lon, lat


class Size(click.ParamType):  # type: ignore[type-arg]
    """A width and a height in pixels written `WIDTHxHEIGHT`, each in an interval."""

    name = "WIDTHxHEIGHT"

    def __init__(self, low: int, high: int) -> None:
        self.low, self.high = low, high

    @property
    def allowed(self) -> str:
        """The interval in words."""
        return f"{self.low}x{self.low} to {self.high}x{self.high}"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Return the name as it is, not in capitals."""
        return self.name

    def convert(  # noqa: D102
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        parts = re.fullmatch(r"([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", str(value))
        if parts is None:
            self.fail(f"{value!r} is not of the form WIDTHxHEIGHT, such as 160x120", param, ctx)
        width, height = int(parts[1]), int(parts[2])
        if not (self.low <= width <= self.high and self.low <= height <= self.high):
            self.fail(f"{value!r} is not from {self.low}x{self.low} to {self.high}x{self.high}", param, ctx)
        return width, height


class NameValue(click.ParamType):  # type: ignore[type-arg]
    """A pair written `NAME=VALUE`."""

    name = "NAME=VALUE"

    def convert(  # noqa: D102
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str]:
        if isinstance(value, tuple):
            return value
        name, equals, text = str(value).partition("=")
        if not (name and equals):
            self.fail(f"{value!r} is not of the form NAME=VALUE", param, ctx)
        return name, text


class Demand(click.ParamType):  # type: ignore[type-arg]
    """A demand on a figure, such as `ari>=0.8`, as name, operator and number."""

    name = "FIGURE>=VALUE"

    def convert(  # noqa: D102
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str, float]:
        if isinstance(value, tuple):
            return value
        parts = _DEMAND.fullmatch(str(value))
        if parts is None:
            self.fail(f"{value!r} is not of the form {self.name}, such as 'ari>=0.8' (or <=, >, <, ==)", param, ctx)
        return parts[1].strip(), parts[2], FiniteFloat().convert(parts[3], param, ctx)


class Tolerance(click.ParamType):  # type: ignore[type-arg]
    """A tolerance written `FIGURE=VALUE`; the figure may be a path with any signs in it."""

    name = "FIGURE=VALUE"

    def convert(  # noqa: D102
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, float]:
        if isinstance(value, tuple):
            return value
        figure, equals, text = str(value).rpartition("=")
        if not (figure and equals):
            self.fail(f"{value!r} is not of the form {self.name}, such as rmse=0.01", param, ctx)
        return figure, FiniteFloat(0).convert(text, param, ctx)


def console_options(command: F) -> F:
    """Add `--json`, `-q`, `-v`, handed over as one `console`."""

    @click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
    @click.option("-q", "--quiet", is_flag=True, help="No notes and no progress bar.")
    @click.option("-v", "--verbose", is_flag=True, help="Tell more on stderr.")
    @functools.wraps(command)
    def wrapped(*args: Any, as_json: bool, quiet: bool, verbose: bool, **kwargs: Any) -> Any:
        return command(*args, console=Console(as_json, quiet, verbose), **kwargs)

    return wrapped  # type: ignore[return-value]


def existing_options(command: F) -> F:
    """Add `--overwrite` and `--force`, handed over as one `existing`."""

    @click.option("--overwrite", is_flag=True, help="Replace an output made from other inputs or parameters.")
    @click.option("--force", is_flag=True, help="Compute again even what is up to date (implies --overwrite).")
    @functools.wraps(command)
    def wrapped(*args: Any, overwrite: bool, force: bool, **kwargs: Any) -> Any:
        from hrt_cli.artifacts.stage import Existing

        return command(*args, existing=Existing(overwrite, force), **kwargs)

    return wrapped  # type: ignore[return-value]


def output(shown: str, text: str = "The file to write.") -> Callable[[F], F]:
    """Return the option `--output`, with what stands for the file in the help: `CLASSES.tif`."""
    return click.option("-o", "--output", required=True, type=File(shown, writes=True), help=text)


output_opt = output("FILE")

seed_opt = click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Seed of every random choice."
)

workers_opt = click.option(
    "--workers",
    type=click.IntRange(1, 256),
    default=1,
    show_default=True,
    help="Threads. The result does not depend on it.",
)

skip_bad_opt = click.option(
    "--skip-bad", is_flag=True, help="Leave out, and count, rows and pictures that cannot be used."
)

correction_opt = click.option(
    "--correction",
    type=FiniteFloat(0, 1),
    default=0.2,
    show_default=True,
    help="Steering added for a left camera, and taken off for a right one.",
)

bands_opt = click.option(
    "-b",
    "--bands",
    metavar="B1,B2,B3",
    callback=lambda ctx, param, value: _bands(value),
    help="Bands to take as red, green, blue: 3,2,1 (or one as grey). Default: as the file declares.",
)

nodata_opt = click.option("--nodata", type=FiniteFloat(), help="Take this value as nodata instead of the file's own.")

creation_opt = click.option(
    "--co",
    "creation",
    multiple=True,
    type=NameValue(),
    help="Creation option of GDAL's COG driver, such as COMPRESS=ZSTD.",
)

unreferenced_opt = click.option(
    "--unreferenced", is_flag=True, help="Accept a plain image without georeference: lengths are pixels."
)


def _figure(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    """Refuse what can be no figure at once, not after the work that it shows."""
    if value is not None:
        from hrt_cli.artifacts.publish import check_target

        if value.suffix.lower() != ".png":
            raise click.BadParameter("a figure is a PNG: choose a name that ends in .png")
        check_target(value, [])
    return value


def _backdrop(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    if value is not None and ctx.params.get("figure") is None:
        raise click.BadParameter("is for a --figure: give one")
    return value


# Eager, so that it is known when --backdrop asks for it.
figure_opt = click.option(
    "--figure",
    type=File("FIGURE.png", writes=True),
    is_eager=True,
    callback=_figure,
    help="Also draw the result as a PNG.",
)

backdrop_opt = click.option("--backdrop", type=RASTER, callback=_backdrop, help="Orthomosaic to draw the figure on.")

require_opt = click.option(
    "--require",
    "demands",
    multiple=True,
    type=Demand(),
    help="Exit with 3 unless a number of the --json output, by its key or dotted path, is so.",
)


def _bands(text: str | None) -> tuple[int, ...]:
    if text is None:
        return ()
    if not _BANDS.fullmatch(text):
        raise click.BadParameter(f"{text!r} is not a list of band numbers such as 1,2,3")
    return tuple(int(part) for part in text.split(","))
