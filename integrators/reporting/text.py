"""Text that reports print: two columns, lines of a width, counted nouns."""

from collections.abc import Iterable
from math import prod
from textwrap import wrap

Line = tuple[str, str]
WIDTH = 110  # characters of a line of text
LONGEST_VALUE = 80  # characters of a value in a message
MOST_SHOWN_ENTRIES = 4  # of an array that a message shows entry by entry


def table(lines: list[Line]) -> str:
    """Names and texts in two columns, the second at most ``WIDTH`` wide."""
    width = max(len(name) for name, _ in lines) + 2
    return "\n".join(f"{name:<{width}}" + ("\n" + " " * width).join(_wrap(text)) for name, text in lines)


def clauses(parts: Iterable[str]) -> str:
    """Sentences that begin a line each, of at most ``WIDTH`` characters; lines that continue one are indented."""
    return ";\n".join("\n  ".join(_wrap(part)) for part in parts)


def _wrap(text: str) -> list[str]:
    lines = (wrap(line, WIDTH, break_long_words=False, break_on_hyphens=False) for line in text.splitlines())
    return [piece for pieces in lines for piece in pieces] or [""]


def plural(count: int, noun: str) -> str:
    """``1 point``, ``2 points``."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


def in_line(value: object) -> str:
    """The text of a value, such as a tuple of arrays, without line breaks."""
    return " ".join(str(value).split())


def brief(value: object) -> str:
    """A value on one line, as messages show what came: a long array by its shape, other values cut after 80
    characters."""
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple) and prod(shape) > MOST_SHOWN_ENTRIES:
        return f"an array of shape {shape}"
    text = in_line(repr(value))
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."
