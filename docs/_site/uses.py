"""Where the pages and the examples use a public name, for its entry in the reference."""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import retrax

DOCS = Path(__file__).parents[1]
MOST = 3  # pages that are named


def used(room: str, name: str) -> list[str]:
    """The documents that use a public name of a room most often, as Sphinx names them."""
    counts = {document: found[room, name] for document, found in _uses().items() if found[room, name]}
    return sorted(counts, key=lambda document: (-counts[document], document))[:MOST]


@cache
def _uses() -> dict[str, Counter[tuple[str, str]]]:
    """How often each document uses names, by the rooms from which it imports them."""
    texts = {f"/{page.stem}": "\n".join(blocks(page.read_text())) for page in sorted(DOCS.glob("*.md"))}
    texts |= {f"/examples/{path.stem}": path.read_text() for path in sorted((DOCS.parent / "examples").glob("*.py"))}
    return {document: count(text) for document, text in texts.items()}


def blocks(page: str) -> list[str]:
    """The Python code of a page."""
    return re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)


def count(text: str) -> Counter[tuple[str, str]]:
    """How often code uses the names that it imports from rooms, and attributes of rooms that it imports and of the
    package, by room and name."""
    nodes, names, rooms, packages = (
        list(ast.walk(ast.parse(text))),
        dict[str, tuple[str, str]](),
        dict[str, str](),
        set(),
    )
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "retrax":
            room = str(node.module).partition(".")[2]
            for alias in node.names:
                if room:
                    names[alias.asname or alias.name] = room, alias.name
                else:
                    rooms[alias.asname or alias.name] = alias.name
        elif isinstance(node, ast.Import):
            packages |= {alias.asname or alias.name for alias in node.names if alias.name == "retrax"}
    uses = [names[node.id] for node in nodes if isinstance(node, ast.Name) and node.id in names]
    for node in (node for node in nodes if isinstance(node, ast.Attribute)):
        owner = ast.unparse(node.value)
        package, _, inner = owner.partition(".")
        if owner in rooms:
            uses.append((rooms[owner], node.attr))
        elif owner in packages and node.attr in _everyday():
            uses.append((_everyday()[node.attr], node.attr))
        elif package in packages and inner in retrax.__all__ and inner not in _everyday():
            uses.append((inner, node.attr))
    return Counter(uses)


@cache
def _everyday() -> dict[str, str]:
    """The rooms of the names that the package itself has."""
    rooms = {room: getattr(retrax, room) for room in ("integrators", "manifolds", "retractions")}
    return {name: room for room, module in rooms.items() for name in set(module.__all__) & set(retrax.__all__)}
