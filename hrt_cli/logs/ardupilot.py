"""ArduPilot's DataFlash log (`.bin`) as a drive log.

Messages by their names (https://ardupilot.org/rover/docs/logmessages.html): places from POS (fused) where it is logged,
else from GPS with a 3D fix; speed from GPS, attitude from ATT, in degrees with the nose up and the right side down
positive, as here; the commanded speed from THR, which only Rover writes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.errors import InputError
from hrt_cli.logs.assemble import log_of_columns
from hrt_cli.logs.dataflash import Messages
from hrt_cli.logs.resample import held, interpolated

Floats = NDArray[np.float64]

_WANTED = {
    "GPS": ("TimeUS", "Lat", "Lng", "Status", "Spd", "GWk", "GMS", "I"),
    "POS": ("TimeUS", "Lat", "Lng"),
    "ATT": ("TimeUS", "Roll", "Pitch", "Yaw"),
    "THR": ("TimeUS", "DesSpeed"),
}
_FIX_3D = 3
_GPS_EPOCH_S = 315_964_800
"""1980-01-06 in Unix seconds, from which GPS weeks count."""
_LEAP_S = 18
"""GPS time is ahead of UTC by so much since 2017; a log that is older is off by a second or two."""
_WEEK_S = 7 * 86_400


def read_ardupilot(path: Path) -> DriveLog:
    """Return the drive in a DataFlash log. One that ends within a message, as most do, is taken up to there.

    Raises
    ------
    InputError
        The file is damaged (`dataflash`), tells no places, or time goes backwards.
    """
    messages = Messages(path)
    told = messages.read(_WANTED)
    pos, att, thr = (_timed(told[name]) for name in ("POS", "ATT", "THR"))
    gps, notes = _receiver(_timed(told["GPS"]))
    places = pos if pos["TimeUS"].size else gps
    good = np.isfinite(places["Lat"] + places["Lng"]) & ((places["Lat"] != 0) | (places["Lng"] != 0))
    if not good.any():
        raise InputError(path, "tells no places: it has no POS, and no GPS with a 3D fix")
    if not good.all():
        notes.append(f"drops {good.size - good.sum()} places at 0, 0")
    base_s, more = _time_base(gps)
    boot_s, att_s = places["TimeUS"][good] / 1e6, att["TimeUS"] / 1e6
    known = {
        "speed_m_s": interpolated(boot_s, gps["TimeUS"] / 1e6, gps["Spd"]),
        "commanded_m_s": held(boot_s, thr["TimeUS"] / 1e6, np.abs(thr["DesSpeed"])),
        "heading_deg": interpolated(boot_s, att_s, att["Yaw"], angle=True) % 360.0,
        "pitch_deg": interpolated(boot_s, att_s, att["Pitch"]),
        "roll_deg": interpolated(boot_s, att_s, att["Roll"], angle=True),
    }
    place = np.stack([places["Lng"], places["Lat"]], axis=1)[good]
    source = f"takes places from {'POS (fused)' if places is pos else 'GPS'}"
    return log_of_columns(path, base_s + boot_s, place, known, notes=[source, *notes, *more, *messages.notes])


def _timed(columns: dict[str, Floats]) -> dict[str, Floats]:
    """Return what is said with a time; logs from before 2015 count it otherwise."""
    known = np.isfinite(columns["TimeUS"])
    return {name: column[known] for name, column in columns.items()}


def _receiver(gps: dict[str, Floats]) -> tuple[dict[str, Floats], list[str]]:
    """Return what the receiver with the most fixes says while it has one."""
    fix = gps["Status"] >= _FIX_3D
    found = {name: column[fix] for name, column in gps.items()}
    numbers, counts = np.unique(found["I"], return_counts=True)
    if numbers.size < 2:
        return found, []
    best = numbers[counts.argmax()]
    others = ", ".join(f"{number:g}" for number in numbers if number != best)
    found = {name: column[found["I"] == best] for name, column in found.items()}
    return found, [f"takes GPS {best:g}, and passes over {others}"]


def _time_base(gps: dict[str, Floats]) -> tuple[float, list[str]]:
    """Return the Unix time at which the vehicle was switched on; 0 where no GPS tells."""
    dated = np.flatnonzero(gps["GWk"] > 0)
    if not dated.size:
        return 0.0, ["tells no date: its times are seconds since it was switched on"]
    k = dated[0]
    unix_s = _GPS_EPOCH_S + _WEEK_S * gps["GWk"][k] + gps["GMS"][k] / 1e3 - _LEAP_S
    return float(unix_s - gps["TimeUS"][k] / 1e6), []
