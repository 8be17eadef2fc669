"""The numpydoc sections of public names: every argument is documented, in the order of the signature."""

import inspect
import re

import pytest
from retrax.interop.isolated_import import import_peer

ROOMS = (
    "retrax",
    "retrax.manifolds",
    "retrax.manifolds.symplectic",
    "retrax.retractions",
    "retrax.integrators",
    "retrax.integrators.singular",
    "retrax.problems",
    "retrax.sweeps",
    "retrax.plotting",
    "retrax.interop",
    "retrax.interop.geomstats",
    "retrax.interop.pymanopt",
    "retrax.testing",
    "retrax.tape",
)
PRONOUNS = "What", "That", "Those", "Of", "Whose", "Which"
MOST_WORDS = 25


def section(words: str, title: str) -> list[str]:
    """The names in a section of a docstring, in order."""
    found = re.search(rf"^{title}\n-+\n(.*?)(?=^\S[^\n]*\n-+\n|\Z)", words, re.DOTALL | re.MULTILINE)
    heads = [line for line in (found[1] if found else "").splitlines() if line and not line.startswith((" ", ">>>"))]
    return [name.strip().lstrip("*") for head in heads for name in head.partition(" : ")[0].split(",")]


def arguments(thing: object) -> list[str]:
    """The names of the arguments of a function or a constructor, without self."""
    if inspect.isclass(thing) and issubclass(thing, Exception) and "__init__" not in vars(thing):
        return []
    return [name for name in inspect.signature(thing).parameters if name not in ("self", "cls")]


def has_section(thing: object, title: str = "Parameters") -> bool:
    """Whether a docstring has a section."""
    return f"{title}\n---" in (inspect.getdoc(thing) or "")


def in_order(names: list[str], among: list[str]) -> bool:
    """Whether the names are among others, in this order."""
    rest = iter(among)
    return all(name in rest for name in names)


def undocumented(thing: object) -> str:
    """How the sections differ from the signature, or the summary from the rules; empty if they do not."""
    words, expected = inspect.getdoc(thing) or "", arguments(thing)
    is_record = inspect.isclass(thing) and has_section(thing, "Attributes") and not has_section(thing)
    summary = " ".join(words.partition("\n\n")[0].split())
    sentence = re.sub(r"``[^`]*``|:math:`[^`]*`", "formula", re.split(r"(?<=[.;:]) (?=[A-Z])", summary)[0])
    if not summary.endswith(".") or summary.startswith(PRONOUNS) or len(sentence.split()) > MOST_WORDS:
        return f"has the summary {summary!r}, expected a sentence of at most {MOST_WORDS} words that names its subject"
    if is_record:
        listed = section(words, "Attributes")
        return "" if in_order(expected, listed) else f"lists the attributes {listed}, expected {expected}"
    listed = section(words, "Parameters")
    return "" if listed == expected else f"documents the arguments {listed}, expected {expected}"


def public(room: str) -> dict[str, object]:
    """The public classes and functions of a room."""
    module = import_peer(room)
    found = {name: getattr(module, name) for name in module.__all__}
    return {name: thing for name, thing in found.items() if inspect.isclass(thing) or inspect.isfunction(thing)}


def methods(kind: type) -> dict[str, object]:
    """The public methods with arguments that a class defines with a docstring of its own."""
    found = {name: getattr(kind, name) for name, own in vars(kind).items() if not isinstance(own, property)}
    own = {name: f for name, f in found.items() if inspect.isfunction(f) or inspect.ismethod(f)}
    named = {name: f for name, f in own.items() if (not name.startswith("_") or name == "__call__") and f.__doc__}
    return {name: function for name, function in named.items() if arguments(function)}


def undocumented_method(kind: type, name: str) -> str:
    """How the sections of a method differ from its signature; empty if a base class documents the same arguments."""
    method = getattr(kind, name)
    inherited = [getattr(base, name) for base in kind.__mro__[1:] if name in vars(base)]
    same = any(not undocumented(other) and arguments(other) == arguments(method) for other in inherited)
    return "" if same and not has_section(method) else undocumented(method)


@pytest.mark.parametrize("room", ROOMS)
def test_every_argument_of_a_public_name_is_documented(room):
    wrong = {name: undocumented(thing) for name, thing in public(room).items()}
    assert not {name: words for name, words in wrong.items() if words}


@pytest.mark.parametrize("room", ROOMS)
def test_every_argument_of_a_method_is_documented(room):
    pairs = [(kind, name) for kind in public(room).values() if inspect.isclass(kind) for name in methods(kind)]
    wrong = {f"{kind.__name__}.{name}": undocumented_method(kind, name) for kind, name in pairs}
    assert not {name: words for name, words in wrong.items() if words}


def documented(first, second=1, *others):
    """A sum of numbers.

    Parameters
    ----------
    first, second : float
        Two numbers.
    *others : float
        More numbers.

    Returns
    -------
    float
        The sum.
    """
    return first + second + sum(others)


def test_a_missing_argument_is_found():
    assert undocumented(documented) == ""

    def lacks_one(first, second, third, *others):
        pass

    def has_another_order(second, first, *others):
        pass

    lacks_one.__doc__ = has_another_order.__doc__ = documented.__doc__
    assert "expected ['first', 'second', 'third', 'others']" in undocumented(lacks_one)
    assert "expected ['second', 'first', 'others']" in undocumented(has_another_order)


@pytest.mark.parametrize("summary", ["", "What it is.", "No full stop", " ".join(["word"] * 26) + "."])
def test_a_summary_that_names_nothing_is_found(summary):
    def function():
        pass

    function.__doc__ = summary
    assert "expected a sentence" in undocumented(function)
