"""Mutants of the library, drawn at random: first a line, then one of the operators of Cosmic Ray that change it."""

import ast
import random
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator, operator_names

FOLDERS = ("manifolds", "retractions", "integrators", "src/retrax/tape")
# Operators that need an argument, and shifts of bits, which raise a TypeError for numbers that are not whole.
LEFT_OUT = ("VariableReplacer", "VariableInserter", "Shift")


@dataclass(frozen=True)
class Mutant:
    """One change of one line: the file, the line's number from 1, the operator and its occurrence in the file."""

    file: str
    line: int
    operator: str
    occurrence: int

    def code(self, root: Path) -> tuple[str, str]:
        """The file's text as it is, and with the change."""
        right = (root / self.file).read_text()
        return right, mutate_code(right, get_operator(self.operator)(), self.occurrence)

    def difference(self, root: Path) -> tuple[str, str]:
        """The first line that differs, as it is and changed."""
        right, wrong = (text.splitlines() for text in self.code(root))
        return next((a.strip(), b.strip()) for a, b in zip(right, wrong, strict=False) if a != b)

    def is_python(self, root: Path) -> bool:
        """Whether the change leaves a file that Python can read."""
        try:
            ast.parse(self.code(root)[1])
        except SyntaxError:
            return False
        return True


def operators() -> dict[str, Operator]:
    """The operators that are drawn from, by name."""
    return {name: get_operator(name)() for name in operator_names() if not any(word in name for word in LEFT_OUT)}


def statements(text: str) -> set[int]:
    """The numbers of the lines that run when the library is used: of functions, without annotations and signatures."""
    lines: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines.update(number for part in node.body for number in range(part.lineno, part.end_lineno + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines.difference_update(range(node.lineno, node.body[0].lineno))
        elif isinstance(node, ast.AnnAssign):
            lines.discard(node.lineno)
    return lines


def mutants(root: Path, file: str) -> dict[int, list[Mutant]]:
    """All mutants of a file, by line."""
    text = (root / file).read_text()
    lines, found = statements(text), {}
    nodes = list(ast_nodes(get_ast(text)))
    for name, operator in operators().items():
        occurrence = 0
        for node in nodes:
            for (line, _), _ in operator.mutation_positions(node):
                if line in lines:
                    found.setdefault(line, []).append(Mutant(file, line, name, occurrence))
                occurrence += 1
    return found


def drawn(root: Path, count: int, seed: int) -> list[Mutant]:
    """Mutants of different lines, each line as likely as any other that an operator changes."""
    files = sorted(str(path.relative_to(root)) for folder in FOLDERS for path in (root / folder).rglob("*.py"))
    lines = [(line, found) for file in files for line, found in sorted(mutants(root, file).items())]
    chance = random.Random(seed)
    return [chance.choice(found) for _, found in chance.sample(lines, count)]
