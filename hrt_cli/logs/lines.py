"""The tool's own drive log, JSON lines (`artifacts.drivelog`)."""

from __future__ import annotations

from pathlib import Path

from hrt_cli.artifacts.drivelog import DriveLog, Header, Record, drive_provenance, line_model
from hrt_cli.artifacts.jsonio import parse_strict
from hrt_cli.logs.assemble import log_of_records


def read_lines(path: Path, text: str, *, as_it_stands: bool = False) -> DriveLog:
    """Return a log of JSON lines; one with provenance is checked against it, unless it is read `as_it_stands`.

    Raises
    ------
    InputError
        A line is not what `Header` and `Record` ask for, or the log is not what its provenance says.
    """
    lines = text.splitlines()
    header = line_model(path, 1, Header, parse_strict(path, lines[0]))
    if header.provenance is not None and not as_it_stands:
        drive_provenance(path)
    records = [
        line_model(path, number, Record, parse_strict(path, line))
        for number, line in enumerate(lines[1:], start=2)
        if line.strip()
    ]
    return log_of_records(path, header, records)
