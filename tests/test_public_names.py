"""What the docstring of each public name says, and what it lacks: words, shapes, errors, a source or equation, an
example."""

import ast
import doctest
import importlib
import inspect
import io
import re
import tempfile
import textwrap
import tomllib
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import retrax

ROOT = Path(__file__).parents[1]
ROOMS = (
    "manifolds",
    "manifolds.symplectic",
    "retractions",
    "integrators",
    "integrators.singular",
    "problems",
    "sweeps",
    "plotting",
    "interop",
    "testing",
    "tape",
)
RECORD = Path(__file__).parent / "lacking.toml"
RECORDED = tomllib.loads(RECORD.read_text())
ARRAYS = re.compile(r"\b(Array|ArrayLike|ndarray)\b")
SIZED = re.compile(r'(Float|Int|Bool|Complex)\[[^\]]*"')  # jaxtyping writes the shape in the annotation
SHAPE = re.compile(r"shape|``\([A-Za-z]|\bscalar\b|\bleaves\b|\baxis\b|\bmatri|\bnumbers?\b")
SOURCE = re.compile(r":math:`|``[^`]*(=|->|<=|\^)[^`]*``|\[[A-Z][^\]]*\d{4}|\b(19|20)\d{2}\b|^    \S", re.MULTILINE)


@cache
def code() -> str:
    """The code of the pages and of the examples."""
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    blocks = [
        block
        for page in pages
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    ]
    return "\n".join([*blocks, *(path.read_text() for path in (ROOT / "examples").glob("*.py"))])


def raises(thing: object) -> bool:
    """Whether the function, or the constructor of the class, raises errors itself."""
    function = thing.__dict__.get("__init__") if inspect.isclass(thing) else inspect.unwrap(thing)
    if function is None or not hasattr(inspect.unwrap(function), "__code__"):
        return False
    try:
        source = textwrap.dedent(inspect.getsource(inspect.unwrap(function)))
    except OSError:  # made by dataclasses
        return False
    return any(isinstance(node, ast.Raise) and node.exc is not None for node in ast.walk(ast.parse(source)))


def takes_arrays(thing: object) -> bool:
    """Whether arguments or values are arrays, of a function or of the fields of a class, without a shape in the
    annotation."""
    notes = inspect.get_annotations(thing if inspect.isclass(thing) else inspect.unwrap(thing))
    texts = [note if isinstance(note, str) else str(note) for note in notes.values()]
    return any(ARRAYS.search(text) and not SIZED.search(text) for text in texts)


def lacks(name: str, thing: object, is_mathematics: bool = True) -> set[str]:
    """What the documentation of a public name lacks; a source or an equation where it ``is_mathematics``."""
    if not (inspect.isclass(thing) or inspect.isroutine(thing)):
        return set() if re.search(rf"\b{name}\b", code()) else {"example"}
    words = inspect.getdoc(thing) or ""
    own = not inspect.isclass(thing) or "__doc__" in vars(thing)
    found = set() if words and own and not words.startswith(f"{name}(") else {"words"}
    if takes_arrays(thing) and not SHAPE.search(words):
        found.add("shapes")
    if raises(thing) and not re.search(r"\braises?\b|Error", words, re.IGNORECASE):
        found.add("errors")
    error = inspect.isclass(thing) and issubclass(thing, Exception)
    if is_mathematics and not error and not SOURCE.search(words):
        found.add("source")
    if not re.search(rf"\b{name}\b", code()) and not re.search(r"::$|>>>", words, re.MULTILINE):
        found.add("example")
    return found


def lacking(room: str) -> dict[str, list[str]]:
    """The public names of a room, without the names of a room above, by what their documentation lacks."""
    module, above = importlib.import_module(f"retrax.{room}"), room.rpartition(".")[0]
    known = set(importlib.import_module(f"retrax.{above}").__all__) if above else set()
    found: dict[str, list[str]] = {}
    for name in sorted(set(module.__all__) - known):
        for what in lacks(name, getattr(module, name), room.startswith(("manifolds", "retractions"))):
            found.setdefault(what, []).append(name)
    return {what: found[what] for what in sorted(found)}


@pytest.mark.parametrize("room", ROOMS)
def test_no_public_name_lacks_more_than_is_recorded(room):
    recorded = RECORDED.get(room, {})
    new = {what: sorted(set(names) - set(recorded.get(what, []))) for what, names in lacking(room).items()}
    assert not any(new.values()), (
        f"{new}: write it in the docstring; for an example, use the name in a page or an example"
    )


@cache
def names_of_examples() -> dict[str, object]:
    """What the examples of docstrings have imported: ``jax``, ``jnp``, ``np``, and the names of the first rooms."""
    modules = [importlib.import_module(f"retrax.{room}") for room in ROOMS[:4]]
    found = {name: getattr(module, name) for module in modules for name in module.__all__}
    return {**found, "load": retrax.load, "jax": jax, "jnp": jnp, "np": np, "tempfile": tempfile}


@pytest.mark.parametrize("room", [*ROOMS, ""])
def test_the_examples_of_docstrings_print_what_they_say(room):
    module = importlib.import_module(f"retrax.{room}") if room else retrax
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL)
    printed = io.StringIO()
    for name in module.__all__ if room else ["load"]:
        words = inspect.getdoc(getattr(module, name)) or ""
        test = doctest.DocTestParser().get_doctest(words, dict(names_of_examples()), name, None, 0)
        runner.run(test, out=printed.write)
    assert not runner.failures, printed.getvalue()


def without_a_word(x):
    return x


def with_all(x):
    """Twice a number ``y = 2 x``; raises ``ValueError`` for none.

    >>> with_all(1)
    """
    if x is None:
        raise ValueError("none")
    return 2 * x


def raising(x: "np.ndarray"):
    """Twice."""
    raise ValueError(x)


def test_the_test_sees_what_lacks():
    assert lacks("without_a_word", without_a_word) == {"words", "source", "example"}
    assert lacks("with_all", with_all) == set()
    assert lacks("raising", raising) == {"shapes", "errors", "source", "example"}
    assert lacks("solve", raising) == {"shapes", "errors", "source"}
    assert lacks("solve", raising, is_mathematics=False) == {"shapes", "errors"}


def write() -> None:
    """Record what is lacking now, instead of what was."""
    lines = ["# Public names whose documentation lacks something; python tests/test_public_names.py writes this list."]
    for room in ROOMS:
        lines += ["", f'["{room}"]' if "." in room else f"[{room}]"]
        for what, names in lacking(room).items():
            lines += [f"{what} = [", *(f'    "{name}",' for name in names), "]"]
    RECORD.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    write()
