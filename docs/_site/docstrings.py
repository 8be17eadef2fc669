"""Docstrings as reStructuredText: formulas that are set off become literal blocks, and signs of mathematics are no
markup. Napoleon makes fields of the sections of numpydoc."""

import re
from typing import Any

LITERAL = re.compile(r"(``.*?``|:math:`[^`]*`)")
DESCRIBED = "Parameters", "Attributes", "Returns", "Raises"  # sections of numpydoc with indented descriptions
# Attributes as a list: as directives they would be there twice.
NAPOLEON = {"napoleon_use_rtype": False, "napoleon_custom_sections": [("Attributes", "returns_style")]}
ARRAY = re.compile(r"\b(jax\.)?jaxlib\.\w+\.Array\b")
MARKUP = re.compile(r"([|*\\]|(?<=\w)_(?!\w))")


def process(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Change the lines of a docstring in place."""
    from sphinx.ext.napoleon import Config, NumpyDocstring  # other functions here need no Sphinx

    found: list[str] = []
    inside = shown = described = False  # a literal block; an example; a section with indented descriptions
    lines[:] = joined(lines)
    for place, line in enumerate(lines):
        if place + 1 < len(lines) and re.fullmatch("-{3,}", lines[place + 1]):
            described = line in DESCRIBED
        before = next((earlier for earlier in reversed(found) if earlier.strip()), "")
        if not line.strip():
            found.append(line)
            shown = False
            continue
        if line.startswith("    ") and not shown and not described:
            if not inside and not before.rstrip().endswith("::") and place and not found[-1].strip():
                found += ["::", ""]
            inside = inside or not found[-1].strip() or before.startswith(".. math::")
            found.append(line if inside else escaped(line))
            continue
        inside = False
        shown = shown or line.startswith(">>>")  # with what it prints, up to an empty line
        found.append(line if shown else escaped(line))
    is_value = what in ("attribute", "data", "property")  # whose colons are no fields
    lines[:] = found if is_value else NumpyDocstring(found, Config(**NAPOLEON), app, what, name, thing, options).lines()


def joined(lines: list[str]) -> list[str]:
    """The lines of a docstring, with each formula on one line."""
    text = re.sub(r":math:`[^`]*`", lambda formula: " ".join(formula[0].split()), "\n".join(lines))
    return text.split("\n")


def prose(text: str) -> list[str]:
    """The paragraphs of a docstring: its summary and its notes, without other sections and examples."""
    _, *sections = re.split(r"(?m)^(?=\w+\n-{3,}$)", text)
    first = re.split(r"(?m)^\w+\n-{3,}$", text, maxsplit=1)[0]
    notes = "\n\n".join(part.split("\n", 2)[2] for part in sections if part.startswith("Notes\n"))
    parts = f"{first.strip()}\n\n{notes.strip()}".split("\n\n")
    return [" ".join(part.split()) for part in parts if part.strip() and not part.startswith(">>>")]


def sign(app: Any, what: str, name: str, thing: Any, options: Any, signature: str | None, value: str | None) -> Any:
    """The signature with the name under which JAX gives its arrays to its users."""
    return tuple(text and ARRAY.sub("Array", text) for text in (signature, value))


def escaped(line: str) -> str:
    """The line with the signs of markup escaped, where it is no literal or formula."""
    parts = LITERAL.split(line)
    return "".join(part if LITERAL.fullmatch(part) else MARKUP.sub(r"\\\1", part) for part in parts)
