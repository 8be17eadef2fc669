"""Docstrings as reStructuredText: formulas that are set off become literal blocks, and signs of mathematics are no
markup."""

import re
from typing import Any

LITERAL = re.compile(r"(``.*?``)")
ARRAY = re.compile(r"\b(jax\.)?jaxlib\.\w+\.Array\b")
MARKUP = re.compile(r"([|*\\]|(?<=\w)_(?!\w))")


def process(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Change the lines of a docstring in place."""
    found: list[str] = []
    inside = shown = False  # a literal block; an example
    for place, line in enumerate(lines):
        before = next((earlier for earlier in reversed(found) if earlier.strip()), "")
        if not line.strip():
            found.append(line)
            shown = False
            continue
        if line.startswith("    ") and not shown:
            if not inside and not before.rstrip().endswith("::") and place and not found[-1].strip():
                found += ["::", ""]
            inside = inside or not found[-1].strip()
            found.append(line if inside else escaped(line))
            continue
        inside = False
        shown = shown or line.startswith(">>>")  # with what it prints, up to an empty line
        found.append(line if shown else escaped(line))
    lines[:] = found


def sign(app: Any, what: str, name: str, thing: Any, options: Any, signature: str | None, value: str | None) -> Any:
    """The signature with the name under which JAX gives its arrays to its users."""
    return tuple(text and ARRAY.sub("Array", text) for text in (signature, value))


def escaped(line: str) -> str:
    """The line with the signs of markup escaped, where it is no literal."""
    parts = LITERAL.split(line)
    return "".join(part if part.startswith("``") else MARKUP.sub(r"\\\1", part) for part in parts)
