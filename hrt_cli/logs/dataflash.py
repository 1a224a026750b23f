"""ArduPilot's DataFlash log (`.bin`) as a drive log.

Messages by their names (https://ardupilot.org/rover/docs/logmessages.html): places from POS (fused) where it is logged,
else from GPS with a 3D fix; speed from GPS, attitude from ATT, in degrees with the nose up and the right side down
positive, as here; the commanded speed from THR, which only Rover writes.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hrt_cli.artifacts.drivelog import DriveLog
from hrt_cli.errors import HrtError, InputError
from hrt_cli.logs.assemble import log_of_columns
from hrt_cli.logs.resample import held, interpolated

Floats = NDArray[np.float64]

_FIX_3D = 3
_GPS_EPOCH_S = 315_964_800
"""1980-01-06 in Unix seconds, from which GPS weeks count."""
_LEAP_S = 18
"""GPS time is ahead of UTC by so much since 2017; a log that is older is off by a second or two."""
_WEEK_S = 7 * 86_400
_MOST_DAMAGED = 0.01
"""A log of which a larger share is no messages is not trusted."""


def read_dataflash(path: Path) -> DriveLog:
    """Return the drive in a DataFlash log. One that ends within a message, as most do, is taken up to there.

    Raises
    ------
    InputError
        The file is no such log, is damaged, tells no places, or pymavlink is not installed.
    """
    with _opened(path) as log:
        notes = _damage(path, log)
        gps = _columns(log, "GPS", ("TimeUS", "Lat", "Lng", "Status"), ("Spd", "GWk", "GMS", "I"))
        pos = _columns(log, "POS", ("TimeUS", "Lat", "Lng"))
        att = _columns(log, "ATT", ("TimeUS", "Roll", "Pitch", "Yaw"))
        thr = _columns(log, "THR", ("TimeUS", "DesSpeed"))
    gps, more = _receiver(gps)
    notes += more
    places = pos if pos["TimeUS"].size else gps
    good = (places["Lat"] != 0) | (places["Lng"] != 0)
    if not good.any():
        raise InputError(path, "tells no places: it has no POS, and no GPS with a 3D fix")
    if not good.all():
        notes.append(f"drops {good.size - good.sum()} places at 0, 0")
    base_s, more = _time_base(gps)
    notes += more
    boot_s = places["TimeUS"][good] / 1e6
    known = {
        "speed_m_s": interpolated(boot_s, gps["TimeUS"] / 1e6, gps["Spd"]),
        "commanded_m_s": held(boot_s, thr["TimeUS"] / 1e6, np.abs(thr["DesSpeed"])),
        "heading_deg": interpolated(boot_s, att["TimeUS"] / 1e6, att["Yaw"], angle=True) % 360.0,
        "pitch_deg": interpolated(boot_s, att["TimeUS"] / 1e6, att["Pitch"]),
        "roll_deg": interpolated(boot_s, att["TimeUS"] / 1e6, att["Roll"], angle=True),
    }
    place = np.stack([places["Lng"], places["Lat"]], axis=1)[good]
    source = "POS (fused)" if places is pos else "GPS"
    return log_of_columns(path, base_s + boot_s, place, known, notes=[f"takes places from {source}", *notes])


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a log; whatever goes wrong in reading it is one refusal."""
    try:
        from pymavlink.DFReader import DFReader_binary
    except ImportError as error:
        raise InputError(path, "needs pymavlink: pip install 'hrt[ardupilot]'") from error
    # It prints what it meets, on stdout too.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            with DFReader_binary(str(path)) as log:
                yield log
        except HrtError:
            raise
        except Exception as error:  # damaged formats show as anything: struct errors, missing keys
            what = " ".join(str(error).split())[:200] or type(error).__name__
            raise InputError(path, f"is not a DataFlash log that can be read: {what}") from error


def _damage(path: Path, log: Any) -> list[str]:
    """Say what of a log is no messages: the end of one that was cut off, and what lies between messages."""
    ends, whole = [0], 0
    for kind, layout in log.formats.items():
        at = np.array(log.offsets[kind], np.int64)
        at = at[at + layout.len <= log.data_len]
        whole += at.size * layout.len
        ends += (at[-1:] + layout.len).tolist()
    tail = log.data_len - max(ends)
    between = log.data_len - tail - whole
    if between > _MOST_DAMAGED * log.data_len or whole == 0:
        raise InputError(path, f"is damaged: {between + tail} of its {log.data_len} bytes are no messages")
    notes = [f"ends within a message: its last {tail} bytes are left out"] if tail else []
    return notes + ([f"is damaged: {between} bytes between its messages are passed over"] if between else [])


def _columns(log: Any, name: str, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, Floats]:
    """Return columns [n] of the messages of a name, NaN for optional ones that it lacks; empty without the needed."""
    log.rewind()
    rows = []
    while (message := log.recv_match(type=[name], strict=True)) is not None:
        rows.append([getattr(message, each, None) for each in (*needed, *optional)])
    if rows and None in rows[0][: len(needed)]:
        rows = []
    table = np.array(rows, np.float64).reshape(-1, len(needed) + len(optional))
    return dict(zip((*needed, *optional), table.T, strict=True))


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
