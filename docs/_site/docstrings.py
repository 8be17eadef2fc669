"""Docstrings as reStructuredText: formulas that are set off become literal blocks, and signs of mathematics outside of
roles are escaped."""

import re
from typing import Any

LITERAL = re.compile(r"(``.*?``|:[\w:]+:`[^`]*`)", re.DOTALL)
ARRAY = re.compile(r"\b(jax\.)?jaxlib\.\w+\.Array\b")
MARKUP = re.compile(r"([|*\\]|(?<=\w)_(?!\w))")
# Sections of numpydoc whose entries are indented below names; napoleon, which reads them next, escapes the names.
ENTRIES = ("Parameters", "Other Parameters", "Returns", "Yields", "Raises", "Warns", "Attributes")


def process(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Change the lines of a docstring in place."""
    from sphinx.ext.napoleon import Config, NumpyDocstring  # other functions here need no Sphinx

    found: list[str] = []
    inside = shown = entries = False  # a literal block; an example; a section of names with indented descriptions
    lines[:] = held(lines)
    for place, line in enumerate(lines):
        if place + 1 < len(lines) and re.fullmatch("-{3,}", lines[place + 1]):
            described = line in DESCRIBED
        before = next((earlier for earlier in reversed(found) if earlier.strip()), "")
        if set(line) == {"-"} and found:  # the line below the heading of a section
            entries, inside = found[-1] in ENTRIES, False
            found.append(line)
            continue
        if not line.strip():
            found.append(line)
            shown = False
            continue
        if entries:
            found.append(escaped(line) if line.startswith("    ") else line)
            continue
        if line.startswith("    ") and not shown:
            if not inside and not before.rstrip().endswith("::") and place and not found[-1].strip():
                found += ["::", ""]
            inside = inside or not found[-1].strip() or before.startswith(".. math::")
            found.append(line if inside else escaped(line))
            continue
        inside = False
        shown = shown or line.startswith(">>>")  # with what it prints, up to an empty line
        found.append(line if shown or line.startswith(".. ") else escaped(line))
    lines[:] = found


def held(lines: list[str]) -> list[str]:
    """The lines with each role on one line: formulas may be broken where lines are."""
    return LITERAL.sub(lambda role: " ".join(role[0].split()), "\n".join(lines)).split("\n")


def sign(app: Any, what: str, name: str, thing: Any, options: Any, signature: str | None, value: str | None) -> Any:
    """The signature with the name under which JAX gives its arrays to its users."""
    return tuple(text and ARRAY.sub("Array", text) for text in (signature, value))


def escaped(text: str) -> str:
    """The text with the signs of markup escaped, where it is no literal and no role."""
    parts = LITERAL.split(text)
    return "".join(part if LITERAL.fullmatch(part) else MARKUP.sub(r"\\\1", part) for part in parts)
