"""Plants errors in a copy of the project, one after the other, and runs the fast tests that should notice them.

``python tests/mutation/run.py`` prints a line for each error, then those that no test noticed; its exit status is their
number. ``--only WORDS``: those with these words in their name or file; ``--part K/M``: every M-th, from the K-th on;
``--trust``: do not run the tests without an error first. The kernels of Numba are compiled anew where a compiled file
is changed.
"""

import argparse
import importlib
import os
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

import numba
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from tests.mutation.planted import PLANTED, Planted  # noqa: E402

ROOMS = {"manifolds": "manifolds", "retractions": "retractions", "integrators": "integrators"}
# Imported once for all forks, and before any of them; what the project itself is made of is not.
BEFORE = (
    "jax",
    "jax.numpy",
    "jax.scipy.linalg",
    "equinox",
    "jaxtyping",
    "casadi",
    "scipy.integrate",
    "scipy.optimize",
    "hypothesis",
)
LONGEST = 300  # seconds of the tests of one error: an endless loop is noticed too
COMPILED = re.compile(r"import numba|from \.(factors|lu|arrays) import")
PASSED, FAILED, BROKEN = 0, 1, 70  # of pytest; other numbers say that no test was run


class Copy:
    """A copy of the project that is imported as it stands, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tree = folder, folder / "project"
        for name in ("src", "tests", *ROOMS):
            shutil.copytree(ROOT / name, self.tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "README.md"):
            shutil.copy2(ROOT / name, self.tree / name)
        package = folder / "import" / "retrax"
        package.mkdir(parents=True)
        for path in (self.tree / "src" / "retrax").iterdir():
            (package / path.name).symlink_to(path)
        for name, room in ROOMS.items():
            (package / name).symlink_to(self.tree / room)

    def run(self, tests: tuple[str, ...], kernels: str) -> tuple[int, float]:
        """Run tests up to the first that fails, in a fork of this process; pytest's exit status, and the seconds it
        took."""
        begin, output = time.monotonic(), self.folder / "output"
        child = os.fork()
        if child == 0:
            code = BROKEN
            try:
                code = self._test(tests, kernels, output)
            except Exception:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        while time.monotonic() < begin + LONGEST:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                code = os.waitstatus_to_exitcode(status)
                if code not in (PASSED, FAILED):
                    print(output.read_text()[-3000:])
                return code, time.monotonic() - begin
            time.sleep(0.05)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return FAILED, time.monotonic() - begin

    def _test(self, tests: tuple[str, ...], kernels: str, output: Path) -> int:
        """Pytest's exit status, in a process that has not imported the project before."""
        with output.open("w") as file:
            for stream in (1, 2):
                os.dup2(file.fileno(), stream)
        os.chdir(self.tree)
        sys.path[:] = [str(self.folder / "import"), str(self.tree), *(path for path in sys.path if path != str(ROOT))]
        for name in [name for name in sys.modules if name.partition(".")[0] in ("tests", "retrax")]:
            del sys.modules[name]
        sys.dont_write_bytecode = True
        numba.config.CACHE_DIR = str(self.folder / kernels)
        options = ["-x", "-q", "-n", "0", "--assert=plain", "-o", f"cache_dir={ROOT / '.pytest_cache'}"]
        return int(pytest.main([*options, *tests]))

    def run_with(self, planted: Planted, number: int) -> tuple[int, float]:
        """The same with an error, which is taken out again."""
        path = self.tree / planted.file
        text, times = path.read_text(), path.stat()
        kernels = f"kernels{number}" if COMPILED.search(text) else "kernels"
        path.write_text(text.replace(planted.right, planted.wrong))
        try:
            return self.run(planted.tests, kernels)
        finally:
            path.write_text(text)
            os.utime(path, (times.st_atime, times.st_mtime))
            shutil.rmtree(self.folder / f"kernels{number}", ignore_errors=True)


def chosen() -> tuple[dict[str, Planted], bool]:
    """The errors that were asked for, and whether the tests are to be run without one first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="")
    parser.add_argument("--part", default="0/1")
    parser.add_argument("--trust", action="store_true")
    asked = parser.parse_args()
    first, step = map(int, asked.part.split("/"))
    found = {name: one for name, one in PLANTED.items() if asked.only in name or asked.only in one.file}
    return dict(list(found.items())[first::step]), not asked.trust


def main() -> int:
    """Plant the errors that were asked for."""
    errors, check = chosen()
    survived, begin = [], time.monotonic()
    for module in BEFORE:
        importlib.import_module(module)
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        if check:
            tests = tuple(dict.fromkeys(test for one in errors.values() for test in one.tests))
            status, seconds = copy.run(tests, "kernels")
            print(
                f"{seconds:6.1f} s  {'passed' if status == PASSED else f'FAILED ({status})'}  without an error",
                flush=True,
            )
            if status != PASSED:
                return 1
        for number, (name, planted) in enumerate(errors.items()):
            status, seconds = copy.run_with(planted, number)
            word = {FAILED: "killed", PASSED: "SURVIVED"}.get(status, f"NO TEST ({status})")
            print(f"{seconds:6.1f} s  {word}  {name}", flush=True)
            survived += [] if status == FAILED else [name]
    minutes = (time.monotonic() - begin) / 60
    print(f"{len(errors) - len(survived)} of {len(errors)} killed in {minutes:.0f} minutes", *survived, sep="\n  ")
    return len(survived)


if __name__ == "__main__":
    sys.exit(main())
