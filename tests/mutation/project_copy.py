"""A copy of the project in which one file is changed, and tests run on it in forks of one process."""

import importlib
import os
import pkgutil
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable
from enum import Enum
from functools import partial
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("manifolds", "retractions", "integrators")
# Imported once for all forks, with the project itself, and before any of them.
BEFORE = ("hypothesis", "jax.scipy.linalg", "scipy.integrate", "scipy.optimize")
# Their dependencies may be missing; the compiled core is a library in C, not a module of Python.
LEFT_OUT = ("retrax.plotting", "retrax.interop", "retrax._core")
BROKEN = 70  # exit status of a fork in which pytest itself did not run
# Of a machine that is busy with other things, a fork may have so little that it takes so many times its own seconds.
BUSY = 5


class Outcome(Enum):
    """How the tests of a mutant ended; a test that never ends, or fails without the error, has not noticed it."""

    KILLED = "killed"
    SURVIVED = "SURVIVED"
    ENDLESS = "TIMED OUT"
    WITHOUT = "FAILS WITHOUT THE ERROR"
    NO_TEST = "NO TEST"


class ProjectCopy:
    """A copy of the project that is imported as it stands, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tree = folder.resolve(), folder.resolve() / "project"
        for name in ("src", "tests", "docs", "examples", *ROOMS):
            shutil.copytree(ROOT / name, self.tree / name, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "README.md"):
            shutil.copy2(ROOT / name, self.tree / name)
        package = self.folder / "import" / "retrax"
        package.mkdir(parents=True)
        for path in (self.tree / "src" / "retrax").iterdir():
            (package / path.name).symlink_to(path)
        for name in ROOMS:
            (package / name).symlink_to(self.tree / name)
        sys.dont_write_bytecode = True
        sys.path[:] = [str(package.parent), str(self.tree), *(path for path in sys.path if path != str(ROOT))]
        forgotten()
        for name in (*BEFORE, "retrax"):
            importlib.import_module(name)
        for module in pkgutil.walk_packages(sys.modules["retrax"].__path__, "retrax."):
            if not module.name.startswith(LEFT_OUT):
                importlib.import_module(module.name)

    def run_with(self, file: str, wrong: str, anew: bool, tests: list[str], longest: float) -> tuple[Outcome, str]:
        """The outcome of the tests up to the first that fails, with another text in a file, for at most so many seconds
        of a processor; and the end of what they print. ``anew``: the project is imported with that text."""
        path = self.tree / file
        right = path.read_text()
        first = ["--cache-clear", *tests]
        if anew:
            path.write_text(wrong)
            outcome, words = self.run(first, longest, forgotten)
            path.write_text(right)
        else:
            outcome, words = self.run(first, longest, partial(changed, path, wrong))
        if outcome is Outcome.KILLED and self.run(["--lf", *tests], longest, list)[0] is not Outcome.SURVIVED:
            return Outcome.WITHOUT, words
        return outcome, words

    def run(self, tests: list[str], longest: float, begin: Callable[[], object]) -> tuple[Outcome, str]:
        """The same of arguments of pytest, in a process that begins with something."""
        end, output = time.monotonic() + BUSY * longest, self.folder / "output"
        child = os.fork()
        if child == 0:
            code = BROKEN
            try:
                resource.setrlimit(resource.RLIMIT_CPU, (int(longest), int(longest) + 1))
                code = self._test(tests, output, begin)
            except Exception:
                traceback.print_exc()
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        code = None
        while code is None and time.monotonic() < end:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                code = os.waitstatus_to_exitcode(status)
            time.sleep(0.05)
        if code is None:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        words = output.read_text(errors="replace")
        return _outcome(code, words), words[-3000:]

    def _test(self, tests: list[str], output: Path, begin: Callable[[], object]) -> int:
        """Pytest's exit status, in a process of its own."""
        with output.open("w") as written:
            for stream in (1, 2):
                os.dup2(written.fileno(), stream)
        os.chdir(self.tree)
        begin()
        options = ["-x", "-q", "-n", "0", "--assert=plain", "-o", f"cache_dir={self.folder / 'cache'}"]
        return int(pytest.main([*options, *tests]))


def forgotten() -> None:
    """Forget what is imported of the project."""
    for name in [name for name in sys.modules if name.partition(".")[0] in ("tests", "retrax")]:
        del sys.modules[name]


def changed(path: Path, wrong: str) -> None:
    """Let what is imported of the project run another text."""
    from .changed_code import change  # of the project that is imported by now

    change(path, wrong)


def _outcome(code: int | None, output: str) -> Outcome:
    """What an exit status says; a test has noticed the error too that ends its process, and a file of tests that cannot
    be imported any more, of which pytest says no more than that it did not find its tests."""
    if code is None or code in (-signal.SIGXCPU, -signal.SIGKILL):
        return Outcome.ENDLESS
    if code < 0 or (code in (2, 4) and "ERROR collecting" in output):
        return Outcome.KILLED
    return {0: Outcome.SURVIVED, 1: Outcome.KILLED}.get(code, Outcome.NO_TEST)
