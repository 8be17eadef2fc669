"""Pages of the API reference: one for every public name, by its own docstring, and tables of the names of a room."""

import importlib
import inspect
import re
import shutil
from pathlib import Path
from types import ModuleType

import retrax
import tables
from docstrings import LITERAL, escaped
from retrax.retractions import RetractionFamily
from uses import MOST, used

ROOMS = {
    "manifolds": "Manifolds",
    "manifolds.symplectic": "Forms, Lagrangian submanifolds and the Tulczyjew triple",
    "retractions": "Retractions and discretization maps",
    "integrators": "Integrators and solvers",
    "integrators.singular": "Classes of singular problems",
    "problems": "Problems with known optima",
    "sweeps": "Thousands of solves",
    "plotting": "Pictures and pages",
    "interop": "Doors to other libraries",
    "testing": "The conformance kit",
    "tape": "Functions as tapes of scalars",
}


TIERS = {
    "Everyday": "Names that ``import retrax`` has, or that three pages or examples use.",
    "Advanced": "",
    "For subclasses": "Abstract classes, from which a class of yours can inherit.",
}


def write(folder: Path) -> None:
    """Write a page for each public name, for each room its tables, and the page that lists the rooms."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for room, title in ROOMS.items():
        module = importlib.import_module(f"retrax.{room}")
        names = sorted(own(module), key=str.lower)
        for name in names:
            lines = [":orphan:", "", *heading(name), f".. currentmodule:: retrax.{room}", "", *entry(module, name)]
            lines += [f"More of :doc:`{title} <{room}>`."]
            (folder / f"{document(room, name, names)}.rst").write_text("\n".join(lines) + "\n")
        lines = [*heading(title), f".. module:: retrax.{room}", ""]
        for kind, words in TIERS.items():
            here = [name for name in names if tier(module, name) == kind]
            alone = len(here) == len(names)
            lines += listed(module, here, names, "All names" if alone else kind, "" if alone else words) if here else []
        (folder / f"{room}.rst").write_text("\n".join(lines) + "\n")
    (folder / "table.rst").write_text("\n".join(tables.table()) + "\n")
    rows = "\n".join(f"   {page}" for page in (*ROOMS, "table"))
    (folder / "index.rst").write_text(
        "\n".join([*heading("Reference"), ".. toctree::", "   :maxdepth: 1", "", rows, ""])
    )


def heading(title: str) -> list[str]:
    """A title and the line below it."""
    return [title, "=" * len(title), ""]


def document(room: str, name: str, names: list[str]) -> str:
    """The page of a name; file systems that ignore case need another one for a function with the name of a class."""
    alike = any(other != name and other.lower() == name.lower() for other in names)
    return f"{room}.{name}" + ("-function" if alike and name.islower() else "")


def tier(module: ModuleType, name: str) -> str:
    """The table in which a public name is."""
    if inspect.isabstract(getattr(module, name)):
        return "For subclasses"
    everyday = name in retrax.__all__ or len(used(module.__name__.partition(".")[2], name)) == MOST
    return "Everyday" if everyday else "Advanced"


def listed(module: ModuleType, here: list[str], names: list[str], kind: str, words: str) -> list[str]:
    """The table of a tier: names with links to their pages, and their first sentences."""
    room = module.__name__.removeprefix("retrax.")
    lines = [kind, "-" * len(kind), "", words, "", ".. list-table::", "   :widths: 30 70", ""]
    for name in here:
        lines += [f"   * - :doc:`{name} <{document(room, name, names)}>`", f"     - {summary(module, name)}"]
    return [*lines, ""]


def summary(module: ModuleType, name: str) -> str:
    """The first sentence of what documents a public name."""
    thing = getattr(module, name)
    if inspect.isclass(thing) or inspect.isroutine(thing):
        first = " ".join((inspect.getdoc(thing) or "").split("\n\n")[0].split())
        parts = LITERAL.split(first)  # text and, in turn, literals and formulas, in which no sentence ends
        end = next((k for k in range(0, len(parts), 2) if re.search(r"[.:;](\s|$)", parts[k])), len(parts) - 1)
        return escaped("".join(parts[:end]) + re.split(r"[.:;](?=\s|$)", parts[end])[0] + ".")
    return described(module, name)


def own(module: ModuleType) -> set[str]:
    """The public names of a room, without the names of a room above, or of the retractions, which are there."""
    above = module.__name__.rpartition(".")[0]
    elsewhere = "retrax.retractions" if module.__name__ == "retrax.integrators" else above
    known = () if elsewhere == "retrax" else importlib.import_module(elsewhere).__all__
    return set(module.__all__) - set(known)


def entry(module: ModuleType, name: str) -> list[str]:
    """What documents a public name."""
    thing, path = getattr(module, name), f"{module.__name__}.{name}"
    places = [f":doc:`{place}`" for place in used(module.__name__.partition(".")[2], name)]
    where = [f"Used in {', '.join(places)}.", ""] if places else []
    if inspect.isclass(thing) or inspect.isroutine(thing):
        return [f".. auto{'class' if inspect.isclass(thing) else 'function'}:: {path}", "", *where]
    return [f".. data:: {name}", "", f"   {described(module, name)}", "", *where]


def described(module: ModuleType, name: str) -> str:
    """A sentence on a constant or a family of retractions."""
    thing = getattr(module, name)
    if isinstance(thing, RetractionFamily):
        kinds = ", ".join(kind.__name__ for kind in thing._members)
        return f"The ``RetractionFamily`` of this name, for {kinds}, and products and powers."
    return escaped(comment(module, name))


def comment(module: ModuleType, name: str) -> str:
    """The comment behind the line that defines a constant, or above it; raises where there is none."""
    for path in sorted(Path(str(module.__file__)).parent.rglob("*.py")):
        text = path.read_text()
        found = re.search(rf"^{name}\b[^#\n]*=[^#\n]*# (.*)$", text, re.MULTILINE)
        found = found or re.search(rf"((?:^# .*\n)+)^{name}\b[^#\n]*=", text, re.MULTILINE)
        if found:
            words = " ".join(line.removeprefix("# ") for line in found[1].splitlines()).removesuffix(".")
            return words[0].upper() + words[1:] + "."
    raise LookupError(f"{module.__name__}.{name} has no comment at the line that defines it, expected what it is")
