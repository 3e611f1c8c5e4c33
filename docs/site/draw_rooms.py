"""Draw the rooms of this repository and who imports whom, from the sources: docs/images/rooms.svg.

Run it where an import between rooms has come or gone (`python docs/site/draw_rooms.py`); a test holds the picture
against the sources.
"""

from __future__ import annotations

import ast
import itertools
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "images" / "rooms.svg"
Graph = dict[str, set[str]]

WIDTH, BOX_WIDTH, BOX_HEIGHT, ROW_HEIGHT = 1000, 120, 34, 74
SWEEPS = 12  # more change nothing
TIP = (
    '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
    '<path d="M0 0L8 4L0 8z" fill="#7a8699"/></marker></defs>'
)


def room_of(module: str) -> str:
    """Return the room of a module: ``eldata.raw.levels`` is in ``raw``, ``capture.plan`` in ``capture``."""
    parts = module.split(".")
    return parts[0] if parts[0] == "capture" or len(parts) == 1 else parts[1]


def imported(tree: ast.AST) -> Iterator[str]:
    """Return what a module imports, at its top or inside of functions, for types or when it runs."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def rooms_that_import(root: Path = ROOT) -> Graph:
    """Return for each room the other rooms that it imports from."""
    graph: Graph = {}
    for path in sorted([*(root / "eldata").rglob("*.py"), *(root / "capture").rglob("*.py")]):
        if path.name == "__main__.py":  # which `python -m` alone runs
            continue
        room = room_of(".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"))
        names = imported(ast.parse(path.read_text(encoding="utf-8")))
        found = {room_of(name) for name in names if name.split(".")[0] in ("eldata", "capture") and name != "eldata"}
        graph.setdefault(room, set()).update(found)
    del graph["eldata"]  # the public front, which loads nothing by itself
    return {room: {other for other in found if other in graph} - {room} for room, found in graph.items()}


def levels_of(graph: Mapping[str, set[str]]) -> dict[str, int]:
    """Return how many rooms lie under each room on the longest way down; 0 imports from no other."""
    levels: dict[str, int] = {}

    def level(room: str) -> int:
        if room not in levels:
            levels[room] = 1 + max((level(other) for other in graph[room]), default=-1)
        return levels[room]

    for room in graph:
        level(room)
    return levels


def without_shortcuts(graph: Mapping[str, set[str]]) -> Graph:
    """Return the arrows that say something new: where A imports B and B imports C, one from A to C does not."""

    def below(room: str) -> set[str]:
        return graph[room].union(*(below(other) for other in graph[room]))

    return {room: found - set().union(*(below(other) for other in found)) for room, found in graph.items()}


def places_of(graph: Mapping[str, set[str]]) -> tuple[dict[str, tuple[float, float]], list[list[str]]]:
    """Return where the middle of each room's box lies, and each arrow as the names of the places that it goes through.

    A long arrow takes a place of its own in each row between (named ``cli>raw@3``), so that it leads past the boxes;
    rows are sorted by where their neighbours lie, down and up by turns.
    """
    levels = levels_of(graph)
    top = max(levels.values())
    ways = [
        [room, *(f"{room}>{other}@{level}" for level in range(levels[room] - 1, levels[other], -1)), other]
        for room in sorted(graph)
        for other in sorted(graph[room])
    ]
    on_level = dict(levels)
    on_level.update({name: int(name.partition("@")[2]) for way in ways for name in way[1:-1]})
    rows = [sorted(name for name in on_level if on_level[name] == level) for level in range(top + 1)]
    near: Graph = {name: set() for name in on_level}
    for way in ways:
        for one, other in itertools.pairwise(way):
            near[one].add(other)
            near[other].add(one)
    places: dict[str, tuple[float, float]] = {}

    def place(row: list[str]) -> None:
        for index, name in enumerate(row):
            places[name] = WIDTH * (index + 1) / (len(row) + 1), 30 + ROW_HEIGHT * (top - on_level[name])

    def middle(name: str, level: int) -> float:
        across = [places[other][0] for other in near[name] if on_level[other] == level]
        return sum(across) / len(across) if across else places[name][0]

    for row in rows:
        place(row)
    for _ in range(SWEEPS):
        for level in [*range(1, top + 1), *range(top - 1, -1, -1)]:
            rows[level].sort(key=lambda name: (middle(name, level - 1) + middle(name, level + 1), name))
            place(rows[level])
    return places, ways


def picture(graph: Mapping[str, set[str]]) -> str:
    """Return the rooms as an SVG: each above all that it imports."""
    places, ways = places_of(without_shortcuts(graph))
    height = 30 + max(y for _, y in places.values())
    arrows = []
    for way in ways:
        (x, y), *through, (to_x, to_y) = (places[name] for name in way)
        line = [(x, y + BOX_HEIGHT / 2), *through, (to_x, to_y - BOX_HEIGHT / 2 - 2)]
        points = " ".join(f"{x:.0f},{y:.0f}" for x, y in line)
        arrows.append(f'<polyline points="{points}" marker-end="url(#tip)"/>')
    boxes = []
    for room in sorted(graph):
        x, y = places[room]
        corner = f'x="{x - BOX_WIDTH / 2:.0f}" y="{y - BOX_HEIGHT / 2:.0f}"'
        boxes.append(f'<rect {corner} width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="6"/>')
        boxes.append(f'<text x="{x:.0f}" y="{y + 5:.0f}" fill="#1d2733" stroke="none">{room}</text>')
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" role="img">',
            "<title>The rooms, each above all that it imports</title>",
            TIP,
            '<rect width="100%" height="100%" fill="#ffffff"/>',
            '<g fill="none" stroke="#7a8699" stroke-width="1.2">',
            *arrows,
            "</g>",
            '<g fill="#eef3fb" stroke="#4a6fa5" font-family="sans-serif" font-size="15" text-anchor="middle">',
            *boxes,
            "</g>",
            "</svg>\n",
        ]
    )


if __name__ == "__main__":
    PICTURE.write_text(picture(rooms_that_import()), encoding="utf-8")
