"""A reader of MOOS-IvP behavior files, from the helm's documented grammar: strict where the helm refuses a file."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

MAX_LINE = 5000  # fileBufferSlash: beyond it the helm's buffer ends
PARAMETERS = {
    "BHV_Waypoint": {
        "points", "polygon", "speed", "capture_radius", "slip_radius", "order", "repeat", "lead", "capture_line",
    },
    "BHV_ConstantDepth": {"depth", "peakwidth", "basewidth", "summitdelta"},
}  # fmt: skip
COMMON = {"name", "pwt", "condition", "endflag", "duration", "updates", "perpetual"}


@dataclass
class Behavior:
    kind: str
    parameters: dict[str, list[str]] = field(default_factory=dict)

    def only(self, name: str) -> str:
        (value,) = self.parameters[name]
        return value


def joined_lines(text: str) -> list[str]:
    """Lines, those that end in a backslash with the next."""
    lines, open_line = [], ""
    for line in text.split("\n"):
        if len(line) >= MAX_LINE:
            raise ValueError(f"a line of {len(line)} characters")
        if line.rstrip(" \t").endswith("\\"):
            open_line += line.rstrip(" \t")[:-1]
        else:
            lines.append(open_line + line)
            open_line = ""
    return lines


def read_behaviors(text: str) -> tuple[dict[str, str], list[Behavior]]:
    """The initial variables and the behaviors of a file."""
    initial: dict[str, str] = {}
    behaviors: list[Behavior] = []
    state = "top"
    for raw in joined_lines(text):
        line = raw.split("//")[0].split("#")[0].strip()
        # A brace at either end of a line counts as one on a line of its own.
        tail = [line[-1]] if len(line) > 1 and line[-1] in "{}" else []
        line = line[:-1].rstrip() if tail else line
        for part in [line, *tail]:
            if not part:
                continue
            left, _, right = (piece.strip() for piece in part.partition("="))
            if part == "{" and state == "declared":
                state = "defining"
            elif part == "}" and state == "defining":
                state = "top"
            elif state == "top" and part.lower().startswith("initialize "):
                name, value = part[len("initialize ") :].split("=")
                initial[name.strip()] = value.strip()
            elif state == "top" and left.lower() == "behavior" and right in PARAMETERS:
                behaviors.append(Behavior(right))
                state = "declared"
            elif state == "defining" and left.lower() in PARAMETERS[behaviors[-1].kind] | COMMON and right:
                behaviors[-1].parameters.setdefault(left.lower(), []).append(right)
            else:
                raise ValueError(f"the helm refuses {part!r}")
    if state != "top" or not behaviors:
        raise ValueError("no whole behavior")
    return initial, behaviors


def read_points(value: str) -> list[tuple[float, float]]:
    """Points as `x,y:x,y` (string2SegList's short form)."""
    points = []
    for vertex in value.split(":"):
        x, y = map(float, vertex.split(","))
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError(vertex)
        points.append((x, y))
    return points
