"""The imports of the code obey the table in docs/architecture.md."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TABLE_ROW = re.compile(r"^\| ([a-z]+) \|([^|]*)\|$")


def allowed_arrows() -> dict[str, set[str]]:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = text.split("| room | may import |")[1].split("\n\n")[0]
    rows = [TABLE_ROW.match(line) for line in table.splitlines()]
    return {row[1]: {name.strip() for name in row[2].split(",")} - {""} for row in rows if row}


def room_of(path: Path) -> str:
    parts = path.relative_to(ROOT).parts
    if parts[0] == "commands":
        return "commands"
    return parts[1].removesuffix(".py")


def imported_rooms(path: Path) -> set[str]:
    rooms = set()
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module or "") if part)
            names = [module, *(f"{module}.{alias.name}" for alias in node.names)]
        for name in names:
            parts = name.split(".")
            if parts[0] == "hrt_commands":
                rooms.add("commands")
            if parts[0] == "hrt_cli" and len(parts) > 1 and parts[1] != "__version__":
                rooms.add(parts[1])
    return rooms


def sources() -> list[Path]:
    return [p for folder in ("hrt_cli", "commands") for p in sorted((ROOT / folder).rglob("*.py"))]


@pytest.mark.parametrize("path", sources(), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_follow_the_arrows(path: Path) -> None:
    room = room_of(path)
    if room == "__init__":
        return
    arrows = allowed_arrows()
    assert room in arrows, f"docs/architecture.md does not name the room {room}"
    wrong = imported_rooms(path) - arrows[room] - {room}
    assert not wrong, f"{path.name} imports {sorted(wrong)}, which docs/architecture.md does not allow from {room}"


def test_the_arrows_have_no_circle() -> None:
    arrows = allowed_arrows()
    done: set[str] = set()
    while ready := {room for room, targets in arrows.items() if targets <= done} - done:
        done |= ready
    assert done == set(arrows), f"a circle among {sorted(set(arrows) - done)}"


def test_a_forbidden_import_would_be_noticed() -> None:
    path = ROOT / "hrt_cli" / "raster" / "gate.py"
    assert {"errors", "raster"} <= imported_rooms(path)
    assert "commands" not in allowed_arrows()["raster"]


def test_no_algorithm_library_in_a_command() -> None:
    heavy = {"numpy", "numba", "cv2", "sklearn", "rasterio", "torch", "scipy", "matplotlib"}
    for path in sorted((ROOT / "commands").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.split(".")[0] for name in names} & heavy, f"{path.name} imports {names}"
