"""A copy of the project in which one file is changed, and tests run on it in forks of one process."""

import importlib
import os
import re
import shutil
import signal
import sys
import time
import traceback
from enum import Enum
from pathlib import Path

import numba
import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("manifolds", "retractions", "integrators")
# Imported once for all forks, and before any of them; the modules of the project itself are not.
BEFORE = ("jax", "jax.numpy", "jax.scipy.linalg", "equinox", "jaxtyping", "casadi", "scipy.integrate", "scipy.optimize")
COMPILED = re.compile(r"import numba|from \.(factors|lu|arrays) import")
BROKEN = 70  # exit status of a fork in which pytest itself did not run


class Outcome(Enum):
    """How the tests of a mutant ended; a test that never ends has not noticed the error."""

    KILLED = "killed"
    SURVIVED = "SURVIVED"
    ENDLESS = "TIMED OUT"
    NO_TEST = "NO TEST"


class ProjectCopy:
    """A copy of the project that is imported as it stands, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tree = folder, folder / "project"
        for module in (*BEFORE, "hypothesis"):
            importlib.import_module(module)
        for name in ("src", "tests", *ROOMS):
            shutil.copytree(ROOT / name, self.tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "README.md"):
            shutil.copy2(ROOT / name, self.tree / name)
        package = folder / "import" / "retrax"
        package.mkdir(parents=True)
        for path in (self.tree / "src" / "retrax").iterdir():
            (package / path.name).symlink_to(path)
        for name in ROOMS:
            (package / name).symlink_to(self.tree / name)

    def run(self, tests: list[str], longest: float, kernels: str = "kernels") -> tuple[Outcome, str]:
        """The outcome of the tests up to the first that fails, for at most so many seconds, and the end of what they
        print."""
        end, output = time.monotonic() + longest, self.folder / "output"
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
        outcome = Outcome.ENDLESS
        while time.monotonic() < end:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                codes = {0: Outcome.SURVIVED, 1: Outcome.KILLED}
                outcome = codes.get(os.waitstatus_to_exitcode(status), Outcome.NO_TEST)
                break
            time.sleep(0.05)
        else:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        return outcome, output.read_text(errors="replace")[-3000:]

    def _test(self, tests: list[str], kernels: str, output: Path) -> int:
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

    def run_with(self, file: str, wrong: str, tests: list[str], longest: float) -> tuple[Outcome, str]:
        """The same with another text in a file, which gets its own text back."""
        path = self.tree / file
        text, times = path.read_text(), path.stat()
        kernels = "kernels_of_mutant" if COMPILED.search(text) else "kernels"
        path.write_text(wrong)
        try:
            return self.run(tests, longest, kernels)
        finally:
            path.write_text(text)
            os.utime(path, (times.st_atime, times.st_mtime))
            shutil.rmtree(self.folder / "kernels_of_mutant", ignore_errors=True)
