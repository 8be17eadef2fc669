"""The fast tests that run a line, quickest first, from one run of them under coverage."""

import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from coverage import CoverageData

SETTINGS = "[run]\nsource = manifolds,retractions,integrators,src/retrax\ndata_file = {}\n"
# Compiled code runs without Python: no coverage tells which tests run it.
COMPILED = ("tests/core", "tests/tape", "tests/integrators/test_inequalities.py")


class Covering:
    """What the fast tests of a project run, read from a folder, where a first use leaves it."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.root, self.data = root, CoverageData(str(folder / "coverage"))
        if not (folder / "coverage").exists():
            measure(root, folder)
        self.data.read()
        self.seconds = durations(folder / "junit.xml")

    def tests(self, file: str, line: int) -> list[str]:
        """The tests that run a line, quickest first; where none does, the tests of compiled code."""
        self.data.set_query_contexts(None)
        contexts = self.data.contexts_by_lineno(str(self.root / file)).get(line, [])
        found = {context.partition("|")[0] for context in contexts if context}
        return sorted(found & self.seconds.keys(), key=self.seconds.__getitem__) or list(COMPILED)

    def is_imported(self, file: str, line: int) -> bool:
        """Whether a line runs where the project is imported."""
        self.data.set_query_contexts(None)
        return "" in self.data.contexts_by_lineno(str(self.root / file)).get(line, [])


def measure(root: Path, folder: Path) -> None:
    """Run the fast tests under coverage, and leave its data and the seconds of each test in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "settings").write_text(SETTINGS.format(folder / "coverage"))
    options = ["--cov", f"--cov-config={folder / 'settings'}", "--cov-context=test", "--cov-report="]
    command = [sys.executable, "-m", "pytest", "-q", *options, f"--junitxml={folder / 'junit.xml'}"]
    subprocess.run(command, cwd=root, check=True)


def durations(path: Path) -> dict[str, float]:
    """The seconds that each test took, by its name as pytest takes it."""
    return {
        f"{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}": float(case.attrib["time"])
        for case in ElementTree.parse(path).iter("testcase")
    }
