"""The record stage: a site becomes steering data, without a drive."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from hrt_cli.artifacts.carriers import json_provenance
from hrt_cli.artifacts.jsonio import parse_strict, read_text
from hrt_cli.artifacts.publish import output_error
from hrt_cli.artifacts.stage import REFUSE, Existing, ReadProvenance, begin
from hrt_cli.driving.album import ABOUT, Album, prepare_folder
from hrt_cli.driving.glance_checkpoint import Checkpoint, Kept
from hrt_cli.driving.glances import IN_ONE_WEATHER, Glances
from hrt_cli.driving.lens import clear_camera
from hrt_cli.driving.vehicle import VEHICLES
from hrt_cli.progress import Note, Progress, silent, unheard
from hrt_cli.world.site import load_site, site_files

STAGE = "record"
STAGE_VERSION = 3


@dataclass(frozen=True)
class GlanceRequest:
    """What to look at.

    Attributes
    ----------
    frames : int
    near : float
        Share of them with something in the way, in [0, 1].
    vehicle : 'ugv', 'auv' or None
        None: the AUV under water, else the UGV.
    seed : int
    """

    frames: int
    near: float = 0.8
    vehicle: str | None = None
    seed: int = 0


@dataclass(frozen=True)
class GlanceSummary:
    """What came of it.

    Attributes
    ----------
    up_to_date : bool
    frames : int
    near : int
        How many of them have something in the way.
    resumed_at : int
        The frame after which a stopped recording went on, 0 where none did.
    """

    up_to_date: bool
    frames: int
    near: int
    resumed_at: int = 0


def record_folder(
    world: Path,
    folder: Path,
    request: GlanceRequest,
    *,
    existing: Existing = REFUSE,
    progress: Progress = silent,
    note: Note = unheard,
) -> GlanceSummary:
    """Look from random places of a site and write the pictures with what they teach (`driving.album`).

    A recording that was stopped is gone on with, to the same bytes.

    Raises
    ------
    InputError
        The site cannot be used.
    ArgumentError
        It has no such places.
    OutputError
        The folder is not one for a recording, or see `hrt_cli.artifacts.stage.begin`.
    """
    inputs = site_files(world)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    outputs: dict[Path, ReadProvenance] = {folder / ABOUT: json_provenance}
    job = begin(STAGE, STAGE_VERSION, inputs=inputs, parameters=asdict(request), outputs=outputs, existing=existing)
    checkpoint = Checkpoint(folder, request.frames, job.provenance, note)
    if job.up_to_date:
        checkpoint.remove_own()
        return _summary(folder, True)
    site = load_site(world)
    vehicle = VEHICLES[request.vehicle or ("auv" if site.under_water else "ugv")]
    glances = Glances(site, vehicle, request.near, request.seed)
    album = Album(folder, vehicle.kind, clear_camera(site, vehicle).lens)

    def go_on(kept: Kept) -> None:
        glances.go_on(len(kept.rows), kept.near, kept.random)
        album.go_on(kept.rows, kept.pictures_sha256)

    if not checkpoint.resume(go_on):
        glances.begin()
        prepare_folder(folder, list(inputs.values()), overwrite=existing.overwrite or existing.force)
    resumed_at = len(album)
    try:
        for rgb, lesson in glances(request.frames):
            album.add(rgb, lesson, f"{folder.name}-{request.seed}-{len(album) // IN_ONE_WEATHER}")
            checkpoint.keep(
                Kept(
                    near=glances.near,
                    random=glances.random,
                    rows=album.rows,
                    pictures_sha256=album.pictures_sha256,
                )
            )
            progress(len(album), request.frames)
        album.finish(job.provenance, near=glances.near)
    except BaseException:  # a signal, too
        checkpoint.stopped()
        raise
    checkpoint.remove()
    return replace(_summary(folder, False), resumed_at=resumed_at)


def _summary(folder: Path, up_to_date: bool) -> GlanceSummary:
    about = parse_strict(folder / ABOUT, read_text(folder / ABOUT))
    return GlanceSummary(up_to_date, int(about["frames"]), int(about["near"]))
