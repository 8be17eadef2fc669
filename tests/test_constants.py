"""Every numeric constant has a comment: what it is, in which unit, and why it has this value; and a name of its own."""

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = "manifolds", "retractions", "integrators", "src/retrax"


def is_numeric(value: ast.expr) -> bool:
    """Whether an expression is made of numbers and of names of other constants."""
    match value:
        case ast.Constant(value=number):
            return isinstance(number, int | float | complex) and not isinstance(number, bool)
        case ast.UnaryOp(operand=operand):
            return is_numeric(operand)
        case ast.BinOp(left=left, right=right):
            sides = [side for side in (left, right) if not isinstance(side, ast.Name | ast.Attribute)]
            return bool(sides) and all(map(is_numeric, sides))
        case ast.Tuple(elts=elements):
            return bool(elements) and all(map(is_numeric, elements))
    return False


def comment_lines(source: str) -> set[int]:
    """The lines of a module with a comment."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {token.start[0] for token in tokens if token.type == tokenize.COMMENT}


def uncommented(source: str) -> Iterator[str]:
    """The constants of a module without a comment on their lines, or above them or their neighbours."""
    commented, covered = comment_lines(source), -1
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and is_numeric(node.value):
            first, last = node.lineno, node.end_lineno or node.lineno
            if not commented.isdisjoint(range(first, last + 1)) or first - 1 in commented or covered == first - 1:
                covered = last if first - 1 in commented or covered == first - 1 else -1
            else:
                yield ast.unparse(node)


def defined(path: Path) -> set[str]:
    """The numeric constants of a module or of a file of C."""
    text = path.read_text()
    if path.suffix == ".c":
        return set(re.findall(r"^#define (\w+) \(?[-\d]", text, re.MULTILINE))
    names = set[str]()
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and is_numeric(node.value):
            names |= {name.id for name in ast.walk(node.targets[0]) if isinstance(name, ast.Name) and name.id.isupper()}
    return names


@pytest.mark.parametrize("suffix", ["py", "c"])
def test_one_name_is_one_constant(suffix):
    paths = {path for room in (*ROOMS, "src/core") for path in (ROOT / room).rglob(f"*.{suffix}")}
    counts = Counter(name for path in paths for name in defined(path))
    assert len(counts) > 90
    assert not {name for name, count in counts.items() if count > 1}


@pytest.mark.parametrize("room", ROOMS)
def test_every_constant_has_a_comment(room):
    paths = (ROOT / room).rglob("*.py")
    assert not {str(path.relative_to(ROOT)): found for path in paths if (found := [*uncommented(path.read_text())])}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("A = 1", ["A = 1"]),
        ("A = 1  # s", []),
        ("# Steps.\nA = 1\nB = 2", []),
        ("# Steps.\n\nA, B = 1, 2", ["A, B = (1, 2)"]),
        ("A = EPS**0.5\nB = EPS", ["A = EPS ** 0.5"]),
        ("A = -1e-3\nkind = int | float", ["A = -0.001"]),
    ],
)
def test_a_constant_without_a_comment_is_found(source, found):
    assert list(uncommented(source)) == found
