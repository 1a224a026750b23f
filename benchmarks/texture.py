"""Benchmarks of the texture classes: what `hrt segment` costs and how good its classes are.

    python benchmarks/texture.py [--quick | --full] [--json FILE] [SECTION ...]

docs/benchmarks.md says what each section measures.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import texture_command
import texture_kernel
import texture_mosaics
import texture_sites
from tables import FULL, NORMAL, QUICK, Effort, Table, machine, measure
from threadpoolctl import threadpool_limits

SECTIONS: dict[str, Callable[[Effort], list[Table]]] = {
    "speed-kernel": texture_kernel.speed_kernel,
    "speed-command": texture_command.speed_command,
    "quality-outex": texture_mosaics.quality_outex,
    "quality-rotated": texture_mosaics.quality_rotated,
    "quality-sites": texture_sites.quality_sites,
    "quality-synth": texture_sites.quality_synth,
}
PACKAGES = ("numpy", "numba", "opencv-python-headless", "rasterio", "scikit-image", "scikit-learn", "scipy")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"{', '.join(SECTIONS)}; all by default")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_const", dest="effort", const=QUICK, help="small inputs")
    size.add_argument("--full", action="store_const", dest="effort", const=FULL, help="rasters up to 24,576 px")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    given = parser.parse_args(arguments)
    unknown = [name for name in given.sections if name not in SECTIONS]
    if unknown:
        parser.error(f"no section {', '.join(unknown)}: choose from {', '.join(SECTIONS)}")
    cv2.setNumThreads(1)
    with threadpool_limits(1):
        sections = measure(SECTIONS, given.sections or list(SECTIONS), given.effort or NORMAL)
    if given.json:
        given.json.write_text(
            json.dumps({"machine": machine(PACKAGES), "sections": sections}, indent=2) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
