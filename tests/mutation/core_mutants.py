"""Draws mutants of the compiled core, and counts how many of them the fast tests notice.

``python tests/mutation/core_mutants.py --count 60 --seed 1`` prints a line for each mutant, and those that no test
notices. A mutant is one change of one line of ``src/core``; it is noticed where it does not compile without warnings,
or a test of ``TESTS`` fails, crashes or does not end.
"""

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
ROOMS = ("manifolds", "retractions", "integrators")
TESTS = (
    "tests/core", "tests/tape", "tests/integrators/test_inequalities.py", "tests/integrators/test_arrival.py",
    "tests/integrators/test_no_minimum.py", "tests/integrators/test_phases.py", "tests/integrators/test_far_ends.py",
    "tests/integrators/test_poor_guesses.py", "tests/integrators/test_small_units.py",
    "tests/integrators/test_claims.py",
)  # fmt: skip
COMPILER = (
    "gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-shared",
    "-fPIC",
)  # fmt: skip
LONGEST = 900  # seconds for all tests of one mutant on a busy computer
# What stands in a line, and what takes its place.
CHANGES = (
    (r" < ", " <= "), (r" <= ", " < "), (r" > ", " >= "), (r" >= ", " > "), (r" < ", " > "), (r" > ", " < "),
    (r" == ", " != "), (r" != ", " == "), (r" && ", " || "), (r" \|\| ", " && "), (r" \+ ", " - "), (r" - ", " + "),
    (r" \* ", " / "), (r" \+= ", " -= "), (r" -= ", " += "), (r"\bfmax\(", "fmin("), (r"\bfmin\(", "fmax("),
    (r"\btrue\b", "false"), (r"\bfalse\b", "true"), (r"\b0\.0\b", "1.0"), (r"\b1\.0\b", "2.0"), (r"\b2\.0\b", "1.0"),
    (r"\b1\b", "2"), (r"\b0\b", "1"), (r"!(?=\w|\()", ""), (r"^( +)(\w+\(.*\));$", r"\1;"),
)  # fmt: skip


class Mutant(NamedTuple):
    """One change of one line of a file of the core; lines count from 1."""

    file: str
    line: int
    right: str
    wrong: str


def code_lines(text: str) -> Iterator[tuple[int, str]]:
    """The numbered lines inside functions."""
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("}"):
            inside = False
        if inside and not line.lstrip().startswith(("/*", "*", "#")):
            yield number, line
        inside = inside or (line.endswith("{") and line[0] not in " }/")


def drawn(count: int, seed: int) -> list[Mutant]:
    """Mutants of different lines, each line as likely as any other that something changes."""
    chance, lines = random.Random(seed), []
    for path in sorted((ROOT / "src" / "core").glob("*.c")):
        for number, line in code_lines(path.read_text()):
            code, *comment = line.partition("/*")
            found = [
                code[: at.start()] + at.expand(new) + code[at.end() :] + "".join(comment)
                for old, new in CHANGES
                for at in re.finditer(old, code)
            ]
            if found:
                lines.append([Mutant(path.name, number, line, wrong) for wrong in found])
    return [chance.choice(found) for found in chance.sample(lines, count)]


class CoreCopy:
    """A copy of the project whose core is compiled anew."""

    def __init__(self, folder: Path) -> None:
        self.tree, self.packages = folder / "project", folder / "import"
        ignored = shutil.ignore_patterns("__pycache__", ".git", ".venv", "build")
        shutil.copytree(ROOT, self.tree, ignore=ignored, symlinks=True)
        package = self.packages / "retrax"
        package.mkdir(parents=True)
        for path in [*(self.tree / "src" / "retrax").iterdir(), *map(self.tree.joinpath, ROOMS)]:
            (package / path.name).symlink_to(path)

    def notices(self, mutant: Mutant) -> str:
        """What notices the mutant; empty if nothing does."""
        path = self.tree / "src" / "core" / mutant.file
        right = path.read_text()
        lines = right.split("\n")
        lines[mutant.line - 1] = mutant.wrong
        path.write_text("\n".join(lines))
        try:
            return self._compiled() or self._tested()
        finally:
            path.write_text(right)

    def _compiled(self) -> str:
        sources = sorted(map(str, (self.tree / "src" / "core").glob("*.c")))
        library = self.tree / "src" / "retrax" / "_core.abi3.so"
        made = subprocess.run([*COMPILER, *sources, "-o", library, "-lm"], capture_output=True, check=False)
        return "the compiler" if made.returncode else ""

    def _tested(self) -> str:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *TESTS]
        environment = os.environ | {"PYTHONPATH": str(self.packages)}
        try:
            options = {"capture_output": True, "text": True, "check": False, "timeout": LONGEST}
            ended = subprocess.run(command, cwd=self.tree, env=environment, **options)
        except subprocess.TimeoutExpired:
            return "a test that does not end"
        failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", ended.stdout, re.M)
        return "" if ended.returncode == 0 else (failed or ["a crash"])[0]


def main() -> int:
    """Draw, compile, run, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", default="0/1")
    options = parser.parse_args()
    first, step = map(int, options.part.split("/"))
    mutants, left = drawn(options.count, options.seed)[first::step], []
    with tempfile.TemporaryDirectory() as folder:
        copy = CoreCopy(Path(folder))
        for mutant in mutants:
            by = copy.notices(mutant)
            words = f"{mutant.file}:{mutant.line}\n    {mutant.right.strip()}\n    {mutant.wrong.strip()}"
            print(f"{by or 'NOT NOTICED'}: {words}", flush=True)
            left += [] if by else [words]
    print(f"{len(mutants) - len(left)} of {len(mutants)} noticed; not:", *left, sep="\n  ")
    return len(left)


if __name__ == "__main__":
    sys.exit(main())
