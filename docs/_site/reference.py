"""Pages of the API reference: every public name of every room, by its own docstring."""

import importlib
import inspect
import re
import shutil
from pathlib import Path
from types import ModuleType

import tables
from docstrings import escaped
from retrax.retractions import RetractionFamily
from uses import used

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


def write(folder: Path) -> None:
    """Write a page for each room, the table of manifolds and retractions, and the page that lists them."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for room, title in ROOMS.items():
        module = importlib.import_module(f"retrax.{room}")
        lines = [title, "=" * len(title), "", f".. module:: retrax.{room}", ""]
        for name in sorted(own(module), key=str.lower):
            lines += entry(module, name)
        (folder / f"{room}.rst").write_text("\n".join(lines) + "\n")
    (folder / "table.rst").write_text("\n".join(tables.table()) + "\n")
    rows = "\n".join(f"   {page}" for page in (*ROOMS, "table"))
    (folder / "index.rst").write_text(f"Reference\n=========\n\n.. toctree::\n   :maxdepth: 1\n\n{rows}\n")


def own(module: ModuleType) -> set[str]:
    """The public names of a room, without the names of a room above, or of the retractions, which are there."""
    above = module.__name__.rpartition(".")[0]
    elsewhere = "retrax.retractions" if module.__name__ == "retrax.integrators" else above
    known = () if elsewhere == "retrax" else importlib.import_module(elsewhere).__all__
    return set(module.__all__) - set(known)


def entry(module: ModuleType, name: str) -> list[str]:
    """What documents a public name."""
    thing, path = getattr(module, name), f"{module.__name__}.{name}"
    places = [link(place) for place in used(module.__name__.partition(".")[2], name)]
    where = [f"   Used in {', '.join(places)}.", ""] if places else []
    if inspect.isclass(thing) or inspect.isroutine(thing):
        return [f".. auto{'class' if inspect.isclass(thing) else 'function'}:: {path}", "", *where]
    if isinstance(thing, RetractionFamily):
        kinds = ", ".join(kind.__name__ for kind in thing._members)
        words = f"The ``RetractionFamily`` of this name, for {kinds}, and products and powers."
    else:
        words = escaped(comment(module, name))
    return [f".. data:: {name}", "", f"   {words}", "", *where]


def link(document: str) -> str:
    """A link to a page by its title, to an example by its file: titles of examples are sentences."""
    folder, _, name = document.rpartition("/")
    return f":doc:`{name}.py <{document}>`" if folder == "/examples" else f":doc:`{document}`"


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
