"""The first sentence of every docstring names its subject by a noun, in at most 25 words."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = "manifolds", "retractions", "integrators", "src/retrax"
FORMULA = re.compile(r"``[^`]*``|:\w+:`[^`]*`|`[^`]*`")
BEGINNINGS = re.compile(r"(What|That|Those|Of|Whose|Which|The same)\b")
# Pronouns whose noun is in no sentence before; after a few words ``it`` may stand for the subject.
PRONOUNS = re.compile(r"\b(that of|those|others|(?<!zeros, )ones)\b|^(\S+ ){0,3}it\b", re.IGNORECASE)
MOST_WORDS = 25


def first_sentence(docstring: str) -> str:
    """The first sentence of a docstring, in which formulas are one word each."""
    words = FORMULA.sub("FORMULA", " ".join(docstring.strip().partition("\n\n")[0].split()))
    return re.split(r"(?<=[.!?]) +(?=[A-Z])", words)[0]


def faults(sentence: str) -> list[str]:
    """The rules that a first sentence breaks."""
    count, pronoun = len(sentence.split()), PRONOUNS.search(sentence)
    found = ["begins with no noun"] if BEGINNINGS.match(sentence) else []
    found += [f"has {pronoun[0]!r} instead of a noun"] if pronoun else []
    found += [f"has {count} words"] if count > MOST_WORDS else []
    return found + (["has several colons or semicolons"] if len(re.findall(r"[:;](?= |$)", sentence)) > 1 else [])


def docstrings(path: Path) -> Iterator[tuple[str, str]]:
    """The places and the docstrings of a module, its classes and its functions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            words = ast.get_docstring(node)
            if words:
                yield f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}", words


@cache
def broken(room: str) -> dict[str, tuple[str, list[str]]]:
    """The first sentences of a folder that break a rule, with the rules."""
    found = [
        (place, first_sentence(words)) for path in (ROOT / room).rglob("*.py") for place, words in docstrings(path)
    ]
    return {place: (words, faults(words)) for place, words in found if faults(words)}


@pytest.mark.parametrize("room", ROOMS)
def test_the_first_sentence_of_every_docstring_names_its_subject(room):
    wrong = broken(room)
    assert not wrong, "\n".join(f"{place}: {words[0]} ({', '.join(words[1])})" for place, words in wrong.items())


@pytest.mark.parametrize(
    ("sentence", "fault"),
    [
        ("What is kept of a step.", "begins with no noun"),
        ("Of each entry the name.", "begins with no noun"),
        ("The same on another mesh.", "begins with no noun"),
        ("The values, and those of the end.", "has 'those' instead of a noun"),
        ("A point and random ones.", "has 'ones' instead of a noun"),
        ("Whether it converges.", "has 'Whether it' instead of a noun"),
        (" ".join(["word"] * 26), "has 26 words"),
        ("A: b; c.", "has several colons or semicolons"),
    ],
)
def test_a_sentence_that_breaks_a_rule_is_found(sentence, fault):
    assert faults(sentence) == [fault]


def test_a_sentence_of_a_textbook_passes():
    words = "Matrix of zeros, ones and ``it``, of ``a: b; c``, if it is regular. What follows is free."
    assert faults(first_sentence(words)) == []
