"""The drives of a page: what they came to, and what the robot's camera saw on them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hrt_cli.errors import InputError
from hrt_cli.evaluation.drives import DriveEvaluation, evaluate_drives
from hrt_cli.report.page.collect import Folder, Item
from hrt_cli.report.page.frames import RECORDED, RENDERED, recorded_frames, rendered_frames
from hrt_cli.world.site import Site, load_site, site_files


class Drives:
    """Measures the drives of a folder, each on the site and the scoremap that it was driven on.

    Parameters
    ----------
    folder : Folder
    world : Path or None
        The site of drives whose own is not in the folder.

    Raises
    ------
    InputError
        `world` is no site.
    """

    def __init__(self, folder: Folder, world: Path | None) -> None:
        self._folder, self._world = folder, world
        self._loaded: dict[Path, Site] = {}
        if world is not None:
            site_files(world)

    def measure(self, item: Item) -> DriveEvaluation:
        """Measure a drive: with its site how near it came to obstacles, with its plan's scoremap what it collected.

        Raises
        ------
        InputError
            The log cannot be used.
        """
        world = self._site_of(item)
        plan = self._folder.input_of(item, "plan")
        scoremap = None if plan is None else self._folder.input_of(plan, "scoremap")
        on_map = None if scoremap is None else scoremap.path
        try:
            return evaluate_drives([item.path], world=world, site=self._site(world), scoremap=on_map)
        except InputError:
            if world is None and scoremap is None:
                raise
            # It lies off the site or the map: then what the log alone tells.
            return evaluate_drives([item.path])

    def frames(self, item: Item, most: int) -> tuple[list[dict[str, Any]], str]:
        """Return at most so many frames of a drive, and what they are: recorded, else rendered, else none.

        Raises
        ------
        InputError
            The recording or the log cannot be used.
        """
        recording = self._recording_of(item)
        if recording is not None:
            return recorded_frames(recording.path, recording.document, most), RECORDED
        site = self._site(self._site_of(item))
        return ([], "") if site is None else (rendered_frames(item.path, site, most), RENDERED)

    def _recording_of(self, item: Item) -> Item | None:
        """Return what was recorded on this very drive."""
        wanted = None if item.provenance is None else item.provenance.fingerprint
        for other in self._folder.of("recording"):
            if other.provenance is not None and other.provenance.fingerprint == wanted:
                return other
        return None

    def _site_of(self, item: Item) -> Path | None:
        """Return the folder of the very site that a drive was on, else the one that was given."""
        ortho, dsm = (self._folder.input_of(item, role) for role in ("ortho", "dsm"))
        if ortho is not None and dsm is not None and ortho.path.parent == dsm.path.parent:
            try:
                if {ortho.path, dsm.path} <= set(site_files(ortho.path.parent).values()):
                    return ortho.path.parent
            except InputError:
                pass
        return self._world

    def _site(self, folder: Path | None) -> Site | None:
        if folder is not None and folder not in self._loaded:
            self._loaded = {folder: load_site(folder)}  # one at a time: they are large
        return None if folder is None else self._loaded[folder]
