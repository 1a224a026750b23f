"""The imports of the code obey the table in docs/architecture.md."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ARROWS_ROW = re.compile(r"^\| ([a-z]+) \|([^|]*)\|$")
MODULES_ROW = re.compile(r"^\| ([a-z/]+) \| (.*) \|$")


def table(heading: str, row: re.Pattern[str]) -> list[re.Match[str]]:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    lines = text.split(f"{heading}\n| --- | --- |\n")[1].split("\n\n")[0].splitlines()
    return [found for line in lines if (found := row.match(line))]


def allowed_arrows(rooms: str = "room") -> dict[str, set[str]]:
    rows = table(f"| {rooms} | may import |", ARROWS_ROW)
    return {row[1]: {name.strip() for name in row[2].split(",")} - {""} for row in rows}


def room_of(path: Path) -> str:
    parts = path.relative_to(ROOT).parts
    if parts[0] == "commands":
        return "commands"
    return parts[1].removesuffix(".py")


def imported_names(path: Path) -> set[str]:
    """All names that are imported anywhere in a file, and what is imported from them."""
    found: set[str] = set()
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module or "") if part)
            found |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    return found


def imported_rooms(path: Path) -> set[str]:
    rooms = set()
    for parts in (name.split(".") for name in imported_names(path)):
        if parts[0] == "hrt_commands":
            rooms.add("commands")
        if parts[0] == "hrt_cli" and len(parts) > 1 and parts[1] != "__version__":
            rooms.add(parts[1])
    return rooms


def sources() -> list[Path]:
    return [p for folder in ("hrt_cli", "commands") for p in sorted((ROOT / folder).rglob("*.py"))]


def module_name(path: Path) -> str:
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    return f"hrt_{name}" if name.startswith("commands") else name


@pytest.mark.parametrize("path", sources(), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_follow_the_arrows(path: Path) -> None:
    room = room_of(path)
    if room == "__init__":
        return
    arrows = allowed_arrows()
    assert room in arrows, f"docs/architecture.md does not name the room {room}"
    wrong = imported_rooms(path) - arrows[room] - {room}
    assert not wrong, f"{path.name} imports {sorted(wrong)}, which docs/architecture.md does not allow from {room}"


def test_imports_inside_steering_follow_the_arrows() -> None:
    arrows = allowed_arrows("inside steering")
    for path in (ROOT / "hrt_cli" / "steering").glob("*/*.py"):
        names = [name.split(".") for name in imported_names(path)]
        within = {parts[2] for parts in names if parts[:2] == ["hrt_cli", "steering"] and len(parts) > 2}
        wrong = within - arrows[path.parent.name] - {path.parent.name}
        assert not wrong, f"{path} imports {sorted(wrong)}, which docs/architecture.md does not allow"


@pytest.mark.parametrize("rooms", ["room", "inside steering"])
def test_the_arrows_have_no_circle(rooms: str) -> None:
    arrows = allowed_arrows(rooms)
    done: set[str] = set()
    while ready := {room for room, targets in arrows.items() if targets <= done} - done:
        done |= ready
    assert done == set(arrows), f"a circle among {sorted(set(arrows) - done)}"


def test_no_modules_import_each_other_in_a_circle() -> None:
    modules = {module_name(path): path for path in sources()}
    graph = {name: (imported_names(path) & set(modules)) - {name} for name, path in modules.items()}
    assert sum(map(len, graph.values())) > len(modules)
    TopologicalSorter(graph).prepare()  # raises CycleError, which names them


def test_every_module_has_its_place_in_the_table_of_rooms() -> None:
    told = {row[1]: set(re.findall(r"`([a-z_0-9]+)`", row[2])) for row in table("| room | modules |", MODULES_ROW)}
    for room, names in told.items():
        there = {path.stem for path in (ROOT / "hrt_cli" / room).glob("*.py")} - {"__init__"}
        assert there == names, f"{room}: {sorted(there ^ names)}"
    rooms = {str(path.parent.relative_to(ROOT / "hrt_cli")) for path in (ROOT / "hrt_cli").glob("*/**/*.py")}
    assert rooms - {"steering", "report"} == set(told)


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
